"""What a task demands of any motion that does it, whatever its kind."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from costs.robot import Mechanism, RobotModel, with_mechanism
from costs.robot.carried import MovableObject
from costs.scene import Scene
from service.demands.phase import TaskPhase
from service.request.resume import NominalRequest
from service.request.schema import PlanRequest
from service.request.tasks.registry import TaskRequest
from service.verify import Motion


class IncompletePlanError(ValueError):
    """An earlier plan whose rest cannot be planned; the message says what it lacks."""


@dataclass(frozen=True)
class World:
    """A request with its robot and scene.

    Attributes:
        request: the request.
        robot: without what the task moves.
        start: (n,) configuration at the start.
        scene: all pieces, floors included.
    """

    request: PlanRequest
    robot: RobotModel
    start: Float[np.ndarray, "n"]
    scene: Scene


@dataclass(frozen=True)
class RecordDemand:
    """What a task demands of a recorded motion, with the choices that the record made.

    Attributes:
        phases: one per recorded phase.
        problems: one sentence for each violation of the task.
    """

    phases: tuple[TaskPhase, ...]
    problems: tuple[str, ...] = ()


class TaskDemand(ABC):
    """What a task demands of any motion."""

    @abstractmethod
    def demand_phases(self, world: World, robot: RobotModel, recorded: Motion) -> RecordDemand:
        """Return the phases of the task, with the choices of a record, one for each phase of the record.

        Args:
            world: the request in its world.
            robot: with what the task moves.
            recorded: a motion of it.
        """

    @property
    def moved(self) -> Mechanism | None:
        """The mechanism that the task moves, if it moves one."""
        return None

    @property
    def objects(self) -> tuple[MovableObject, ...]:
        """Objects that hands carry."""
        return ()

    @property
    def feet(self) -> tuple[str, ...] | None:
        """Planted links, where the task says them itself."""
        return None

    @property
    def is_balanced(self) -> bool:
        """Whether the centre of mass stays above the planted links."""
        return True

    @property
    def changes_contacts(self) -> bool:
        """Whether the robot moves from stance to stance."""
        return False

    @property
    def can_escape(self) -> bool:
        """Whether a start in collision can be left first."""
        return True

    @property
    def has_own_targets(self) -> bool:
        """Whether a motion may promise more targets than the task demands."""
        return False

    @property
    def unproven(self) -> tuple[str, ...]:
        """Constraints of the request that no check stands for."""
        return ()

    def find_strays(self, world: World, q: Float[np.ndarray, "K n"]) -> Iterator[str]:
        """Yield a sentence for each coordinate that moves although the task keeps it."""
        yield from ()

    def measure(self, motion: Motion) -> Mapping[str, float]:
        """Measure the task's figures on a motion."""
        return {}

    def measure_displacement(self, motion: Motion, earlier: NominalRequest) -> Mapping[str, float]:
        """Measure how far hands that hold something are from an earlier motion; nothing where none do."""
        return {}

    @property
    def keeps_motion(self) -> bool:
        """Whether the rest of a plan is searched from the earlier motion first."""
        return True

    def keep_choices(self, recorded: Motion) -> dict[str, Any]:
        """Return the fields of ``resume`` that keep the choices of an earlier plan.

        Raises:
            IncompletePlanError: the plan has none.
        """
        return {}

    def make_rest(
        self,
        world: World,
        recorded: Motion,
        phase: str,
        start: Float[np.ndarray, "n"],
        carrying: Sequence[str] | None,
    ) -> TaskRequest | None:
        """Return the task of doing the rest of an earlier plan; None where it is the same task, from a phase on.

        Args:
            world: the request of the earlier plan.
            recorded: its motion.
            phase: name of the phase to begin with.
            start: (n,) configuration of the robot as it is.
            carrying: what carries the robot; by default as in the earlier plan.

        Raises:
            IncompletePlanError: the plan does not do the whole task.
            RequestError: there is no such phase, or nothing like that carries the robot.
        """
        return None

    def augment(self, robot: RobotModel) -> RobotModel:
        """Return the robot with what the task moves."""
        return robot if self.moved is None else with_mechanism(robot, self.moved.joints)
