"""Solve phases of steps: frames led on ways, straight lines of configurations, and free motions to a goal."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import chain, islice

import numpy as np
from jaxtyping import Float

from costs.allowance import Allowance
from costs.guide import Guide
from costs.robot import RobotModel
from costs.state import MotionState
from costs.terms import JointTarget
from scopt import Constraint, Sense
from service.body.effort import Effort
from service.body.forces.loaded_regions import PlannedRegion, plan_world_region
from service.body.holds import (
    Hold,
    KeptPose,
    find_prescribed,
    largest_hold_error,
    project_onto_holds,
)
from service.body.inverse_kinematics import solve_holds
from service.body.ladder import Ends, GivenEnd, MotionSearch, NoEnd, Path, find_motion
from service.body.paths import straight_path
from service.body.phases import PhaseSolver
from service.body.starts import DIRECT, End, Way, choose_policy
from service.body.task_plan import KeptCurve, PlannedPhase, Solved
from service.body.whole_body import WholeBody
from service.demands.steps.phases import KEPT_M, KEPT_RAD, Led, PhaseMaker, StepPhase
from service.demands.targets import make_goal_rotation
from service.request.schema import PlanRequest
from service.request.tasks.reach import PoseGoalRequest
from service.tasks.reach.goal import Goal
from service.tasks.reach.goal_poses import GoalEnds
from service.tasks.steps.over import list_ways_over
from service.tasks.steps.profiles import find_least_duration, make_profile
from service.tasks.steps.ways import FOLLOWED, count_waypoints, explain_break, hold_share, measure_led, stay_on
from service.verify import RelativePoseTarget

STRAIGHT_WAYPOINTS, OVER_WAYPOINTS = 12, 20
PLACE_TOLERANCE, TURN_TOLERANCE = 2e-4, 1e-3  # at a waypoint [m, rad]
FOLLOW_STEPS = 15  # of Newton's method from one waypoint to the next
FAR_OFF = 0.03  # of a frame from the end of its way, with nothing but joint limits in the way [m, rad]
MOST_BEGINS = 6  # poses from which a path is tried
RESTORABLE = 20.0
DEPTH_RESERVE = 1e-3


@dataclass(frozen=True)
class Tried:
    """A phase that was not solved.

    Attributes:
        name: of the phase.
        reasons: sentences besides those of ``solved``.
        solved: the best attempt, where the optimiser made one.
        is_impossible: whether the reasons hold for every motion.
    """

    name: str
    reasons: tuple[str, ...] = ()
    solved: Solved | None = None
    is_impossible: bool = False


@dataclass(frozen=True)
class StepSolver:
    """Solver of the phases of one step.

    Attributes:
        solver: of the robot with what hands push and take.
        robot: without what hands push.
        request: the whole of it.
    """

    solver: PhaseSolver
    robot: RobotModel
    request: PlanRequest

    def make(self, maker: PhaseMaker, at: Float[np.ndarray, "n"]) -> StepPhase:
        """Return a phase from a configuration on, which may have the joints of parts besides the robot's."""
        return maker.make(at[: self.robot.n])

    def solve_chain(
        self, makers: Sequence[PhaseMaker], at: Float[np.ndarray, "n"]
    ) -> tuple[list[PlannedPhase], Tried | None]:
        """Return phases solved one after the other, the best attempt last, and the one that was not solved."""
        phases: list[PlannedPhase] = []
        for maker in makers:
            made = self.make(maker, at)
            if made.goal is not None:
                own, tried = self.solve_free(made, at, None)
            elif made.straight:
                own, tried = self.solve_straight(made, at)
            else:
                own, tried = self.solve_led(made, at)
            phases += own
            if tried is not None:
                return phases, tried
            at = phases[-1].q[-1]
        return phases, None

    def list_begins(self, free: StepPhase, path: PhaseMaker, at: Float[np.ndarray, "n"]) -> Iterator[np.ndarray]:
        """Yield configurations at the goal of a free phase at which the phase after it begins exactly on its way."""
        stage = _Stage.of(self.solver, self.robot, free, at)
        assert free.goal is not None
        goal = stage.make_goal()
        ends = GoalEnds(stage.solver, goal, touches=stage.reserved)
        found = chain(ends.find(End.FIRST, 0), ends.find(End.OTHERS, 0))
        for q in islice(found, MOST_BEGINS):
            made = self.make(path, q)
            led = made.led
            if free.is_chosen:  # nothing else says where the path begins
                led = tuple(Led(pose.link, _stay_at(pose)) for pose in free.goal.poses)
            holds = (*stage.solver.body.holds(), *(hold_share(stage.solver.body, own, 0.0) for own in led))
            yield project_onto_holds(stage.solver.body.engine, q[None], holds)[0]

    def solve_free(
        self, made: StepPhase, at: Float[np.ndarray, "n"], end: Float[np.ndarray, "n"] | None
    ) -> tuple[list[PlannedPhase], Tried | None]:
        """Return a free motion to a goal, to a given configuration there if there is one."""
        stage = _Stage.of(self.solver, self.robot, made, at)
        goal = stage.make_goal()
        if end is None:
            ends = GoalEnds(stage.solver, goal, touches=stage.reserved)
            if ends.miss is not None:
                q = np.stack([at, ends.miss.x[0]])
                return [stage.plan(q, is_feasible=False)], Tried(made.name, (), ends.miss)
            constraints, fix = goal.constraints, goal.fix_joints
        else:
            ends = GivenEnd(end)  # type: ignore[assignment]

        def solve(solver: PhaseSolver, path: Path) -> Solved:
            last = len(path) - 1
            is_fixed = end is not None or goal.is_complete
            fixed = {0: path[0], last: path[-1]} if is_fixed else {0: path[0]}

            def bounds(lower: np.ndarray, upper: np.ndarray) -> None:
                stage.lock(lower, upper)
                if end is None:
                    fix(lower, upper)

            own = () if is_fixed and end is not None else constraints(last)
            return solver.solve_trajectory(
                made.name, path, fixed, constraints=own, allowances=stage.reserved, bounds=bounds
            )

        policy = choose_policy(stage.solver.body.robot)
        paths = {Way.LED: lambda: stage.list_ways_over(at, ends)} if stage.carried else {}
        search = MotionSearch(made.name, stage.solver, solve, at, ends, policy, paths, restorable=10.0)
        solved = find_motion(search)
        resolve = partial(_solve_between, stage, made)
        return stage.finish(solved, resolve)

    def solve_straight(self, made: StepPhase, at: Float[np.ndarray, "n"]) -> tuple[list[PlannedPhase], Tried | None]:
        """Return a straight line of configurations, or where it breaks."""
        stage = _Stage.of(self.solver, self.robot, made, at)
        robot = self.solver.body.robot
        end = at.copy()
        end[[robot.joint_names.index(name) for name in made.straight]] = list(made.straight.values())
        path = straight_path(at, end, STRAIGHT_WAYPOINTS)
        phases, tried = stage.finish(stage.check_path(path), None)
        if tried is not None:
            reasons = ("the straight line breaks there; along: free looks for a way around it",)
            return phases, replace(tried, reasons=reasons)
        if made.profile == "any":
            return phases, None
        options = self.request.options
        speed, gain = robot.velocity * options.speed_share, robot.acceleration * options.acceleration_share
        least = find_least_duration(made.profile, end - at, speed, gain)
        duration = least if made.duration_s is None else made.duration_s
        if duration < least * (1.0 - 1e-6):
            reason = (
                f"duration_s: {duration:g} s is less than the {least:.2f} s that a {made.profile} profile needs within "
                "the joints' limits of speed and acceleration"
            )
            return [replace(phases[0], is_feasible=False)], Tried(made.name, (reason,), None)
        curve, law = make_profile(made.profile, path[0], path[-1], duration)
        return [replace(phases[0], q=curve.positions, kept=KeptCurve(curve, law, is_settled=True))], None

    def solve_led(self, made: StepPhase, at: Float[np.ndarray, "n"]) -> tuple[list[PlannedPhase], Tried | None]:
        """Return a phase whose frames are on their ways between the waypoints, too."""
        stage = _Stage.of(self.solver, self.robot, made, at)
        count = count_waypoints(made.led, flows=made.flows or made.is_entered)
        _, path = next(stage.list_led_paths(made, at, count))
        solve = partial(_solve_led, stage, made)
        if stage.measure_miss(path) > FAR_OFF:  # no obstacle or balance is to blame, and no optimiser helps
            reasons = tuple(explain_break(stage.body, made.led, path))
            followed = max(stage.count_followed(path), 2)
            return [stage.plan(path[:followed], is_feasible=False)], Tried(made.name, reasons)
        paths = {Way.GIVEN: lambda: stage.list_led_paths(made, at, count)}
        search = MotionSearch(
            made.name, stage.solver, solve, at, NoEnd(), DIRECT, paths, restorable=RESTORABLE, is_sampled=False
        )
        solved = find_motion(search)
        if made.flows or made.is_entered:
            solved = stage.find_most_even(solved)
        phases, tried = stage.finish(solved, partial(solve, stage.solver))
        if tried is None:
            return phases, None
        reasons = tuple(explain_break(stage.body, made.led, path))
        return phases, Tried(made.name, reasons) if reasons else tried


@dataclass(frozen=True)
class _Stage:
    """A phase on its way to a solution.

    Attributes:
        solver: of the robot at the phase's beginning, with what the phase keeps.
        robot: without what hands push.
        made: the phase.
        at: (n,) configuration at its beginning.
        locked: coordinates of the robot that stay.
        still: coordinates of what hands push.
        kept: poses that stay.
        standing: the robot with the objects, where there are some.
    """

    solver: PhaseSolver
    robot: RobotModel
    made: StepPhase
    at: Float[np.ndarray, "n"]
    locked: tuple[int, ...]
    still: tuple[int, ...]
    kept: tuple[KeptPose, ...]
    standing: WholeBody | None = None

    @staticmethod
    def of(solver: PhaseSolver, robot: RobotModel, made: StepPhase, at: Float[np.ndarray, "n"]) -> _Stage:
        """Return a phase of a solver's body from a configuration on."""
        body = solver.body
        kept = tuple(KeptPose(frame, None, pose, pose, KEPT_M, KEPT_RAD) for frame, pose in made.kept)
        if made.holding is not None:
            kept += tuple(_keep_chain(target) for hold in made.holding.held.values() for target in hold.list_chain())
        own = replace(body, nominal=at, kept=(*body.kept, *kept))
        locked = tuple(body.robot.joint_names.index(name) for name in made.locked)
        still = tuple(range(robot.n, body.robot.n))
        standing = None if made.holding is None else body
        return _Stage(replace(solver, body=own), robot, made, at, locked, still, kept, standing)

    @property
    def body(self) -> WholeBody:
        """The robot at the beginning of the phase."""
        return self.solver.body

    @cached_property
    def touches(self) -> tuple[Allowance, ...]:
        """Pairs that may touch."""
        return self.made.list_touches(self.robot, self.at[: self.robot.n], None)

    @property
    def reserved(self) -> tuple[Allowance, ...]:
        """Pairs that may touch, with depths that leave room for what lies between waypoints."""
        return tuple(replace(touch, depth=max(touch.depth - DEPTH_RESERVE, 0.0)) for touch in self.touches)

    @property
    def carried(self) -> tuple[str, ...]:
        """Objects that hands carry."""
        return () if self.made.holding is None else tuple(self.made.holding.held)

    def list_ways_over(self, at: Float[np.ndarray, "n"], ends: Ends) -> Iterator[tuple[str, Path]]:
        """Yield paths to the goal on which an object goes up, across and down."""
        for end in islice(ends.find(End.FIRST, 0), 1):
            yield from list_ways_over(self.body, self.carried[0], at, end, OVER_WAYPOINTS)

    def make_goal(self) -> Goal:
        """Return the goal of a free phase, with the fingers that move besides; what hands have pushed stays."""
        assert self.made.goal is not None
        goal, names = Goal.of(self.body, self.made.goal), self.body.robot.joint_names
        fingers = {names.index(joint): value for joint, value in self.made.fingers.items()}
        locked, still = ({k: float(self.at[k]) for k in columns} for columns in (self.locked, self.still))
        return replace(goal, joints={**locked, **goal.joints, **fingers, **still})

    def lock(self, lower: Float[np.ndarray, "T n"], upper: Float[np.ndarray, "T n"]) -> None:
        """Fix the locked coordinates at all waypoints, in place."""
        columns = [*self.locked, *self.still]
        lower[:, columns] = upper[:, columns] = self.at[columns]
        names = self.body.robot.joint_names
        for joint, value in self.made.fingers.items():
            column = names.index(joint)
            lower[:, column] = upper[:, column] = np.linspace(self.at[column], value, len(lower))

    def list_holds(self) -> tuple[Hold, ...]:
        """Return what the curve keeps besides planted links: ways, kept poses, locked joints."""
        robot = self.body.robot
        holds: list[Hold] = [partial(stay_on, robot, led) for led in self.made.led]
        for pose in self.kept:
            holds += pose.holds(robot)
        if self.locked:
            columns = np.array(self.locked)
            values, n = self.at[columns], robot.n
            holds.append(lambda waypoints: JointTarget(len(waypoints), n, waypoints, columns, values))
        return tuple(holds)

    def check_path(self, path: Path) -> Solved:
        """Return a path as it is, with what the constraints say of it."""
        quiet, fixed = self.solver.with_effort(Effort.NONE), dict(enumerate(path))
        regions = self.find_regions(len(path))
        solved = quiet.solve_trajectory(self.made.name, path, fixed, allowances=self.touches, regions=regions)
        return replace(solved, result=replace(solved.result, x=path))

    def find_most_even(self, solved: Solved) -> Solved:
        """Return the motion whose joints move most evenly: as solved, or as led alone.

        Where a path goes on without a rest, a joint that hurries between two waypoints slows the hand.
        """
        led = (self.check_path(path) for _, path in self.list_led_paths(self.made, self.at, len(solved.x)))
        motions = [own for own in (solved, *led) if own.is_feasible]
        return min(motions, key=self._measure_unevenness, default=solved)

    def _measure_unevenness(self, solved: Solved) -> float:
        """Return by how much the step of a joint differs from that before, in time at its largest speed [s]."""
        return float((np.abs(np.diff(solved.x, 2, axis=0)) / self.body.robot.velocity).max())

    def find_regions(self, count: int) -> tuple[PlannedRegion, ...]:
        """Return where the feet hold the robot while the world pushes its hands, on ``count`` waypoints."""
        if not self.made.loads or not self.body.is_balanced:
            return ()
        return (plan_world_region(self.robot, self.body.planted, self.made.loads, count),)

    def finish(self, solved: Solved, resolve: object) -> tuple[list[PlannedPhase], Tried | None]:
        """Return the solved phase with its waypoints exactly on what it keeps, and what was missed if it is not."""
        is_feasible = solved.is_feasible
        q = solved.x
        if is_feasible:
            holds = (*self.body.holds(), *self.list_holds())
            q = np.concatenate([q[:1], project_onto_holds(self.body.engine, q[1:], holds)])
        phase = self.plan(q, is_feasible=is_feasible, resolve=resolve)
        return [phase], None if is_feasible else Tried(self.made.name, (), solved)

    def plan(self, q: Float[np.ndarray, "T n"], *, is_feasible: bool, resolve: object = None) -> PlannedPhase:
        """Return waypoints as a phase with its promises."""
        made, robot = self.made, self.robot
        first, last = q[0, : robot.n], q[-1, : robot.n]
        return PlannedPhase(
            made.demand(robot, first, last),
            q,
            is_feasible,
            holds=self.list_holds() if is_feasible else (),  # a curve cannot be brought onto what is out of reach
            resolve=resolve,  # type: ignore[arg-type]
            regions=self.find_regions(len(q)),
            values=np.zeros((len(q), 0)) if made.loads else None,
            limits=tuple((led.frame, led.speed_m_s) for led in made.led if led.speed_m_s is not None),
            duration_s=None if made.profile != "any" else made.duration_s,
            body=self.standing,
            drift=min((kept.drift for kept in self.kept), default=np.inf),
        )

    def count_followed(self, path: Float[np.ndarray, "T n"]) -> int:
        """Return how many waypoints at equal shares have their frames on their ways."""
        for k, (q, share) in enumerate(zip(path, np.linspace(0.0, 1.0, len(path)), strict=True)):
            holds = [hold_share(self.body, led, share) for led in self.made.led]
            if largest_hold_error(self.body.engine, q[None], holds)[0] > FOLLOWED:
                return k
        return len(path)

    def measure_miss(self, path: Float[np.ndarray, "T n"]) -> float:
        """Return how far frames are from the ends of their ways at the end of a path [m, rad]."""
        holds = [hold_share(self.body, led, 1.0) for led in self.made.led]
        return float(largest_hold_error(self.body.engine, path[-1:], holds)[0])

    def list_led_paths(
        self, made: StepPhase, at: Float[np.ndarray, "n"], count: int
    ) -> Iterator[tuple[str, Float[np.ndarray, "T n"]]]:
        """Yield paths whose frames are at their shares, one waypoint after the other."""
        body = self.body
        fixed = find_prescribed(body.robot)
        fixed[list(self.locked)] = True
        for name, balance in (("on its way", ()), ("on its way, in balance", body.hold_in_balance())):
            path = np.tile(at, (count, 1))
            for k in range(1, count):
                share = k / (count - 1)
                step = path[k - 1] - path[k - 2] if k > 1 else np.zeros(len(at))
                start = np.where(fixed, at, path[k - 1] + step)
                holds = (*body.holds(), *(hold_share(body, led, share) for led in made.led), *balance)
                found, error = solve_holds(body, start[None], holds, fixed, FOLLOW_STEPS)
                if error[0] > FOLLOWED and k > 1:
                    found, _ = solve_holds(body, path[[k - 1]], holds, fixed, 2 * FOLLOW_STEPS)
                path[k] = found[0]
            yield name, path
            if not balance and not body.hold_in_balance():
                return


def _stay_at(pose: PoseGoalRequest) -> Guide:
    """Return a way of no length at a pose."""
    turned = make_goal_rotation(pose)
    return Guide.line(np.asarray(pose.origin), np.eye(3) if turned is None else turned, np.zeros(3))


def _keep_chain(target: RelativePoseTarget) -> KeptPose:
    """Return the hold of a second hand against the first."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = target.rotation, target.position
    most = target.position_tolerance_m, target.rotation_tolerance_rad
    return KeptPose(target.frame, target.reference, pose, pose, *most)


def _solve_led(stage: _Stage, made: StepPhase, solver: PhaseSolver, path: Path) -> Solved:
    """Solve a phase with its frames at equal shares of their ways."""
    count = len(path)
    waypoints, shares = np.arange(1, count), np.linspace(0.0, 1.0, count)[1:]
    constraints: list[Constraint[MotionState]] = []
    for led in made.led:
        for name, term, unit in measure_led(stage.body, led, waypoints, led.guide.poses(shares)):
            tolerance = PLACE_TOLERANCE if unit == "m" else TURN_TOLERANCE
            constraints.append(Constraint(name, term, Sense.EQUAL_ZERO, tolerance, unit=unit))
    return solver.solve_trajectory(
        made.name,
        path,
        {0: path[0]},
        constraints=constraints,
        allowances=stage.reserved,
        bounds=stage.lock,
        regions=stage.find_regions(count),
    )


def _solve_between(stage: _Stage, made: StepPhase, q: Path) -> Solved:
    """Solve a free motion between the ends of a path."""
    fixed = {0: q[0], len(q) - 1: q[-1]}
    return stage.solver.solve_trajectory(made.name, q, fixed, allowances=stage.reserved, bounds=stage.lock)
