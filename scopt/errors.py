"""Errors of the optimiser; an unsolved problem is a status, not an error."""


class ScoptError(Exception):
    """Base of all errors raised by ``scopt``."""


class ProblemError(ScoptError):
    """A problem that is not well posed."""


class SolverError(ScoptError):
    """A convex solver answered with a status that is not in our mapping, or was asked for by an unknown name."""
