"""Errors of the optimiser; an unsolved problem is a status, not an error."""


class ScoptError(Exception):
    """Base of all errors raised by ``scopt``."""


class ProblemError(ScoptError):
    """A problem that is not well posed."""


class SolverError(ScoptError):
    """A convex solver answered with a status that is not in our mapping, or was asked for by an unknown name."""


class DerivativeError(ScoptError):
    """A residual that brings no derivative cannot be differentiated, or brings one that is malformed."""


class DerivativeWarning(UserWarning):
    """A finite difference that is not to be trusted.

    Attributes:
        term: whose it is.
        row, waypoint, variable: where it is worst.
    """

    def __init__(self, message: str, term: str, row: int, waypoint: int, variable: int) -> None:
        super().__init__(message)
        self.term, self.row, self.waypoint, self.variable = term, row, waypoint, variable
