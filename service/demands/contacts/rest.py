"""The rest of a plan that changes contacts: its stances from one of its phases on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.robot import BASE_NAMES, RobotModel
from service.demands.contacts.phases import FINISH, list_change_phases, list_contact_phases
from service.demands.contacts.stances import ContactChange, ContactStance, StanceContact, find_link_yaw
from service.demands.phase import TaskPhase
from service.errors import RequestError, shown, would_do
from service.request.tasks.contacts import (
    ContactsRequest,
    PlaceRequest,
    PostureRequest,
    StanceRequest,
    SurfaceRequest,
)
from service.verify import GROUND_TOLERANCE_M, Motion


@dataclass(frozen=True)
class ChangedContacts:
    """What an earlier plan did: its stances and its motion.

    Attributes:
        robot: with contact patches.
        stances: that of the start first.
        has_finish: whether a last phase leads to a posture.
        motion: of the plan.
        surfaces: of its request, by name.
    """

    robot: RobotModel
    stances: tuple[ContactStance, ...]
    has_finish: bool
    motion: Motion
    surfaces: dict[str, SurfaceRequest]

    def make_rest(self, phase: str, start: Float[np.ndarray, "n"], carrying: Sequence[str] | None) -> ContactsRequest:
        """Return the task of doing the rest.

        Args:
            phase: name of the phase to begin with.
            start: (n,) configuration of the robot as it is.
            carrying: patches that carry it; by default those that do so at the start of the phase.

        Raises:
            RequestError: there is no such phase, or a patch is unknown.
        """
        specs = list_contact_phases(self.stances, has_finish=self.has_finish)
        names = [spec.name for spec in specs]
        if phase not in names:
            raise RequestError(f"--from-phase: unknown phase {shown(phase)}; the plan has {', '.join(names)}")
        spec = specs[names.index(phase)]
        if self.has_finish and spec is specs[-1]:
            last = len(self.stances) - 1
            held = self._choose(self.stances[last].contacts, carrying)
            return ContactsRequest(self.surfaces, _name_surfaces(held), (self._stand(FINISH, phase),))
        k = next(
            k
            for k in range(1, len(self.stances))
            if phase in [own.name for own in list_change_phases(*self.stances[k - 1 : k + 1])]
        )
        held = self._choose(self._find_held(spec, k, start), carrying)
        on = {contact.patch: contact for contact in held}
        rest = [self._change(k, set(on))]
        rest += [self._change(later, None) for later in range(k + 1, len(self.stances))]
        if self.has_finish:
            rest.append(self._stand(FINISH, FINISH))
        stances = tuple(stance for stance in rest if stance is not None)
        return ContactsRequest(self.surfaces, _name_surfaces(held), stances)

    def _find_held(self, spec: TaskPhase, k: int, start: Float[np.ndarray, "n"]) -> tuple[StanceContact, ...]:
        """Return what carries the robot at the start of a phase; what has not left its place yet still does."""
        contacts = spec.contacts or ()
        if not any(frame.leaves for frame in spec.frames):
            return contacts
        return tuple(
            contact
            for contact in self.stances[k - 1].contacts
            if contact in contacts or _is_in_place(self.robot, contact, start)
        )

    def _choose(self, contacts: Sequence[StanceContact], carrying: Sequence[str] | None) -> tuple[StanceContact, ...]:
        """Return the contacts of some patches, by default as they are.

        Raises:
            RequestError: the plan has no contact of a patch.
        """
        if carrying is None:
            return tuple(contacts)
        known = {contact.patch: contact for stance in self.stances for contact in stance.contacts}
        known |= {contact.patch: contact for contact in contacts}
        unknown = [patch for patch in carrying if patch not in known]
        if unknown:
            expected = would_do(unknown[0], sorted(known))
            raise RequestError(f"contacts: the plan has no contact of {shown(unknown[0])}; expected {expected}")
        return tuple(known[patch] for patch in carrying)

    def _change(self, k: int, held: set[str] | None) -> StanceRequest | None:
        """Return the change to a stance; None where the robot has made it already.

        Args:
            k: of the stance.
            held: patches that carry the robot before; by default those of the stance before.
        """
        stance = self.stances[k]
        change = ContactChange.between(self.stances[k - 1], stance)
        if not change.leaving and not change.arriving:
            return self._stand(stance.name, f"{stance.name}: move")
        made = {contact.patch: _make_place(self.robot, contact) for contact in change.arriving}
        links = {contact.planted.link for contact in change.arriving}
        before = {c.patch for c in change.leaving} if held is None else held & {c.patch for c in change.leaving}
        released = tuple(c.patch for c in change.leaving if c.patch in before and c.planted.link not in links)
        if not made and not released:
            return None
        return StanceRequest(stance.name, made, released)

    def _stand(self, name: str, phase: str) -> StanceRequest:
        """Return the move to the pose at the end of a phase."""
        last = next(own.last for own in self.motion.phases if own.name == phase)
        return StanceRequest(name, posture=self._describe(self.motion.curve(np.array([last]))[0]))

    def _describe(self, q: Float[np.ndarray, "n"]) -> PostureRequest:
        """Return a configuration as a request has it."""
        robot = self.robot
        x, y, z, yaw, pitch, roll = q[: len(BASE_NAMES)].tolist()
        joints = dict(zip(robot.joint_names[len(BASE_NAMES) :], q[len(BASE_NAMES) : robot.n].tolist(), strict=True))
        return PostureRequest((x, y, z, yaw, pitch, roll), joints, next(iter(sorted(robot.postures))))


def _name_surfaces(contacts: Sequence[StanceContact]) -> dict[str, str]:
    return {contact.patch: contact.surface.name for contact in contacts}


def _make_place(robot: RobotModel, contact: StanceContact) -> PlaceRequest:
    """Return the place of a contact as a request has it."""
    yaw = find_link_yaw(robot.contacts[contact.patch], contact)
    x, y, z = contact.points.mean(axis=0).tolist()
    return PlaceRequest(contact.surface.name, (x, y, z), float(np.rad2deg(yaw)), contact.slack_m)


def _is_in_place(robot: RobotModel, contact: StanceContact, q: Float[np.ndarray, "n"]) -> bool:
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    pose = data.oMf[robot.model.getFrameId(contact.planted.link)]
    points = contact.planted.sole @ pose.rotation.T + pose.translation
    return bool(np.abs(contact.surface.measure_height(points)).max() <= GROUND_TOLERANCE_M)
