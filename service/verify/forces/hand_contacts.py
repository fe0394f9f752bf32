"""Checks of hands that move a mechanism: their surfaces touch it, and push it the way that it moves.

At a contact the force is inside the friction cone about the normal, which the shapes decide: the direction from the
core of the hand's surface to the core of the body (``service.verify.forces.rounded``).  The rules of a pose are in
``service.verify.forces.hand_balance``.

Between two poses the normal is bounded as well (``service.verify.forces.turning``).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from costs.robot import LinkBody, read_joint_axis
from service.verify.certificate import Check
from service.verify.forces.hand_balance import (
    LEAST_APART_M,
    TOUCH_GAP_M,
    Meeting,
    find_jamming_angle,
    measure_excesses,
    meet,
)
from service.verify.forces.hand_loads import bound_coordinate
from service.verify.forces.rounded import RoundedBody, measure_beyond_hull
from service.verify.forces.turning import bound_turns
from service.verify.frame_paths import FramePath, find_mechanism_joints
from service.verify.motion import HandContact, HandPush, Motion, Phase, VerifyError, VerifySettings
from service.verify.phase_proof import PhaseProof, values_at_ends
from service.verify.prepared_motion import PreparedMotion

SURFACE_SLACK_M = 2e-3  # by which a stated surface of a hand may stand out of the link's shapes
MOVES = 1e-4  # by which a joint moves [rad, m]
_DISTANCE_ERROR_M = 1e-6  # tolerance of coal's distances, which counts like a displacement of the core
MOST_HALVINGS = 9  # of intervals: a contact that needs more is at the edge of its cone
_GAP_RESOLUTION_M = 5e-4
_RESOLUTION = float(np.deg2rad(1.0))
_MORE_THAN_SQUARE = 0.5 * np.pi + 0.01


def list_moving_joints(motion: Motion, phase: Phase) -> tuple[str, ...]:
    """Return the joints of the mechanism that move in a phase."""
    model, moving = motion.robot.model, []
    for joint in sorted(find_mechanism_joints(motion)):
        low, high = bound_coordinate(motion.curve, int(model.joints[joint].idx_q), phase.first, phase.last)
        if high - low > MOVES:
            moving.append(str(model.names[joint]))
    return tuple(moving)


def check_hand_contacts(prepared: PreparedMotion, phase: Phase, settings: VerifySettings) -> Iterator[Check]:
    """Check every push of a phase: the hand touches what it presses, and can push it the way it goes.

    Raises:
        VerifyError: a push names a joint, link, body or frame that the motion does not have, or a surface that stands
            out of its link.
    """
    proof = PhaseProof(prepared, phase, replace(settings, max_halvings=min(settings.max_halvings, MOST_HALVINGS)))
    for push in phase.pushes:
        for contact in push.contacts:
            _check_surface(prepared.motion, contact)
        path = PushPath(prepared, push, settings.rounding)
        names = tuple(dict.fromkeys(name for contact in push.contacts for name in (contact.frame, contact.body)))
        surfaces, bodies = _name_contacts(push, " or ")
        gap = proof.bound(path.bound_gap, TOUCH_GAP_M, _GAP_RESOLUTION_M)
        text = f"{surfaces} touches {bodies} during {phase.name}"
        failure = f"{surfaces} is {1e3 * gap.sampled:.1f} mm off {bodies} during {phase.name}"
        name, place = f"hand_touch.{phase.name}.{push.joint}", path.locate(gap.s)
        yield proof.check(name, gap, TOUCH_GAP_M, "m", text, place, names=names, failure=failure)
        excess = proof.bound(path.bound_excess, 0.0, _RESOLUTION)
        angle = path.measure_angle(excess.s)
        text = f"{describe_push(push, angle)} during {phase.name}"
        failure = f"{describe_failure(push, angle)} during {phase.name}"
        name, place = f"hand_contact.{phase.name}.{push.joint}", path.locate(excess.s)
        yield proof.check(name, excess, 0.0, "rad", text, place, names=names, failure=failure)


def describe_push(push: HandPush, angle: float) -> str:
    """Return a sentence about contacts that push, given the least angle between way and normal [rad]."""
    surfaces, bodies = _name_contacts(push)
    held = f" while {' and '.join(held.joint for held in push.held)} stays" if push.held else ""
    low, high = push.friction
    if len(push.contacts) > 1:
        return f"{surfaces} together push {bodies} the way of joint {push.joint}{held}, with a friction of {low:g}"
    degrees = f"{np.rad2deg(angle):.1f} deg off the way of joint {push.joint}{held}"
    return f"{surfaces} pushes {bodies} {degrees}, with a friction of {low:g} to {high:g}"


def describe_failure(push: HandPush, angle: float) -> str:
    """Return a sentence about contacts that do not push, given the least angle between way and normal [rad]."""
    surfaces, bodies = _name_contacts(push)
    if not np.isfinite(angle):
        return f"{surfaces} does not touch {bodies}, which it is to push the way of joint {push.joint}"
    degrees = f"the contact's normal is {np.rad2deg(angle):.0f} deg off the way of joint {push.joint}"
    low, high = push.friction
    if angle > _MORE_THAN_SQUARE:
        return f"{surfaces} would have to pull {bodies}: {degrees}, and a contact only pushes"
    if len(push.contacts) > 1:
        held = f" and keep {' and '.join(held.joint for held in push.held)} still" if push.held else ""
        able = f"no forces below their caps, inside cones of a friction of {low:g}, do"
        return f"{surfaces} together do not push {bodies} the way of joint {push.joint}{held}: {able}"
    most = find_jamming_angle(push)
    if angle > most:
        return f"{surfaces} jams on {bodies}: {degrees}, a friction of {high:g} permits at most {np.rad2deg(most):.0f}"
    if push.held:
        held = " and ".join(held.joint for held in push.held)
        return f"{surfaces} would move {held} besides {push.joint}: a friction of {low:g} does not prevent it"
    return f"{surfaces} slips on {bodies}: {degrees}, a friction of {low:g} does not hold it"


def _name_contacts(push: HandPush, word: str = " and ") -> tuple[str, str]:
    """Return the surfaces and the bodies of a push in words, joined by a word."""
    surfaces = dict.fromkeys(contact.surface for contact in push.contacts)
    bodies = dict.fromkeys(contact.body for contact in push.contacts)
    return word.join(surfaces), word.join(bodies)


class PushPath:
    """The contacts of a push along the motion."""

    def __init__(self, prepared: PreparedMotion, push: HandPush, rounding: float) -> None:
        """Prepare.

        Raises:
            VerifyError: the push names a joint, link, body or frame that the motion does not have.
        """
        self._prepared, self._push = prepared, push
        motion = prepared.motion
        self._joints = [_find_joint(motion, name) for name in (push.joint, *(held.joint for held in push.held))]
        self._axes = [read_joint_axis(motion.robot, joint) for joint in self._joints]
        self._bodies = [find_pushed_body(motion, contact) for contact in push.contacts]
        self._paths = [
            FramePath.of(prepared, contact.frame, contact.core, rounding, contact.link) for contact in push.contacts
        ]
        self._known: dict[float, tuple[Meeting, ...]] = {}
        self._cores: dict[float, tuple[Float[np.ndarray, "K 3"], ...]] = {}
        self._excesses: dict[float, float] = {}

    def meet(self, s: float) -> tuple[Meeting, ...]:
        """Return where each contact meets its body at a path parameter."""
        self._find(np.array([s]))
        return self._known[s]

    def place_cores(self, s: float) -> tuple[Float[np.ndarray, "K 3"], ...]:
        """Return the points of each contact's core at a path parameter, as seen from what it presses [m]."""
        self._find(np.array([s]))
        return self._cores[s]

    def _find(self, s: Float[np.ndarray, "S"]) -> None:
        """Find where the contacts meet their bodies at path parameters, all that are new at once."""
        new = np.array([at for at in dict.fromkeys(s.tolist()) if at not in self._known])
        if not len(new):
            return
        placed, rows = self._prepared.at(new)
        contacts = zip(self._push.contacts, self._bodies, self._paths, strict=True)
        met, cores = list[list[Meeting]](), list[Float[np.ndarray, "S K 3"]]()
        for contact, body, path in contacts:
            points, rotations = path.at(new)
            moved = [placed.relative(body.joint, joint, rows) for joint in self._joints]
            cores.append(points)
            met.append([])
            for k in range(len(new)):
                pose = (rotations[k], points[k, 0] - rotations[k] @ contact.core[0])
                ways = [_find_way(axis, turned[k], at[k]) for axis, (turned, at) in zip(self._axes, moved, strict=True)]
                met[-1].append(meet(contact, body, pose, self._push.sense, ways))
        for k, at in enumerate(new.tolist()):
            self._known[at], self._cores[at] = tuple(each[k] for each in met), tuple(each[k] for each in cores)

    def bound_gap(self, first: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return bounds of the nearest contact's gap on intervals, and its values at their ends [m]."""
        ends = values_at_ends(self._list_gaps, first, last)
        return np.maximum(*ends) + self.bound_travel(first, last).max(axis=0), *ends

    def bound_excess(self, first: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return on intervals how much wider the cones would have to be at most, and the same at their ends [rad]."""
        ends = values_at_ends(self._list_excesses, first, last)
        travel = np.tile(self.bound_travel(first, last), 2)
        turns = self._bound_turns(np.concatenate([first, last]), travel).reshape(2, -1).max(axis=0)
        return np.maximum(*ends) + turns, *ends

    def _bound_turns(self, s: Float[np.ndarray, "S"], travel: Float[np.ndarray, "C S"]) -> Float[np.ndarray, "S"]:
        """Return by how much any contact's normal turns where its core moves by a travel from each pose [rad]."""
        turns = np.zeros(len(s))
        for k, body in enumerate(self._bodies):
            met = [self._known[at][k] for at in s.tolist()]
            cores = np.stack([self._cores[at][k] for at in s.tolist()])
            apart = np.maximum([meeting.apart for meeting in met], LEAST_APART_M)
            normals = np.stack([meeting.normal for meeting in met])
            turns = np.maximum(turns, bound_turns(cores, RoundedBody.of_body(body), normals, apart, travel[k]))
        return turns

    def _list_gaps(self, s: Float[np.ndarray, "S"]) -> Float[np.ndarray, "S"]:
        self._find(s)
        return np.array([min(meeting.gap for meeting in self._known[at]) for at in s.tolist()])

    def _list_excesses(self, s: Float[np.ndarray, "S"]) -> Float[np.ndarray, "S"]:
        self._find(s)
        new = [at for at in dict.fromkeys(s.tolist()) if at not in self._excesses]
        self._excesses |= zip(new, measure_excesses(self._push, [self._known[at] for at in new]).tolist(), strict=True)
        return np.array([self._excesses[at] for at in s.tolist()])

    def bound_travel(self, first: np.ndarray, last: np.ndarray) -> Float[np.ndarray, "C I"]:
        """Return per contact how far its core's points are at most from where they are at the nearer end [m].

        On the curve itself: exported samples, read linearly, leave it by less than any part is made exactly.
        """
        travels = []
        for path in self._paths:
            chord = np.linalg.norm(path.at(last)[0] - path.at(first)[0], axis=2).max(axis=1)
            travels.append(0.5 * chord + path.chain.deviation(self._prepared.over(first, last)) + _DISTANCE_ERROR_M)
        return np.array(travels)

    def measure_angle(self, s: float) -> float:
        """Return the least angle between a contact's normal and the way; infinite where none touches [rad]."""
        return min((meeting.angle for meeting in self.meet(s) if meeting.is_touching), default=float("inf"))

    def locate(self, s: float) -> Float[np.ndarray, "3"]:
        """Return the first contact's point in the world [m]."""
        placed, rows = self._prepared.at(np.array([s]))
        rotation, translation = placed.relative(0, self._bodies[0].joint, rows)
        return np.asarray(rotation[0] @ self.meet(s)[0].point + translation[0])


def _find_way(
    axis: Float[np.ndarray, "6"], turned: Float[np.ndarray, "3 3"], moved: Float[np.ndarray, "3"]
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Return how a joint moves the origin of a body's frame, and turns it, per unit of its coordinate.

    Args:
        axis: (6,) of the joint in its own frame, linear and angular.
        turned, moved: pose of the joint's frame in the body's.
    """
    (x, y, z), (a, b, c) = (turned @ axis[3:]).tolist(), moved.tolist()
    return turned @ axis[:3] - [y * c - z * b, z * a - x * c, x * b - y * a], np.array([x, y, z])


def find_pushed_body(motion: Motion, contact: HandContact) -> LinkBody:
    """Return the body of the mechanism that a contact presses.

    Raises:
        VerifyError: the motion has none of that name.
    """
    for body in motion.robot.bodies:
        if body.name == contact.body and body.link == contact.link and body.link in motion.mechanism_links:
            return body
    raise VerifyError(f"no body '{contact.body}' of the mechanism's link '{contact.link}', which a hand is to press")


def _find_joint(motion: Motion, name: str) -> int:
    """Return the index of a joint (VerifyError where there is none of that name)."""
    model = motion.robot.model
    if not model.existJointName(name):
        raise VerifyError(f"unknown joint '{name}' of a push")
    return int(model.getJointId(name))


def _check_surface(motion: Motion, contact: HandContact) -> None:
    """Refuse a stated surface of a hand that stands out of the shapes that its frame carries.

    Raises:
        VerifyError: it does, or the robot has no such frame.
    """
    model = motion.robot.model
    if not model.existFrame(contact.frame):
        raise VerifyError(f"unknown frame '{contact.frame}' of a hand's contact")
    frame = model.frames[model.getFrameId(contact.frame)]
    points = contact.core @ np.array(frame.placement.rotation).T + np.array(frame.placement.translation)
    bodies = [body for body in motion.robot.bodies if body.joint == int(frame.parentJoint)]
    beyond = [measure_beyond_hull(points, body.vertices) + contact.radius for body in bodies]
    if min(beyond, default=np.inf) > SURFACE_SLACK_M:
        raise VerifyError(
            f"{contact.surface} of '{contact.frame}' stands {1e3 * min(beyond, default=np.inf):.1f} mm out of its "
            f"link's shapes; expected at most {1e3 * SURFACE_SLACK_M:g}"
        )
