"""Result of a solve and the record of its trial steps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

import numpy as np
from jaxtyping import Float


class Status(Enum):
    """Why the optimiser stopped."""

    CONVERGED = "converged"  # feasible within tolerance and no step improves the merit enough
    ACCEPTABLE = "acceptable"  # violations within what is acceptable, and trial steps did not remove them
    STALLED = "stalled"  # infeasible: the trust region collapsed or no step improves the merit at the largest penalty
    ITERATION_LIMIT = "iteration_limit"
    TIME_LIMIT = "time_limit"
    CANCELLED = "cancelled"
    SUBPROBLEM_FAILED = "subproblem_failed"


@dataclass(frozen=True)
class Iteration:
    """One trial step of the optimiser.

    Attributes:
        index: counts trial steps from 0.
        penalty: mu of the outer loop.
        trust_radius: box scale of the trial.
        merit: exact merit at the iterate before the trial.
        trial_merit, model_merit: exact and modelled merit after the trial step.
        is_accepted: whether the step was taken.
        cost, violation: exact cost and largest violation by name after the trial (accepted) or before it (rejected).
        convexify_s, solve_s, evaluate_s: wall time of the steps [s].
    """

    index: int
    penalty: float
    trust_radius: float
    merit: float
    trial_merit: float
    model_merit: float
    is_accepted: bool
    cost: Mapping[str, float]
    violation: Mapping[str, float]
    convexify_s: float
    solve_s: float
    evaluate_s: float


@dataclass(frozen=True)
class Result:
    """Best trajectory of a solve.

    Attributes:
        x: (T, n) waypoints: of the feasible iterates the cheapest, else the one with the least violation.
        status: why the optimiser stopped.
        is_feasible: measured at ``x``: every violation within its constraint's tolerance.
        cost, violation: exact cost and largest row violation by name at ``x``.
        penalty: mu at the end.
        history: one entry per trial step.
        solve_time_s: wall time [s].
        message: one sentence for users.
    """

    x: Float[np.ndarray, "T n"]
    status: Status
    is_feasible: bool
    cost: Mapping[str, float]
    violation: Mapping[str, float]
    penalty: float
    history: tuple[Iteration, ...]
    solve_time_s: float
    message: str
