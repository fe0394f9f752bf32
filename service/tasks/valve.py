"""Turning a valve: reach the wheel, insert the hook, turn, retract; and again from a new grasp where the wrist ends.

Two modes. ``hook``: the hook rests between the spokes and the hand is free to turn about its axis, so that one stroke
goes all the way round. ``grasp``: the hand turns with the wheel, starting with the wrist at the limit that leaves the
longest turn (Franklin, 2016, sec. 4.3), and takes a new grasp when its range is used up.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float

from costs.allowance import Allowance, BodyRef
from costs.kinematics import locate_links
from costs.robot import RobotModel
from costs.state import MotionState
from costs.terms import AxisDirection, FramePose, WithinTolerance
from scopt import Constraint, Sense
from service.body.holds import Hold
from service.body.phases import (
    Bounds,
    PhaseSolver,
    PlannedPhase,
    Solved,
    Stuck,
    Targets,
    TaskPlan,
    path_via,
    posture_guesses,
    straight_path,
)
from service.body.whole_body import LIMIT_RESERVE, WholeBody
from service.demands.wheel import HAND_AXIS, Hand, Wheel, make_hook_allowances, make_stroke_targets
from service.errors import RequestError
from service.request.names import VALVE_LINK
from service.tasks.wheel import add_wheel, tool_positions, turned_angle, wrist_of
from service.verify import Motion, Target

Mode = Literal["hook", "grasp"]

STANDOFF = 0.07  # of the tool from the wheel's plane before it is inserted, beyond the rim's tube [m]
TURN_STEP = np.deg2rad(20.0)  # between waypoints
AXIS_AIM = np.deg2rad(1.0)  # what the optimiser keeps to at the waypoints
POSITION_TOLERANCE = 5e-4  # of the tool at a waypoint [m]
HOOK_MARGIN = 5e-3  # asked of the hook and the wheel it reaches into [m]
WRIST_RESERVE = 0.1  # kept from the wrist's limits in a grasp, for the lean of the hand axis [rad]
MOST_GAPS = 3  # tried with each hand, the nearest first
REACH_WAYPOINTS, LINE_WAYPOINTS = 14, 5
TOOL_POSITION = (True,) * 3 + (False,) * 3


@dataclass(frozen=True)
class Stroke:
    """One turn of the wheel without letting go.

    Attributes:
        suffix: of the phases' names; empty for the only one.
        first, last: wheel angle at its ends [rad].
    """

    suffix: str
    first: float
    last: float


@dataclass(frozen=True)
class ValveTurn:
    """One attempt to turn a wheel with one hand, entering at one gap.

    Attributes:
        solver: of the body augmented by the wheel.
        wheel: what to turn.
        hand: with which hand.
        mode: ``hook`` or ``grasp``.
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
        """The robot with the wheel."""
        return self.solver.body

    @property
    def robot(self) -> RobotModel:
        """The robot with the wheel."""
        return self.solver.body.robot

    @property
    def touching(self) -> tuple[Allowance, ...]:
        """The hook may touch the rim, and nothing else may."""
        return make_hook_allowances(self.wheel, self.hand)

    def strokes(self) -> tuple[Stroke, ...]:
        """As few equal strokes as the wrist's range allows; one in hook mode."""
        count = 1
        if self.mode == "grasp":
            column, _ = wrist_of(self.hand, self.robot)
            usable = self.robot.upper[column] - self.robot.lower[column] - 2.0 * WRIST_RESERVE
            count = int(np.ceil(abs(self.turn) / usable))
        edges = np.linspace(0.0, self.turn, count + 1)
        names = [""] if count == 1 else [f" {k + 1}" for k in range(count)]
        return tuple(Stroke(name, *ends) for name, *ends in zip(names, edges[:-1], edges[1:], strict=True))

    def plan(self) -> TaskPlan:
        """All strokes one after the other, each planned backwards from its turn."""
        phases: tuple[PlannedPhase, ...] = ()
        at = self.body.nominal
        for stroke in self.strokes():
            done, stuck = self._stroke(stroke, at)
            phases += done
            if stuck is not None:
                return TaskPlan(self.body, phases, stuck=stuck, measure=self._measure)
            at = phases[-1].q[-1]
        note = f"{self.hand.side} hand in {self.mode} mode, inserted at {np.rad2deg(self.entry):.0f} deg of the rim"
        return TaskPlan(self.body, phases, measure=self._measure, notes=(note,))

    def _stroke(self, stroke: Stroke, at: Float[np.ndarray, "n"]) -> tuple[tuple[PlannedPhase, ...], Stuck | None]:
        """The phases of a stroke from configuration ``at``, and the step that has no solution, if there is one."""
        monitor, suffix = self.solver.monitor, stroke.suffix
        with monitor.step("pose at the wheel", 0.1):
            pose = self._pose(stroke, at)
        if not pose.is_feasible:
            return _stopped(f"reach{suffix}", "pose at the wheel", pose, np.stack([at, pose.x[0]]))
        hold = self._hold(stroke, pose.x[0])
        with monitor.step("turn", 0.2):
            turn = self._turn(stroke, hold, pose.x[0])
        if not turn.is_feasible:
            return _stopped(f"turn{suffix}", "turn", turn, np.concatenate([at[None], turn.x]))
        with monitor.step("insert", 0.45):
            insert = self._line("insert", turn.x[0], self.entry + stroke.first)
        if not insert.is_feasible:
            return _stopped(f"insert{suffix}", "insert", insert, np.concatenate([at[None], insert.x[::-1]]))
        approach = insert.x[::-1]
        with monitor.step("reach", 0.55):
            reach = self._reach(at, approach[0])
        phases = [PlannedPhase(f"reach{suffix}", reach.x, reach.is_feasible, resolve=self._reach_again)]
        if not reach.is_feasible:
            return tuple(phases), Stuck(f"reach{suffix}", reach)
        with monitor.step("retract", 0.65):
            retract = self._line("retract", turn.x[-1], self.entry + stroke.last)
        phases += [
            PlannedPhase(f"insert{suffix}", approach, True, allowances=self.touching),
            PlannedPhase(f"turn{suffix}", turn.x, True, (hold,), self.touching, self._targets(stroke, pose.x[0])),
            PlannedPhase(f"retract{suffix}", retract.x, retract.is_feasible, allowances=self.touching),
        ]
        return tuple(phases), Stuck.at(f"retract{suffix}", retract)

    def _pose(self, stroke: Stroke, at: Float[np.ndarray, "n"]) -> Solved:
        """The hook at its point of the rim as the stroke begins; in a grasp with the wrist at its limit."""
        fixed = {self.robot.n - 1: stroke.first}
        if self.mode == "grasp":
            column, sense = wrist_of(self.hand, self.robot)
            # The tool's z axis points against the wheel's: a positive turn needs the wrist to go against its sense.
            rises = np.sign(stroke.last - stroke.first) * sense < 0.0
            reserve = max(WRIST_RESERVE, LIMIT_RESERVE)
            lower, upper = self.robot.lower[column] + reserve, self.robot.upper[column] - reserve
            fixed[column] = float(lower if rises else upper)
        candidates = [at, *(guess for _, guess in posture_guesses(self.body)[1:])]
        on_rim = Constraint(
            "tool on the rim",
            FramePose(self.robot, self.hand.tool, [0], self._rim_target(), TOOL_POSITION, VALVE_LINK),
            Sense.EQUAL_ZERO,
            POSITION_TOLERANCE,
            unit="m",
        )
        return self.solver.pose("pose at the wheel", candidates, (on_rim, self._hand_axis([0])), self.touching, fixed)

    def _rim_target(self) -> Float[np.ndarray, "4 4"]:
        """The hook's point of the rim in the wheel's frame."""
        target = np.eye(4)
        target[:3, 3] = self.wheel.rim_point(self.entry) - self.wheel.centre
        return target

    def _hold(self, stroke: Stroke, pose: Float[np.ndarray, "n"]) -> Hold:
        """The tool stays at its point of the rim; in a grasp it also keeps its angle about the hand axis."""
        target, axes = self._rim_target(), TOOL_POSITION
        if self.mode == "grasp":
            target[:3, :3] = self._grasp_rotation(stroke, pose)
            axes = (True, True, True, False, False, True)
        return lambda waypoints: FramePose(self.robot, self.hand.tool, waypoints, target, axes, VALVE_LINK)

    def _grasp_rotation(self, stroke: Stroke, pose: Float[np.ndarray, "n"]) -> Float[np.ndarray, "3 3"]:
        """rotation_valve_tool of a grasp: z along the wheel's axis inwards, x as the hand has it in ``pose``."""
        tool = locate_links(self.body.engine, pose, [self.hand.tool])[self.hand.tool][:3, :3]
        valve = locate_links(self.body.engine, pose, [VALVE_LINK])[VALVE_LINK][:3, :3]
        z = -self.wheel.axis
        x = tool[:, 0] - (tool[:, 0] @ z) * z
        x /= np.linalg.norm(x)
        return np.asarray(valve.T @ np.stack([x, np.cross(z, x), z], axis=1))

    def _hand_axis(self, waypoints: Sequence[int]) -> Constraint[MotionState]:
        """The hand axis is parallel to the valve's, the hand free to turn about it."""
        along = AxisDirection(self.robot, self.hand.tool, waypoints, HAND_AXIS, -self.wheel.axis)
        return Constraint("hand axis", WithinTolerance(along, AXIS_AIM), tolerance=0.2 * AXIS_AIM, unit="rad")

    def _turn(self, stroke: Stroke, hold: Hold, pose: Float[np.ndarray, "n"]) -> Solved:
        n_waypoints = max(int(np.ceil(abs(stroke.last - stroke.first) / TURN_STEP)) + 1, 3)
        everywhere = np.arange(n_waypoints)
        angles = np.linspace(stroke.first, stroke.last, n_waypoints)
        start = np.tile(pose, (n_waypoints, 1))
        start[:, -1] = angles
        column, sense = wrist_of(self.hand, self.robot)
        if self.mode == "grasp":
            start[:, column] -= sense * (angles - stroke.first)

        def at_angles(lower: np.ndarray, upper: np.ndarray) -> None:
            lower[:, -1] = upper[:, -1] = angles
            if self.mode == "grasp":
                lower[0, column] = upper[0, column] = pose[column]

        return self.solver.trajectory(
            "turn",
            [start],
            {},
            constraints=(
                Constraint("tool on the rim", hold(everywhere), Sense.EQUAL_ZERO, POSITION_TOLERANCE, unit="m"),
                self._hand_axis(everywhere.tolist()),
            ),
            allowances=self.touching,
            bounds=at_angles,
        )

    def _line(self, name: str, at_rim: Float[np.ndarray, "n"], angle: float) -> Solved:
        """Straight away from the rim along the valve's axis."""
        steps = np.linspace(0.0, self.wheel.tube_radius + STANDOFF, LINE_WAYPOINTS)
        targets = np.tile(np.eye(4), (LINE_WAYPOINTS - 1, 1, 1))
        targets[:, :3, 3] = self.wheel.rim_point(angle) + steps[1:, None] * self.wheel.axis
        waypoints = np.arange(1, LINE_WAYPOINTS)
        line = FramePose(self.robot, self.hand.tool, waypoints, targets, TOOL_POSITION)
        return self.solver.trajectory(
            name,
            [np.tile(at_rim, (LINE_WAYPOINTS, 1))],
            {0: at_rim},
            constraints=(
                Constraint("tool on its line", line, Sense.EQUAL_ZERO, POSITION_TOLERANCE, unit="m"),
                self._hand_axis(waypoints.tolist()),
            ),
            allowances=self.touching,
            bounds=_wheel_still(at_rim[-1]),
        )

    def _reach(self, start: Float[np.ndarray, "n"], end: Float[np.ndarray, "n"]) -> Solved:
        count = self.reach_waypoints
        starts = [straight_path(start, end, count)]
        for _, guess in posture_guesses(self.body)[1:]:
            guess[-1] = start[-1]
            starts.append(path_via(start, guess, end, count))
        return self.solver.trajectory("reach", starts, {0: start, count - 1: end}, bounds=_wheel_still(start[-1]))

    def _reach_again(self, q: Float[np.ndarray, "T n"]) -> Solved:
        return self.solver.trajectory("reach", [q], {0: q[0], len(q) - 1: q[-1]}, bounds=_wheel_still(q[0, -1]))

    def _targets(self, stroke: Stroke, pose: Float[np.ndarray, "n"]) -> Targets:
        grasp = self._grasp_rotation(stroke, pose) if self.mode == "grasp" else None

        def targets(s_last: float) -> tuple[Target, ...]:
            return make_stroke_targets(self.wheel, self.hand, self.entry, stroke.last, s_last, grasp)

        return targets

    def _measure(self, motion: Motion) -> Mapping[str, float]:
        """The angle the tool has gone round the valve's axis, measured on the executed curve."""
        turned = 0.0
        for phase in motion.phases:
            if phase.name.startswith("turn"):
                s = np.linspace(phase.first, phase.last, 400)
                points = tool_positions(motion.robot, self.hand.tool, motion.curve(s))
                turned += turned_angle(points, self.wheel.centre, self.wheel.axis)
        return {"turned_deg": float(np.rad2deg(turned))}


def _wheel_still(angle: float) -> Bounds:
    def bounds(lower: np.ndarray, upper: np.ndarray) -> None:
        lower[:, -1] = upper[:, -1] = angle

    return bounds


def _stopped(
    name: str, step: str, result: Solved, q: Float[np.ndarray, "T n"]
) -> tuple[tuple[PlannedPhase, ...], Stuck]:
    """The best attempt as a single phase, and the step it is stuck at."""
    return (PlannedPhase(name, q, False),), Stuck(step, result)


def _touching_at_start(body: WholeBody) -> tuple[str, ...]:
    """A sentence for each link that is in the wheel before anything has moved."""
    contacts = body.checker()(body.engine(body.nominal[None]))
    bodies = body.robot.bodies
    lines = []
    for row in np.flatnonzero(contacts.is_self & (contacts.distance < 0.0)):
        pair = [bodies[contacts.body[row]], bodies[contacts.other[row]]]
        if any(one.link == VALVE_LINK for one in pair):
            link, part = (one.name for one in sorted(pair, key=lambda one: one.link == VALVE_LINK))
            depth = -float(contacts.distance[row])
            lines.append(f"start is in collision: {link} is {depth:.3f} m inside {part}; start farther away")
    return tuple(lines)


def plan_turn(
    solver: PhaseSolver,
    wheel: Wheel,
    hands: Sequence[Hand],
    mode: Mode,
    turn: float,
    reach_waypoints: int = REACH_WAYPOINTS,
) -> TaskPlan:
    """Try hands and gaps in turn; the first that works, else the attempt that got furthest.

    Raises:
        RequestError: a link of the robot is in the wheel before anything has moved.
    """
    wheel_body = BodyRef("mechanism", VALVE_LINK)
    solver = replace(
        solver,
        body=add_wheel(solver.body, wheel),
        overrides=tuple((BodyRef.of_link(hand.hook), wheel_body, HOOK_MARGIN) for hand in hands),
    )
    touching = _touching_at_start(solver.body)
    if touching:
        raise RequestError(touching)
    best: TaskPlan | None = None
    for hand in hands:
        for entry in wheel.gaps[:MOST_GAPS]:
            plan = ValveTurn(solver, wheel, hand, mode, turn, entry, reach_waypoints).plan()
            if plan.is_feasible:
                return plan
            if best is None or len(plan.phases) > len(best.phases):
                best = plan
    if best is None:
        raise ValueError("a wheel needs a gap and the robot a hand")
    return best
