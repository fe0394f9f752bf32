"""Turning a valve with a hook: reach the wheel, insert the hook, turn, retract."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from costs.allowance import Allowance
from costs.robot import RobotModel, with_revolute
from costs.rotation import tangent_basis
from costs.state import MotionState
from costs.terms import AxisDirection, FramePose, WithinTolerance
from scopt import Constraint, Result, Sense
from service.phases import PhaseSolver, PlannedPhase, TaskPlan, guesses, shortcomings, straight, via
from service.spline import Hold
from service.verify import CircleTarget, JointTarget, Target
from service.whole_body import WholeBody

VALVE_JOINT = "valve_turn"
VALVE_LINK = "valve"
WHEEL_SPEED = 1.0  # [rad/s]
WHEEL_ACCELERATION = 2.0  # [rad/s^2]
STANDOFF = 0.07  # of the tool from the wheel's plane before it is inserted, beyond the rim's tube [m]
TURN_STEP = np.deg2rad(20.0)  # between waypoints
RIM_TOLERANCE = 5e-3  # of the tool from the rim's centre line, as promised [m]
AXIS_TOLERANCE = np.deg2rad(3.0)  # of the hand axis from the valve's, as promised
AXIS_AIM = np.deg2rad(1.0)  # what the optimiser keeps to at the waypoints
POSITION_TOLERANCE = 5e-4  # of the tool at a waypoint [m]
TOUCH_RESERVE = 0.015  # the hook may be this much deeper in the rim than its half thickness [m]
REACH_WAYPOINTS, LINE_WAYPOINTS = 14, 5


@dataclass(frozen=True)
class Wheel:
    """The wheel to turn.

    Attributes:
        centre: (3,) of the rim's centre-line circle, in the world [m].
        axis: (3,) unit, towards the robot.
        radius: of the centre line [m].
        tube_radius: half the rim's thickness [m].
        gaps: angles about the axis at which there is no spoke, from ``start_direction`` [rad].
        start_direction: (3,) unit, where the angle is zero.
        bodies: vertices in the world by body name: rim pieces are called ``valve/rim/...``.
    """

    centre: Float[np.ndarray, "3"]
    axis: Float[np.ndarray, "3"]
    radius: float
    tube_radius: float
    gaps: tuple[float, ...]
    start_direction: Float[np.ndarray, "3"]
    bodies: Mapping[str, Float[np.ndarray, "V 3"]]

    def rim_point(self, angle: float) -> Float[np.ndarray, "3"]:
        """Point of the centre line at an angle, in the world [m]."""
        third = np.cross(self.axis, self.start_direction)
        return np.asarray(self.centre + self.radius * (np.cos(angle) * self.start_direction + np.sin(angle) * third))


@dataclass(frozen=True)
class Hand:
    """A hand with its hook.

    Attributes:
        side: ``left`` or ``right``.
        tool: frame at the hook's end, z along the hand axis outwards.
        hook: link that may touch the rim.
    """

    side: str
    tool: str
    hook: str


HANDS = {"left": Hand("left", "l_tool", "l_hook"), "right": Hand("right", "r_tool", "r_hook")}


def with_wheel(body: WholeBody, wheel: Wheel) -> WholeBody:
    """The body of a robot whose last coordinate is the wheel's angle."""
    robot = with_revolute(
        body.robot,
        name=VALVE_JOINT,
        origin=wheel.centre,
        axis=wheel.axis,
        bodies=wheel.bodies,
        link=VALVE_LINK,
        lower=-2.5 * np.pi,
        upper=2.5 * np.pi,
        velocity=WHEEL_SPEED,
        acceleration=WHEEL_ACCELERATION,
    )
    return body.with_robot(robot, np.append(body.nominal, 0.0))


@dataclass(frozen=True)
class HookTask:
    """One attempt to turn a wheel with one hand, entering at one gap.

    Attributes:
        solver: of the body augmented by the wheel.
        wheel: what to turn.
        hand: with which hand.
        turn: angle to turn by, right-handed about the wheel's axis [rad].
        entry: angle of the gap at which the hook is inserted [rad].
    """

    solver: PhaseSolver
    wheel: Wheel
    hand: Hand
    turn: float
    entry: float

    @property
    def body(self) -> WholeBody:
        """The robot with the wheel."""
        return self.solver.body

    @property
    def robot(self) -> RobotModel:
        """The robot with the wheel."""
        return self.solver.body.robot

    @property
    def touching(self) -> tuple[Allowance, ...]:
        """The hook may touch the rim, and nothing else may."""
        return (Allowance(self.hand.hook, "valve/rim/*", self.wheel.tube_radius + TOUCH_RESERVE),)

    def hold(self) -> Hold:
        """The tool stays at its point of the rim while the wheel turns."""
        local = np.eye(4)
        local[:3, 3] = self.wheel.rim_point(self.entry) - self.wheel.centre
        return lambda waypoints: FramePose(
            self.robot, self.hand.tool, waypoints, local, (True,) * 3 + (False,) * 3, VALVE_LINK
        )

    def plan(self) -> TaskPlan:
        """All phases, backwards from the turn: what it needs decides where the hook goes in."""
        monitor = self.solver.monitor
        start = self.body.nominal
        with monitor.step("pose at the wheel", 0.1):
            pose = self.solver.pose(
                "pose at the wheel", guesses(self.body), self._on_rim([0]), self.touching, {self.robot.n - 1: 0.0}
            )
        if not pose.is_feasible:
            return self._stopped("pose at the wheel", pose, np.stack([start, pose.x[0]]))
        with monitor.step("turn", 0.2):
            turn = self._turn(pose.x[0])
        if not turn.is_feasible:
            return self._stopped("turn", turn, np.concatenate([start[None], turn.x]))
        with monitor.step("insert", 0.45):
            insert = self._line("insert", turn.x[0], self.entry)
        if not insert.is_feasible:
            return self._stopped("insert", insert, np.concatenate([start[None], insert.x[::-1]]))
        with monitor.step("retract", 0.55):
            retract = self._line("retract", turn.x[-1], self.entry + self.turn)
        if not retract.is_feasible:
            return self._stopped("retract", retract, np.concatenate([turn.x, retract.x]))
        approach = insert.x[::-1]
        with monitor.step("reach", 0.65):
            reach = self._reach(start, approach[0])
        return TaskPlan(
            self.body,
            (
                PlannedPhase("reach", reach.x, reach.is_feasible),
                PlannedPhase("insert", approach, True, allowances=self.touching),
                PlannedPhase("turn", turn.x, True, (self.hold(),), self.touching, self._turn_targets),
                PlannedPhase("retract", retract.x, True, allowances=self.touching),
            ),
            () if reach.is_feasible else shortcomings(reach, "reach"),
            notes=(f"{self.hand.side} hand, hook inserted at {np.rad2deg(self.entry):.0f} deg",),
        )

    def _stopped(self, step: str, result: Result, q: Float[np.ndarray, "T n"]) -> TaskPlan:
        """The best attempt as a single phase, with what is wrong with it."""
        return TaskPlan(self.body, (PlannedPhase(step, q, False),), shortcomings(result, step))

    def _on_rim(self, waypoints: Sequence[int]) -> tuple[Constraint[MotionState], ...]:
        return (
            Constraint("tool on the rim", self.hold()(np.asarray(waypoints)), Sense.EQUAL_ZERO, POSITION_TOLERANCE),
            self._hand_axis(waypoints),
        )

    def _hand_axis(self, waypoints: Sequence[int]) -> Constraint[MotionState]:
        """The hand axis is parallel to the valve's, the hand free to turn about it."""
        along = AxisDirection(self.robot, self.hand.tool, waypoints, np.array([0.0, 0.0, 1.0]), -self.wheel.axis)
        return Constraint("hand axis", WithinTolerance(along, AXIS_AIM), tolerance=0.2 * AXIS_AIM)

    def _turn(self, pose: Float[np.ndarray, "n"]) -> Result:
        n_waypoints = max(int(np.ceil(abs(self.turn) / TURN_STEP)) + 1, 3)
        angles = np.linspace(0.0, self.turn, n_waypoints)
        start = np.tile(pose, (n_waypoints, 1))
        start[:, -1] = angles

        def at_angles(lower: np.ndarray, upper: np.ndarray) -> None:
            lower[:, -1] = upper[:, -1] = angles

        return self.solver.trajectory(
            "turn",
            [start],
            {},
            constraints=self._on_rim(range(n_waypoints)),
            allowances=self.touching,
            bounds=at_angles,
        )

    def _line(self, name: str, at_rim: Float[np.ndarray, "n"], angle: float) -> Result:
        """Straight away from the rim along the valve's axis."""
        steps = np.linspace(0.0, self.wheel.tube_radius + STANDOFF, LINE_WAYPOINTS)
        targets = np.tile(np.eye(4), (LINE_WAYPOINTS - 1, 1, 1))
        targets[:, :3, 3] = self.wheel.rim_point(angle) + steps[1:, None] * self.wheel.axis
        waypoints = np.arange(1, LINE_WAYPOINTS)
        line = FramePose(self.robot, self.hand.tool, waypoints, targets, (True,) * 3 + (False,) * 3)

        def wheel_still(lower: np.ndarray, upper: np.ndarray) -> None:
            lower[:, -1] = upper[:, -1] = at_rim[-1]

        return self.solver.trajectory(
            name,
            [np.tile(at_rim, (LINE_WAYPOINTS, 1))],
            {0: at_rim},
            constraints=(
                Constraint("tool on its line", line, Sense.EQUAL_ZERO, POSITION_TOLERANCE),
                self._hand_axis(waypoints.tolist()),
            ),
            allowances=self.touching,
            bounds=wheel_still,
        )

    def _reach(self, start: Float[np.ndarray, "n"], end: Float[np.ndarray, "n"]) -> Result:
        def wheel_still(lower: np.ndarray, upper: np.ndarray) -> None:
            lower[:, -1] = upper[:, -1] = 0.0

        starts = [straight(start, end, REACH_WAYPOINTS)]
        for guess in guesses(self.body)[1:]:
            starts.append(via(start, guess, end, REACH_WAYPOINTS))
        return self.solver.trajectory("reach", starts, {0: start, REACH_WAYPOINTS - 1: end}, bounds=wheel_still)

    def _turn_targets(self, s_last: float) -> tuple[Target, ...]:
        circle = CircleTarget(
            self.hand.tool,
            self.wheel.centre,
            self.wheel.axis,
            self.wheel.radius,
            RIM_TOLERANCE,
            np.array([0.0, 0.0, -1.0]),
            AXIS_TOLERANCE,
        )
        return (circle, JointTarget(VALVE_JOINT, self.turn, 1e-3, s_last))


def turned_angle(
    tool: Float[np.ndarray, "S 3"], centre: Float[np.ndarray, "3"], axis: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "S"]:
    """Angle by which a point has gone round an axis since the first sample, unwrapped [rad]."""
    first, second = tangent_basis(np.asarray(axis))
    offset = tool - centre
    angle = np.unwrap(np.arctan2(offset @ second, offset @ first))
    return np.asarray(angle - angle[0])


def plan_hook(solver: PhaseSolver, wheel: Wheel, hands: Sequence[Hand], turn: float) -> TaskPlan:
    """Try hands and gaps in turn; the first that works, else the attempt that got furthest."""
    body = with_wheel(solver.body, wheel)
    solver = replace(solver, body=body)
    best: TaskPlan | None = None
    for hand in hands:
        for entry in wheel.gaps:
            plan = HookTask(solver, wheel, hand, turn, entry).plan()
            if plan.is_feasible:
                return plan
            if best is None or len(plan.phases) > len(best.phases):
                best = plan
    if best is None:
        raise ValueError("a wheel needs a gap and the robot a hand")
    return best
