"""A problem resolved for one robot, and the waypoints that stand for its steps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from service.trajopt.problem import FootHeightTerm, PoseTerm, ProblemFile, ZmpTerm


@dataclass(frozen=True)
class JointRange:
    """Range of a coordinate at a step; ``lower`` equals ``upper`` if the file gives no tolerances.

    Attributes:
        path: JSON path of the constraint.
        target: wanted value, within the range.
    """

    path: str
    target: float
    lower: float
    upper: float


@dataclass(frozen=True)
class Program:
    """A problem resolved for a robot.

    Attributes:
        problem: the problem, without the terms that ``planted`` and ``is_balanced`` replace.
        start: (n,) configuration at the start.
        columns: (k,) coordinates of ``manip``, in the file's order.
        free: (f,) coordinates that may move, ascending; all others keep their start value.
        init: (T, n) initial trajectory.
        fixed: configurations by step, for steps whose coordinates are all fixed.
        ranges: joint ranges by step and coordinate.
        planted: links that keep their start pose during the whole motion.
        is_balanced: whether the centre of mass must stay above the planted links at every step.
        notes: one line per assumption, and per setting of the file that has no effect.
    """

    problem: ProblemFile
    start: Float[np.ndarray, "n"]
    columns: Int[np.ndarray, "k"]
    free: Int[np.ndarray, "f"]
    init: Float[np.ndarray, "T n"]
    fixed: Mapping[int, Float[np.ndarray, "n"]]
    ranges: Mapping[int, Mapping[int, JointRange]]
    planted: tuple[str, ...]
    is_balanced: bool
    notes: tuple[str, ...]

    def restrict_to(self, step: int) -> Program:
        """Return a program of one step with the constraints and costs of ``step`` alone."""
        terms = tuple(
            replace(term, step=0)
            for term in self.problem.terms
            if isinstance(term, PoseTerm | ZmpTerm | FootHeightTerm) and term.step == step
        )
        basic = replace(self.problem.basic, n_steps=1)
        return replace(
            self,
            problem=replace(self.problem, basic=basic, terms=terms),
            init=self.init[step : step + 1],
            fixed={},
            ranges={0: self.ranges[step]} if step in self.ranges else {},
        )

    @property
    def n_steps(self) -> int:
        """Number of steps of the file."""
        return self.problem.basic.n_steps


@dataclass(frozen=True)
class Timeline:
    """Waypoints of the file's steps; repairs insert further waypoints between them.

    Attributes:
        rows: (T,) waypoint of each step, increasing.
        n_waypoints: number of all waypoints; the last step is the last waypoint.
    """

    rows: Int[np.ndarray, "T"]
    n_waypoints: int

    @staticmethod
    def of_steps(n_steps: int) -> Timeline:
        """Return the timeline whose waypoints are the steps."""
        return Timeline(np.arange(n_steps), n_steps)

    def insert_waypoints(self, before: Float[np.ndarray, "T n"], after: Float[np.ndarray, "U n"]) -> Timeline:
        """Return the timeline on waypoints ``after``, which contain those of ``before`` in order, slightly shifted."""
        matches: list[int] = []
        for index, q in enumerate(before):
            first = matches[-1] + 1 if matches else 0
            last = len(after) - (len(before) - 1 - index)  # leave a match for each waypoint that follows
            matches.append(first + int(np.abs(after[first:last] - q).max(axis=1).argmin()))
        matches[0], matches[-1] = 0, len(after) - 1
        return Timeline(np.array(matches)[self.rows], len(after))

    def list_waypoints(self, first: int, last: int) -> Int[np.ndarray, "S"]:
        """Return all waypoints from step ``first`` to step ``last``, inclusive."""
        return np.arange(int(self.rows[first]), int(self.rows[last]) + 1)

    def find_steps(self, waypoints: Int[np.ndarray, "S"]) -> Int[np.ndarray, "S"]:
        """Return the last step at or before each waypoint."""
        return np.asarray(np.searchsorted(self.rows, waypoints, side="right") - 1)
