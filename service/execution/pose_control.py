"""Online pose control: the joint speeds that follow a plan best, once per control cycle."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from jaxtyping import Bool, Float

from costs.robot import BASE_NAMES, RobotModel
from service.errors import ExecutionError, would_do
from service.execution.box_qp import BoxQPError, solve_box_qp
from service.execution.gains import PRESETS, PoseGains, TaskGains
from service.execution.shift import Shift

BODY = "body"  # name by which pelvis and centre of mass are displaced together
WORLD_AXES = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED


@dataclass(frozen=True)
class Command:
    """Configuration and speeds that are commanded in one cycle.

    Attributes:
        q: (n,) in the robot's coordinates [rad, m].
        qd: (n,) per second.
        is_bound: (n,) whether a coordinate is held back by its limits.
    """

    q: Float[np.ndarray, "n"]
    qd: Float[np.ndarray, "n"]
    is_bound: Bool[np.ndarray, "n"]

    @staticmethod
    def at_rest(q: Float[np.ndarray, "n"]) -> Command:
        """Return the command that holds a configuration."""
        return Command(np.asarray(q, dtype=float), np.zeros(len(q)), np.zeros(len(q), dtype=bool))


@dataclass(frozen=True)
class _Task:
    """Rows of one link or of the centre of mass.

    Attributes:
        frame: index in the model; -1 for the centre of mass.
        part: of the six rows of a link's twist, those that count.
        rows: of the quadratic program's least squares.
        gains: of the task.
        link: name by which its target is displaced; empty for a task that is not.
    """

    frame: int
    part: slice
    rows: slice
    gains: TaskGains
    link: str


class PoseController:
    """Quadratic program of each cycle, eq. 6 and 7 of Liu et al., Humanoids 2015.

    Minimises ``sum_i w_i |J_i qd - a xd_i' - kp_i (xd_i - x_i) - kd_i (xd_i' - x_i')|^2 + w_d |B (qd - a qd_d)|^2`` in
    the box of the joints' limits, where ``x`` and ``x'`` belong to the earlier command, ``xd`` to the desired pose, and
    ``a`` is ``gains.feed_forward``; then ``q + qd dt`` is commanded.
    """

    def __init__(
        self,
        robot: RobotModel,
        gains: PoseGains = PRESETS["follow"],
        period_s: float = 1e-3,
        has_rate_limits: bool = True,
    ) -> None:
        """Prepare the tasks.

        Args:
            robot: its groups ``feet``, ``hands`` and ``upright`` name the links of the tasks; groups may be missing.
            gains: weights and gains of the tasks.
            period_s: of the cycle [s].
            has_rate_limits: whether speeds and accelerations stay within the robot's limits, beside positions, which is
                all that eq. 6 has.

        Raises:
            ExecutionError: the period is not between 1e-5 and 0.1 s.
        """
        if not 1e-5 <= period_s <= 0.1:
            raise ExecutionError(f"period_s {period_s:g}; expected 1e-5 to 0.1 s")
        self.robot, self.gains, self.period_s, self.has_rate_limits = robot, gains, period_s, has_rate_limits
        self._tasks = tuple(_list_tasks(robot, gains))
        sizes = [task.rows.stop - task.rows.start for task in self._tasks]
        self._weights = np.repeat([task.gains.weight for task in self._tasks], sizes)
        self._actual, self._wanted = robot.model.createData(), robot.model.createData()

    @property
    def links(self) -> tuple[str, ...]:
        """Feet and hands, whose targets may be shifted."""
        groups = self.robot.link_groups
        return (*groups.get("feet", ()), *groups.get("hands", ()))

    def check_link(self, link: str) -> None:
        """Refuse a link whose target cannot be shifted.

        Raises:
            ExecutionError: it is no foot or hand of the robot.
        """
        if link not in self.links:
            raise ExecutionError(f"shift: unknown link {link!r}; expected {would_do(link, self.links)}")

    def step(
        self,
        command: Command,
        desired_q: Float[np.ndarray, "n"],
        desired_qd: Float[np.ndarray, "n"],
        shifts: Mapping[str, Shift] | None = None,
    ) -> Command:
        """Return the next command.

        Args:
            command: the earlier one.
            desired_q, desired_qd: of the plan, in the robot's coordinates.
            shifts: displacements of the targets of feet and hands by link, and of ``BODY``.

        Raises:
            ExecutionError: the program has no solution (a configuration that is not finite).
        """
        program = self.make_program(command, desired_q, desired_qd, shifts or {})
        try:
            solution = solve_box_qp(*program)
        except BoxQPError as error:
            raise ExecutionError(f"pose control has no solution: {error}") from None
        return Command(command.q + self.period_s * solution.x, solution.x, solution.is_bound)

    def make_program(
        self,
        command: Command,
        desired_q: Float[np.ndarray, "n"],
        desired_qd: Float[np.ndarray, "n"],
        shifts: Mapping[str, Shift],
    ) -> tuple[Float[np.ndarray, "n n"], Float[np.ndarray, "n"], Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
        """Return matrix, linear term and bounds of the quadratic program of a cycle; arguments as of ``step``."""
        return (*self._sum_tasks(command, desired_q, desired_qd, shifts), *self.bound_speeds(command))

    def bound_speeds(self, command: Command) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
        """Return the lowest and the highest speed of each coordinate in the cycle after a command.

        With rate limits a joint can always stop before its limit, and its speed changes by at most its acceleration
        limit, except where a start outside of the limits leaves no such speed.
        """
        robot, period = self.robot, self.period_s
        below, above = robot.lower - command.q, robot.upper - command.q
        if not self.has_rate_limits:
            return below / period, above / period
        reach = robot.acceleration * period
        with np.errstate(invalid="ignore"):
            highest = np.minimum(_stop_within(above, robot.acceleration, reach), robot.velocity)
            lowest = np.maximum(-_stop_within(-below, robot.acceleration, reach), -robot.velocity)
        lowest = np.minimum(lowest, highest)
        return np.clip(command.qd - reach, lowest, highest), np.clip(command.qd + reach, lowest, highest)

    def _sum_tasks(
        self,
        command: Command,
        desired_q: Float[np.ndarray, "n"],
        desired_qd: Float[np.ndarray, "n"],
        shifts: Mapping[str, Shift],
    ) -> tuple[Float[np.ndarray, "n n"], Float[np.ndarray, "n"]]:
        """Return matrix and linear term of the quadratic program."""
        gains, n_base = self.gains, len(BASE_NAMES) if self.robot.is_floating else 0
        jacobian, weights, speeds = self._linearize(command, desired_q, desired_qd, shifts)
        weighted = jacobian * weights[:, None]
        hessian = weighted.T @ jacobian
        linear = -(weighted.T @ speeds)
        joint = gains.joint
        own = slice(n_base, None)
        rate = (
            joint.kp * (desired_q - command.q) + joint.kd * (desired_qd - command.qd) + gains.feed_forward * desired_qd
        )
        diagonal = hessian.reshape(-1)[:: self.robot.n + 1]
        diagonal[own] += joint.weight + gains.damping
        linear[own] -= joint.weight * rate[own] + gains.damping * gains.feed_forward * desired_qd[own]
        return hessian, linear

    def _linearize(
        self,
        command: Command,
        desired_q: Float[np.ndarray, "n"],
        desired_qd: Float[np.ndarray, "n"],
        shifts: Mapping[str, Shift],
    ) -> tuple[Float[np.ndarray, "m n"], Float[np.ndarray, "m"], Float[np.ndarray, "m"]]:
        """Return Jacobian, weights and wanted speeds of the tasks' rows."""
        model, actual, wanted, gains = self.robot.model, self._actual, self._wanted, self.gains
        pin.computeJointJacobians(model, actual, command.q)
        pin.forwardKinematics(model, wanted, desired_q, desired_qd)
        jacobians, speeds = np.empty((len(self._weights), self.robot.n)), np.empty(len(self._weights))
        for task in self._tasks:
            rows, g = task.rows, task.gains
            if task.frame < 0:
                jacobian = pin.jacobianCenterOfMass(model, actual, command.q, False)
                pin.centerOfMass(model, wanted, desired_q, desired_qd, False)
                error, goal = wanted.com[0] - actual.com[0], wanted.vcom[0].copy()
            else:
                place = pin.updateFramePlacement(model, actual, task.frame)
                target = pin.updateFramePlacement(model, wanted, task.frame)
                jacobian = pin.getFrameJacobian(model, actual, task.frame, WORLD_AXES)[task.part]
                goal = pin.getFrameVelocity(model, wanted, task.frame, WORLD_AXES).vector[task.part]
                turn = pin.log3(target.rotation @ place.rotation.T)
                error = np.concatenate([target.translation - place.translation, turn])[task.part]
            shift = shifts.get(task.link)
            if shift is not None:
                error[:3] += shift.offset
                goal[:3] += shift.speed
            jacobians[rows] = jacobian
            speeds[rows] = g.kp * error + gains.feed_forward * goal
            if g.kd:
                speeds[rows] += g.kd * (goal - jacobian @ command.qd)
        return jacobians, self._weights, speeds


def _stop_within(
    distance: Float[np.ndarray, "n"], acceleration: Float[np.ndarray, "n"], reach: Float[np.ndarray, "n"]
) -> Float[np.ndarray, "n"]:
    """Return the highest speed that can be stopped within a distance; ``reach`` is the change of speed of one period.

    A step of speed v over period T, then braking by a, goes ``v T + v^2 / (2 a)``; solved for v.
    """
    speed = np.sqrt(reach**2 + 2.0 * acceleration * np.maximum(distance, 0.0)) - reach
    return np.where(np.isfinite(distance) & np.isfinite(acceleration), speed, np.inf)


def _list_tasks(robot: RobotModel, gains: PoseGains) -> list[_Task]:
    """Return the tasks that a robot has links for."""
    model, groups = robot.model, robot.link_groups
    position, rotation, both = slice(0, 3), slice(3, 6), slice(0, 6)
    listed: list[tuple[int, slice, TaskGains, str]] = []
    if robot.is_floating:
        base = next(frame.name for frame in model.frames if frame.type == pin.FrameType.BODY and frame.parentJoint == 1)
        torso = (groups.get("upright") or (base,))[-1]
        listed += [
            (model.getFrameId(base), position, gains.pelvis, BODY),
            (model.getFrameId(torso), rotation, gains.torso, ""),
            (-1, position, gains.com, BODY),
        ]
    for kind, of_kind in (("feet", gains.foot), ("hands", gains.hand)):
        listed += [(model.getFrameId(link), both, of_kind, link) for link in groups.get(kind, ())]
    ends = np.cumsum([0] + [part.stop - part.start for _, part, _, _ in listed]).tolist()
    return [
        _Task(frame, part, slice(first, last), of_task, link)
        for (frame, part, of_task, link), first, last in zip(listed, ends, ends[1:], strict=False)
    ]
