"""Changes of contacts: weight shifted over those that stay, links lifted, moved and set down."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Float

from costs.robot import BASE_NAMES
from service.body.holds import project_onto_holds
from service.body.ladder import MotionSearch, Path, find_motion
from service.body.paths import bend_path, cut_path, path_via
from service.body.phases import PhaseSolver
from service.body.poses import Seed, find_pose, posture_guesses
from service.body.sampling import free_coordinates
from service.body.starts import Way
from service.body.task_plan import PlannedPhase, Stuck
from service.body.whole_body import WholeBody
from service.demands.contacts.phases import LINE_M, list_change_phases
from service.demands.contacts.stances import ContactChange, ContactStance, StanceContact
from service.demands.phase import TaskPhase
from service.tasks.chain import PhaseMotion, solve_phases
from service.tasks.contacts.held_pose import SAME_STATE, HeldPose
from service.tasks.contacts.pose_finder import DEPTH_RESERVE, POSE_RESERVE, MissingPose, PoseFinder, StuckError
from service.tasks.hints import PhaseHints
from service.tasks.phase_compiler import PhaseCompiler

SHIFT_WAYPOINTS, LINE_WAYPOINTS, SWING_WAYPOINTS = 8, 4, 20
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
        change, phases = ContactChange.between(before, after), list_change_phases(before, after)
        poses: dict[int, Float[np.ndarray, "n"]] = {}
        if not change.leaving and not change.arriving:
            poses[1] = self._find_pose(phases[0], after, at)
        else:
            left, made = self.finder.find_between(after.name, change, at)
            poses |= {} if left is None else {1: left}
            poses |= {} if made is None else {len(phases): made}
        return solve_phases(phases, at, poses, _ChangeWork(self, change)).planned

    def _find_pose(self, phase: TaskPhase, stance: ContactStance, at: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        """Return another pose on the same contacts: the known one of the stance, or one near a configuration."""
        step, there = f"{stance.name}: pose", self.finder.guesses.there.get(stance.name)
        pose = self.finder.take_known(phase.name, stance.contacts, ())
        if pose is not None and there is not None and np.abs(pose - there).max() <= SAME_STATE:
            return pose
        with self.solver.monitor.step(step, 0.3):
            return self.finder.find(step, stance.contacts, (), at, there)

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
        return self.join(spec, at, last)

    def _compile(self, spec: TaskPhase, touching: tuple[StanceContact, ...] = ()) -> PhaseCompiler:
        """Return the compiler of a phase on its contacts, while others may touch."""
        body = self.finder.stand_on(_list_contacts(spec), touching)
        solver = replace(self.solver, body=body)
        return PhaseCompiler(solver, earlier=self.finder.guesses.earlier, hints=hint_contacts)

    def line(
        self,
        spec: TaskPhase,
        moving: tuple[StanceContact, ...],
        pose: Float[np.ndarray, "n"],
        *,
        is_up: bool,
    ) -> PlannedPhase:
        """Return the phase in which links leave their places, or arrive there, straight along their normals."""
        compiler = self._compile(spec, moving)
        taken = compiler.take(spec, {0 if is_up else -1: pose})
        if taken is not None:
            return taken
        solved = compiler.solve_held(spec, pose, 0.4, is_backwards=not is_up)
        if not solved.is_feasible:
            kept = _list_contacts(spec)
            away = tuple(contact.move(LINE_M * contact.surface.normal) for contact in moving)
            held = HeldPose(self.solver, self.finder.stand_on(kept, moving, POSE_RESERVE), kept, away)
            raise StuckError(spec.name, (), solved.x[-1], Stuck(spec.name, solved), MissingPose(held, pose))
        return compiler.finish(spec, solved)

    def join(self, spec: TaskPhase, first: Float[np.ndarray, "n"], last: Float[np.ndarray, "n"]) -> PlannedPhase:
        """Return a phase between two configurations, as the earlier motion has it or searched anew.

        Raises:
            StuckError: it is not solved.
        """
        compiler = self._compile(spec)
        taken = compiler.take(spec, {0: first, -1: last})
        if taken is not None:
            return taken
        fit = partial(_keep_contacts, compiler.solver.body)
        search = replace(compiler.search_free(spec, first, last), fit=fit, is_shortened=False)
        solved = find_motion(self._narrow(search) if is_shift(spec) else self._widen(search, spec, last))
        if not solved.is_feasible:
            raise StuckError(spec.name, (), solved.x[-1], Stuck(spec.name, solved))
        return compiler.finish(spec, solved)

    def _narrow(self, search: MotionSearch) -> MotionSearch:
        """Return the search for a motion of the body alone."""
        return replace(search, vias=lambda: (), is_sampled=False)

    def _widen(self, search: MotionSearch, spec: TaskPhase, last: Float[np.ndarray, "n"]) -> MotionSearch:
        """Return the search for a motion of limbs that carry nothing, perhaps around something."""
        body, first = search.solver.body, search.first
        known = self.finder.guesses.earlier.curves.get(spec.name)
        rest = None if known is None else cut_path(known.positions, first)
        guide = replace(body, nominal=first)
        corners = (
            (name, path_via(first, q, last, SWING_WAYPOINTS)) for name, q in self._find_corners(spec, first, last)
        )
        paths: dict[Way, Callable[[], Iterable[tuple[str, Path]]]] = {
            Way.CORNERS: lambda: ((name, search.fit(path)) for name, path in corners)
        }
        if rest is not None:
            paths[Way.LED] = lambda: ((Way.KNOWN.value, search.fit(bend_path(rest, first, last))),)
        return replace(
            search,
            paths=paths,
            vias=lambda: posture_guesses(guide)[1:MOST_VIAS],
            is_sampled=self._has_free_limb(body),
            fraction=0.5,
        )

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


@dataclass(frozen=True)
class _ChangeWork:
    """Solver of the phases between two stances; it raises ``StuckError`` where one is stuck."""

    walker: Walker
    change: ContactChange

    def lead(
        self, phase: TaskPhase, first: Float[np.ndarray, "n"] | None, last: Float[np.ndarray, "n"] | None
    ) -> PhaseMotion:
        """Lift links from the first configuration, or set them down into the last."""
        if first is not None:
            return PhaseMotion.of(self.walker.line(phase, self.change.leaving, first, is_up=True))
        assert last is not None
        return PhaseMotion.of(self.walker.line(phase, self.change.arriving, last, is_up=False))

    def join(self, phase: TaskPhase, first: Float[np.ndarray, "n"], last: Float[np.ndarray, "n"]) -> PhaseMotion:
        """Shift the body, or swing links that carry nothing."""
        return PhaseMotion.of(self.walker.join(phase, first, last))


def is_shift(phase: TaskPhase) -> bool:
    """Return whether a phase only moves the body over what stays."""
    return phase.name.endswith(": shift")


def hint_contacts(phase: TaskPhase) -> PhaseHints:
    """Return how to go about a phase between two stances."""
    return PhaseHints(
        free_waypoints=SHIFT_WAYPOINTS if is_shift(phase) else SWING_WAYPOINTS,
        line_waypoints=LINE_WAYPOINTS,
        depth_reserve_m=DEPTH_RESERVE,
        restorable=0.0,
    )


def _keep_contacts(body: WholeBody, path: Float[np.ndarray, "T n"]) -> Float[np.ndarray, "T n"]:
    """Return a path between two configurations with all others moved onto the contacts that stay."""
    inner = project_onto_holds(body.engine, path[1:-1], body.holds())
    inner = np.clip(inner, body.robot.lower, body.robot.upper)
    return np.concatenate([path[:1], inner, path[-1:]])


def _list_contacts(spec: TaskPhase) -> tuple[StanceContact, ...]:
    """Return what carries the robot."""
    return spec.contacts or ()
