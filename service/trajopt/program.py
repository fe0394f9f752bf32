"""A problem made real for one robot: which coordinates move, where waypoints may be, which links stand."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from service.trajopt.problem import FootHeightTerm, PoseTerm, Problem, ZmpTerm


@dataclass(frozen=True)
class JointRange:
    """Where a coordinate may be at a step: ``lower`` to ``upper``, equal for a value that is asked for.

    Attributes:
        path: of the constraint in the file.
        target: what is aimed at, between the two.
    """

    path: str
    target: float
    lower: float
    upper: float


@dataclass(frozen=True)
class Program:
    """What a problem asks of a robot.

    Attributes:
        problem: as read.
        start: (n,) where the robot starts.
        columns: (k,) coordinates of ``manip``, in the file's order.
        free: (f,) those that may move, ascending; all others stay at the start.
        init: (T, n) trajectory to start from.
        fixed: configuration by step where all coordinates are fixed.
        ranges: by step and coordinate.
        planted: links that stand throughout; their pose constraints are not among ``poses``.
        is_balanced: whether the centre of mass is to stay above the planted links at every step.
        notes: what was assumed, and what the file says that has no bearing.
    """

    problem: Problem
    start: Float[np.ndarray, "n"]
    columns: Int[np.ndarray, "k"]
    free: Int[np.ndarray, "f"]
    init: Float[np.ndarray, "T n"]
    fixed: Mapping[int, Float[np.ndarray, "n"]]
    ranges: Mapping[int, Mapping[int, JointRange]]
    planted: tuple[str, ...]
    is_balanced: bool
    notes: tuple[str, ...]

    def only(self, step: int) -> Program:
        """What is asked of one waypoint alone, as a program of one step."""
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
        """Waypoints."""
        return self.problem.basic.n_steps


@dataclass(frozen=True)
class Timeline:
    """Where the steps of the file are among the waypoints, of which there may be more.

    Attributes:
        rows: (T,) waypoint of each step, increasing.
        n_waypoints: in all; the last step is the last of them.
    """

    rows: Int[np.ndarray, "T"]
    n_waypoints: int

    @staticmethod
    def of_steps(n_steps: int) -> Timeline:
        """Every step is a waypoint, and every waypoint a step."""
        return Timeline(np.arange(n_steps), n_steps)

    def denser(self, before: Float[np.ndarray, "T n"], after: Float[np.ndarray, "U n"]) -> Timeline:
        """The steps among waypoints that hold, in order and but for small shifts, all waypoints of before."""
        found: list[int] = []
        for index, q in enumerate(before):
            first = found[-1] + 1 if found else 0
            last = len(after) - (len(before) - 1 - index)  # what comes after needs its places, too
            found.append(first + int(np.abs(after[first:last] - q).max(axis=1).argmin()))
        found[0], found[-1] = 0, len(after) - 1
        return Timeline(np.array(found)[self.rows], len(after))

    def between(self, first: int, last: int) -> Int[np.ndarray, "S"]:
        """All waypoints from a step to another, inclusive."""
        return np.arange(int(self.rows[first]), int(self.rows[last]) + 1)

    def step_of(self, waypoints: Int[np.ndarray, "S"]) -> Int[np.ndarray, "S"]:
        """The last step at or before each waypoint."""
        return np.asarray(np.searchsorted(self.rows, waypoints, side="right") - 1)
