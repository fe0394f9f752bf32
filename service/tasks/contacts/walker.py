"""Changes of contacts: weight shifted over those that stay, links lifted, moved and set down."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from costs.robot import BASE_NAMES
from costs.state import MotionState
from costs.static_region import StaticRegionError
from costs.terms import FramePose, Joined, JointTarget, WithinTolerance
from scopt import Constraint, Cost, Residual
from service.body.equilibrium_pose import EquilibriumPose
from service.body.holds import project_onto_holds
from service.body.loaded_regions import plan_contact_region
from service.body.phases import PhaseSolver, path_via, posture_guesses, straight_path
from service.body.sampling import Tree, free_coordinates
from service.body.task_plan import PlannedPhase, Solved, Stuck
from service.body.whole_body import WholeBody
from service.demands.contacts.stances import (
    LINE_M,
    LINE_TILT_RAD,
    ContactChange,
    ContactPhase,
    ContactStance,
    StanceContact,
)
from service.tasks.contacts.held_pose import KNOWN_WEIGHT, SAME_STATE, HeldPose, keep_sides
from service.tasks.contacts.known_motion import KnownMotion, lead_way
from service.tasks.phase_compiler import shrink

SHIFT_WAYPOINTS, LINE_WAYPOINTS, SWING_WAYPOINTS = 8, 4, 20
# Of a link on its line, at the waypoints: how far it may be off along and about each axis, and the tolerance of that
# [m, rad].  Tilted about all three axes at once it stays within ``LINE_TILT_RAD``, with room between the waypoints.
LINE_ROOM = np.concatenate([np.full(3, 1e-3), np.full(3, LINE_TILT_RAD / np.sqrt(3.0) - float(np.deg2rad(0.3)))])
LINE_TOLERANCE = 2e-4
TREES = (Tree(0, 3000, "LBKPIECE1"), Tree(1, 6000, "LBKPIECE1"), Tree(2, 3000))  # of sampled starts of a swing
LEAST_JOINTS = 3  # of a limb that goes around something
LEAST_CORNER_M = 0.05  # farthest component of a swing's way from which on the body may go around a corner
PLAIN_TRIES = 2  # of a change of contacts, without random guesses
N_TRIES = 4  # of a change of contacts, from other guesses
SPREAD = 0.15  # of the joints of these guesses, standard deviation [rad]
DEPTH_RESERVE = 1.5e-3  # of an allowance, for the curve between waypoints [m]
POSE_RESERVE = 2.5e-3  # of an allowance in poses, for the motion between them [m]


class StuckError(Exception):
    """A step has no solution; carries the sentences, the best attempt, and the pose that is missing, if it is one."""

    def __init__(
        self,
        step: str,
        reasons: Sequence[str],
        q: Float[np.ndarray, "n"],
        stuck: Stuck | None = None,
        missing: MissingPose | None = None,
    ) -> None:
        super().__init__("; ".join(reasons))
        self.step, self.reasons, self.q, self.stuck, self.missing = step, tuple(reasons), q, stuck, missing


@dataclass(frozen=True)
class MissingPose:
    """A pose that a change of contacts needs and that does not exist with its contacts where they are.

    Attributes:
        held: the pose.
        near: (n,) configuration that it should be near.
    """

    held: HeldPose
    near: Float[np.ndarray, "n"]


@dataclass(frozen=True)
class Walker:
    """Plans the phases between two stances.

    Attributes:
        solver: of the robot at its start.
        guesses: poses and motions that are known already.
        noise: (n,) added to guesses of poses.
        n_tries: of each change of contacts, from other guesses.
        arrives_first: whether the pose at the new places is solved before that on what stays.
        keeps_poses: whether poses of an earlier motion are taken where they hold.
    """

    solver: PhaseSolver
    guesses: KnownMotion
    noise: Float[np.ndarray, "n"]
    n_tries: int
    arrives_first: bool = False
    keeps_poses: bool = True

    @property
    def start(self) -> WholeBody:
        return self.solver.body

    @property
    def most_tries(self) -> int:
        return min(self.n_tries, self.solver.most_starts)

    def stand_on(
        self,
        contacts: Sequence[StanceContact],
        touching: Sequence[StanceContact] = (),
        reserve_m: float = DEPTH_RESERVE,
    ) -> WholeBody:
        """Return the robot on contacts, while others may touch; of what may touch, a reserve of depth is kept [m].

        Raises:
            StuckError: the contacts hold it nowhere.
        """
        spec = ContactPhase("", "shift", tuple(contacts), tuple(touching))
        touches = shrink(spec.list_allowances(self.start.robot), reserve_m)
        planted = tuple(contact.planted for contact in contacts)
        try:
            region = plan_contact_region(self.start.robot, planted)
        except StaticRegionError as error:
            names = ", ".join(contact.patch for contact in contacts)
            raise StuckError(
                f"stand on {names}", (f"{names} hold the robot nowhere: {error}",), self.start.nominal
            ) from None
        return self.start.on_contacts(planted, touches, region)

    def try_change(
        self,
        specs: Sequence[ContactPhase],
        before: ContactStance,
        after: ContactStance,
        at: Float[np.ndarray, "n"],
        tries: range,
        first: StuckError | None = None,
    ) -> Sequence[PlannedPhase]:
        """Return the phases from one stance to the next, perhaps from random guesses of the poses.

        Args:
            specs: the phases.
            before, after: the stances.
            at: (n,) configuration at their beginning.
            tries: numbers of the tries; the first ones have no random guesses.
            first: error of the very first try, if that was made before.

        Raises:
            StuckError: of the first try, where none succeeds.
        """
        rng = np.random.default_rng(self.solver.seed)
        is_known = after.name in self.guesses.arrive
        for k in tries[: self.most_tries]:
            noise = np.zeros(len(at)) if k < PLAIN_TRIES else SPREAD * rng.normal(size=len(at))
            noise[: len(BASE_NAMES)] = 0.0
            try:
                arrives_first = is_known ^ (k % 2 == 1)
                walker = replace(self, noise=noise, arrives_first=arrives_first, keeps_poses=k == 0)
                return walker.change(specs, before, after, at)
            except StuckError as error:
                first = first or error
        assert first is not None
        raise first

    def change(
        self,
        specs: Sequence[ContactPhase],
        before: ContactStance,
        after: ContactStance,
        at: Float[np.ndarray, "n"],
    ) -> Sequence[PlannedPhase]:
        """Return the phases from one stance to the next, which begin at a configuration."""
        by_kind = {spec.kind: spec for spec in specs}
        if "move" in by_kind:
            step, there = f"{after.name}: pose", self.guesses.there.get(after.name)
            pose = self._take_pose(by_kind["move"].name, after.contacts, ())
            if pose is None or there is None or np.abs(pose - there).max() > SAME_STATE:
                with self.solver.monitor.step(step, 0.3):
                    pose = self._pose(step, after.contacts, (), at, there)
            return [self._swing(by_kind["move"], at, pose)]
        left, made = self._find_poses(after.name, ContactChange.between(before, after), at)
        phases: list[PlannedPhase] = []
        here = at
        if left is not None:
            phases.append(self._move(by_kind["shift"], at, left, SHIFT_WAYPOINTS))
            lifted = self._line(by_kind["lift"], left, is_up=True)
            phases.append(lifted)
            here = lifted.q[-1]
        if made is not None:
            landing = self._line(by_kind["land"], made, is_up=False)
            phases.append(self._swing(by_kind["swing"], here, landing.q[0]))
            phases.append(landing)
        return phases

    def _find_poses(
        self,
        name: str,
        change: ContactChange,
        at: Float[np.ndarray, "n"],
    ) -> tuple[Float[np.ndarray, "n"] | None, Float[np.ndarray, "n"] | None]:
        """Return the poses in which the old and the new contacts are in place, held by those kept; None without such.

        The body is where it is in the first of the two that is solved, so that a swing moves little else than what
        swings.
        """
        monitor = self.solver.monitor
        kept, leaving, arriving = change.kept, change.leaving, change.arriving
        known = self.guesses.leave.get(name), self.guesses.arrive.get(name)
        steps = f"{name}: pose on what stays", f"{name}: pose at the new places"
        left = self._take_pose(f"{name}: shift", kept, leaving) if leaving else None
        made = self._take_pose(f"{name}: land", kept, arriving) if arriving else None
        limbs = free_coordinates(self.stand_on(kept))
        if not self.arrives_first or not arriving or not self._are_moved_by(limbs, leaving):
            if leaving and left is None:
                with monitor.step(steps[0], 0.2):
                    left = self._pose(steps[0], kept, leaving, at, known[0])
            if arriving and made is None:
                with monitor.step(steps[1], 0.3):
                    made = self._pose(steps[1], kept, arriving, at if left is None else left, known[1])
            return left, made
        if made is None:
            with monitor.step(steps[1], 0.2):
                made = self._pose(steps[1], kept, arriving, at, known[1])
        if leaving and left is None:
            near = made.copy()
            near[limbs] = (at if known[0] is None else known[0])[limbs]
            with monitor.step(steps[0], 0.3):
                left = self._pose(steps[0], kept, leaving, at, near)
        return left, made

    def _are_moved_by(self, limbs: Int[np.ndarray, "k"], contacts: Sequence[StanceContact]) -> bool:
        """Return whether each contact's link is on a limb that carries nothing."""
        model, supports = self.start.robot.model, self.start.engine.topology.supports
        joints = [int(model.frames[model.getFrameId(contact.planted.link)].parentJoint) for contact in contacts]
        return all(bool(np.any(supports[joint][limbs])) for joint in joints)

    def _has_free_limb(self, body: WholeBody) -> bool:
        """Return whether all joints of one of the robot's groups carry nothing: only these move on a sampled path."""
        free = set(free_coordinates(body).tolist())
        columns = {name: i for i, name in enumerate(body.robot.joint_names)}
        groups = [{columns[name] for name in names if name in columns} for names in body.robot.groups.values()]
        return not groups or any(len(group) >= LEAST_JOINTS and group <= free for group in groups)

    def end_in(self, spec: ContactPhase, at: Float[np.ndarray, "n"], finish: Float[np.ndarray, "n"]) -> PlannedPhase:
        """Return the phase that ends as near to a posture as the stance allows, perhaps around obstacles."""
        body = replace(self.stand_on(spec.contacts), nominal=finish)
        guess = finish.copy()
        guess[: len(BASE_NAMES)] = at[: len(BASE_NAMES)]
        with self.solver.monitor.step(spec.name, 0.6):
            end = replace(self.solver, body=body).solve_pose(spec.name, [guess, at], ())
        if not end.is_feasible:
            raise StuckError(spec.name, (), end.x[0], Stuck(spec.name, end))
        last = project_onto_holds(body.engine, end.x, body.holds())[0]
        return self._swing(spec, at, last)

    def _pose(
        self,
        step: str,
        kept: tuple[StanceContact, ...],
        placed: tuple[StanceContact, ...],
        at: Float[np.ndarray, "n"],
        known: Float[np.ndarray, "n"] | None,
        fixed: Mapping[int, float] | None = None,
    ) -> Float[np.ndarray, "n"]:
        """Return a configuration with all contacts in place, held by those kept alone.

        It is near a known one, or near ``at`` without one; coordinates may be fixed.

        Raises:
            StuckError: there is none.
        """
        if not kept:
            raise StuckError(step, (f"{step}: no contact stays where it is",), at)
        robot, one = self.start.robot, np.zeros(1, dtype=int)
        held = HeldPose(self.solver, self.stand_on(kept, placed, POSE_RESERVE), kept, placed, fixed)
        guesses = [guess for _, guess in posture_guesses(replace(self.start, nominal=at))[1:]]
        guesses = [np.clip(at + self.noise, robot.lower, robot.upper), *guesses]
        costs: list[Cost[MotionState]] = []
        if known is not None:
            guesses = [np.clip(known + self.noise, robot.lower, robot.upper), *guesses]
            costs.append(Cost("known pose", JointTarget(1, robot.n, one, np.arange(robot.n), known), KNOWN_WEIGHT))
        near = at if known is None else known
        best: EquilibriumPose | None = None
        tries: list[tuple[Float[np.ndarray, "n"], list[Cost[MotionState]], tuple[Float[np.ndarray, "n"], ...]]]
        tries = [(guess, costs, ()) for guess in guesses[:4]]
        if costs:  # the cost may hold the pose where it is not feasible
            tries += [(guess, [], ()) for guess in guesses[:4]]
        tries += [(guess, [], (at,)) for guess in guesses[:2]]  # what is near at the start may stay as near
        for guess, wanted, ends in tries:
            self.solver.monitor.check()
            pose = held.solve(guess, near, wanted, ends)
            if pose.is_feasible:
                return held.project(pose.q)
            if best is None or len(pose.violations) < len(best.violations):
                best = pose
        assert best is not None
        reasons = tuple(f"{step}: {line}" for line in best.violations)
        raise StuckError(step, reasons, best.q, missing=MissingPose(held, near))

    def _take_pose(
        self, phase: str, kept: tuple[StanceContact, ...], placed: tuple[StanceContact, ...]
    ) -> Float[np.ndarray, "n"] | None:
        """Return the configuration in which a phase of the earlier motion ends; None where it does not do any more."""
        known = self.guesses.curves.get(phase)
        if known is None or not self.keeps_poses or not kept:
            return None
        q = known.curve.positions[-1]
        held = HeldPose(self.solver, self.stand_on(kept, placed, POSE_RESERVE), kept, placed)
        return q if held.holds_at(q) else None

    def _take_phase(
        self, spec: ContactPhase, body: WholeBody, ends: Mapping[int, Float[np.ndarray, "n"]]
    ) -> PlannedPhase | None:
        """Return a phase as the earlier motion has it; None where that does not lead through its ends any more.

        Args:
            spec: the phase.
            body: on its contacts.
            ends: configuration by index of the first or the last waypoint.
        """
        known = self.guesses.curves.get(spec.name)
        if known is None:
            return None
        q = known.curve.positions.copy()
        for k, end in ends.items():
            if np.abs(q[k] - end).max() > SAME_STATE:
                return None
            q[k] = end
        sides = keep_sides(body, spec.contacts, np.arange(1, len(q) - 1))
        if not replace(self.solver, body=body).is_feasible(q, sides):
            return None
        solve = self._solve_between(spec, body)
        kept = replace(known, curve=replace(known.curve, positions=q))
        return replace(_promise(spec, body, q, lambda q: solve([q])), kept=kept)

    def _line(
        self,
        spec: ContactPhase,
        pose: Float[np.ndarray, "n"],
        *,
        is_up: bool,
    ) -> PlannedPhase:
        """Return the phase in which links leave their places, or arrive there, straight along their normals."""
        body = self.stand_on(spec.contacts, spec.moving)
        taken = self._take_phase(spec, body, {0 if is_up else -1: pose})
        if taken is not None:
            return taken
        at = 0 if is_up else LINE_WAYPOINTS - 1
        shares = {k: abs(k - at) / (LINE_WAYPOINTS - 1) for k in range(LINE_WAYPOINTS) if k != at}
        constraints = [
            Constraint(
                f"{contact.patch} on its line",
                Joined([_keep_on_line(body, contact, k, share * LINE_M) for k, share in shares.items()]),
                tolerance=LINE_TOLERANCE,
                unit="m or rad",
            )
            for contact in spec.moving
        ]
        start = np.tile(pose, (LINE_WAYPOINTS, 1))
        solver = replace(self.solver, body=body)
        with solver.monitor.step(spec.name, 0.4):
            inner = np.array(sorted(shares))
            constraints += keep_sides(body, spec.contacts, inner)
            solved = solver.solve_trajectory(spec.name, [start], {at: pose}, constraints=constraints)
        if not solved.is_feasible:
            away = tuple(contact.move(LINE_M * contact.surface.normal) for contact in spec.moving)
            held = HeldPose(self.solver, self.stand_on(spec.contacts, spec.moving, POSE_RESERVE), spec.contacts, away)
            raise StuckError(spec.name, (), solved.x[-1], Stuck(spec.name, solved), MissingPose(held, pose))
        return _finish(spec, body, solved)

    def _swing(
        self,
        spec: ContactPhase,
        first: Float[np.ndarray, "n"],
        last: Float[np.ndarray, "n"],
    ) -> PlannedPhase:
        """Return the free phase between two lines."""
        body = self.stand_on(spec.contacts)
        taken = self._take_phase(spec, body, {0: first, -1: last})
        if taken is not None:
            return taken
        solve = self._solve_between(spec, body)
        known = self.guesses.curves.get(spec.name)
        led = None if known is None else lead_way(known.curve.positions, first, last)
        if led is not None:
            with self.solver.monitor.step(spec.name, 0.5):
                solved = solve([_keep_contacts(body, led)])
            if solved.is_feasible:
                return _finish(spec, body, solved, lambda q: solve([q]))
        guide = replace(body, nominal=first)
        starts = [straight_path(first, last, SWING_WAYPOINTS)]
        starts += [path_via(first, guess, last, SWING_WAYPOINTS) for _, guess in posture_guesses(guide)[1:3]]
        with self.solver.monitor.step(spec.name, 0.5):
            solved = solve([_keep_contacts(body, start) for start in starts])
            for corner in () if solved.is_feasible else self._find_corners(spec, first, last):
                around = solve([_keep_contacts(body, path_via(first, corner, last, SWING_WAYPOINTS))])
                if around.is_feasible:
                    solved = around
                    break
            for tree in TREES if self._has_free_limb(body) else ():
                if solved.is_feasible:
                    break
                path = replace(self.solver, body=body).sample_carried(first, last, tree)
                if path is not None:
                    around = solve([_keep_contacts(body, path)])
                    solved = around if around.is_feasible else solved
        return _finish(spec, body, solved, lambda q: solve([q]))

    def _find_corners(
        self, spec: ContactPhase, first: Float[np.ndarray, "n"], last: Float[np.ndarray, "n"]
    ) -> Iterator[Float[np.ndarray, "n"]]:
        """Yield poses in which the body has risen but not yet moved on, and has moved on but not yet risen."""
        if not self.start.robot.is_floating or np.abs(last[:3] - first[:3]).max() < LEAST_CORNER_M:
            return
        for across, up in ((first, last), (last, first)):
            corner = 0.5 * (first + last)
            corner[:2], corner[2] = across[:2], up[2]
            fixed = {0: float(corner[0]), 1: float(corner[1]), 2: float(corner[2])}
            try:
                yield self._pose(f"{spec.name}: corner", spec.contacts, (), first, corner, fixed)
            except StuckError:
                continue

    def _move(
        self, spec: ContactPhase, first: Float[np.ndarray, "n"], last: Float[np.ndarray, "n"], n_waypoints: int
    ) -> PlannedPhase:
        """Return a phase between two configurations on contacts that stay."""
        body = self.stand_on(spec.contacts)
        taken = self._take_phase(spec, body, {0: first, -1: last})
        if taken is not None:
            return taken
        solve = self._solve_between(spec, body)
        with self.solver.monitor.step(spec.name, 0.4):
            solved = solve([_keep_contacts(body, straight_path(first, last, n_waypoints))])
        return _finish(spec, body, solved, lambda q: solve([q]))

    def _solve_between(
        self, spec: ContactPhase, body: WholeBody
    ) -> Callable[[Sequence[Float[np.ndarray, "T n"]]], Solved]:
        """Return a function that solves a phase between the ends of trajectories to start from."""
        solver = replace(self.solver, body=body)

        def solve(starts: Sequence[Float[np.ndarray, "T n"]]) -> Solved:
            last = len(starts[0]) - 1
            sides = keep_sides(body, spec.contacts, np.arange(1, last))
            return solver.solve_trajectory(spec.name, starts, {0: starts[0][0], last: starts[0][-1]}, constraints=sides)

        return solve


def _keep_on_line(body: WholeBody, contact: StanceContact, waypoint: int, height_m: float) -> Residual[MotionState]:
    """Return how far a contact leaves its line along the normal at a waypoint, where it is at a height."""
    planted = contact.planted
    target, offset = planted.pose_world_link.copy(), np.eye(4)
    offset[:3, 3] = planted.sole.mean(axis=0)
    target[:3, 3] = planted.points.mean(axis=0) + height_m * contact.surface.normal
    axes = (True, True, True, *(len(planted.sole) >= 3,) * 3)
    pose = FramePose(body.robot, planted.link, [waypoint], target, axes, offset=offset)
    return WithinTolerance(pose, LINE_ROOM[: sum(axes)])


def _keep_contacts(body: WholeBody, path: Float[np.ndarray, "T n"]) -> Float[np.ndarray, "T n"]:
    """Return a path between two configurations with all others moved onto the contacts that stay."""
    inner = project_onto_holds(body.engine, path[1:-1], body.holds())
    inner = np.clip(inner, body.robot.lower, body.robot.upper)
    return np.concatenate([path[:1], inner, path[-1:]])


def _finish(
    spec: ContactPhase,
    body: WholeBody,
    solved: Solved,
    resolve: Callable[[Float[np.ndarray, "T n"]], Solved] | None = None,
) -> PlannedPhase:
    """Return a solved phase with its promises.

    Raises:
        StuckError: it is not solved.
    """
    if not solved.is_feasible:
        raise StuckError(spec.name, (), solved.x[-1], Stuck(spec.name, solved))
    return _promise(spec, body, solved.x, resolve)


def _promise(
    spec: ContactPhase,
    body: WholeBody,
    q: Float[np.ndarray, "T n"],
    resolve: Callable[[Float[np.ndarray, "T n"]], Solved] | None,
) -> PlannedPhase:
    """Return the waypoints of a phase with its promises."""
    return PlannedPhase(
        spec.name,
        q,
        True,
        targets=lambda at: spec.list_targets(),
        resolve=resolve,
        body=replace(body, touches=spec.list_allowances(body.robot)),
    )
