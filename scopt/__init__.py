"""Sequential convex optimisation over waypoints: residuals, problems and the trust-region solver."""

from scopt.errors import ProblemError, ScoptError, SolverError
from scopt.problem import Constraint, Cost, Penalty, Problem, Sense
from scopt.residual import AffineRows, Residual
from scopt.result import Iteration, Result, Status
from scopt.sqp import Settings, TrustRegionSQP

__all__ = [
    "AffineRows",
    "Constraint",
    "Cost",
    "Iteration",
    "Penalty",
    "Problem",
    "ProblemError",
    "Residual",
    "Result",
    "ScoptError",
    "Sense",
    "Settings",
    "SolverError",
    "Status",
    "TrustRegionSQP",
]
