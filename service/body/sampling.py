"""Paths of a sampling planner, as starts of the optimiser where no straight one leads around the obstacles."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib.util import find_spec
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from costs.collision import SearchChecker
from costs.robot import BASE_NAMES
from service.body.holds import find_prescribed, largest_hold_error, project_within_limits
from service.body.paths import resample_path
from service.body.whole_body import SAMPLING_CLEARANCE, WholeBody

EDGE_STEP = 0.15  # by default; see ``Tree.edge_step`` [rad, m]
CLOCK_EVERY = 16
LEAST_TRAVEL = 0.05  # range of the coordinate along a carrier [rad, m]
CARRIED_POINTS = 40  # of a path whose other coordinates follow
CORNER_TRIES, POINT_TRIES = 60, 60  # of shortcuts
LEAST_SAVING = 0.005  # of a shortcut, as a share of the length
RANGE = 0.6  # longest extension of a tree [rad, m]
BASE_SCALE = 3.0  # of a floating base's place in a search: 1 m counts as much as so many radians
BASE_BEYOND = np.repeat([0.15, 0.25], 3)  # farthest that a base is drawn beyond start and end [m, rad]
HELD = 5e-4  # largest residual of the holds at a pose of a search [m, rad]


@dataclass(frozen=True)
class SamplingProblem:
    """Two configurations to connect by moving some of the coordinates.

    Attributes:
        body: the robot in its scene.
        checker: for the poses along an edge.
        start, end: (n,) configurations; without ``carrier`` they differ in ``free`` only.
        free: indices of the coordinates that move.
        carrier: (G, n) configurations from start to end on the contacts that stay. The coordinates that are not free
            then follow them, as far along as one more coordinate says, which is the last.
        edge_step: largest joint step between the poses at which an edge is checked [rad, m].
    """

    body: WholeBody
    checker: SearchChecker
    start: Float[np.ndarray, "n"]
    end: Float[np.ndarray, "n"]
    free: Int[np.ndarray, "k"]
    carrier: Float[np.ndarray, "G n"] | None = None
    edge_step: float = EDGE_STEP

    @property
    def bends(self) -> bool:
        """Whether other coordinates move along an edge than those of the search, and not in a straight line."""
        return self.carrier is not None

    @property
    def length(self) -> float:
        """Range of the last coordinate where there is a carrier: the largest travel of a coordinate [rad, m]."""
        others = np.delete(self.end - self.start, self.free)
        return max(float(np.abs(others).max(initial=0.0)), LEAST_TRAVEL)

    @property
    def ends(self) -> tuple[Float[np.ndarray, "k"], Float[np.ndarray, "k"]]:
        """Start and end in the coordinates of the search."""
        if self.carrier is None:
            return self.start[self.free], self.end[self.free]
        return np.append(self.start[self.free], 0.0), np.append(self.end[self.free], self.length)

    def place(self, poses: Float[np.ndarray, "K k"]) -> Float[np.ndarray, "K n"]:
        """Return the configurations of poses of the search."""
        if len(self.free) == len(self.start):
            return poses
        q = np.tile(self.start, (len(poses), 1))
        if self.carrier is not None:
            at = np.linspace(0.0, self.length, len(self.carrier))
            q = np.stack([np.interp(poses[:, -1], at, column) for column in self.carrier.T], axis=1)
        q[:, self.free] = poses[:, : len(self.free)]
        return q

    def limit_draws(self, beyond: float) -> tuple[Float[np.ndarray, "k"], Float[np.ndarray, "k"]]:
        """Return bounds of the search: the limits, at most so far beyond start and end; within a turn if infinite."""
        robot, free = self.body.robot, self.free
        ends = np.stack([self.start, self.end])
        low, high = ends.min(axis=0) - beyond, ends.max(axis=0) + beyond
        if not np.isfinite(beyond):
            low, high = np.minimum(ends.min(axis=0), -np.pi), np.maximum(ends.max(axis=0), np.pi)
        if robot.is_floating:
            low[: len(BASE_NAMES)] = ends.min(axis=0)[: len(BASE_NAMES)] - BASE_BEYOND
            high[: len(BASE_NAMES)] = ends.max(axis=0)[: len(BASE_NAMES)] + BASE_BEYOND
        low, high = np.maximum(low, robot.lower)[free], np.minimum(high, robot.upper)[free]
        if self.carrier is not None:
            low, high = np.append(low, 0.0), np.append(high, self.length)
        return low, high

    def trace(self, corners: Float[np.ndarray, "K k"]) -> Float[np.ndarray, "S n"]:
        """Return the configurations along a polyline of the search: its corners, or more where others bend."""
        if self.bends:
            corners = resample_path(corners, max(CARRIED_POINTS, 2 * len(corners)))
        path = self.place(corners)
        path[0], path[-1] = self.start, self.end
        return path

    def interpolate_edge(self, first: Float[np.ndarray, "k"], last: Float[np.ndarray, "k"]) -> Float[np.ndarray, "K k"]:
        """Return poses close to each other on the straight line, without the first, which is clear already."""
        step = last - first
        count = max(int(np.ceil(np.abs(step).max() / self.edge_step)), 1)
        return np.asarray(first + (np.arange(1, count + 1) / count)[:, None] * step)

    def is_clear(self, poses: Float[np.ndarray, "K k"]) -> bool:
        """Return whether poses of the search are all clear and balanced."""
        return self.are_configurations_clear(self.place(poses))

    def are_configurations_clear(self, q: Float[np.ndarray, "K n"]) -> bool:
        """Return whether configurations are all clear, balanced and in the regions of kept poses."""
        body, polygon, margin = self.body, self.body.polygon, self.body.aims.balance_margin
        if body.region is not None:  # the optimiser adds the rest of the margin
            polygon, margin = body.region.region.polygon, 0.5 * margin
        if polygon is not None or body.kept:
            placed = body.engine.place(q)
            if polygon is not None and polygon.margin(placed.com[:, :2]).min() < margin:
                return False
            if not all(kept.are_within(body.robot, placed) for kept in body.kept):
                return False
        return self.checker.are_clear(q)


@dataclass(frozen=True)
class HeldProblem(SamplingProblem):
    """Two configurations on the same holds, to connect by leading some coordinates while others follow.

    On planted feet the base and the limbs that carry nothing lead, and the standing legs follow so that the feet stay
    where they are.  With kept poses all coordinates lead and all follow: a pose of the search stands for the nearest
    configuration on the holds (Berenson et al., Manipulation planning on constraint manifolds, ICRA 2009).

    Attributes:
        following: indices of the coordinates that move until the holds are kept.
    """

    following: Int[np.ndarray, "f"] = field(default_factory=lambda: np.zeros(0, dtype=int))

    @staticmethod
    def between(
        body: WholeBody,
        checker: SearchChecker,
        start: Float[np.ndarray, "n"],
        end: Float[np.ndarray, "n"],
    ) -> HeldProblem:
        """Return the problem of two configurations of a robot that keeps its holds."""
        moving = np.flatnonzero(~find_prescribed(body.robot))
        if body.keeps_poses:
            return HeldProblem(body, checker, start, end, moving, following=moving)
        base = np.arange(len(BASE_NAMES) if body.robot.is_floating else 0)
        lead = np.union1d(base, np.intersect1d(free_coordinates(body), moving))
        return HeldProblem(body, checker, start, end, lead, following=np.setdiff1d(moving, lead))

    @property
    def bends(self) -> bool:
        """Legs and kept poses do."""
        return True

    @cached_property
    def _scale(self) -> Float[np.ndarray, "k"]:
        """Search units per metre or radian of each coordinate."""
        scale = np.ones(len(self.free))
        if self.body.robot.is_floating:
            scale[self.free < 3] = BASE_SCALE
        return scale

    @property
    def ends(self) -> tuple[Float[np.ndarray, "k"], Float[np.ndarray, "k"]]:
        """Start and end in the coordinates of the search."""
        return self.start[self.free] * self._scale, self.end[self.free] * self._scale

    def shorten(self, q: Float[np.ndarray, "K n"], rng: np.random.Generator) -> Float[np.ndarray, "S n"]:
        """Return a path on the holds along a shorter polyline with the same ends, whose new edges are clear."""
        return self.trace(shorten_polyline(self, q[:, self.free] * self._scale, rng))

    def limit_draws(self, beyond: float) -> tuple[Float[np.ndarray, "k"], Float[np.ndarray, "k"]]:
        """Return bounds of the search in its own units."""
        low, high = super().limit_draws(beyond)
        return low * self._scale, high * self._scale

    def place(self, poses: Float[np.ndarray, "K k"]) -> Float[np.ndarray, "K n"]:
        """Return configurations in which what follows has come as near to the holds as it can."""
        q = np.tile(self.start, (len(poses), 1))
        q[:, self.free] = poses / self._scale
        body, robot = self.body, self.body.robot
        is_still = np.ones(robot.n, dtype=bool)
        is_still[self.following] = False
        return project_within_limits(body.engine, q, body.holds(), robot.lower[None], robot.upper[None], is_still)

    def is_clear(self, poses: Float[np.ndarray, "K k"]) -> bool:
        """Return whether poses of the search are on the holds, clear and balanced."""
        q = self.place(poses)
        if largest_hold_error(self.body.engine, q, self.body.holds()).max() > HELD:
            return False
        return self.are_configurations_clear(q)


def free_coordinates(body: WholeBody) -> Int[np.ndarray, "k"]:
    """Return the coordinates that move no planted link: neither base nor standing legs."""
    robot = body.robot
    fixed = set(range(len(BASE_NAMES))) if robot.is_floating else set()
    supports = body.engine.topology.supports
    for foot in body.planted:
        joint = int(robot.model.frames[robot.model.getFrameId(foot.link)].parentJoint)
        fixed |= set(np.flatnonzero(supports[joint]).tolist())
    return np.array([i for i in range(robot.n) if i not in fixed], dtype=int)


@dataclass(frozen=True)
class Tree:
    """Planner and effort of one search; checks are counted, not timed, so that equal seeds give equal paths.

    Attributes:
        seed: of the draws.
        most_checks: limit of checked edges and states.
        planner: RRTConnect (Kuffner and LaValle, ICRA 2000), or LBKPIECE1 (Sucan and Kavraki, WAFR 2008, with lazy
            checks), which gets through narrow shelves with a tenth of the checks and is worse among bars.
        beyond: how far beyond start and end the coordinates are drawn, within their limits [rad, m]; infinite for a
            turn about 0.
        clearance: of the poses [m]; what lacks of the margin is added by the optimiser.
        edge_step: largest joint step between the poses at which an edge is checked [rad, m].
        keeps_holds: whether base and standing legs move too, and kept poses are kept; else there is no path where these
            would have to move, and poses are kept by the optimiser alone.
    """

    seed: int
    most_checks: int
    planner: Literal["RRTConnect", "LBKPIECE1"] = "RRTConnect"
    beyond: float = np.pi
    clearance: float = SAMPLING_CLEARANCE
    edge_step: float = EDGE_STEP
    keeps_holds: bool = False


def can_sample() -> bool:
    """Return whether OMPL is installed, which samples the paths; it is not to be had on every system."""
    return find_spec("ompl") is not None


def sample_path(
    problem: SamplingProblem, tree: Tree, is_over: Callable[[], bool] = lambda: False
) -> Float[np.ndarray, "K n"] | None:
    """Return the corners of a shortened collision-free polyline; None if OMPL finds none or is missing.

    Args:
        problem: the ends and the free coordinates.
        tree: seed and effort.
        is_over: polled often; True ends the search.
    """
    if not can_sample() or not all(problem.is_clear(end[None]) for end in problem.ends):
        return None  # OMPL would wait for another goal until the time is up
    from ompl import util  # slow to import, and rarely needed

    util.setLogLevel(util.LOG_NONE)
    util.RNG.setSeed(tree.seed + 1)
    problem = replace(problem, edge_step=tree.edge_step)
    corners = _connect(problem, tree, is_over)
    if corners is None:
        return None
    corners = shorten_polyline(problem, corners, np.random.default_rng(tree.seed))
    return problem.trace(corners)


def _connect(problem: SamplingProblem, tree: Tree, is_over: Callable[[], bool]) -> Float[np.ndarray, "K k"] | None:
    """Return the corners of OMPL's path in the free coordinates; None if it finds none."""
    from ompl import base, geometric

    first, last = problem.ends
    space = base.RealVectorStateSpace(len(first))
    bounds = base.RealVectorBounds(len(first))
    for k, (low, high) in enumerate(zip(*(bound.tolist() for bound in problem.limit_draws(tree.beyond)), strict=True)):
        bounds.setLow(k, low)
        bounds.setHigh(k, high)
    space.setBounds(bounds)
    effort = _EffortCounter(problem, tree.most_checks, is_over)

    def read_state(state: object) -> Float[np.ndarray, "k"]:
        return np.array([state[k] for k in range(len(first))])  # type: ignore[index]

    class Edge(base.MotionValidator):  # type: ignore[misc]
        def checkMotion(self, first: object, last: object, *_: object) -> bool:
            return effort.is_clear(problem.interpolate_edge(read_state(first), read_state(last)))

    information = base.SpaceInformation(space)
    information.setStateValidityChecker(lambda state: effort.is_clear(read_state(state)[None]))
    information.setMotionValidator(Edge(information))
    information.setup()
    definition = base.ProblemDefinition(information)
    states = [space.allocState(), space.allocState()]
    for state, values in zip(states, (first, last), strict=True):
        for k, value in enumerate(values.tolist()):
            state[k] = value
    definition.setStartAndGoalStates(*states)
    planner = getattr(geometric, tree.planner)(information)
    planner.setProblemDefinition(definition)
    planner.setRange(RANGE)
    planner.setup()
    if not planner.solve(base.PlannerTerminationCondition(effort.is_enough)) or not definition.hasExactSolution():
        return None
    path = definition.getSolutionPath()
    return np.array([read_state(path.getState(k)) for k in range(path.getStateCount())])


class _EffortCounter:
    """Count of a planner's checks, with their limit."""

    def __init__(self, problem: SamplingProblem, most_checks: int, is_over: Callable[[], bool]) -> None:
        self._problem, self._most_checks, self._is_over = problem, most_checks, is_over
        self._n_checks = self._n_polls = 0
        self._is_stopped = False

    def is_clear(self, poses: Float[np.ndarray, "K k"]) -> bool:
        """Return whether poses of the free coordinates are clear; counts as one check."""
        self._n_checks += 1
        return self._problem.is_clear(poses)

    def is_enough(self) -> bool:
        """Return whether to give up."""
        self._n_polls += 1
        # Polled about three times per check: the clock would take a notable share of the time.
        self._is_stopped = self._is_stopped or (self._n_polls % CLOCK_EVERY == 0 and self._is_over())
        return self._is_stopped or self._n_checks >= self._most_checks


def shorten_polyline(
    problem: SamplingProblem, corners: Float[np.ndarray, "K k"], rng: np.random.Generator
) -> Float[np.ndarray, "K k"]:
    """Return a shorter polyline with the same ends, whose new edges are clear.

    Corners are left out first, then random points on two edges are joined (Geraerts and Overmars, IJRR 2007).
    """
    for _ in range(CORNER_TRIES):
        if len(corners) < 3:
            return corners
        first, last = np.sort(rng.choice(len(corners), 2, replace=False))
        if last - first > 1 and problem.is_clear(problem.interpolate_edge(corners[first], corners[last])):
            corners = np.delete(corners, np.arange(first + 1, last), axis=0)
    for _ in range(POINT_TRIES):
        if len(corners) < 3:
            return corners
        lengths = np.linalg.norm(np.diff(corners, axis=0), axis=1)
        ends = np.concatenate([[0.0], np.cumsum(lengths)])
        at = np.sort(rng.uniform(0.0, ends[-1], 2))
        edges = np.clip(np.searchsorted(ends, at, side="right") - 1, 0, len(lengths) - 1)
        if edges[0] == edges[1]:
            continue
        shares = (at - ends[edges]) / np.maximum(lengths[edges], 1e-12)
        joined = corners[edges] + shares[:, None] * (corners[edges + 1] - corners[edges])
        saved = at[1] - at[0] - float(np.linalg.norm(joined[1] - joined[0]))
        if saved > LEAST_SAVING * ends[-1] and problem.is_clear(problem.interpolate_edge(joined[0], joined[1])):
            corners = np.concatenate([corners[: edges[0] + 1], joined, corners[edges[1] + 1 :]])
    return corners
