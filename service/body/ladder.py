"""The search for one motion: starts are tried in the order of a policy until one leads to a solution.

Every phase is searched here: a reach as well as a step, the turn of a wheel, an escape or a problem file.  They differ
in their problems, their ends and the paths that only they know.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import islice
from typing import Protocol

import numpy as np
from jaxtyping import Float, Int

from costs.scene import ConvexPiece, Scene
from service.body.effort import Effort
from service.body.paths import measure_length, path_via, resample_path, straight_path
from service.body.phases import PhaseSolver
from service.body.poses import posture_guesses
from service.body.sampling import Tree
from service.body.starts import BETWEEN_POSES, End, Policy, Start, Way
from service.body.task_plan import Solved
from service.body.whole_body import SAMPLING_CLEARANCE
from service.start.standing import FLOOR_KIND

Path = Float[np.ndarray, "T n"]
Attempts = Iterator[tuple[str, Iterable[Solved]]]
"""Starts by name, each with what its path leads to, solved on demand."""

LEAST_WAYPOINTS, MOST_WAYPOINTS = 8, 16
WAYPOINT_STEP = 0.15  # of the joint that moves most, between waypoints [rad, m]
MOST_NARROW = 400  # waypoints of a path with little clearance
MOST_EMPTY = 30  # rounds in which no start has a path; the trees of later ones are no larger
MOST_HELD = 40  # waypoints of a sampled path of a robot that keeps its holds
DENSER = 3  # times the waypoints of a path that was not solved
TIGHTENINGS = 3
LONG = 1.15  # length of a path, relative to the straight line, from which shortcuts are tried
SHORTER = 0.97  # of the length before, from which another solve is worth it
ENDS_PER_ROUND = 3
RESERVE_S, RESERVE_SHARE = 10.0, 0.2  # of the time that is left for the explanation: at most, and of the whole


class Ends(Protocol):
    """Configurations at the end of a motion, found on demand."""

    def find(self, end: End, number: int) -> Iterator[Float[np.ndarray, "n"]]:
        """Yield those of a kind; ``number`` is that of the round."""


@dataclass(frozen=True)
class GivenEnd:
    """The one configuration at which a motion ends."""

    q: Float[np.ndarray, "n"]

    def find(self, end: End, number: int) -> Iterator[Float[np.ndarray, "n"]]:
        """Yield it as the first."""
        if end is End.FIRST:
            yield self.q


@dataclass(frozen=True)
class NoEnd:
    """A motion whose end is free: only paths that its phase knows lead there."""

    def find(self, end: End, number: int) -> Iterator[Float[np.ndarray, "n"]]:
        """Yield nothing."""
        yield from ()


@dataclass(frozen=True)
class MotionSearch:
    """A phase as the search sees it.

    Attributes:
        step: its name.
        solver: of its body.
        solve: solves it from a path, with a solver of the same body.
        first: where it begins.
        ends: where it may end.
        policy: starts in their order.
        paths: by way, paths that only this phase knows, by name.
        n_waypoints: of every path; as many as its length needs if it is not given.
        fit: moves a path onto what the phase keeps.
        vias: configurations that paths lead through, by name; the robot's postures by default.
        drawn: coordinates that sampled paths may draw, of those that carry nothing; all of them by default.
        is_sampled: whether sampled paths are tried.
        is_shortened: whether shortcuts of sampled paths are tried.
        restorable: largest shortfall from which a solution is restored; 0 for none.
        fraction: of the plan that is done, for its progress.
        repair: solves it from an earlier motion, where that is done in another way.
    """

    step: str
    solver: PhaseSolver
    solve: Callable[[PhaseSolver, Path], Solved]
    first: Float[np.ndarray, "n"]
    ends: Ends
    policy: Policy = BETWEEN_POSES
    paths: Mapping[Way, Callable[[], Iterable[tuple[str, Path]]]] = field(default_factory=dict)
    n_waypoints: int | None = None
    fit: Callable[[Path], Path] = lambda path: path
    vias: Callable[[], Iterable[tuple[str, Float[np.ndarray, "n"]]]] | None = None
    drawn: Int[np.ndarray, "k"] | None = None
    is_sampled: bool = True
    is_shortened: bool = True
    restorable: float = 0.0
    fraction: float = 0.4
    repair: Callable[[PhaseSolver, Path], Solved] | None = None

    @property
    def keeps_holds(self) -> bool:
        """Whether more than free joints has to move: on planted feet the base, with kept poses whatever they need."""
        return self.solver.body.robot.is_floating or self.solver.body.keeps_poses

    def count(self, end: Float[np.ndarray, "n"]) -> int:
        """Return the number of waypoints to an end."""
        if self.n_waypoints is not None:
            return self.n_waypoints
        farthest = np.abs(end - self.first).max(initial=0.0)
        return int(np.clip(np.ceil(farthest / WAYPOINT_STEP), LEAST_WAYPOINTS, MOST_WAYPOINTS))

    def run(self, path: Path, effort: Effort, solver: PhaseSolver | None = None) -> Solved:
        """Return what the optimiser makes of a path."""
        solver = self.solver if solver is None else solver
        with solver.monitor.step(self.step, self.fraction):
            return self.solve(solver.with_effort(effort), path)


def find_motion(search: MotionSearch) -> Solved:
    """Return the first solution, or the attempt that missed least.

    Raises:
        ValueError: no start of the policy is one of the phase.
    """
    best: Solved | None = None
    for _, solved in list_motions(search):
        if solved.is_feasible:
            return solved
        if best is None or solved.shortfall < best.shortfall:
            best = solved
    if best is None:
        raise ValueError(f"{search.step}: at least one start is needed")
    return best


def list_motions(search: MotionSearch) -> Iterator[tuple[str, Solved]]:
    """Yield what the starts of a policy lead to, by name; a near miss is followed by its restoration."""
    n_left = search.solver.most_starts
    for name, solved, is_restored in _walk(search):
        n_left -= not is_restored
        if n_left < 0:
            return
        yield name, solved


def _walk(search: MotionSearch) -> Iterator[tuple[str, Solved, bool]]:
    """Yield name, solution and whether it is a restoration of the one before."""
    monitor = search.solver.monitor
    reserve = min(RESERVE_S, RESERVE_SHARE * monitor.time_limit_s)
    last_tried = 0
    for number, start in search.policy.list_starts():
        if number == 1 and next(search.ends.find(End.FIRST, 0), None) is None:
            return
        if number > last_tried + MOST_EMPTY:
            return
        for attempt in _try(search, start, number):
            last_tried = number
            yield attempt
        if number and monitor.remaining_s() < reserve:
            return


def _try(search: MotionSearch, start: Start, number: int) -> Iterator[tuple[str, Solved, bool]]:
    """Yield what a start leads to and record what it cost."""
    monitor = search.solver.monitor
    for name, solutions in _list_attempts(search, start, number):
        mark, is_empty = monitor.mark(), True
        for solved in solutions:
            monitor.log_start(search.step, name, mark, solved.is_feasible)
            is_empty = False
            if not solved.is_feasible:
                monitor.note_miss(search.step, solved.shortfall, partial(solved.describe_violations, search.step))
            yield name, solved, False
            mark = monitor.mark()
            if not solved.is_feasible and solved.shortfall < search.restorable and len(solved.x) > 1:
                with monitor.step(search.step, search.fraction):
                    restored = search.solver.restore_feasibility(search.step, solved)
                monitor.log_start(search.step, f"{name}, restored", mark, restored.is_feasible)
                yield name, restored, True
                mark = monitor.mark()
        if is_empty:
            monitor.log_start(search.step, name, mark, False)


def _list_attempts(search: MotionSearch, start: Start, number: int) -> Attempts:
    """Yield the attempts of a start: none where its way is not one of the phase."""
    if start.way is Way.KNOWN and search.repair is not None:
        search = replace(search, solve=search.repair)
    own = search.paths.get(start.way)
    if own is not None:
        for name, path in own():
            yield name, _solve_paths(search, start.effort, [path])
        return
    if start.way in (Way.KNOWN, Way.GIVEN, Way.LED, Way.CORNERS):
        return
    if start.way in (Way.TREE, Way.SHRUNKEN) and not search.is_sampled:
        return
    for end in islice(search.ends.find(start.end, number), ENDS_PER_ROUND if start.end is End.DRAWN else None):
        yield from _list_to_end(search, start, end)


def _list_to_end(search: MotionSearch, start: Start, end: Float[np.ndarray, "n"]) -> Attempts:
    """Yield the attempts of a start that lead to an end."""
    body, waypoints = search.solver.body, search.count(end)
    to = "" if start.end is End.FIRST else " to another posture" if start.end is End.OTHERS else " to a random posture"
    to += " at the goal" if to else ""
    match start.way:
        case Way.STRAIGHT:
            path = search.fit(straight_path(search.first, end, waypoints))
            yield f"straight line{to}", _solve_paths(search, start.effort, [path])
        case Way.ON_HOLDS if body.keeps_poses:
            path = body.project_onto_holds(straight_path(search.first, end, waypoints))
            yield start.way.value, _solve_paths(search, start.effort, [path])
        case Way.POSTURES:
            for name, posture in posture_guesses(body)[1:] if search.vias is None else search.vias():
                path = search.fit(path_via(search.first, posture, end, waypoints))
                yield f"via posture '{name}'", _solve_paths(search, start.effort, [path])
        case Way.TREE if start.tree is not None:
            yield (
                f"path of {start.tree.planner}, tree {start.tree.seed + 1}",
                _go_around(search, start, start.tree, end),
            )
        case Way.SHRUNKEN if start.tree is not None:
            name = f"path among obstacles of {100.0 * start.share:.0f} % size, tree {start.tree.seed + 1}"
            yield name, _go_through_shrunken(search, start, start.tree, end)


def _solve_paths(search: MotionSearch, effort: Effort, paths: Iterable[Path]) -> Iterator[Solved]:
    for path in paths:
        yield search.run(path, effort)


def _go_around(search: MotionSearch, start: Start, tree: Tree, end: Float[np.ndarray, "n"]) -> Iterator[Solved]:
    """Yield what a sampled path leads to; the path itself where the solve fails and the path does not."""
    body = replace(search.solver.body, sampled_clearance=tree.clearance)
    corners = _sample(search, replace(search.solver, body=body), end, tree)
    if corners is None:
        return
    waypoints = _count_along(search, corners, end)
    solved = _solve_sampled(search, start.effort, resample_path(corners, waypoints))
    if solved.may_hold and not solved.is_feasible:
        yield solved
    if not solved.is_feasible and search.n_waypoints is None:
        # The hull of a long step may contain what the step itself goes around.
        denser = _solve_sampled(search, start.effort, resample_path(corners, DENSER * waypoints))
        solved = denser if denser.is_feasible else solved
    if not solved.is_feasible and search.n_waypoints is None and tree.clearance < SAMPLING_CLEARANCE:
        narrow = _solve_narrow(search, start.effort, corners, tree)
        solved = narrow if narrow.is_feasible else solved
    if solved.is_feasible and search.is_shortened:
        solved = _tighten(search, start.effort, solved, tree)
    yield solved


def _go_through_shrunken(
    search: MotionSearch, start: Start, tree: Tree, end: Float[np.ndarray, "n"]
) -> Iterator[Solved]:
    """Yield what a path among smaller obstacles leads to, which the optimiser moves out of the true ones."""
    body = search.solver.body
    shrunken = replace(body, scene=shrink_scene(body.scene, start.share))
    corners = _sample(search, replace(search.solver, body=shrunken), end, tree)
    if corners is not None:
        yield search.run(search.fit(resample_path(corners, _count_along(search, corners, end))), start.effort)


def _sample(search: MotionSearch, solver: PhaseSolver, end: Float[np.ndarray, "n"], tree: Tree) -> Path | None:
    """Return the corners of a sampled path to an end; None where no tree finds one."""
    with solver.monitor.step("sampling", 0.5):
        return solver.sample(search.first, end, tree, search.drawn)


def _count_along(search: MotionSearch, corners: Path, end: Float[np.ndarray, "n"]) -> int:
    """Return the number of waypoints of a sampled path; that of a standing robot has many corners already."""
    least = search.count(end)
    if search.n_waypoints is not None and not search.is_shortened:
        return least
    if not search.keeps_holds:
        return max(least, 2 * len(corners))
    steps = np.abs(np.diff(corners, axis=0)).max(axis=1).sum() / WAYPOINT_STEP
    return int(np.clip(np.ceil(steps), least, max(least, MOST_HELD)))


def _solve_narrow(search: MotionSearch, effort: Effort, corners: Path, tree: Tree) -> Solved:
    """Return the solve from a path with little clearance: with a small margin, and in steps like its checks."""
    body = search.solver.body
    aims = replace(body.aims, margin=min(body.aims.margin, tree.clearance))
    narrow = replace(search, solver=replace(search.solver, body=replace(body, aims=aims)))
    length = float(np.abs(np.diff(corners, axis=0)).max(axis=1).sum())
    waypoints = int(np.ceil(length / tree.edge_step)) + len(corners)
    most = DENSER * MOST_HELD if search.keeps_holds else MOST_NARROW
    return _solve_sampled(narrow, effort, resample_path(corners, min(waypoints, most)))


def _solve_sampled(search: MotionSearch, effort: Effort, path: Path) -> Solved:
    """Return the solve from a sampled path; the path itself where only that is feasible, or may hold."""
    path = search.fit(path)
    solved = search.run(path, effort)
    if solved.is_feasible:
        return solved
    unchanged = search.run(path, Effort.NONE)
    return unchanged if unchanged.is_feasible or (unchanged.may_hold and not solved.may_hold) else solved


def _tighten(search: MotionSearch, effort: Effort, solved: Solved, tree: Tree) -> Solved:
    """Return a shorter solution found from shortcuts between the waypoints, or the solution as it is."""
    for attempt in range(TIGHTENINGS):
        before = measure_length(solved.x)
        if before <= LONG * np.linalg.norm(solved.x[-1] - solved.x[0]):
            break
        with search.solver.monitor.step("sampling", 0.5):
            corners = search.solver.shorten_path(solved.x, tree.seed + attempt, keeps_holds=search.keeps_holds)
        if measure_length(corners) > SHORTER * before:
            break
        shorter = search.run(search.fit(resample_path(corners, len(solved.x))), effort)
        if not shorter.is_feasible or measure_length(shorter.x) > SHORTER * before:
            break
        solved = shorter
    return solved


def shrink_scene(scene: Scene, share: float) -> Scene:
    """Return a scene whose pieces, floors aside, are smaller about their centres."""

    def shrink(piece: ConvexPiece) -> ConvexPiece:
        if piece.kind == FLOOR_KIND:
            return piece
        centre = 0.5 * (piece.lower + piece.upper)
        return ConvexPiece(piece.name, centre + share * (piece.vertices - centre), piece.kind)

    return Scene(tuple(shrink(piece) for piece in scene.pieces))
