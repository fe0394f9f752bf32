"""Solve a problem file as one phase: with its own costs and constraints, and links kept apart."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain

import numpy as np
from jaxtyping import Float

from service.body.ladder import GivenEnd, MotionSearch, NoEnd, list_motions
from service.body.phases import PhaseSolver, report_solutions
from service.body.poses import find_pose, posture_guesses
from service.body.starts import Way
from service.body.task_plan import LEAST_CLEARANCE, PlannedPhase, Solved, Stuck, TaskPlan
from service.body.whole_body import CLEARANCE_TOLERANCE, WholeBody
from service.demands.phase import TaskPhase
from service.errors import RequestError, would_do
from service.explain.distance import find_out_of_reach
from service.start.overlaps import describe_collisions, find_overlaps_and_unresolved
from service.trajopt import Builder, Program, Promises, Timeline
from service.trajopt.problem import CollisionTerm, PoseTerm

PHASE, INIT = "trajopt", "init_info"
APART = LEAST_CLEARANCE + CLEARANCE_TOLERANCE  # clearance of all pairs, besides the file's own collision terms [m]
SIGHT = 0.03  # beyond the largest distance of a collision term [m]
# As in TrajOpt, the optimiser goes on until its costs are low; elsewhere the first feasible motion is enough.
LEAST_GAIN = 1e-3


def plan_program(solver: PhaseSolver, program: Program) -> Iterator[TaskPlan]:
    """Yield a plan for every start that solves the program, its own first.

    Raises:
        RequestError: a collision term names what is neither a link nor a piece of the scene.
    """
    body = fit_body(solver.body, program)
    _check_pairs(program, body)
    impossible = _find_impossible(program, body)
    if impossible:
        yield TaskPlan(body, (), impossible, is_impossible=True, notes=program.notes)
        return
    unresolved = _find_unresolved(program, body)
    if unresolved:
        yield TaskPlan(body, (), unresolved, notes=program.notes)
        return
    settings = {"min_improvement_feasible": LEAST_GAIN, **program.problem.opt.settings}
    solver = replace(solver, body=body).with_settings(**settings)
    search = _ProgramSearch(solver, program, Promises.of(program, body.robot))
    yield from report_solutions(search.list_solutions(), search.make_plan)


def fit_body(body: WholeBody, program: Program) -> WholeBody:
    """Return the robot without default costs, with the file's collision distances, balanced if the file says so."""
    distances = [
        distance
        for term in program.problem.terms
        if isinstance(term, CollisionTerm)
        for listed in (term.dist_pen, *(pair.dist_pen for pair in term.pairs))
        for distance in listed
    ]
    return replace(
        body,
        aims=replace(body.aims, margin=APART),
        polygon=body.polygon if program.is_balanced else None,
        region=body.region if program.is_balanced else None,
        has_default_costs=False,
        sight=max([0.0, *distances]) + SIGHT,
    )


def _check_pairs(program: Program, body: WholeBody) -> None:
    links = {name for member in body.robot.bodies for name in (member.link, member.name)}
    known = [*sorted(links), *(piece.name for piece in body.scene.pieces)]
    problems = [
        f"{pair.path}.pair[{k}]: {other!r} is no link and no piece of the scene; expected {would_do(other, known)}"
        for term in program.problem.terms
        if isinstance(term, CollisionTerm)
        for pair in term.pairs
        for k, other in enumerate(pair.others)
        if other not in known
    ]
    if problems:
        raise RequestError(problems)


def _find_impossible(program: Program, body: WholeBody) -> tuple[str, ...]:
    """Return reasons that hold for every motion: a fixed waypoint in collision, a pose out of reach."""
    planted = [foot.link for foot in body.planted]
    lines = [
        f"waypoint {step}, which is fixed, is in collision: {line}"
        for step, q in sorted(program.fixed.items())
        if step  # the start is checked by the set-up
        for line in describe_collisions(body.robot, q, body.scene, planted)
    ]
    for term in program.problem.terms:
        is_plain = isinstance(term, PoseTerm) and term.reference is None and not any(term.offset_xyz)
        if isinstance(term, PoseTerm) and not term.is_cost and is_plain and all(term.pos_coeffs):
            reason = find_out_of_reach(body, term.frame, np.array(term.xyz), program.problem.opt.tolerance)
            lines += [] if reason is None else [f"{term.path}: {reason}"]
    return tuple(lines)


def _find_unresolved(program: Program, body: WholeBody) -> tuple[str, ...]:
    """Return fixed waypoints where only hulls overlap, so that no motion through them can be certified."""
    planted = [foot.link for foot in body.planted]
    return tuple(
        f"waypoint {step}, which is fixed, is too near to plan through: {overlap.nearness}"
        for step, q in sorted(program.fixed.items())
        if step
        for overlap in find_overlaps_and_unresolved(body.robot, q, body.scene, planted)[1]
    )


@dataclass(frozen=True)
class _ProgramSearch:
    """Starts of one program, the file's own first, solved on demand."""

    solver: PhaseSolver
    program: Program
    promises: Promises

    def list_solutions(self) -> Iterator[tuple[str, Solved]]:
        """Yield solved starts by name, feasible or not."""
        program = self.program
        end = self._find_end()
        search = MotionSearch(
            PHASE,
            self.solver,
            lambda solver, path: replace(self, solver=solver).solve(path),
            program.init[0],
            NoEnd() if end is None else GivenEnd(end),
            paths={Way.GIVEN: lambda: ((INIT, program.init),)},
            n_waypoints=program.n_steps,
            vias=lambda: ((name, self._move_free(q)) for name, q in posture_guesses(self.solver.body)[1:]),
            drawn=program.free,
            is_shortened=False,
        )
        return list_motions(search)

    def make_plan(self, name: str, solved: Solved) -> TaskPlan:
        """Return a solution as the task's plan."""
        promises = self.promises
        phase = ProgramPhase(
            TaskPhase(PHASE, targets=promises.make_targets()),
            solved.x,
            solved.is_feasible,
            holds=promises.make_holds(),
            search=self,
            timeline=Timeline.of_steps(self.program.n_steps),
        ).with_waypoint_targets()
        notes = (*self.program.notes, *promises.notes)
        stuck = Stuck.at(PHASE, solved)
        return TaskPlan(self.solver.body, (phase,), stuck=stuck, found_from=name, notes=notes)

    def solve(self, q: Float[np.ndarray, "T n"], timeline: Timeline | None = None) -> Solved:
        """Solve the program from a start; without a timeline every waypoint is a step."""
        program, body = self.program, self.solver.body
        timeline = Timeline.of_steps(program.n_steps) if timeline is None else timeline
        fixed = {int(timeline.rows[step]): at for step, at in program.fixed.items()}
        builder = Builder(program, timeline, body, body.make_checker())
        return self.solver.solve_trajectory(
            PHASE, q, fixed, builder.make_costs(), builder.make_constraints(), bounds=builder.narrow_bounds
        )

    def _find_end(self) -> Float[np.ndarray, "n"] | None:
        """Return a configuration for the last waypoint: the fixed one, or one that keeps its constraints; else None."""
        program, solver = self.program, self.solver
        last = program.n_steps - 1
        if last in program.fixed:
            return program.fixed[last]
        alone = program.restrict_to(last)
        builder = Builder(alone, Timeline.of_steps(1), solver.body, solver.body.make_checker())
        constraints = builder.make_constraints()
        if not constraints:
            return None
        lower, upper = solver.body.bounds(1, {})
        builder.narrow_bounds(lower, upper)
        fixed = {i: float(lower[0, i]) for i in np.flatnonzero(lower[0] == upper[0]).tolist()}
        postures = ((name, self._move_free(q)) for name, q in posture_guesses(solver.body))
        pose = find_pose(
            replace(solver.pose_problem("goal pose", constraints, fixed=fixed, fraction=0.1), most=None),
            chain([(INIT, program.init[last])], postures),
        )
        return pose.q if pose.is_feasible else None

    def _move_free(self, posture: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        """Return the start with the posture's values of the coordinates that may move."""
        q = self.program.start.copy()
        q[self.program.free] = posture[self.program.free]
        return q


@dataclass(frozen=True)
class ProgramPhase(PlannedPhase):
    """The phase of a program; solved anew, its timeline maps the file's steps to the denser waypoints."""

    search: _ProgramSearch | None = None
    timeline: Timeline | None = None

    def with_waypoint_targets(self) -> ProgramPhase:
        """Return the phase with its waypoints' targets."""
        if self.search is None or self.timeline is None:
            return self
        return replace(self, at_waypoints=partial(self.search.promises.make_waypoint_targets, self.timeline))

    def solve_again(self, q: Float[np.ndarray, "T n"]) -> PlannedPhase | None:
        """Solve the program on from a denser trajectory."""
        if self.search is None or self.timeline is None:
            return None
        timeline = self.timeline.insert_waypoints(self.q, q)
        solved = self.search.solve(q, timeline)
        anew = replace(self, q=solved.x, is_feasible=solved.is_feasible, timeline=timeline)
        return anew.with_waypoint_targets()
