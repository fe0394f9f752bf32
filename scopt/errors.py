"""Errors of the optimiser; an unsolved problem is a status, not an error."""


class ScoptError(Exception):
    """Base of all errors raised by ``scopt``."""


class ProblemError(ScoptError):
    """An ill-posed problem."""


class SolverError(ScoptError):
    """An unknown back end, or a back end's status that is not in our mapping."""


class DerivativeError(ScoptError):
    """A residual without a derivative cannot be differentiated, or its own derivative is malformed."""


class DerivativeWarning(UserWarning):
    """An unreliable finite difference.

    Attributes:
        term: name of the term.
        row, waypoint, variable: place of the largest error.
    """

    def __init__(self, message: str, term: str, row: int, waypoint: int, variable: int) -> None:
        super().__init__(message)
        self.term, self.row, self.waypoint, self.variable = term, row, waypoint, variable
