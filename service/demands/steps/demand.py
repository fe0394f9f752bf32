"""What a list of steps demands of any motion: the phases of each step, from where the motion has it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from costs.robot import Mechanism, RobotModel
from service.demands.figures.travel import measure_ends
from service.demands.holds.pushes import add_pushes
from service.demands.mechanism.demand import GivenMechanismDemand
from service.demands.phase import TaskPhase
from service.demands.recorded_task import find_moved_joints
from service.demands.stance import UNSETTLED
from service.demands.steps.compile import compile_step
from service.demands.steps.extent import Extent, NamedStep
from service.demands.steps.moved import MovedParts
from service.demands.task_demand import RecordDemand, TaskDemand, World
from service.request.tasks.steps import StepsSection
from service.verify import Motion, Phase


@dataclass(frozen=True)
class StepsDemand(TaskDemand):
    """The steps of a request.

    Attributes:
        section: the steps.
    """

    section: StepsSection

    @cached_property
    def parts(self) -> MovedParts:
        """What hands push."""
        return MovedParts.of(self.section)

    @property
    def moved(self) -> Mechanism | None:
        """What hands push, as one mechanism."""
        return self.parts.mechanism

    @property
    def keeps_motion(self) -> bool:
        """No: steps are planned anew."""
        return False

    def demand_phases(self, world: World, robot: RobotModel, recorded: Motion) -> RecordDemand:
        """Demand each step from the configuration that the record has at its beginning."""
        record = _Record(self, world, robot, recorded)
        record.read()
        problems = list(record.problems)
        names = [phase.name for phase in recorded.phases]
        if self.moved is not None:
            specs = [record.specs.get(name) for name in names]
            problems += find_moved_joints(self.moved, recorded, specs)
        before = [name for name in names if name in UNSETTLED]
        if names[len(before) :] != record.names or names[: len(before)] != before:
            problems.append(f"the phases are {', '.join(names)}; the steps have {', '.join(record.names)}")
        phases = [record.phases.get(name, TaskPhase(name)) for name in names]
        return RecordDemand(tuple(phases), tuple(problems))

    def measure(self, motion: Motion) -> Mapping[str, float]:
        """Measure the values of the pushed joints at the end of a motion [deg, m]."""
        figures: dict[str, float] = {}
        for given in self.parts.parts.values():
            figures |= measure_ends(given.mechanism, [move.joint for move in given.request.moves], motion)
        return figures


@dataclass
class _Record:
    """A record, read step by step.

    Attributes:
        demand, world, robot, recorded: as in ``demand_phases``.
        names: of the phases that the steps have.
        phases, specs: by name; ``specs`` are those in which a hand pushes.
        problems: one sentence for each violation.
    """

    demand: StepsDemand
    world: World
    robot: RobotModel
    recorded: Motion

    def __post_init__(self) -> None:
        self.names: list[str] = []
        self.phases: dict[str, TaskPhase] = {}
        self.specs: dict[str, TaskPhase] = {}
        self.problems: list[str] = []
        self._recorded: dict[str, Phase] = {phase.name: phase for phase in self.recorded.phases}

    def read(self) -> None:
        """Make the demands of all steps."""
        mechanism = self.demand.moved
        values = np.zeros(0) if mechanism is None else mechanism.start
        for named in Extent.of(self.demand.section).done:
            if named.index in self.demand.parts.parts:
                self._read_part(named, values)
                values = self.demand.parts.advance(named.index, values)
            else:
                self._read_step(named)

    def _read_step(self, named: NamedStep) -> None:
        robot, recorded = self.world.robot, self.recorded
        for maker in compile_step(robot, self.world.scene, named.step, named.name):
            self.names.append(maker.name)
            phase = self._recorded.get(maker.name)
            if phase is None:
                continue
            ends = recorded.curve(np.array([phase.first, phase.last]))[:, : robot.n]
            self.phases[maker.name] = maker.make(ends[0]).demand(robot, ends[0], ends[1])

    def _read_part(self, named: NamedStep, values: np.ndarray) -> None:
        parts, mechanism = self.demand.parts, self.demand.moved
        assert mechanism is not None
        friction = self.world.request.options.hand_friction
        own = GivenMechanismDemand(parts.parts[named.index], self.world.robot, friction)
        specs, problems = own.read_choices(self.recorded)
        self.problems += (f"step '{named.name}': {problem}" for problem in problems)
        for spec in add_pushes(parts.widen(specs, named.index, named.name, values), self.robot, mechanism, friction):
            self.names.append(spec.name)
            self.specs[spec.name] = self.phases[spec.name] = spec
