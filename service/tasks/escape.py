"""Escaping: leaving what the robot is in at the start before anything else moves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float

from costs.allowance import Allowance, BodyIndex, BodyRef
from costs.collision import Contacts, SweptCollisionChecker
from costs.state import MotionState
from scopt import Constraint, Cost, Problem
from service.body.phases import PhaseSolver, PlannedPhase, Solved, Stuck, TaskPlan, straight_path
from service.body.restore import restore_feasibility
from service.body.sampling import free_coordinates
from service.body.whole_body import CLEARANCE_TOLERANCE, WholeBody
from service.demands.stance import DEPTH_ROUNDING, make_escape_allowances
from service.start.overlaps import Overlap
from service.tasks.settle import needs_settling

STEP = "escape"
WAYPOINTS = 10
SPREADS = (0.2, 0.2, 0.4, 0.4, 0.8, 0.8)  # of random guesses about the start [rad, m]


@dataclass(frozen=True)
class LeavingBody(WholeBody):
    """A robot that is in something, and is asked to come out of it step by step.

    Attributes:
        overlaps: at the start; every other pair is asked for what it always is.
    """

    overlaps: tuple[Overlap, ...] = ()

    @staticmethod
    def of(body: WholeBody, overlaps: Sequence[Overlap]) -> LeavingBody:
        """The body in its overlaps."""
        same = {field.name: getattr(body, field.name) for field in fields(WholeBody)}
        return LeavingBody(**same, overlaps=tuple(overlaps))

    def checker(
        self,
        allowances: Sequence[Allowance] = (),
        ends: Sequence[Float[np.ndarray, "n"]] = (),
        overrides: Sequence[tuple[BodyRef, BodyRef, float]] = (),
    ) -> SweptCollisionChecker:
        """As ever, but what overlaps at the start is asked for its whole margin all the same."""
        asked = super().checker(allowances, (), overrides).margins
        fitting = super().checker(allowances, ends, overrides)
        world, own = fitting.margins.world.copy(), fitting.margins.own.copy()
        overlaps_world = np.isfinite(self._depths[:, len(self.robot.bodies) :])
        world[overlaps_world] = asked.world[overlaps_world]
        first, second = asked.self_pairs.T
        overlaps_own = np.isfinite(self._depths[first, second])
        own[overlaps_own] = asked.own[overlaps_own]
        return fitting.with_margins(replace(fitting.margins, world=world, own=own))

    def problem(
        self,
        lower: Float[np.ndarray, "T n"],
        upper: Float[np.ndarray, "T n"],
        checker: SweptCollisionChecker,
        costs: Sequence[Cost[MotionState]] = (),
        constraints: Sequence[Constraint[MotionState]] = (),
        balanced: Sequence[int] | None = None,
    ) -> Problem[MotionState]:
        """As ever, but what overlaps at the start comes out of it interval by interval, never deeper than on a line."""
        problem = super().problem(lower, upper, checker, costs, constraints, balanced)

        def state(x: Float[np.ndarray, "T n"]) -> MotionState:
            full = problem.state(x)
            return replace(full, contacts=self._rising(full.contacts, len(lower)))

        return replace(problem, state=state)

    def _rising(self, contacts: Contacts, n_waypoints: int) -> Contacts:
        """Contacts asked for ever more: from the depth at the start to what is always asked on the last interval."""
        if n_waypoints == 1:
            return contacts
        other = np.where(contacts.is_self, contacts.other, contacts.other + len(self.robot.bodies))
        depth = self._depths[contacts.body, other]
        share = 1.0 - contacts.first / max(n_waypoints - 2, 1)
        # What counts as feasible is a tolerance less than the margin.
        rising = -depth * share + CLEARANCE_TOLERANCE - 0.5 * DEPTH_ROUNDING
        is_rising = np.isfinite(depth) & (contacts.first < n_waypoints - 2)
        margin = np.where(is_rising, np.minimum(contacts.margin, rising), contacts.margin)
        return replace(contacts, margin=margin)

    @cached_property
    def _depths(self) -> Float[np.ndarray, "B B+P"]:
        """Depth at the start by body and by other body or piece [m]; NaN where there is none."""
        index = BodyIndex(self.robot.bodies, self.robot.mechanism_links, self.scene.pieces)
        depths = np.full(index.shape, np.nan)
        for overlap in self.overlaps:
            index.fill(depths, *overlap.pair, overlap.depth)
        return depths


def escape(solver: PhaseSolver, overlaps: Sequence[Overlap]) -> TaskPlan:
    """One phase from the start to a nearby configuration that is free; the plan's body starts from there.

    Only the pairs that overlap at the start may touch in it, no deeper than there, ever less on the way, and apart at
    its end.
    """
    body = solver.body
    leaving = replace(solver, body=LeavingBody.of(body, overlaps))
    with solver.monitor.step(STEP, 0.05):
        free = _free(leaving)
        out = free
        if free.is_feasible:
            line = straight_path(body.nominal, free.x[0], WAYPOINTS - 1)
            out = _out(leaving, np.concatenate([line, line[-1:]]))
    phase = PlannedPhase(
        STEP,
        out.x if len(out.x) > 1 else np.stack([body.nominal, out.x[0]]),
        out.is_feasible,
        allowances=make_escape_allowances(overlaps),
        is_settling=needs_settling(body),
        resolve=lambda q: _out(leaving, q, is_end_fixed=True),
    )
    return TaskPlan(replace(body, nominal=out.x[-1]), (phase,), stuck=Stuck.at(STEP, out))


def _free(leaving: PhaseSolver) -> Solved:
    """A configuration that is in nothing; where it is not found from the start, from ever farther away."""
    body = leaving.body
    rng = np.random.default_rng(leaving.seed)
    joints = free_coordinates(body)
    found = leaving.pose(STEP, [body.nominal], ())
    for reach in SPREADS:
        if found.is_feasible:
            break
        guess = body.nominal.copy()
        guess[joints] += rng.uniform(-reach, reach, len(joints))
        again = leaving.pose(STEP, [np.clip(guess, body.robot.lower, body.robot.upper)], ())
        found = again if again.is_feasible or again.shortfall < found.shortfall else found
    return found


def _out(leaving: PhaseSolver, q: Float[np.ndarray, "T n"], is_end_fixed: bool = False) -> Solved:
    """The way out from a first guess that begins at the start."""
    last = len(q) - 1
    fixed = {0: q[0], last: q[-1]} if is_end_fixed else {0: q[0]}
    balanced = [last] if needs_settling(leaving.body) else None
    out = leaving.trajectory(STEP, [q], fixed, balanced=balanced)
    return out if out.is_feasible else restore_feasibility(leaving, STEP, out)
