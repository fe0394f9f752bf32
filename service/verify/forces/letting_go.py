"""Check of a hand that leaves what it pressed: it drags no joint that nothing but the hand keeps where it is.

A hand that leaves still presses until it is off the face by as much as its servos and its surface had given way, and
drags what it slides along with a force of up to ``mu N``.  A joint that bears less goes along.  So where a joint does
not bear it, the hand leaves the face before it moves along the way of that joint.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from service.verify.certificate import Check
from service.verify.forces.hand_balance import LEAST_FORCE_N, LEAST_SHARE, find_least_share
from service.verify.forces.hand_contacts import PushPath, list_moving_joints
from service.verify.motion import HandPush, Phase, VerifySettings
from service.verify.phase_proof import PhaseProof, values_at_ends
from service.verify.prepared_motion import PreparedMotion

RELEASED_GAP_M = 1e-2  # from which on a hand that leaves presses no more
MOST_DRAG_M = 5e-3  # along the way of a joint that nothing else keeps still, before that
_RESOLUTION_M = 5e-4


def check_letting_go(prepared: PreparedMotion, phase: Phase, settings: VerifySettings) -> Iterator[Check]:
    """Check in a phase after a push, in which no joint moves, that the hand drags nothing along.

    Raises:
        VerifyError: a push names a joint, link, body or frame that the motion does not have.
    """
    before = _find_last_push(prepared, phase)
    if before is None:
        return
    proof = PhaseProof(prepared, phase, settings)
    for push in before.pushes:
        path = PushPath(prepared, push, settings.rounding)
        for index, held in enumerate(push.held):
            drag = JointDrag(path, push, index, before.last)
            if not drag.is_possible:
                continue
            found = proof.bound(drag.bound, MOST_DRAG_M, _RESOLUTION_M)
            bodies = " and ".join(dict.fromkeys(contact.body for contact in push.contacts))
            text = f"the hand leaves {bodies} before it moves along the way of {held.joint}, which nothing else holds"
            failure = (
                f"the hand drags {bodies} by {1e3 * found.sampled:.0f} mm along the way of {held.joint} as it leaves "
                f"during {phase.name}, and nothing else holds {held.joint}"
            )
            names = tuple(dict.fromkeys(name for each in push.contacts for name in (each.frame, each.body)))
            name, place = f"let_go.{phase.name}.{held.joint}", path.locate(found.s)
            yield proof.check(name, found, MOST_DRAG_M, "m", text, place, names=names, failure=failure)


def _find_last_push(prepared: PreparedMotion, phase: Phase) -> Phase | None:
    """Return the phase whose hand lets go during a later one: the last with pushes, if nothing has moved since."""
    phases = prepared.phases
    at = next(k for k, known in enumerate(phases) if known is phase)
    for known in phases[at::-1]:
        if known.pushes:
            return None if known is phase else known
        if list_moving_joints(prepared.motion, known):
            return None
    return None


class JointDrag:
    """Displacement of a hand along the way of a joint that has to stay, while it may still press [m]."""

    def __init__(self, path: PushPath, push: HandPush, index: int, begin: float) -> None:
        """Prepare.

        Args:
            path: of the push.
            push: what the hand exerted.
            index: of the held joint.
            begin: path parameter at which the hand lets go.
        """
        self._path = path
        self._begin = path.place_cores(begin)
        self._ways = np.zeros((len(push.contacts), 2, 3))  # per contact: towards greater values and smaller ones
        held = push.held[index]
        for k, (contact, meeting) in enumerate(zip(push.contacts, path.meet(begin), strict=True)):
            share = find_least_share(push, meeting) if len(push.contacts) == 1 else LEAST_SHARE
            pressure = max(push.force_n, LEAST_FORCE_N) / max(share, LEAST_SHARE)
            most = push.friction[1] * min(pressure, contact.cap_n)
            for sense, (way, bears) in enumerate(((meeting.held[index], held.high), (-meeting.held[index], -held.low))):
                pressed = float(way @ meeting.normal)  # a face that the hand leaves is pushed by it, and never pulled
                way = way - min(pressed, 0.0) * meeting.normal
                size = float(np.linalg.norm(way))
                if size > 0.0 and bears < most * size:
                    self._ways[k, sense] = way / size

    @property
    def is_possible(self) -> bool:
        """Whether the joint bears less than the hand may drag with."""
        return bool(self._ways.any())

    def bound(self, first: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return bounds of the displacement on intervals, and its values at their ends [m]."""
        ends = values_at_ends(self._list_displacements, first, last)
        travel = self._path.bound_travel(first, last)
        both = np.concatenate([first, last])
        highest = np.zeros(len(first))
        for k, far in enumerate(travel):
            gaps, sizes = (each(both, k).reshape(2, -1) for each in (self._list_gaps, self._list_along))
            is_near = gaps.min(axis=0) - far <= RELEASED_GAP_M
            highest = np.maximum(highest, np.where(is_near, sizes.max(axis=0) + far, 0.0))
        return highest, *ends

    def _list_displacements(self, s: Float[np.ndarray, "S"]) -> Float[np.ndarray, "S"]:
        sizes = [
            np.where(self._list_gaps(s, k) <= RELEASED_GAP_M, self._list_along(s, k), 0.0)
            for k in range(len(self._ways))
        ]
        return np.asarray(np.max(sizes, axis=0))

    def _list_gaps(self, s: Float[np.ndarray, "S"], contact: int) -> Float[np.ndarray, "S"]:
        return np.array([self._path.meet(at)[contact].gap for at in s.tolist()])

    def _list_along(self, s: Float[np.ndarray, "S"], contact: int) -> Float[np.ndarray, "S"]:
        moved = [self._path.place_cores(at)[contact] - self._begin[contact] for at in s.tolist()]
        return np.array([max(float((each @ self._ways[contact].T).max()), 0.0) for each in moved])
