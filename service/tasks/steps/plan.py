"""Plan steps one after the other; a step that cannot be done ends the plan with its best attempt."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from service.body.phases import PhaseSolver
from service.body.task_plan import PlannedPhase, Stuck, TaskPlan
from service.demands.steps.compile import compile_step
from service.demands.steps.demand import StepsDemand
from service.demands.steps.extent import Extent, NamedStep
from service.demands.steps.phases import PhaseMaker
from service.errors import RequestError
from service.request.tasks.steps import StepsSection
from service.setup.prepare import PlanSetup
from service.tasks.handling import FARTHER, find_collisions
from service.tasks.sequence import add_mechanism
from service.tasks.steps.pushed import plan_part
from service.tasks.steps.solve import StepSolver, Tried


def plan_steps(section: StepsSection, setup: PlanSetup, plain: PhaseSolver) -> Iterator[TaskPlan]:
    """Yield the plan of all steps up to the first at which it ends, or up to the one that cannot be done.

    Raises:
        RequestError: a hand does not touch what it is to push, or the robot is inside it at the start.
    """
    demand, extent = StepsDemand(section), Extent.of(section)
    notes = tuple(extent.list_notes())
    if not extent.done:
        words = f"nothing comes before step '{extent.rest[0].name}'; plan the steps after it"
        yield TaskPlan(plain.body, (), (words,), notes=notes)
        return
    mechanism = demand.moved
    solver = plain if mechanism is None else add_mechanism(plain, mechanism)
    collisions = () if mechanism is None else tuple(find_collisions(solver.body, remedy=FARTHER))
    if collisions:
        raise RequestError(collisions)
    walk = _Walk(plain, solver, setup, demand, solver.body.nominal)
    phases: list[PlannedPhase] = []
    for named in extent.done:
        done, tried = walk.do(named)
        phases += done
        if tried is not None:
            stuck = None if tried.solved is None else Stuck(tried.name, tried.solved, walk.order)
            obstacle = tuple(f"step '{named.name}': {reason}" for reason in tried.reasons)
            yield TaskPlan(solver.body, tuple(phases), obstacle, stuck, notes=notes, measure=demand.measure)
            return
    yield TaskPlan(solver.body, tuple(phases), notes=notes, measure=demand.measure)


class _Walk:
    """Steps in their order, from the configuration that the ones before have reached."""

    def __init__(
        self,
        plain: PhaseSolver,
        solver: PhaseSolver,
        setup: PlanSetup,
        demand: StepsDemand,
        at: Float[np.ndarray, "n"],
    ) -> None:
        self._plain, self._solver, self._setup, self._demand, self._at = plain, solver, setup, demand, at
        self._values = at[plain.body.robot.n :]
        self.order: tuple[str, ...] = ()

    def do(self, named: NamedStep) -> tuple[list[PlannedPhase], Tried | None]:
        """Return the phases of a step, the best attempt last, and what was not solved."""
        if named.index in self._demand.parts.parts:
            own = replace(self._solver, body=replace(self._solver.body, nominal=self._at))
            phases, tried = plan_part(self._plain, own, self._demand.parts, named, self._at, self._values)
            self._values = self._demand.parts.advance(named.index, self._values)
            self.order += tuple(phase.name for phase in phases)
        else:
            makers = compile_step(self._setup.robot, self._setup.scene, named.step, named.name)
            self.order += tuple(maker.name for maker in makers)
            phases, tried = _plan_step(StepSolver(self._solver, self._setup), makers, self._at)
        if tried is None:
            self._at = phases[-1].q[-1]
        return phases, tried


def _plan_step(
    own: StepSolver, makers: tuple[PhaseMaker, ...], at: Float[np.ndarray, "n"]
) -> tuple[list[PlannedPhase], Tried | None]:
    """Return the phases of a step that were solved, the best attempt last, and the one that was not."""
    first = own.make(makers[0], at)
    if first.goal is None or len(makers) == 1:
        return own.solve_chain(makers, at)
    # A free motion that leads to a path: the pose between them is one from which the whole path can be followed.
    best: tuple[list[PlannedPhase], Tried | None] | None = None
    for pose in own.list_begins(first, makers[1], at):
        path, tried = own.solve_chain(makers[1:], pose)
        lead, missed = own.solve_free(first, at, pose)
        if tried is None and missed is None:
            return [*lead, *path], None
        if missed is None:
            lead = [*lead, *path]
        if best is None or len(lead) > len(best[0]):
            best = lead, missed or tried
    return own.solve_chain(makers[:1], at) if best is None else best
