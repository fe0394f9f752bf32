"""Demands of a TrajOpt problem on the waypoints of its motion, which may be more than its steps."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from jaxtyping import Float, Int

from costs.robot import RobotModel
from service.demands.phase import TaskPhase
from service.demands.task_demand import RecordDemand, TaskDemand, World
from service.verify import (
    AxisTarget,
    JointTarget,
    Motion,
    PoseTarget,
    Target,
    limits_rotation,
    list_position_demands,
    measure_angle,
    measure_lean,
    offset_from_target,
)

STILL = 1e-6  # how far a coordinate that the problem does not move may be off [rad, m]
ROUNDING = 1e-9

StepTarget = JointTarget | PoseTarget | AxisTarget


@dataclass(frozen=True)
class ProgramDemand(TaskDemand):
    """Demands of a problem, step by step.

    Attributes:
        steps: targets of each step; their path parameters (``at``) are set from the motion.
        free: (f,) coordinates that may move.
        planted: links that stand throughout.
        balances: whether the centre of mass stays above them.
        without_target: constraints of the file that no target stands for.
    """

    steps: tuple[tuple[StepTarget, ...], ...]
    free: Int[np.ndarray, "f"]
    planted: tuple[str, ...]
    balances: bool
    without_target: tuple[str, ...] = ()

    @property
    def feet(self) -> tuple[str, ...]:
        """Links that stand throughout."""
        return self.planted

    @property
    def is_balanced(self) -> bool:
        """Whether the centre of mass stays above them."""
        return self.balances

    @property
    def can_escape(self) -> bool:
        """No: the waypoints of a problem include the start."""
        return False

    @property
    def has_own_targets(self) -> bool:
        """Yes: the planner itself promises targets between the steps."""
        return True

    @property
    def unproven(self) -> tuple[str, ...]:
        """Constraints of the file that no target stands for."""
        return self.without_target

    def demand_phases(self, world: World, robot: RobotModel, recorded: Motion) -> RecordDemand:
        """Demand the targets of the steps at the waypoints that meet them, and what the record promises all along."""
        q = recorded.curve.positions[:, : world.robot.n]
        targets, problems = make_program_targets(self, world.robot, recorded.curve.knots, q)
        phases = [
            TaskPhase(phase.name, targets=tuple(t for t in phase.targets if getattr(t, "at", None) is None))
            for phase in recorded.phases
        ]
        phases[-1] = replace(phases[-1], targets=(*phases[-1].targets, *targets))
        return RecordDemand(tuple(phases), problems)

    def find_strays(self, world: World, q: Float[np.ndarray, "K n"]) -> Iterator[str]:
        """Yield a sentence for each coordinate that moves although the problem keeps it fixed."""
        others = np.setdiff1d(np.arange(world.robot.n), self.free)
        moves = np.abs(q[:, others] - world.start[others]).max(axis=0, initial=0.0)
        for column, moved in zip(others.tolist(), moves.tolist(), strict=True):
            if moved > STILL:
                yield f"{world.robot.joint_names[column]} moves by {moved:.3g}, and task.trajopt does not move it"


def make_program_targets(
    program: ProgramDemand, robot: RobotModel, knots: Float[np.ndarray, "K"], q: Float[np.ndarray, "K n"]
) -> tuple[tuple[Target, ...], tuple[str, ...]]:
    """Return the targets of a program at the waypoints of a motion, and a sentence for a step that no waypoint meets.

    The steps are the earliest waypoints, in order, at which what each step demands holds; the first step is the
    motion's first waypoint, the last step its last.

    Args:
        knots: (K,) path parameters of the waypoints.
        q: (K, n) configurations at the waypoints.
    """
    targets: list[Target] = []
    after, final = -1, len(program.steps) - 1
    for step, demanded in enumerate(program.steps):
        places = range(after + 1, len(knots) - (final - step))
        if step in (0, final):
            only = 0 if step == 0 else len(knots) - 1
            places = range(only, only + 1) if only > after else range(0)
        row = next((row for row in places if all(_holds(robot, target, q[row]) for target in demanded)), None)
        if row is None:
            return (), (f"no waypoint does what task.trajopt demands at step {step}",)
        after = row
        targets += [replace(target, at=float(knots[row])) for target in demanded]
    return tuple(targets), ()


def _holds(robot: RobotModel, target: StepTarget, q: Float[np.ndarray, "n"]) -> bool:
    """Return whether a target holds at a configuration."""
    if isinstance(target, JointTarget):
        return bool(abs(q[robot.joint_names.index(target.joint)] - target.value) <= target.tolerance + ROUNDING)
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q[: robot.n])
    pose = data.oMf[robot.model.getFrameId(target.frame)]
    if isinstance(target, AxisTarget):
        lean = float(measure_lean((pose.rotation @ target.frame_axis)[None], target.axis)[0])
        return lean <= target.tolerance_rad + ROUNDING
    offset = offset_from_target(target, pose.translation[None])
    demands = list_position_demands(target)
    is_there = all(float(one.measure(offset)[0]) <= one.tolerance_m + ROUNDING for one in demands)
    if target.rotation is None or not limits_rotation(target):
        return is_there
    angle = float(measure_angle((target.rotation.T @ pose.rotation)[None])[0])
    return is_there and angle <= target.rotation_tolerance[0] + ROUNDING
