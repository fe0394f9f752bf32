"""What getting out of a vehicle demands of any motion: phases as data, and the places that a record chose."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from costs.names import would_do
from costs.robot import RobotModel
from costs.scene import Scene
from service.demands.contacts.contact_task import face_pieces, find_off
from service.demands.contacts.demand import StancesDemand
from service.demands.contacts.moved_places import FINISH, find_recorded
from service.demands.contacts.stances import (
    ContactStance,
    StanceContact,
    Surface,
    ends_with_new_contacts,
    find_link_pose,
    place_patch,
    place_patch_as_it_is,
)
from service.demands.contacts.surfaces import find_unknown, make_surfaces
from service.demands.egress.mirrored_phases import mirror_phases
from service.errors import RequestError, shown
from service.request.file import load_section
from service.request.tasks.contacts import SurfaceRequest
from service.request.tasks.egress import ContactRequest, EgressRequest, PhaseRequest, PhasesFile
from service.verify import Motion

SHIPPED_PHASES = Path(__file__).with_name("egress_phases.yaml")
SHIPPED_SIDE = "right"
BEYOND_M = 0.1  # by which a given place may be beyond the edges of its surface, onto which it is brought
GIVEN_M = 1e-3  # by which a recorded contact may be off a place that the phases give
TOE_M = 1e-3  # by which points of the toe differ along the link
GIVEN_RAD = 1e-3  # the same of its turn
MOST_TURN_RAD = float(np.deg2rad(30.0))  # of a patch at a drawn place, so that it is on its surface


def load_phases(request: EgressRequest, robot: RobotModel, folder: Path = Path()) -> tuple[PhaseRequest, ...]:
    """Return the request's phases, those of its file, or those that ship with the package, as far as they are wanted.

    Those that ship are of the right side, and mirrored for the left one.

    Raises:
        RequestError: the file cannot be used, or ``until`` names none of its phases.
    """
    phases = request.phases
    if not phases:
        path = SHIPPED_PHASES if request.phases_file is None else folder / request.phases_file
        phases = load_section(PhasesFile, path).phases
        if request.phases_file is None and request.side != SHIPPED_SIDE:
            phases = mirror_phases(robot, phases)
    if request.until is None:
        return phases
    names = [phase.name for phase in phases]
    if request.until not in names[1:]:
        raise RequestError(
            f"task.egress.until: no phase {shown(request.until)} after the first; "
            f"expected {would_do(request.until, names[1:])}"
        )
    return phases[: names.index(request.until) + 1]


@dataclass(frozen=True)
class EgressDemand(StancesDemand):
    """What the task of getting out demands.

    Attributes:
        request: the task.
        robot: with contact patches.
        scene: all pieces.
        start: (n,) seated configuration.
        surfaces: by name.
        phases: of contacts, in their order.
    """

    request: EgressRequest
    robot: RobotModel
    scene: Scene
    start: Float[np.ndarray, "n"]
    surfaces: dict[str, Surface]
    phases: tuple[PhaseRequest, ...]

    @property
    def named_surfaces(self) -> dict[str, SurfaceRequest]:
        """Surfaces of the request by name."""
        return dict(self.request.surfaces)

    def has_finish(self, stances: Sequence[ContactStance]) -> bool:
        """Whether the last stance makes contacts that a last phase moves onto."""
        return ends_with_new_contacts(stances)

    @staticmethod
    def of(
        request: EgressRequest, robot: RobotModel, scene: Scene, start: Float[np.ndarray, "n"], folder: Path = Path()
    ) -> EgressDemand:
        """Return the demands of a request.

        Raises:
            RequestError: surfaces or phases that cannot be used.
        """
        if not robot.is_floating:
            raise RequestError("task.egress: this robot's base is fixed; it leaves no vehicle")
        surfaces = make_surfaces(request.surfaces, scene, "task.egress.surfaces")
        phases = load_phases(request, robot, folder)
        problems = [
            line
            for k, phase in enumerate(phases)
            for patch, contact in phase.contacts.items()
            if (line := find_unknown(robot, surfaces, patch, contact.surface, f"task.egress.phases[{k}].contacts"))
        ]
        if problems:
            raise RequestError(problems)
        return EgressDemand(request, robot, scene, start, surfaces, phases)

    def seat(self) -> ContactStance:
        """Return the stance at the start: the contacts of the first phase where the start has them.

        Raises:
            RequestError: one line per contact that is off its surface.
        """
        first, contacts, problems = self.phases[0], [], list[str]()
        for patch, contact in first.contacts.items():
            placed = place_patch_as_it_is(self.robot, self.start, patch, self.surfaces[contact.surface])
            contacts.append(face_pieces(placed, self.scene))
            off = find_off(contacts[-1], self.scene, f"task.egress: '{first.name}': {patch}")
            problems += [off] if off else []
        if problems:
            raise RequestError(problems)
        return ContactStance(first.name, tuple(contacts))

    def read_stances(self, recorded: Motion) -> tuple[tuple[ContactStance, ...], tuple[str, ...]]:
        """Return the stances with the places that a record chose, and a sentence for each that the phases forbid."""
        stances, problems = [self.seat()], list[str]()
        for k, phase in enumerate(self.phases[1:], start=1):
            before = {contact.patch: contact for contact in stances[-1].contacts}
            contacts = []
            for patch, contact in phase.contacts.items():
                surface = self.surfaces[contact.surface]
                is_placed = contact.at is not None or contact.toe is not None or contact.yaw_deg is not None
                if not is_placed and patch in before and before[patch].surface.name == surface.name:
                    contacts.append(before[patch])
                    continue
                later = {phase.name for phase in self.phases[k + 1 :]} | {FINISH}
                planted = find_recorded(recorded, self.robot.contacts[patch].link, later)
                if planted is None:
                    problems.append(f"no phase of the record stands on {patch} after '{phase.name}'")
                    continue
                placed = place_patch(self.robot.contacts[patch], patch, surface, planted.pose_world_link)
                contacts.append(replace(face_pieces(placed, self.scene), slack_m=contact.slack_m))
                problems += self._find_forbidden(contacts[-1], contact, phase.name)
            stances.append(ContactStance(phase.name, tuple(contacts)))
        return tuple(stances), tuple(problems)

    def _find_forbidden(self, contact: StanceContact, request: ContactRequest, phase: str) -> Iterator[str]:
        """Yield a sentence where a contact is off its surface, or not where the phases have it."""
        words = f"{contact.patch} in '{phase}'"
        off = find_off(contact, self.scene, words)
        if off is not None:
            yield off
        patch, pose = self.robot.contacts[contact.patch], contact.planted.pose_world_link
        given = request.at if request.toe is None else request.toe
        if given is not None:
            mark = patch.points.mean(axis=0) if request.toe is None else find_toe(patch.points)
            wanted = contact.surface.bring_onto(np.array(given))
            away = np.abs(pose[:3, :3] @ mark + pose[:3, 3] - wanted)
            room = np.full(3, GIVEN_M) if request.region is None else np.array([*request.region, 0.0]) / 2.0 + GIVEN_M
            if request.region is not None:  # a drawn place is brought onto the surface as well
                room += np.abs(wanted - np.array(given))
            room += request.slack_m * np.abs(contact.surface.along)
            if np.any(away > room):
                yield f"{words} is {away.max():.3f} m from the place that the phases give"
        if request.yaw_deg is not None and len(patch.points) >= 3:
            yaw = float(np.deg2rad(request.yaw_deg))
            wanted = find_link_pose(patch, contact.surface, contact.points.mean(axis=0), yaw)
            turn = np.arccos(np.clip((np.trace(wanted[:3, :3].T @ pose[:3, :3]) - 1.0) / 2.0, -1.0, 1.0))
            if turn > GIVEN_RAD + (MOST_TURN_RAD if request.region is not None else 0.0):
                yield f"{words} is turned by {np.rad2deg(turn):.1f} deg from what the phases give"


def find_toe(points: Float[np.ndarray, "C 3"]) -> Float[np.ndarray, "3"]:
    """Return the middle of the points of a patch that are farthest along its link's x axis [m]."""
    return np.asarray(points[points[:, 0] >= points[:, 0].max() - TOE_M].mean(axis=0))
