"""Leave an unfit start before the task begins: out of collision, off what carried bodies rest on, then into balance."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property, partial

import numpy as np
from jaxtyping import Float

from costs.allowance import Allowance, BodyIndex, BodyRef
from costs.collision import Contacts, SweptCollisionChecker
from costs.support import SupportPolygon
from service.body.ladder import Path, find_motion
from service.body.phases import PhaseSolver
from service.body.starts import DIRECT
from service.body.task_plan import PlannedPhase, Solved, Stuck, TaskPlan
from service.body.whole_body import CLEARANCE_TOLERANCE, WholeBody
from service.demands.phase import TaskPhase
from service.demands.stance import DEPTH_ROUNDING, is_unsettled, make_escape_allowances, make_resting_allowances
from service.start.overlaps import Overlap
from service.start.resting import SUPPORT_DEPTH_M
from service.tasks.hints import PhaseHints
from service.tasks.nearby import find_free_pose
from service.tasks.phase_compiler import PhaseCompiler

ESCAPE, RAISE, SETTLE = "escape", "raise", "settle"
RESTING_DEPTH_M = SUPPORT_DEPTH_M - DEPTH_ROUNDING  # from which a body is raised that rests on something
ESCAPE_WAYPOINTS, SETTLE_WAYPOINTS = 10, 6


def leave_start(solver: PhaseSolver, overlaps: Sequence[Overlap], rests: Sequence[tuple[str, str]] = ()) -> TaskPlan:
    """Plan the phases before the task, none where the start is fit; the plan's body stands at their end.

    Args:
        solver: of the phases.
        overlaps: at the start.
        rests: carried bodies and the pieces on which they rest.
    """
    lead = TaskPlan(solver.body, ())
    if overlaps or rests:
        lead = _escape(solver, overlaps, rests)
    if lead.stuck is None and _needs_settling(lead.body):
        settling = _settle(replace(solver, body=lead.body))
        lead = replace(settling, phases=(*lead.phases, *settling.phases))
    return lead


@dataclass(frozen=True)
class LeavingBody(WholeBody):
    """A robot with overlaps at its start, whose depth must fall along the motion; other pairs keep their margins."""

    overlaps: tuple[Overlap, ...] = ()

    @staticmethod
    def of(body: WholeBody, overlaps: Sequence[Overlap]) -> LeavingBody:
        """Return a body with its overlaps."""
        same = {field.name: getattr(body, field.name) for field in fields(WholeBody)}
        return LeavingBody(**same, overlaps=tuple(overlaps))

    def make_checker(
        self,
        allowances: Sequence[Allowance] = (),
        ends: Sequence[Float[np.ndarray, "n"]] = (),
        overrides: Sequence[tuple[BodyRef, BodyRef, float]] = (),
    ) -> SweptCollisionChecker:
        """Return the usual checker, but with the whole margin of pairs that overlap at the start."""
        whole = super().make_checker(allowances, (), overrides).margins
        fitting = super().make_checker(allowances, ends, overrides)
        world, own = fitting.margins.world.copy(), fitting.margins.own.copy()
        overlaps_world = np.isfinite(self._depths[:, len(self.robot.bodies) :])
        world[overlaps_world] = whole.world[overlaps_world]
        first, second = whole.self_pairs.T
        overlaps_own = np.isfinite(self._depths[first, second])
        own[overlaps_own] = whole.own[overlaps_own]
        return fitting.with_margins(replace(fitting.margins, world=world, own=own))

    def adjust_contacts(self, contacts: Contacts, n_waypoints: int) -> Contacts:
        """Raise the margins of overlaps from minus their depth at the start to the usual ones on the last interval.

        Their depth then falls at least linearly over the intervals.
        """
        if n_waypoints == 1:
            return contacts
        other = np.where(contacts.is_self, contacts.other, contacts.other + len(self.robot.bodies))
        depth = self._depths[contacts.body, other]
        share = 1.0 - contacts.first / max(n_waypoints - 2, 1)
        # A contact is feasible within a tolerance of its margin.
        rising = -depth * share + CLEARANCE_TOLERANCE - 0.5 * DEPTH_ROUNDING
        is_rising = np.isfinite(depth) & (contacts.first < n_waypoints - 2)
        margin = np.where(is_rising, np.minimum(contacts.margin, rising), contacts.margin)
        return replace(contacts, margin=margin)

    @cached_property
    def _depths(self) -> Float[np.ndarray, "B B+P"]:
        """Depth at the start by body and by other body or piece [m]; NaN without overlap."""
        index = BodyIndex(self.robot.bodies, self.robot.mechanism_links, self.scene.pieces)
        depths = np.full(index.shape, np.nan)
        for overlap in self.overlaps:
            index.fill(depths, *overlap.pair, overlap.depth)
        return depths


def _escape(solver: PhaseSolver, overlaps: Sequence[Overlap], rests: Sequence[tuple[str, str]]) -> TaskPlan:
    """Plan a phase from the start to a nearby configuration without collision.

    Only the pairs that overlap or rest on each other at the start may touch in it, no deeper than there, less and less
    on the way, and apart at its end.
    """
    body, name = solver.body, ESCAPE if overlaps else RAISE
    resting = [Overlap(link, piece, RESTING_DEPTH_M, "") for link, piece in rests]
    leaving = replace(solver, body=LeavingBody.of(body, [*overlaps, *resting]))
    with solver.monitor.step(name, 0.05):
        pose = find_free_pose(leaving, name)
    phase = TaskPhase(name, touches=(*make_escape_allowances(overlaps), *make_resting_allowances(rests)))
    way = replace(phase, touches=())  # the body itself lets overlaps be as deep as they may be on the way
    compiler = _compile(leaving, ESCAPE_WAYPOINTS - 1)
    out = _find_escape(compiler, way, pose.q) if pose.is_feasible else pose
    planned = PlannedPhase(
        phase,
        out.x if len(out.x) > 1 else np.stack([body.nominal, out.x[0]]),
        out.is_feasible,
        is_settling=_needs_settling(body),
        resolve=partial(compiler.solve_between, way),
    )
    return TaskPlan(replace(body, nominal=out.x[-1]), (planned,), stuck=Stuck.at(name, out))


def _find_escape(compiler: PhaseCompiler, phase: TaskPhase, end: Float[np.ndarray, "n"]) -> Solved:
    """Return the motion out of collision to near a pose; its last interval is clear of everything."""

    def solve(solver: PhaseSolver, path: Path) -> Solved:
        return replace(compiler, solver=solver).solve(phase, [path], {0: path[0]}, phase.values(len(path)), ())

    search = compiler.search_free(phase, compiler.solver.body.nominal, end)
    fit: Callable[[Path], Path] = lambda path: np.concatenate([path, path[-1:]])  # noqa: E731
    return find_motion(replace(search, solve=solve, policy=DIRECT, fit=fit, restorable=np.inf, fraction=0.05))


def _compile(solver: PhaseSolver, n_waypoints: int) -> PhaseCompiler:
    """Return the solver of a phase before the task, which may begin out of balance."""
    hints = PhaseHints(free_waypoints=n_waypoints, restorable=0.0, settles=_needs_settling(solver.body))
    return PhaseCompiler(solver, hints=lambda phase: hints)


def _needs_settling(body: WholeBody) -> bool:
    """Return whether the balance margin at the start is smaller than the motion's."""
    if not body.is_on_feet:
        return False
    hull = SupportPolygon.of_soles([foot.points for foot in body.planted])
    centre = body.engine(body.nominal[None]).com[0]
    return is_unsettled(hull, centre, body.aims.balance_margin, is_level=body.polygon is not None)


def _settle(solver: PhaseSolver) -> TaskPlan:
    """Plan a phase from the start to a nearby configuration inside the balance margin."""
    compiler, phase = _compile(solver, SETTLE_WAYPOINTS), TaskPhase(SETTLE)
    solved = compiler.solve_held(phase, solver.body.nominal, 0.05)
    planned = replace(compiler.finish(phase, solved), is_settling=True)
    return TaskPlan(replace(solver.body, nominal=solved.x[-1]), (planned,), stuck=Stuck.at(SETTLE, solved))
