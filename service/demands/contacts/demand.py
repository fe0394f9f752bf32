"""What moving from stance to stance demands of any motion."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.robot import RobotModel
from costs.scene import Scene
from service.demands.contacts.moved_places import take_recorded_places
from service.demands.contacts.phases import list_change_phases, list_contact_phases
from service.demands.contacts.rest import ChangedContacts
from service.demands.contacts.stances import ContactChange, ContactStance, StanceContact
from service.demands.task_demand import IncompletePlanError, RecordDemand, TaskDemand, World
from service.request.tasks.contacts import SurfaceRequest
from service.request.tasks.registry import TaskRequest
from service.verify import Motion


class StancesDemand(TaskDemand):
    """A task that moves from stance to stance."""

    @abstractmethod
    def read_stances(self, recorded: Motion) -> tuple[tuple[ContactStance, ...], tuple[str, ...]]:
        """Return the stances with the places that a record chose, and a sentence for each that is forbidden."""

    @abstractmethod
    def has_finish(self, stances: Sequence[ContactStance]) -> bool:
        """Whether a last phase leads to a posture."""

    @property
    @abstractmethod
    def named_surfaces(self) -> dict[str, SurfaceRequest]:
        """Surfaces of the request by name."""

    @property
    def changes_contacts(self) -> bool:
        """Yes."""
        return True

    def make_rest(
        self,
        world: World,
        recorded: Motion,
        phase: str,
        start: Float[np.ndarray, "n"],
        carrying: Sequence[str] | None,
    ) -> TaskRequest:
        """Return the task of moving through the stances that are left; ``carrying`` names patches."""
        stances, problems = self.read_stances(recorded)
        if problems:
            raise IncompletePlanError(problems[0])
        changed = ChangedContacts(world.robot, stances, self.has_finish(stances), recorded, self.named_surfaces)
        return TaskRequest(contacts=changed.make_rest(phase, start, carrying))

    def demand_phases(self, world: World, robot: RobotModel, recorded: Motion) -> RecordDemand:
        """Demand the phases between the stances."""
        stances, forbidden = self.read_stances(recorded)
        phases = list_contact_phases(stances, has_finish=self.has_finish(stances))
        problems = list(forbidden)
        names, wanted = [phase.name for phase in recorded.phases], [phase.name for phase in phases]
        if names != wanted:
            problems.append(f"the phases are {', '.join(names)}; the task has {', '.join(wanted)}")
        problems += _find_unmade(world.robot, recorded, stances)
        missing = max(len(names) - len(phases), 0)
        return RecordDemand((*phases, *(phases[-1:] * missing))[: len(names)], tuple(problems))


@dataclass(frozen=True)
class ContactsDemand(StancesDemand):
    """The stances of a request, some of whose places have slack.

    Attributes:
        stances: that of the start first.
        scene: all pieces.
        surfaces: of the request by name.
        finishes: whether the request names a posture to end in.
    """

    stances: tuple[ContactStance, ...]
    scene: Scene
    surfaces: dict[str, SurfaceRequest]
    finishes: bool

    def read_stances(self, recorded: Motion) -> tuple[tuple[ContactStance, ...], tuple[str, ...]]:
        """Return the stances with places moved within their slack."""
        return take_recorded_places(self.stances, self.scene, recorded)

    def has_finish(self, stances: Sequence[ContactStance]) -> bool:
        """Whether the request names a posture to end in."""
        return self.finishes

    @property
    def named_surfaces(self) -> dict[str, SurfaceRequest]:
        """Surfaces of the request by name."""
        return dict(self.surfaces)


def _find_unmade(robot: RobotModel, recorded: Motion, stances: Sequence[ContactStance]) -> Iterator[str]:
    """Yield a sentence for each contact that is not in its place at the end of the phase that lands it.

    No phase stands on the contacts that the last stance makes, so that no other check sees them.
    """
    data = robot.model.createData()
    made: list[tuple[StanceContact, ...]] = []
    for before, after in pairwise(stances):
        others = list_change_phases(before, after)[:-1]
        made += [*(() for _ in others), ContactChange.between(before, after).arriving]
    for phase, arriving in zip(recorded.phases, made, strict=False):
        for contact in arriving:
            planted = contact.planted
            q = recorded.curve(np.array([phase.last]))[0, : robot.n]
            pin.framesForwardKinematics(robot.model, data, q)
            pose = data.oMf[robot.model.getFrameId(planted.link)]
            points = planted.sole @ pose.rotation.T + pose.translation
            off = float(np.linalg.norm(points - planted.points, axis=1).max())
            if off > planted.knot_tolerance_m:
                yield f"{contact.patch} is {1e3 * off:.1f} mm off its place at the end of phase '{phase.name}'"
