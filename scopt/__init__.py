"""Sequential convex optimisation over waypoints: residuals, problems and the trust-region solver."""

from scopt.affine import AffineRows
from scopt.derivative_check import DerivativeCheck, check_derivative
from scopt.errors import DerivativeError, DerivativeWarning, ProblemError, ScoptError, SolverError
from scopt.expression import ConvexExpression
from scopt.problem import Constraint, Cost, Penalty, Problem, Sense
from scopt.residual import Residual
from scopt.result import Iteration, Result, Status
from scopt.settings import Clock, EffortClock, Settings
from scopt.sqp import TrustRegionSQP

__all__ = [
    "AffineRows",
    "Clock",
    "Constraint",
    "ConvexExpression",
    "Cost",
    "DerivativeCheck",
    "DerivativeError",
    "DerivativeWarning",
    "EffortClock",
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
    "check_derivative",
]
