"""A recorded motion against the phases that its task demands, made anew with the choices of the record."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from costs.robot import Mechanism, RobotModel
from service.demands.holds.pushes import add_pushes
from service.demands.phase import TaskPhase
from service.demands.rest.displacement import measure_displacement
from service.demands.stance import UNSETTLED
from service.demands.task_demand import IncompletePlanError, RecordDemand, TaskDemand, World
from service.request.resume import NominalRequest
from service.verify import Motion, bound_coordinate, measure_retreat

STILL = 1e-5  # by which a joint of the mechanism at rest may be off [rad, m]
BORDER_OFF = 1.5e-3  # by which a joint of the mechanism may miss its value at a phase's border [rad, m]


class MovingTask(Protocol):
    """A task that moves a mechanism by phases, with the choices that it leaves."""

    @property
    def mechanism(self) -> Mechanism:
        """The mechanism that the task moves."""
        ...

    def read_choices(self, recorded: Motion) -> tuple[tuple[TaskPhase, ...], tuple[str, ...]]:
        """Return the task's phases with the choices of a record, and a sentence for each choice that it forbids."""
        ...

    def measure(self, motion: Motion) -> Mapping[str, float]:
        """Measure the figures of the task on a motion."""
        ...

    def keep_choices(self, recorded: Motion) -> dict[str, Any] | str:
        """Return the fields of ``resume`` that keep a record's choices, or a sentence why it has none."""
        ...


@dataclass(frozen=True)
class RecordedTask:
    """The phases of a task, matched to those of a record.

    Attributes:
        specs: per recorded phase; None for those before the task, and where none matches.
        problems: one sentence for each violation of the task.
    """

    specs: tuple[TaskPhase | None, ...]
    problems: tuple[str, ...]

    @staticmethod
    def of(task: MovingTask, recorded: Motion) -> RecordedTask:
        """Match the phases of a motion whose last coordinates are the mechanism's."""
        chosen, forbidden = task.read_choices(recorded)
        names = [phase.name for phase in recorded.phases]
        n_before = 0
        while n_before < len(names) and names[n_before] in UNSETTLED:
            n_before += 1
        specs: list[TaskPhase | None] = [None] * n_before
        problems = list(forbidden)
        if not forbidden and names[n_before:] != [spec.name for spec in chosen]:
            wanted = ", ".join(spec.name for spec in chosen)
            problems.append(f"the phases are {', '.join(names[n_before:])}; the task has {wanted}")
        for name in names[n_before:]:
            specs.append(next((spec for spec in chosen if spec.name == name), None))
        problems += find_moved_joints(task.mechanism, recorded, specs)
        return RecordedTask(tuple(specs), tuple(problems))

    def map_specs(self, change: Callable[[Sequence[TaskPhase]], Sequence[TaskPhase]]) -> RecordedTask:
        """Return the same with phases changed, those that are None left out."""
        changed = iter(change([spec for spec in self.specs if spec is not None]))
        return replace(self, specs=tuple(None if spec is None else next(changed) for spec in self.specs))


@dataclass(frozen=True)
class MechanismDemand(TaskDemand):
    """What a task with a mechanism demands: its phases, with the loads and pushes of its hands."""

    task: MovingTask

    @property
    def moved(self) -> Mechanism:
        """The mechanism that the task moves."""
        return self.task.mechanism

    def demand_phases(self, world: World, robot: RobotModel, recorded: Motion) -> RecordDemand:
        """Demand the task's phases with the choices of the record."""
        mechanism, friction = self.moved, world.request.options.hand_friction
        task = RecordedTask.of(self.task, recorded).map_specs(
            lambda specs: add_pushes(specs, robot, mechanism, friction)
        )
        names = [phase.name for phase in recorded.phases]
        phases = [TaskPhase(name) if spec is None else spec for name, spec in zip(names, task.specs, strict=True)]
        return RecordDemand(tuple(phases), task.problems)

    def measure(self, motion: Motion) -> Mapping[str, float]:
        """Measure the task's figures on a motion."""
        return self.task.measure(motion)

    def measure_displacement(self, motion: Motion, earlier: NominalRequest) -> Mapping[str, float]:
        """Measure how far the hands that hold are from an earlier motion."""
        return measure_displacement(motion, self.task.read_choices(motion)[0], earlier)

    def keep_choices(self, recorded: Motion) -> dict[str, Any]:
        """Return the fields of ``resume`` that keep hand, grip and other choices."""
        kept = self.task.keep_choices(recorded)
        if isinstance(kept, str):
            raise IncompletePlanError(kept)
        return kept


def find_moved_joints(mechanism: Mechanism, motion: Motion, specs: Sequence[TaskPhase | None]) -> Iterator[str]:
    """Yield a sentence where the mechanism does not start as demanded, or moves in a phase that leaves it still."""
    curve, k = motion.curve, len(mechanism.joints)
    start = mechanism.start
    names = [joint.name for joint in mechanism.joints]
    off = np.abs(curve.positions[0, -k:] - start)
    for index in np.flatnonzero(off > STILL).tolist():
        yield f"{names[index]} starts at {curve.positions[0, -k + index]:.4g} instead of {start[index]:.4g}"
    for phase, spec in zip(motion.phases, specs, strict=True):
        inside = curve.find_knots(phase.first, phase.last)
        values, rates = curve.positions[inside, -k:], curve.tangents[inside, -k:]
        moving = () if spec is None else spec.moving
        for index in range(k):
            is_still = np.ptp(values[:, index]) <= STILL and np.abs(rates[:, index]).max() <= STILL
            if index not in moving and not is_still:
                yield f"{names[index]} moves in phase '{phase.name}', which leaves it where it is"
            if spec is not None and (
                abs(values[0, index] - spec.first[index]) > BORDER_OFF
                or abs(values[-1, index] - spec.last[index]) > BORDER_OFF
            ):
                yield f"{names[index]} does not move as the task has it in phase '{phase.name}'"
            elif spec is not None and index in moving:  # its loads are those between the two values
                column = len(curve.positions[0]) - k + index
                low, high = bound_coordinate(curve, column, phase.first, phase.last)
                ends = sorted((float(spec.first[index]), float(spec.last[index])))
                if low < ends[0] - BORDER_OFF or high > ends[1] + BORDER_OFF:
                    yield f"{names[index]} leaves its way from {ends[0]:.4g} to {ends[1]:.4g} in phase '{phase.name}'"
                elif (back := measure_retreat(curve, column, phase.first, phase.last)) > BORDER_OFF:  # one way's loads
                    yield f"{names[index]} moves back by {back:.4g} in phase '{phase.name}'"
