"""Where to stand for a task with a mechanism: a search over places of the feet, scored by quick checks of poses.

The robot stands in the posture of its start, feet and base moved together in the plane. Candidates of a coarse grid
are ranked by geometry alone: distances between shoulders and the places that the hands hold, feet clear of the leaf.
The best are checked by poses, and finer steps about the best of these are checked again. The effort is counted, so that
equal seeds give equal results where the time limit is not reached.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from costs.robot import RobotModel, with_mechanism
from costs.scene import Scene
from costs.stopping import Stopped, stops_when
from scopt import Clock, EffortClock, Settings
from service.body.aims import Aims
from service.body.monitor import Interrupted, Monitor, OnProgress
from service.body.phases import PhaseSolver
from service.body.whole_body import WholeBody
from service.errors import RequestError
from service.request.schema import PlanRequest
from service.setup.checks import check_start, find_soles
from service.setup.prepare import PlanSetup, prepare
from service.start.standing import FLOOR_KIND, place_bodies
from service.tasks.handling import FARTHER, find_collisions
from service.tasks.kind import find_plan_part
from service.tasks.stances.grid import Grid, is_near, make_rotation
from service.tasks.stances.poses import Outcome, StanceTask

if TYPE_CHECKING:
    from perception import Perceived

LIMIT_S = 20.0
RADIUS_M = 1.0  # of the places searched about the start
COARSE, ENOUGH_GOOD = 8, 4  # most places of the grid that are checked by poses, and how many of them have to do
COARSE_APART = 2.0  # between them, in steps of the grid
FINE, FINE_ROUNDS, FINE_PARENTS = 2, 2, 2  # places that are checked about the best, and rounds
EXCELLENT, FEW_GOOD = 0.95, 2  # score after which little is to be gained, once that many places are good
ENOUGH_BALANCE_M, ENOUGH_REACH_M, ENOUGH_CLEARANCE_M = 0.05, 0.2, 0.1  # reserves that count no further
SCORE_SHARES = (0.7, 0.12, 0.1, 0.08)  # of angle, balance, reach and clearance


@dataclass(frozen=True)
class StanceCandidate:
    """A place to stand, with its score.

    Attributes:
        base: (3,) x, y [m] and yaw [rad] of the base in the world.
        start: (n,) configuration of the robot there.
        soles: (C, 3) corners of each planted link's sole in the world [m].
        score: 0 to 1; 0 for a place that is refused.
        outcome: how far the task gets; None for a place that is refused.
        clearance_m: of the robot at rest from scene and mechanism, at most 0.1 more than the request's margin [m].
        refused: sentences; empty for a place to stand at.
    """

    base: Float[np.ndarray, "3"]
    start: Float[np.ndarray, "n"]
    soles: dict[str, Float[np.ndarray, "C 3"]]
    score: float
    outcome: Outcome | None
    clearance_m: float
    refused: tuple[str, ...] = ()

    @property
    def position(self) -> tuple[float, float, float]:
        """Position of the base, as in ``start.base`` of a request [m]."""
        x, y, z = (round(float(value), 4) for value in self.start[:3])
        return x, y, z

    @property
    def quaternion_wxyz(self) -> tuple[float, float, float, float]:
        """Orientation of the base, as in ``start.base`` of a request."""
        w, x, y, z = Rotation.from_euler("ZYX", self.start[3:6]).as_quat(scalar_first=True).round(6).tolist()
        return w, x, y, z


@dataclass(frozen=True)
class StanceSearch:
    """The result of a search for a stance.

    Attributes:
        setup: the request's robot and scene.
        task: what is to be done.
        candidates: that were checked, the best first; refused ones last.
        notes: about mechanism and search.
        n_ranked: places that were ranked by geometry.
        is_complete: whether the search ended before its time limit.
        seconds: wall time.
    """

    setup: PlanSetup
    task: StanceTask | None
    candidates: tuple[StanceCandidate, ...]
    notes: tuple[str, ...]
    n_ranked: int
    is_complete: bool
    seconds: float

    @property
    def best(self) -> StanceCandidate | None:
        """The best place to stand; None if nothing can be moved from any."""
        return next((candidate for candidate in self.candidates if candidate.score > 0.0), None)


def find_stance(
    request: PlanRequest,
    limit_s: float | None = None,
    radius_m: float = RADIUS_M,
    on_progress: OnProgress | None = None,
    should_stop: Callable[[], bool] | None = None,
    robot: RobotModel | None = None,
    see: Callable[..., Perceived] | None = None,
    *,
    takes_first: bool = False,
    clock: Clock | None = None,
) -> StanceSearch:
    """Search for places to stand from which a request's door, valve or mechanism can be moved farthest.

    Nothing is planned: a place with the highest score has poses at the handle, on the leaf or at the rim, and the
    motions between them may still not exist.

    Args:
        request: with ``task.door``, ``task.valve`` or ``task.mechanism``; its start is where the search begins.
        limit_s: wall time for the whole search, perception included; by default ``LIMIT_S`` of processor time.
        radius_m: of the places searched about the start.
        on_progress: called with the name of the current step and the fraction that is done.
        should_stop: polled often; once it returns True the search ends with what it has.
        robot: the request's robot if it is loaded already.
        see: ``perception.perceive``, or a function that caches its results.
        takes_first: whether the first place that has all poses ends the search; the request's own place comes first.
        clock: measures the time limit instead.

    Raises:
        RequestError: another task, a robot with a fixed base or without hands, or a problem of the request.
    """
    part = find_plan_part(request)
    if not part.has_stances:
        raise RequestError(
            f"{request.kind.field}: a place to stand is searched for tasks with a mechanism; expected task.door, "
            "task.valve or task.mechanism"
        )
    if request.resume is not None:
        raise RequestError("resume: the robot stands where the motion was interrupted; leave it out")
    started = time.perf_counter()
    if clock is None:
        clock = EffortClock() if limit_s is None else time.monotonic
    monitor = Monitor(LIMIT_S if limit_s is None else limit_s, should_stop, on_progress, clock=clock)
    setup = prepare(
        request,
        lambda step: monitor.report(step, 0.02),
        robot,
        monitor.is_over,
        see,
        checks_start=False,
        finds_package=True,
    )
    if not setup.robot.is_floating:
        raise RequestError(
            f"robot: the base of {setup.robot.name} is fixed and plants no feet; expected a robot that stands"
        )
    candidates: list[StanceCandidate] = []
    n_ranked, is_complete = 0, False
    found: tuple[StanceTask, tuple[str, ...]] | str = "the scan was not read in time"
    if not setup.is_stopped:
        aims = Aims.of(request.options, setup.robot, setup.scene)
        body = WholeBody.standing(setup.robot, setup.scene, setup.start, setup.contacts, aims)
        found = part.find_stance_task(setup.request.section, setup, body)  # with its files read
    if isinstance(found, str):
        return StanceSearch(setup, None, (), (found,), 0, not setup.is_stopped, time.perf_counter() - started)
    sought, notes = found
    try:
        with stops_when(monitor.is_over):
            grid = Grid(setup, sought, radius_m)
            ranked = grid.rank(request.options.seed)
            n_ranked = len(ranked)
            _search(_Examiner(setup, sought, monitor), grid, ranked, candidates, takes_first)
            is_complete = True
    except (Interrupted, Stopped):
        pass
    if not n_ranked and is_complete:
        notes = (*notes, f"no place within {radius_m:g} m of the start has what is held within the arms' reach")
    ordered = sorted(candidates, key=lambda candidate: (bool(candidate.refused), -candidate.score))
    seconds = time.perf_counter() - started
    return StanceSearch(setup, sought, tuple(ordered), notes, n_ranked, is_complete, seconds)


@dataclass(frozen=True)
class _Examiner:
    """Checks of single places."""

    setup: PlanSetup
    task: StanceTask
    monitor: Monitor

    @cached_property
    def robot(self) -> RobotModel:
        """The robot with the mechanism."""
        return with_mechanism(self.setup.robot, self.task.mechanism.joints)

    @cached_property
    def at_rest(self) -> list[tuple[str, Float[np.ndarray, "V 3"]]]:
        """Vertices of each link at rest that is not planted, as in the base's frame turned upright [m]."""
        start = self.setup.start
        placed = [(body.link, points) for body, points in place_bodies(self.setup.robot, start)]
        turn = make_rotation(-start[3])
        return [
            (link, np.column_stack([(points[:, :2] - start[:2]) @ turn.T, points[:, 2]]))
            for link, points in placed
            if link not in self.setup.soles
        ]

    @cached_property
    def solids(self) -> list[tuple[str, Float[np.ndarray, "2 3"], Float[np.ndarray, "F 4"]]]:
        """Name, box and outward planes of each piece and of each part of the mechanism at rest."""
        shapes = [(piece.name, piece.vertices) for piece in self.setup.scene.pieces if piece.kind != FLOOR_KIND]
        q = np.concatenate([self.setup.start, self.task.mechanism.start])
        moved = self.robot.mechanism_links
        shapes += [(body.name, points) for body, points in place_bodies(self.robot, q) if body.link in moved]
        return [
            (name, np.stack([points.min(axis=0), points.max(axis=0)]), ConvexHull(points).equations)
            for name, points in shapes
        ]

    def find_overlap(self, pose: Float[np.ndarray, "3"]) -> str | None:
        """Return a sentence where a vertex of the robot at rest is in a piece or in the mechanism; quickly."""
        turn, margin = make_rotation(pose[2]), self.setup.request.options.margin_m
        links = [
            (link, np.column_stack([points[:, :2] @ turn.T + pose[:2], points[:, 2]])) for link, points in self.at_rest
        ]
        boxes = np.array([[points.min(axis=0), points.max(axis=0)] for _, points in links])
        for name, (low, high), planes in self.solids:
            meets = np.all((boxes[:, 0] <= high + margin) & (boxes[:, 1] >= low - margin), axis=1)
            for at in np.flatnonzero(meets).tolist():
                link, points = links[at]
                if np.any(np.all(points @ planes[:, :3].T + planes[:, 3] < margin, axis=1)):
                    return f"start is in collision: {link} is in or within {1e3 * margin:.0f} mm of {name}"
        return None

    def list_starts(self, poses: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N n"]:
        """Return the start configuration at each place."""
        starts = np.tile(self.setup.start, (len(poses), 1))
        starts[:, [0, 1, 3]] = poses
        return starts

    def examine(self, pose: Float[np.ndarray, "3"]) -> StanceCandidate:
        """Return a place with its score, or why it is refused."""
        setup, options = self.setup, self.setup.request.options
        (start,) = self.list_starts(pose[None])
        soles = find_soles(setup.robot, start, setup.request, None)

        def refuse(*lines: str) -> StanceCandidate:
            return StanceCandidate(pose, start, soles, 0.0, None, 0.0, lines)

        overlap = self.find_overlap(pose)
        if overlap is not None:
            return refuse(overlap)
        try:
            check = check_start(setup.robot, start, setup.scene, soles, setup.request, None)
        except RequestError as error:
            return refuse(*error.problems)
        if check.overlaps or check.unresolved:
            return refuse(*check.notes, *check.unresolved)
        aims = Aims.of(options, setup.robot, setup.scene)
        plain = WholeBody.standing(setup.robot, setup.scene, start, tuple(soles), aims)
        joints = self.task.mechanism
        body = replace(plain.with_robot(self.robot, np.concatenate([start, joints.start])), releases=joints.releases)
        inside = tuple(find_collisions(body, remedy=FARTHER))
        if inside:
            return refuse(*inside)
        clearance = self._measure_clearance(body)
        if clearance < aims.margin:
            return refuse(f"only {1e3 * clearance:.0f} mm from the surroundings at rest")
        met = tuple(self.task.find_in_the_way(replace(body, scene=Scene(()))))
        if met:
            return refuse(*met)
        solver = PhaseSolver(
            body,
            self.monitor,
            Settings(qp=options.qp),
            self.task.near,
            options.starts,
            options.seed,
            hand_friction=options.hand_friction,
        )
        outcome = self.task.try_stance(solver)
        return StanceCandidate(pose, start, soles, self._score(outcome, clearance), outcome, clearance)

    def _score(self, outcome: Outcome, clearance: float) -> float:
        """Return the weighted mean of angle, balance, reach and clearance, each from 0 to 1."""
        options = self.setup.request.options
        parts = (
            outcome.reached / self.task.whole,
            (outcome.balance_m - options.balance_margin_m) / ENOUGH_BALANCE_M,
            outcome.reach_m / ENOUGH_REACH_M,
            (clearance - options.margin_m) / ENOUGH_CLEARANCE_M,
        )
        share = np.clip(parts, 0.0, 1.0)
        if outcome.reached <= 0.0:
            return 0.0
        return float(np.array(SCORE_SHARES) @ share)

    def _measure_clearance(self, body: WholeBody) -> float:
        """Return the least distance of the robot from pieces and mechanism, as far as the checker sees [m]."""
        seeing = replace(body, sight=ENOUGH_CLEARANCE_M)
        contacts = seeing.make_checker()(body.engine(body.nominal[None]))
        bodies, moved = body.robot.bodies, body.robot.mechanism_links
        floors = [piece.kind == FLOOR_KIND for piece in body.scene.pieces]
        least = body.aims.margin + ENOUGH_CLEARANCE_M
        for row in range(len(contacts)):
            first, other = bodies[contacts.body[row]].link in moved, int(contacts.other[row])
            counts = first != (bodies[other].link in moved) if contacts.is_self[row] else not (first or floors[other])
            if counts:
                least = min(least, float(contacts.distance[row]))
        return least


def _search(
    examiner: _Examiner,
    grid: Grid,
    ranked: Float[np.ndarray, "N 3"],
    candidates: list[StanceCandidate],
    takes_first: bool,
) -> None:
    """Check the most promising places, then finer steps about the best; what was checked is added in place.

    Args:
        examiner, grid, ranked, candidates: of the search.
        takes_first: whether the first place that has all poses ends it.
    """
    monitor = examiner.monitor
    total = ENOUGH_GOOD + FINE * FINE_ROUNDS

    def best_score() -> float:
        return max((candidate.score for candidate in candidates), default=0.0)

    def examine(poses: Float[np.ndarray, "N 3"], most: int, apart: float, enough: int) -> None:
        """Check places that are apart from those before, until enough of them do or most were checked by poses."""
        checked = good = 0
        for pose in poses:
            if checked >= most or good >= enough or (takes_first and _has_all_poses(candidates)):
                return
            if good >= FEW_GOOD and best_score() >= EXCELLENT:
                return
            if any(is_near(pose, known.base, apart if known.outcome is not None else 0.99) for known in candidates):
                continue
            monitor.check()
            monitor.report("places to stand", min(sum(not c.refused for c in candidates) / total, 1.0))
            candidate = examiner.examine(pose)
            candidates.append(candidate)
            checked += not candidate.refused
            good += candidate.score > 0.0

    start = examiner.setup.start[[0, 1, 3]][None]
    examine(start, 1, 0.99, 1)  # the request's own place may do
    examine(ranked, COARSE, COARSE_APART, ENOUGH_GOOD)
    if not any(candidate.score > 0.0 for candidate in candidates):
        examine(ranked, COARSE // 2, 0.99, 1)
    for level in range(1, FINE_ROUNDS + 1):
        good = sorted((c for c in candidates if c.score > 0.0), key=lambda c: -c.score)[:FINE_PARENTS]
        if good and best_score() < EXCELLENT:
            examine(grid.refine([c.base for c in good], 0.5**level), FINE, 0.9 * 0.5**level, FINE)


def _has_all_poses(candidates: Sequence[StanceCandidate]) -> bool:
    """Return whether the task can be done from the last place, as far as single poses show."""
    outcome = candidates[-1].outcome if candidates else None
    return outcome is not None and not outcome.missing
