"""What a list of steps demands of any motion: the phases of each step, from where the motion has it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from costs.robot import Mechanism, RobotModel
from costs.robot.carried import MovableObject
from service.demands.figures.travel import measure_ends
from service.demands.grasping.gripper import Gripper
from service.demands.holds.pushes import add_pushes
from service.demands.mechanism.demand import GivenMechanismDemand
from service.demands.phase import TaskPhase
from service.demands.recorded_task import find_moved_joints
from service.demands.stance import UNSETTLED
from service.demands.steps.compile import compile_step
from service.demands.steps.extent import Extent, NamedStep
from service.demands.steps.holding import Holding, carry_along, choose_grippers
from service.demands.steps.moved import MovedParts
from service.demands.steps.objects import CLOSE, OPEN, Taking
from service.demands.steps.walking import list_walking_phases, read_stances
from service.demands.task_demand import RecordDemand, TaskDemand, World
from service.request.tasks.step_objects import GraspStep
from service.request.tasks.steps import StepsSection
from service.verify import Motion, Phase, place_frames, split_motion


@dataclass(frozen=True)
class StepsDemand(TaskDemand):
    """The steps of a request.

    Attributes:
        section: the steps.
        start: the objects that they take, at the start.
    """

    section: StepsSection
    start: Holding

    @cached_property
    def parts(self) -> MovedParts:
        """What hands push."""
        return MovedParts.of(self.section)

    @property
    def moved(self) -> Mechanism | None:
        """What hands push, as one mechanism."""
        return self.parts.mechanism

    @property
    def objects(self) -> tuple[MovableObject, ...]:
        """What hands take."""
        return self.start.objects

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
        resting = self.start.carriers
        phases = [record.phases.get(name, TaskPhase(name, carriers=resting)) for name in names]
        return RecordDemand(tuple(phases), tuple(problems))

    def measure(self, motion: Motion) -> Mapping[str, float]:
        """Measure the values of the pushed joints at the end of a motion, and how far objects are moved [deg, m]."""
        figures: dict[str, float] = {}
        if self.objects:
            last = split_motion(motion)[-1]
            poses = place_frames(last.robot, last.curve.positions[-1], [item.name for item in self.objects])
            for item in self.objects:
                way = poses[item.name][:3, 3] - item.start[:3, 3]
                figures[f"moved_{item.name}_m"] = float(np.linalg.norm(way))
        if self.moved is not None:
            moved = (move.joint for given in self.parts.parts.values() for move in given.request.moves)
            figures |= measure_ends(self.moved, moved, motion)
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
        self._holding, self._at = self.demand.start, self.world.start
        self._recorded: dict[str, Phase] = {phase.name: phase for phase in self.recorded.phases}

    def read(self) -> None:
        """Make the demands of all steps."""
        mechanism = self.demand.moved
        values = np.zeros(0) if mechanism is None else mechanism.start
        steps = Extent.of(self.demand.section).done
        unsettled = [phase for phase in self.recorded.phases if phase.name in UNSETTLED]
        if unsettled:
            self._at = self.recorded.curve(np.array([unsettled[-1].last]))[0, : self.world.robot.n]
        for named in steps:
            if named.index in self.demand.parts.parts:
                self._read_part(named, values)
                values = self.demand.parts.advance(named.index, values)
            elif named.step.hold is not None:
                field_name = f"task.steps[{named.index}].hold"
                self._holding = self._holding.begin_with(named.step.hold, field_name, self._at)
            elif named.step.changes_contacts:
                self._read_walk(named)
            else:
                self._read_step(named)
            self._at = self._find_end()

    def _read_step(self, named: NamedStep) -> None:
        grasp, release, q = named.step.grasp, named.step.release, None
        taking = None if grasp is None else self._read_taking(named, grasp)
        released: tuple[Gripper, ...] = ()
        if release is not None and release.object in self._holding.held:
            first = self._recorded.get(f"{named.name}: {OPEN}")
            at = self.recorded.curve.knots[-1] if first is None else first.first
            field_name, begin = f"task.steps[{named.index}].release", self.recorded.curve(np.array([at]))[0]
            self._holding, released = self._holding.let_go(release, field_name, begin)
        robot = self._holding.placed
        for maker in compile_step(self._holding, named, taking, released):
            self.names.append(maker.name)
            phase = self._recorded.get(maker.name)
            if phase is None:
                continue
            ends = self.recorded.curve(np.array([phase.first, phase.last]))[:, : robot.n]
            self.phases[maker.name] = maker.make(ends[0]).demand(robot, ends[0], ends[1])
            q = ends[1]
        self._holding = self._holding.settle(named.waits)
        if grasp is not None and taking is not None and q is not None:
            self._holding = self._holding.take(grasp.object, taking.grippers, grasp.force_n, q)

    def _read_walk(self, named: NamedStep) -> None:
        stances, finish = read_stances(self._holding, self.world.scene, named.step, named.name, self._at)
        for phase in list_walking_phases(self._holding, stances, finish, named.name):
            self.names.append(phase.name)
            self.phases[phase.name] = phase
        self._holding = self._holding.stand(self._find_end(), stances[-1].contacts)

    def _find_end(self) -> Float[np.ndarray, "n"]:
        """Return the configuration at the end of the last phase that was read and that the record has."""
        done = [self._recorded[name] for name in self.names if name in self._recorded]
        if not done:
            return self._at
        return np.asarray(self.recorded.curve(np.array([done[-1].last]))[0, : self.world.robot.n])

    def _read_taking(self, named: NamedStep, grasp: GraspStep) -> Taking:
        """Return the hands with which a record takes an object: those that carry it, or the nearest to it."""
        grippers = choose_grippers(self.world.robot, grasp.hand, f"task.steps[{named.index}].grasp.hand")
        free = tuple(gripper for gripper in grippers if gripper.tool not in self._holding.busy)
        grippers = free or grippers
        closing = self._recorded.get(f"{named.name}: {CLOSE}")
        at = float(self.recorded.curve.knots[-1]) if closing is None else closing.last
        q = self.recorded.curve(np.array([at]))[0]
        names = [phase.name for phase in self.recorded.phases]
        after = None if closing is None else names.index(closing.name) + 1
        carriers = self.recorded.phases[after].carriers if after is not None and after < len(names) else ()
        links = [carrier.link for carrier in carriers if carrier.item == grasp.object]
        poses = place_frames(self.world.robot, q[: self.world.robot.n], [gripper.tool for gripper in grippers])
        place = self._holding.locate(grasp.object, q)[:3, 3]

        def measure(gripper: Gripper) -> tuple[bool, float]:
            return gripper.link not in links, float(np.linalg.norm(poses[gripper.tool][:3, 3] - place))

        ranked = sorted(grippers, key=measure)
        return Taking(tuple(ranked if grasp.hand == "both" else ranked[:1]))

    def _read_part(self, named: NamedStep, values: np.ndarray) -> None:
        parts, mechanism = self.demand.parts, self.demand.moved
        assert mechanism is not None
        friction = self.world.request.options.hand_friction
        own = GivenMechanismDemand(parts.parts[named.index], self.world.robot, friction)
        specs, problems = own.read_choices(self.recorded)
        self.problems += (f"step '{named.name}': {problem}" for problem in problems)
        for spec in add_pushes(parts.widen(specs, named.index, named.name, values), self.robot, mechanism, friction):
            self.names.append(spec.name)
            self.specs[spec.name] = self.phases[spec.name] = carry_along(spec, self._holding)
        self._holding = self._holding.settle()
