"""Turn a valve: reach the wheel, insert the hook, turn, retract; again with a new grasp at the wrist's limit.

Two modes. ``hook``: the hook rests between the spokes and the hand is free to turn about its axis, so that one stroke
is a full turn. ``grasp``: the hand turns with the wheel, starting with the wrist at the limit that leaves the longest
turn (Franklin, 2016, sec. 4.3), and takes a new grasp at the other limit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from costs.allowance import Allowance
from costs.kinematics import KinematicsEngine, locate_frame, locate_links
from costs.robot import RobotModel
from costs.rotation import make_tangent_basis
from costs.state import MotionState
from costs.terms import AxisDirection, FramePose, WithinTolerance
from scopt import Constraint, Sense
from service.body.holds import POSITION, Hold
from service.body.phases import Bounds, PhaseSolver, path_via, posture_guesses, straight_path
from service.body.task_plan import PlannedPhase, Solved, Stuck, Targets, TaskPlan
from service.body.whole_body import LIMIT_RESERVE, WholeBody
from service.demands.wheel import HAND_AXIS, Hand, Wheel, make_hook_allowances, make_stroke_targets
from service.request.names import VALVE_LINK
from service.verify import Motion, Target

Mode = Literal["hook", "grasp"]

STANDOFF = 0.07  # of the tool from the wheel's plane before it is inserted, beyond the rim's tube [m]
TURN_STEP = np.deg2rad(20.0)  # between waypoints
AXIS_AIM = np.deg2rad(1.0)  # largest lean of the hand axis at the waypoints
POSITION_TOLERANCE = 5e-4  # of the tool at a waypoint [m]
WRIST_RESERVE = 0.1  # distance from the wrist's limits in a grasp, for the lean of the hand axis [rad]
REACH_WAYPOINTS, LINE_WAYPOINTS = 14, 5


@dataclass(frozen=True)
class WheelStroke:
    """A turn of the wheel in a single grasp, from a first to a last wheel angle [rad].

    ``suffix`` ends the names of its phases; empty for a single stroke.
    """

    suffix: str
    first: float
    last: float


@dataclass(frozen=True)
class ValveTurn:
    """One attempt to turn a wheel with one hand, entering at one gap.

    Attributes:
        solver: of the body augmented by the wheel.
        wheel, hand, mode: as in the request.
        turn: angle to turn by, right-handed about the wheel's axis [rad].
        entry: angle of the gap at which the hook is inserted [rad].
        reach_waypoints: of the phases that reach for the wheel.
    """

    solver: PhaseSolver
    wheel: Wheel
    hand: Hand
    mode: Mode
    turn: float
    entry: float
    reach_waypoints: int = REACH_WAYPOINTS

    @property
    def body(self) -> WholeBody:
        """The robot with the wheel, in its scene."""
        return self.solver.body

    @property
    def robot(self) -> RobotModel:
        """The robot with the wheel."""
        return self.solver.body.robot

    @property
    def touching(self) -> tuple[Allowance, ...]:
        """The pair of hook and rim, which may touch."""
        return make_hook_allowances(self.wheel, self.hand)

    def split_turn(self) -> tuple[WheelStroke, ...]:
        """Return as few equal strokes as the wrist's range allows; a single one in hook mode."""
        count = 1
        if self.mode == "grasp":
            column, _ = _find_wrist(self.hand, self.robot)
            usable = self.robot.upper[column] - self.robot.lower[column] - 2.0 * WRIST_RESERVE
            count = int(np.ceil(abs(self.turn) / usable))
        edges = np.linspace(0.0, self.turn, count + 1)
        names = [""] if count == 1 else [f" {k + 1}" for k in range(count)]
        return tuple(WheelStroke(name, *ends) for name, *ends in zip(names, edges[:-1], edges[1:], strict=True))

    def plan(self) -> TaskPlan:
        """Plan all strokes in order, each backwards from its turn."""
        phases: tuple[PlannedPhase, ...] = ()
        at = self.body.nominal
        for stroke in self.split_turn():
            planned, stuck = self._plan_stroke(stroke, at)
            phases += planned
            if stuck is not None:
                return TaskPlan(self.body, phases, stuck=stuck, measure=self._measure)
            at = phases[-1].q[-1]
        note = f"{self.hand.side} hand in {self.mode} mode, inserted at {np.rad2deg(self.entry):.0f} deg of the rim"
        return TaskPlan(self.body, phases, measure=self._measure, notes=(note,))

    def _plan_stroke(
        self, stroke: WheelStroke, at: Float[np.ndarray, "n"]
    ) -> tuple[tuple[PlannedPhase, ...], Stuck | None]:
        """Return the phases of a stroke from configuration ``at``, and the step without a solution, if any."""
        monitor, suffix = self.solver.monitor, stroke.suffix
        with monitor.step("pose at the wheel", 0.1):
            pose = self._solve_pose(stroke, at)
        if not pose.is_feasible:
            return _stop_at(f"reach{suffix}", "pose at the wheel", pose, np.stack([at, pose.x[0]]))
        hold = self._make_hold(stroke, pose.x[0])
        with monitor.step("turn", 0.2):
            turn = self._solve_turn(stroke, hold, pose.x[0])
        if not turn.is_feasible:
            return _stop_at(f"turn{suffix}", "turn", turn, np.concatenate([at[None], turn.x]))
        with monitor.step("insert", 0.45):
            insert = self._solve_line("insert", turn.x[0], self.entry + stroke.first)
        if not insert.is_feasible:
            return _stop_at(f"insert{suffix}", "insert", insert, np.concatenate([at[None], insert.x[::-1]]))
        approach = insert.x[::-1]
        with monitor.step("reach", 0.55):
            reach = self._solve_reach(at, approach[0])
        phases = [PlannedPhase(f"reach{suffix}", reach.x, reach.is_feasible, resolve=self._solve_reach_again)]
        if not reach.is_feasible:
            return tuple(phases), Stuck(f"reach{suffix}", reach)
        with monitor.step("retract", 0.65):
            retract = self._solve_line("retract", turn.x[-1], self.entry + stroke.last)
        phases += [
            PlannedPhase(f"insert{suffix}", approach, True, allowances=self.touching),
            PlannedPhase(f"turn{suffix}", turn.x, True, (hold,), self.touching, self._make_targets(stroke, pose.x[0])),
            PlannedPhase(f"retract{suffix}", retract.x, retract.is_feasible, allowances=self.touching),
        ]
        return tuple(phases), Stuck.at(f"retract{suffix}", retract)

    def _solve_pose(self, stroke: WheelStroke, at: Float[np.ndarray, "n"]) -> Solved:
        """Solve for the hook at its point of the rim as the stroke begins; in a grasp with the wrist at its limit."""
        fixed = {self.robot.n - 1: stroke.first}
        if self.mode == "grasp":
            column, sense = _find_wrist(self.hand, self.robot)
            # The tool's z axis points against the wheel's: a positive turn needs the wrist to go against its sense.
            rises = np.sign(stroke.last - stroke.first) * sense < 0.0
            reserve = max(WRIST_RESERVE, LIMIT_RESERVE)
            lower, upper = self.robot.lower[column] + reserve, self.robot.upper[column] - reserve
            fixed[column] = float(lower if rises else upper)
        candidates = [at, *(guess for _, guess in posture_guesses(self.body)[1:])]
        on_rim = Constraint(
            "tool on the rim",
            FramePose(self.robot, self.hand.tool, [0], self._rim_target(), POSITION, VALVE_LINK),
            Sense.EQUAL_ZERO,
            POSITION_TOLERANCE,
            unit="m",
        )
        return self.solver.solve_pose(
            "pose at the wheel", candidates, (on_rim, self._align_hand([0])), self.touching, fixed
        )

    def _rim_target(self) -> Float[np.ndarray, "4 4"]:
        """Return the pose of the hook's point of the rim in the wheel's frame."""
        target = np.eye(4)
        target[:3, 3] = self.wheel.rim_point(self.entry) - self.wheel.centre
        return target

    def _make_hold(self, stroke: WheelStroke, pose: Float[np.ndarray, "n"]) -> Hold:
        """Return the hold of the tool at its point of the rim; in a grasp also of its angle about the hand axis."""
        target, axes = self._rim_target(), POSITION
        if self.mode == "grasp":
            target[:3, :3] = self._grasp_rotation(pose)
            axes = (True, True, True, False, False, True)
        return lambda waypoints: FramePose(self.robot, self.hand.tool, waypoints, target, axes, VALVE_LINK)

    def _grasp_rotation(self, pose: Float[np.ndarray, "n"]) -> Float[np.ndarray, "3 3"]:
        """Return rotation_valve_tool of a grasp: z along the wheel's axis inwards, x as of the hand in ``pose``."""
        tool = locate_links(self.body.engine, pose, [self.hand.tool])[self.hand.tool][:3, :3]
        valve = locate_links(self.body.engine, pose, [VALVE_LINK])[VALVE_LINK][:3, :3]
        z = -self.wheel.axis
        x = tool[:, 0] - (tool[:, 0] @ z) * z
        x /= np.linalg.norm(x)
        return np.asarray(valve.T @ np.stack([x, np.cross(z, x), z], axis=1))

    def _align_hand(self, waypoints: Sequence[int]) -> Constraint[MotionState]:
        """Return the constraint that the hand axis is parallel to the valve's."""
        direction = AxisDirection(self.robot, self.hand.tool, waypoints, HAND_AXIS, -self.wheel.axis)
        return Constraint("hand axis", WithinTolerance(direction, AXIS_AIM), tolerance=0.2 * AXIS_AIM, unit="rad")

    def _solve_turn(self, stroke: WheelStroke, hold: Hold, pose: Float[np.ndarray, "n"]) -> Solved:
        """Solve for the tool on the rim while the wheel turns in equal steps."""
        n_waypoints = max(int(np.ceil(abs(stroke.last - stroke.first) / TURN_STEP)) + 1, 3)
        everywhere = np.arange(n_waypoints)
        angles = np.linspace(stroke.first, stroke.last, n_waypoints)
        start = np.tile(pose, (n_waypoints, 1))
        start[:, -1] = angles
        column, sense = _find_wrist(self.hand, self.robot)
        if self.mode == "grasp":
            start[:, column] -= sense * (angles - stroke.first)

        def fix_angles(lower: np.ndarray, upper: np.ndarray) -> None:
            lower[:, -1] = upper[:, -1] = angles
            if self.mode == "grasp":
                lower[0, column] = upper[0, column] = pose[column]

        return self.solver.solve_trajectory(
            "turn",
            [start],
            {},
            constraints=(
                Constraint("tool on the rim", hold(everywhere), Sense.EQUAL_ZERO, POSITION_TOLERANCE, unit="m"),
                self._align_hand(everywhere.tolist()),
            ),
            allowances=self.touching,
            bounds=fix_angles,
        )

    def _solve_line(self, name: str, at_rim: Float[np.ndarray, "n"], angle: float) -> Solved:
        """Solve for a straight line from the rim outwards along the valve's axis."""
        steps = np.linspace(0.0, self.wheel.tube_radius + STANDOFF, LINE_WAYPOINTS)
        targets = np.tile(np.eye(4), (LINE_WAYPOINTS - 1, 1, 1))
        targets[:, :3, 3] = self.wheel.rim_point(angle) + steps[1:, None] * self.wheel.axis
        waypoints = np.arange(1, LINE_WAYPOINTS)
        line = FramePose(self.robot, self.hand.tool, waypoints, targets, POSITION)
        return self.solver.solve_trajectory(
            name,
            [np.tile(at_rim, (LINE_WAYPOINTS, 1))],
            {0: at_rim},
            constraints=(
                Constraint("tool on its line", line, Sense.EQUAL_ZERO, POSITION_TOLERANCE, unit="m"),
                self._align_hand(waypoints.tolist()),
            ),
            allowances=self.touching,
            bounds=_keep_wheel(at_rim[-1]),
        )

    def _solve_reach(self, start: Float[np.ndarray, "n"], end: Float[np.ndarray, "n"]) -> Solved:
        count = self.reach_waypoints
        starts = [straight_path(start, end, count)]
        for _, guess in posture_guesses(self.body)[1:]:
            guess[-1] = start[-1]
            starts.append(path_via(start, guess, end, count))
        return self.solver.solve_trajectory("reach", starts, {0: start, count - 1: end}, bounds=_keep_wheel(start[-1]))

    def _solve_reach_again(self, q: Float[np.ndarray, "T n"]) -> Solved:
        return self.solver.solve_trajectory("reach", [q], {0: q[0], len(q) - 1: q[-1]}, bounds=_keep_wheel(q[0, -1]))

    def _make_targets(self, stroke: WheelStroke, pose: Float[np.ndarray, "n"]) -> Targets:
        grasp = self._grasp_rotation(pose) if self.mode == "grasp" else None

        def targets(s_last: float) -> tuple[Target, ...]:
            return make_stroke_targets(self.wheel, self.hand, self.entry, stroke.last, s_last, grasp)

        return targets

    def _measure(self, motion: Motion) -> Mapping[str, float]:
        """Measure the tool's angle of travel about the valve's axis on the executed curve."""
        total = 0.0
        joint, pose_joint_tool = locate_frame(motion.robot, self.hand.tool)
        first, second = make_tangent_basis(np.asarray(self.wheel.axis))
        for phase in motion.phases:
            if phase.name.startswith("turn"):
                kinematics = KinematicsEngine(motion.robot)(motion.curve(np.linspace(phase.first, phase.last, 400)))
                positions = kinematics.rotation[:, joint] @ pose_joint_tool[:3, 3] + kinematics.position[:, joint]
                offset = positions - self.wheel.centre
                angle = np.unwrap(np.arctan2(offset @ second, offset @ first))
                total += float(angle[-1] - angle[0])
        return {"turned_deg": float(np.rad2deg(total))}


def _keep_wheel(angle: float) -> Bounds:
    def bounds(lower: np.ndarray, upper: np.ndarray) -> None:
        lower[:, -1] = upper[:, -1] = angle

    return bounds


def _stop_at(
    name: str, step: str, result: Solved, q: Float[np.ndarray, "T n"]
) -> tuple[tuple[PlannedPhase, ...], Stuck]:
    """Return the best attempt as a single phase, and the step it is stuck at."""
    return (PlannedPhase(name, q, False),), Stuck(step, result)


def _find_wrist(hand: Hand, robot: RobotModel) -> tuple[int, float]:
    """Return the coordinate that turns a hand about its axis, and its sense about the tool's z axis."""
    joint, pose_joint_tool = locate_frame(robot, hand.tool)
    column = int(robot.model.joints[joint].idx_v)
    kinematics = KinematicsEngine(robot)(np.zeros((1, robot.n)))
    turns = kinematics.jacobian[0, 3:, column]
    axis = kinematics.rotation[0, joint] @ pose_joint_tool[:3, :3] @ HAND_AXIS
    return column, float(np.sign(turns @ axis))
