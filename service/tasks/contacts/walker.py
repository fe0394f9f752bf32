"""Changes of contacts: weight shifted over those that stay, links lifted, moved and set down."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Float

from costs.robot import BASE_NAMES
from costs.state import MotionState
from costs.terms import FramePose, Joined, WithinTolerance
from scopt import Constraint, Residual
from service.body.holds import project_onto_holds
from service.body.ladder import GivenEnd, MotionSearch, NoEnd, Path, find_motion
from service.body.paths import path_via
from service.body.phases import PhaseSolver
from service.body.poses import find_pose
from service.body.sampling import free_coordinates
from service.body.seeds import Seed, posture_guesses
from service.body.starts import Way
from service.body.task_plan import PlannedPhase, Solved, Stuck
from service.body.whole_body import WholeBody
from service.demands.contacts.phases import LINE_M, LINE_TILT_RAD, list_change_phases
from service.demands.contacts.stances import ContactChange, ContactStance, StanceContact
from service.demands.phase import TaskPhase
from service.tasks.contacts.held_pose import SAME_STATE, HeldPose, keep_sides
from service.tasks.contacts.known_motion import lead_way
from service.tasks.contacts.pose_finder import POSE_RESERVE, MissingPose, PoseFinder, StuckError

SHIFT_WAYPOINTS, LINE_WAYPOINTS, SWING_WAYPOINTS = 8, 4, 20
# Of a link on its line, at the waypoints: how far it may be off along and about each axis, and the tolerance of that
# [m, rad].  Tilted about all three axes at once it stays within ``LINE_TILT_RAD``, with room between the waypoints.
LINE_ROOM = np.concatenate([np.full(3, 1e-3), np.full(3, LINE_TILT_RAD / np.sqrt(3.0) - float(np.deg2rad(0.3)))])
LINE_TOLERANCE = 2e-4
MOST_VIAS = 3  # postures of a swing, the nominal one among them
LEAST_JOINTS = 3  # of a limb that goes around something
LEAST_CORNER_M = 0.05  # farthest component of a swing's way from which on the body may go around a corner
PLAIN_TRIES = 2  # of a change of contacts, without random guesses
N_TRIES = 4  # of a change of contacts, from other guesses
SPREAD = 0.15  # of the joints of these guesses, standard deviation [rad]


@dataclass(frozen=True)
class Walker:
    """Plans the phases between two stances.

    Attributes:
        finder: of the poses between stances.
        n_tries: of each change of contacts, from other guesses.
    """

    finder: PoseFinder
    n_tries: int

    @property
    def solver(self) -> PhaseSolver:
        """Solver of the robot at its start."""
        return self.finder.solver

    @property
    def start(self) -> WholeBody:
        """The robot at its start."""
        return self.solver.body

    @property
    def most_tries(self) -> int:
        return min(self.n_tries, self.solver.most_starts)

    def try_change(
        self,
        before: ContactStance,
        after: ContactStance,
        at: Float[np.ndarray, "n"],
        tries: range,
        first: StuckError | None = None,
    ) -> Sequence[PlannedPhase]:
        """Return the phases from one stance to the next, perhaps from random guesses of the poses.

        Args:
            before, after: the stances.
            at: (n,) configuration at their beginning.
            tries: numbers of the tries; the first ones have no random guesses.
            first: error of the very first try, if that was made before.

        Raises:
            StuckError: of the first try, where none succeeds.
        """
        rng = np.random.default_rng(self.solver.seed)
        is_known = after.name in self.finder.guesses.arrive
        for k in tries[: self.most_tries]:
            noise = np.zeros(len(at)) if k < PLAIN_TRIES else SPREAD * rng.normal(size=len(at))
            noise[: len(BASE_NAMES)] = 0.0
            try:
                arrives_first = is_known ^ (k % 2 == 1)
                finder = replace(self.finder, noise=noise, arrives_first=arrives_first, keeps_poses=k == 0)
                return replace(self, finder=finder).change(before, after, at)
            except StuckError as error:
                first = first or error
        assert first is not None
        raise first

    def change(self, before: ContactStance, after: ContactStance, at: Float[np.ndarray, "n"]) -> Sequence[PlannedPhase]:
        """Return the phases from one stance to the next, which begin at a configuration."""
        change, specs = ContactChange.between(before, after), list_change_phases(before, after)
        if not change.leaving and not change.arriving:
            (move,) = specs
            step, there = f"{after.name}: pose", self.finder.guesses.there.get(after.name)
            pose = self.finder.take_known(move.name, after.contacts, ())
            if pose is None or there is None or np.abs(pose - there).max() > SAME_STATE:
                with self.solver.monitor.step(step, 0.3):
                    pose = self.finder.find(step, after.contacts, (), at, there)
            return [self._swing(move, at, pose)]
        left, made = self.finder.find_between(after.name, change, at)
        phases: list[PlannedPhase] = []
        here = at
        if left is not None:
            shift, lift, *_ = specs
            phases.append(self._move(shift, at, left, SHIFT_WAYPOINTS))
            lifted = self._line(lift, change.kept, change.leaving, left, is_up=True)
            phases.append(lifted)
            here = lifted.q[-1]
        if made is not None:
            *_, swing, land = specs
            landing = self._line(land, change.kept, change.arriving, made, is_up=False)
            phases.append(self._swing(swing, here, landing.q[0]))
            phases.append(landing)
        return phases

    def _has_free_limb(self, body: WholeBody) -> bool:
        """Return whether all joints of one of the robot's groups carry nothing: only these move on a sampled path."""
        free = set(free_coordinates(body).tolist())
        columns = {name: i for i, name in enumerate(body.robot.joint_names)}
        groups = [{columns[name] for name in names if name in columns} for names in body.robot.groups.values()]
        return not groups or any(len(group) >= LEAST_JOINTS and group <= free for group in groups)

    def end_in(self, spec: TaskPhase, at: Float[np.ndarray, "n"], finish: Float[np.ndarray, "n"]) -> PlannedPhase:
        """Return the phase that ends as near to a posture as the stance allows, perhaps around obstacles."""
        body = replace(self.finder.stand_on(_list_contacts(spec)), nominal=finish)
        guess = finish.copy()
        guess[: len(BASE_NAMES)] = at[: len(BASE_NAMES)]
        problem = replace(self.solver, body=body).pose_problem(spec.name, fraction=0.6)
        end = find_pose(problem, [("finish", guess), ("at hand", at)])
        if not end.is_feasible:
            raise StuckError(spec.name, (), end.x[0], Stuck(spec.name, end))
        last = project_onto_holds(body.engine, end.x, body.holds())[0]
        return self._swing(spec, at, last)

    def _take_phase(
        self, spec: TaskPhase, body: WholeBody, ends: Mapping[int, Float[np.ndarray, "n"]]
    ) -> PlannedPhase | None:
        """Return a phase as the earlier motion has it; None where that does not lead through its ends any more.

        Args:
            spec: the phase.
            body: on its contacts.
            ends: configuration by index of the first or the last waypoint.
        """
        known = self.finder.guesses.curves.get(spec.name)
        if known is None:
            return None
        q = known.curve.positions.copy()
        for k, end in ends.items():
            if np.abs(q[k] - end).max() > SAME_STATE:
                return None
            q[k] = end
        sides = keep_sides(body, _list_contacts(spec), np.arange(1, len(q) - 1))
        if not replace(self.solver, body=body).is_feasible(q, sides):
            return None
        kept = replace(known, curve=replace(known.curve, positions=q))
        resolve = partial(_solve_between, spec, replace(self.solver, body=body))
        return replace(_promise(spec, body, q, resolve), kept=kept)

    def _line(
        self,
        spec: TaskPhase,
        kept: tuple[StanceContact, ...],
        moving: tuple[StanceContact, ...],
        pose: Float[np.ndarray, "n"],
        *,
        is_up: bool,
    ) -> PlannedPhase:
        """Return the phase in which links leave their places, or arrive there, straight along their normals."""
        body = self.finder.stand_on(kept, moving)
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
            for contact in moving
        ]
        start = np.tile(pose, (LINE_WAYPOINTS, 1))
        solver = replace(self.solver, body=body)
        constraints += keep_sides(body, kept, np.array(sorted(shares)))
        solved = find_motion(
            MotionSearch(
                spec.name,
                solver,
                lambda own, path: own.solve_trajectory(spec.name, path, {at: pose}, constraints=constraints),
                pose,
                NoEnd(),
                paths={Way.GIVEN: lambda: (("standing still", start),)},
            )
        )
        if not solved.is_feasible:
            away = tuple(contact.move(LINE_M * contact.surface.normal) for contact in moving)
            held = HeldPose(self.solver, self.finder.stand_on(kept, moving, POSE_RESERVE), kept, away)
            raise StuckError(spec.name, (), solved.x[-1], Stuck(spec.name, solved), MissingPose(held, pose))
        return _promise(spec, body, solved.x, None)

    def _swing(
        self,
        spec: TaskPhase,
        first: Float[np.ndarray, "n"],
        last: Float[np.ndarray, "n"],
    ) -> PlannedPhase:
        """Return the free phase between two lines."""
        body = self.finder.stand_on(_list_contacts(spec))
        taken = self._take_phase(spec, body, {0: first, -1: last})
        if taken is not None:
            return taken
        known = self.finder.guesses.curves.get(spec.name)
        led = None if known is None else lead_way(known.curve.positions, first, last)
        guide = replace(body, nominal=first)
        search = replace(
            self._search(spec, body, first, last, SWING_WAYPOINTS),
            vias=lambda: posture_guesses(guide)[1:MOST_VIAS],
            is_sampled=self._has_free_limb(body),
            fraction=0.5,
        )
        corners = (
            (name, path_via(first, q, last, SWING_WAYPOINTS)) for name, q in self._find_corners(spec, first, last)
        )
        paths: dict[Way, Callable[[], Iterable[tuple[str, Path]]]] = {
            Way.CORNERS: lambda: ((name, search.fit(path)) for name, path in corners)
        }
        if led is not None:
            paths[Way.LED] = lambda: ((Way.KNOWN.value, search.fit(led)),)
        return self._finish(spec, body, find_motion(replace(search, paths=paths)))

    def _find_corners(
        self, spec: TaskPhase, first: Float[np.ndarray, "n"], last: Float[np.ndarray, "n"]
    ) -> Iterator[Seed]:
        """Yield poses in which the body has risen but not yet moved on, and has moved on but not yet risen."""
        if not self.start.robot.is_floating or np.abs(last[:3] - first[:3]).max() < LEAST_CORNER_M:
            return
        for name, across, up in (("via corner 1", first, last), ("via corner 2", last, first)):
            corner = 0.5 * (first + last)
            corner[:2], corner[2] = across[:2], up[2]
            fixed = {0: float(corner[0]), 1: float(corner[1]), 2: float(corner[2])}
            try:
                pose = self.finder.find(f"{spec.name}: corner", _list_contacts(spec), (), first, corner, fixed)
            except StuckError:
                continue
            yield name, pose

    def _move(
        self, spec: TaskPhase, first: Float[np.ndarray, "n"], last: Float[np.ndarray, "n"], n_waypoints: int
    ) -> PlannedPhase:
        """Return a phase between two configurations on contacts that stay."""
        body = self.finder.stand_on(_list_contacts(spec))
        taken = self._take_phase(spec, body, {0: first, -1: last})
        if taken is not None:
            return taken
        search = replace(self._search(spec, body, first, last, n_waypoints), vias=lambda: (), is_sampled=False)
        return self._finish(spec, body, find_motion(search))

    def _search(
        self,
        spec: TaskPhase,
        body: WholeBody,
        first: Float[np.ndarray, "n"],
        last: Float[np.ndarray, "n"],
        n_waypoints: int,
    ) -> MotionSearch:
        """Return the search for the motion of a phase between two configurations on its contacts."""
        return MotionSearch(
            spec.name,
            replace(self.solver, body=body),
            partial(_solve_between, spec),
            first,
            GivenEnd(last),
            n_waypoints=n_waypoints,
            fit=partial(_keep_contacts, body),
            is_shortened=False,
        )

    def _finish(self, spec: TaskPhase, body: WholeBody, solved: Solved) -> PlannedPhase:
        """Return a solved phase with its promises, which is solved again between its ends.

        Raises:
            StuckError: it is not solved.
        """
        if not solved.is_feasible:
            raise StuckError(spec.name, (), solved.x[-1], Stuck(spec.name, solved))
        return _promise(spec, body, solved.x, partial(_solve_between, spec, replace(self.solver, body=body)))


def _solve_between(spec: TaskPhase, solver: PhaseSolver, path: Path) -> Solved:
    """Solve a phase between the ends of a path."""
    last = len(path) - 1
    sides = keep_sides(solver.body, _list_contacts(spec), np.arange(1, last))
    return solver.solve_trajectory(spec.name, path, {0: path[0], last: path[-1]}, constraints=sides)


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


def _promise(
    spec: TaskPhase,
    body: WholeBody,
    q: Float[np.ndarray, "T n"],
    resolve: Callable[[Float[np.ndarray, "T n"]], Solved] | None,
) -> PlannedPhase:
    """Return the waypoints of a phase with its promises."""
    return PlannedPhase(spec, q, True, resolve=resolve, body=body)


def _list_contacts(spec: TaskPhase) -> tuple[StanceContact, ...]:
    """Return what carries the robot."""
    return spec.contacts or ()
