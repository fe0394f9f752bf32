"""A problem file as one phase: its costs and constraints and no others, but that links stay apart."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice

import numpy as np
from jaxtyping import Float

from service.body.phases import (
    LEAST_CLEARANCE,
    PhaseSolver,
    PlannedPhase,
    Solved,
    Stuck,
    TaskPlan,
    path_via,
    posture_guesses,
    straight_path,
)
from service.body.reach import find_out_of_reach
from service.body.sampling import SamplingProblem, Tree, free_coordinates, resample_path, sample_path
from service.body.whole_body import CLEARANCE_TOLERANCE, Aims, WholeBody
from service.errors import RequestError
from service.start.overlaps import describe_collisions, find_overlaps_and_unresolved
from service.trajopt import Builder, Program, Promises, Timeline
from service.trajopt.json_fields import did_you_mean
from service.trajopt.problem import CollisionTerm, PoseTerm

PHASE = "trajopt"
APART = LEAST_CLEARANCE + CLEARANCE_TOLERANCE  # kept of all pairs, whatever the file's own collision terms ask [m]
SIGHT = 0.03  # beyond the largest distance that is asked [m]
TREES = (
    Tree(0, 1000, "LBKPIECE1"),
    Tree(1, 1500, "RRTConnect"),
    Tree(2, 2000, "LBKPIECE1"),
    Tree(3, 4000, "RRTConnect"),
)
# As in TrajOpt, the optimiser goes on until its costs are low; elsewhere the first feasible motion will do.
LEAST_GAIN = 1e-3


def plan_program(solver: PhaseSolver, program: Program) -> Iterator[TaskPlan]:
    """The program solved from its own start, then from others, as often as one is feasible.

    Raises:
        RequestError: a collision term names what is neither a link nor a piece of the scene.
    """
    body = with_sight(solver.body, program)
    _check_pairs(program, body)
    impossible = _impossible(program, body)
    if impossible:
        yield TaskPlan(body, (), impossible, is_impossible=True, notes=program.notes)
        return
    unresolved = _unresolved(program, body)
    if unresolved:
        yield TaskPlan(body, (), unresolved, notes=program.notes)
        return
    settings = {"min_improvement_feasible": LEAST_GAIN, **program.problem.opt.settings}
    search = _Search(replace(solver, body=body).with_settings(**settings), program, Promises.of(program, body.robot))
    best: tuple[str, Solved] | None = None
    is_found = False
    for name, solved in islice(search.solutions(), solver.most_starts):
        if solved.is_feasible:
            is_found = True
            yield search.plan(name, solved)
        elif best is None or solved.shortfall < best[1].shortfall:
            best = name, solved
    if not is_found and best is not None:
        yield search.plan(*best)


def with_sight(body: WholeBody, program: Program) -> WholeBody:
    """The robot without habits of its own, seeing as far as the file asks, balanced if the file asks for that."""
    asked = [
        distance
        for term in program.problem.terms
        if isinstance(term, CollisionTerm)
        for distances in (term.dist_pen, *(pair.dist_pen for pair in term.pairs))
        for distance in distances
    ]
    return replace(
        body,
        aims=Aims(APART, body.aims.balance_margin),
        polygon=body.polygon if program.is_balanced else None,
        has_habits=False,
        sight=max([0.0, *asked]) + SIGHT,
    )


def _check_pairs(program: Program, body: WholeBody) -> None:
    links = {name for each in body.robot.bodies for name in (each.link, each.name)}
    known = [*sorted(links), *(piece.name for piece in body.scene.pieces)]
    problems = [
        f"{pair.path}.pair[{k}]: {other!r} is neither a link nor a piece of the scene; {did_you_mean(other, known)}"
        for term in program.problem.terms
        if isinstance(term, CollisionTerm)
        for pair in term.pairs
        for k, other in enumerate(pair.others)
        if other not in known
    ]
    if problems:
        raise RequestError(problems)


def _impossible(program: Program, body: WholeBody) -> tuple[str, ...]:
    """Reasons that hold for every motion: a fixed waypoint in collision, a pose beyond the chain."""
    planted = [foot.link for foot in body.planted]
    lines = [
        f"waypoint {step}, which is fixed, is in collision: {line}"
        for step, q in sorted(program.fixed.items())
        if step  # the start was looked at before
        for line in describe_collisions(body.robot, q, body.scene, planted)
    ]
    for term in program.problem.terms:
        is_plain = isinstance(term, PoseTerm) and term.reference is None and not any(term.offset_xyz)
        if isinstance(term, PoseTerm) and not term.is_cost and is_plain and all(term.pos_coeffs):
            reason = find_out_of_reach(body, term.frame, np.array(term.xyz), program.problem.opt.tolerance)
            lines += [] if reason is None else [f"{term.path}: {reason}"]
    return tuple(lines)


def _unresolved(program: Program, body: WholeBody) -> tuple[str, ...]:
    """Fixed waypoints that are clear while hulls overlap there, so that no motion through them can be certified."""
    planted = [foot.link for foot in body.planted]
    return tuple(
        f"waypoint {step}, which is fixed, is too near to plan through: {overlap.nearness}"
        for step, q in sorted(program.fixed.items())
        if step
        for overlap in find_overlaps_and_unresolved(body.robot, q, body.scene, planted)[1]
    )


@dataclass(frozen=True)
class _Search:
    """The starts of one program, the file's own first, and what the optimiser makes of them."""

    solver: PhaseSolver
    program: Program
    promises: Promises

    def solutions(self) -> Iterator[tuple[str, Solved]]:
        """Solved starts by name, feasible or not; every one asked for costs its solve."""
        program = self.program
        yield "init_info", self.solve(program.init)
        end = self._end()
        if end is None:
            return
        start, count = program.init[0], program.n_steps
        yield from self._around(start, end, TREES[0])
        if np.abs(straight_path(start, end, count) - program.init).max() > 1e-6:
            yield "straight line", self.solve(straight_path(start, end, count))
        yield from self._around(start, end, TREES[1])
        for name, posture in posture_guesses(self.solver.body)[1:]:
            yield f"via posture '{name}'", self.solve(path_via(start, self._moved(posture), end, count))
        for tree in TREES[2:]:
            yield from self._around(start, end, tree)

    def plan(self, name: str, solved: Solved) -> TaskPlan:
        """A solution as a task's plan."""
        promises = self.promises
        phase = ProgramPhase(
            PHASE,
            solved.x,
            solved.is_feasible,
            holds=promises.make_holds(),
            targets=lambda s_last: promises.make_targets(),
            search=self,
            timeline=Timeline.of_steps(self.program.n_steps),
        ).with_waypoint_targets()
        notes = (*self.program.notes, *promises.notes)
        stuck = Stuck.at(PHASE, solved)
        return TaskPlan(self.solver.body, (phase,), stuck=stuck, found_from=name, notes=notes)

    def solve(self, q: Float[np.ndarray, "T n"], timeline: Timeline | None = None) -> Solved:
        """The program from a start; without a timeline every waypoint is a step."""
        program, body = self.program, self.solver.body
        timeline = Timeline.of_steps(program.n_steps) if timeline is None else timeline
        fixed = {int(timeline.rows[step]): at for step, at in program.fixed.items()}
        builder = Builder(program, timeline, body, body.checker())
        with self.solver.monitor.step(PHASE, 0.4):
            return self.solver.trajectory(
                PHASE, [q], fixed, builder.make_costs(), builder.make_constraints(), bounds=builder.narrow_bounds
            )

    def _end(self) -> Float[np.ndarray, "n"] | None:
        """A configuration for the last waypoint: the one that is asked for, or one that keeps its constraints."""
        program, solver = self.program, self.solver
        last = program.n_steps - 1
        if last in program.fixed:
            return program.fixed[last]
        alone = program.restrict_to(last)
        builder = Builder(alone, Timeline.of_steps(1), solver.body, solver.body.checker())
        constraints = builder.make_constraints()
        if not constraints:
            return None
        lower, upper = solver.body.bounds(1, {})
        builder.narrow_bounds(lower, upper)
        fixed = {i: float(lower[0, i]) for i in np.flatnonzero(lower[0] == upper[0]).tolist()}
        for guess in (program.init[last], *(self._moved(posture) for _, posture in posture_guesses(solver.body))):
            with solver.monitor.step("goal pose", 0.1):
                solved = solver.pose("goal pose", [guess], constraints, fixed=fixed)
            if solved.is_feasible:
                return np.asarray(solved.x[0])
        return None

    def _moved(self, posture: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        """A posture of the coordinates that may move; the others are where they start."""
        q = self.program.start.copy()
        q[self.program.free] = posture[self.program.free]
        return q

    def _around(
        self, start: Float[np.ndarray, "n"], end: Float[np.ndarray, "n"], tree: Tree
    ) -> Iterator[tuple[str, Solved]]:
        """From the path of a sampling planner, on the waypoints that the file allows: optimised, or as it is."""
        solver, body = self.solver, self.solver.body
        free = np.intersect1d(self.program.free, free_coordinates(body))
        others = np.setdiff1d(np.arange(body.robot.n), free)
        if not len(free) or np.abs(end - start)[others].max(initial=0.0) > 1e-6:
            return
        with solver.monitor.step("sampling", 0.5):
            problem = SamplingProblem(body, body.pose_checker([start, end]), start, end, free)
            corners = sample_path(problem, replace(tree, seed=tree.seed + solver.seed), solver.monitor.is_over)
            solver.monitor.check()
        if corners is None:
            return
        path = resample_path(corners, self.program.n_steps)
        solved = self.solve(path)
        if not solved.is_feasible:
            as_it_is = replace(self, solver=solver.with_settings(max_iterations=0)).solve(path)
            solved = as_it_is if as_it_is.is_feasible else solved
        yield f"path of {tree.planner}, tree {tree.seed + 1}", solved


@dataclass(frozen=True)
class ProgramPhase(PlannedPhase):
    """The one phase of a program; when it is solved anew, it knows where the file's steps are among more waypoints."""

    search: _Search | None = None
    timeline: Timeline | None = None

    def with_waypoint_targets(self) -> ProgramPhase:
        """The phase with what it promises of its waypoints."""
        if self.search is None or self.timeline is None:
            return self
        return replace(self, at_waypoints=partial(self.search.promises.make_waypoint_targets, self.timeline))

    def solve_again(self, q: Float[np.ndarray, "T n"]) -> PlannedPhase | None:
        """The program solved on from a denser trajectory."""
        if self.search is None or self.timeline is None:
            return None
        timeline = self.timeline.insert_waypoints(self.q, q)
        solved = self.search.solve(q, timeline)
        anew = replace(self, q=solved.x, is_feasible=solved.is_feasible, timeline=timeline)
        return anew.with_waypoint_targets()
