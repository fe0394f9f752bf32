"""The last attempt at a step: from the best one before, asking for nothing but what must hold."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float

from costs.collision import Contacts
from costs.state import MotionState
from scopt import Problem, TrustRegionSQP
from service.body.phases import LEAST_CLEARANCE, PhaseSolver, Solved
from service.body.whole_body import CLEARANCE_TOLERANCE

# Steps from a local minimum: what gives way does so at once.
EFFORT: dict[str, Any] = {"penalty": 100.0, "max_penalty_raises": 1, "max_iterations": 30}


def keep_required(problem: Problem[MotionState]) -> Problem[MotionState]:
    """What must hold alone: no costs, and of the clearance that is aimed at what keeps links apart."""
    least = LEAST_CLEARANCE + CLEARANCE_TOLERANCE

    def apart(contacts: Contacts) -> Contacts:
        return replace(contacts, margin=np.minimum(contacts.margin, least))

    return change_contacts(replace(problem, costs=()), apart)


def restore_feasibility(solver: PhaseSolver, step: str, solved: Solved) -> Solved:
    """A feasible solution near the best attempt, or that attempt where there is none within a few steps.

    Args:
        solver: of the step.
        step: its name.
        solved: the best attempt, not feasible.
    """
    problem = keep_required(solved.problem)
    settings = solver.monitor.settings(replace(solver.settings, **EFFORT))
    result = TrustRegionSQP(settings).solve(problem, solved.x, should_stop=solver.monitor.should_stop)
    solver.monitor.note(step, result)
    found = Solved(result, problem, solved.body)
    return found if found.is_feasible else solved


def change_contacts(problem: Problem[MotionState], change: Callable[[Contacts], Contacts]) -> Problem[MotionState]:
    """The problem that sees its contacts changed."""

    def state(x: Float[np.ndarray, "T n"]) -> MotionState:
        full = problem.state(x)
        return replace(full, contacts=change(full.contacts))

    return replace(problem, state=state)
