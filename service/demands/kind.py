"""The demand part of a kind of task: what the stages around planning ask of it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

import numpy as np
from jaxtyping import Float

from costs.robot import RobotModel
from costs.scene import ConvexPiece
from service.demands.resistance import MechanismPhysics
from service.demands.stance import list_planted_feet
from service.demands.task_demand import TaskDemand, World
from service.request.schema import PlanRequest
from service.request.tasks.kind import TaskSection, load_part
from service.start.configuration import make_start_configuration

if TYPE_CHECKING:
    from perception import LeverDetection, SeenPart, ValveDetection
    from service.demands.contacts.stances import ContactStance
    from service.demands.door.demand import SeenDoor
    from service.demands.mechanism.given import GivenMechanism

S = TypeVar("S", bound=TaskSection)


class Shown(Protocol):
    """What a request's scan shows of what the task moves, from the scan itself or from a record."""

    @property
    def valves(self) -> tuple[ValveDetection | LeverDetection, ...]:
        """Wheels and levers, the task's first."""

    @property
    def doors(self) -> tuple[SeenDoor, ...]:
        """Doors, the task's first."""

    @property
    def seen(self) -> tuple[SeenPart, ...]:
        """Parts of the first that a hand may press."""


@dataclass(frozen=True)
class ResolvedStart:
    """Start of a request.

    Attributes:
        q: (n,) configuration.
        notes: about it.
        program: the ``service.trajopt.Program`` that says it, or None.
    """

    q: Float[np.ndarray, "n"]
    notes: tuple[str, ...]
    program: Any = None


class DemandPart(ABC, Generic[S]):
    """What a kind of task knows of its requests without anything that plans; a kind overrides what applies to it."""

    @abstractmethod
    def make_demand(self, section: S, world: World, shown: Shown, program: Any) -> TaskDemand:
        """Return what a request demands of any motion.

        Raises:
            RequestError: the scan does not show what the task moves, or the request contradicts itself.
        """

    def list_name_problems(self, section: S, request: PlanRequest, robot: RobotModel) -> Iterator[str]:
        """Yield a line for each unknown joint, link or posture, and each joint value beyond its limits."""
        yield from ()

    def list_given_problems(
        self, section: S, robot: RobotModel, start: Float[np.ndarray, "n"], obstacles: Sequence[ConvexPiece]
    ) -> Iterator[str]:
        """Yield a line for each part of a given object that could not be built."""
        yield from ()

    def read_mechanisms(self, section: S) -> tuple[GivenMechanism, ...]:
        """Return the mechanisms that the request gives by a URDF."""
        return ()

    def read_physics(self, section: S) -> MechanismPhysics:
        """Return what the moved mechanism opposes to a hand."""
        return MechanismPhysics({})

    def list_stances(self, section: S, world: World) -> tuple[ContactStance, ...]:
        """Return the stances as far as the request says them, that of the start first; none on feet that stay."""
        return ()

    def resolve_start(self, section: S, request: PlanRequest, robot: RobotModel) -> ResolvedStart:
        """Return the start configuration.

        Raises:
            RequestError: one line per problem.
        """
        feet = list_planted_feet(robot, request.options.feet)
        return ResolvedStart(*make_start_configuration(robot, request.start, feet))


def find_demand_part(request: PlanRequest) -> DemandPart[Any]:
    """Return the demand part of a request's kind."""
    part: DemandPart[Any] = load_part(request.kind.demand)
    return part


def read_mechanism_physics(request: PlanRequest) -> MechanismPhysics:
    """Return the resistances of the mechanism that a request moves."""
    return find_demand_part(request).read_physics(request.section)
