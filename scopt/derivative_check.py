"""Comparison of a residual's own derivative with central differences."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from scopt.errors import DerivativeError
from scopt.finite_difference import Differences
from scopt.residual import Residual, StateT

TOLERANCE = 1e-5  # of a slope, absolute up to 1 and relative above; central differences are right to some 1e-9


@dataclass(frozen=True)
class DerivativeCheck:
    """Largest difference between a derivative and central differences.

    Attributes:
        term: class of the residual.
        error: the largest difference, absolute for slopes up to 1 and relative above.
        row, waypoint, variable: where.
        variable_name: empty where the state has no ``variable_names``.
        given, measured: the derivative there, and its central difference.
    """

    term: str
    error: float
    row: int
    waypoint: int
    variable: int
    variable_name: str
    given: float
    measured: float

    @property
    def is_right(self) -> bool:
        """Whether no derivative is off by more than the tolerance."""
        return self.error <= TOLERANCE

    def __str__(self) -> str:
        if self.is_right:
            return f"'{self.term}': derivatives agree with central differences within {self.error:.1e}"
        name = f" ('{self.variable_name}')" if self.variable_name else ""
        return (
            f"'{self.term}': the derivative of row {self.row} along waypoint {self.waypoint}, variable {self.variable}"
            f"{name} is {self.given:.6g}, central differences give {self.measured:.6g}"
        )


def check_derivative(
    residual: Residual[StateT],
    state: Callable[[Float[np.ndarray, "T n"]], StateT],
    x: Float[np.ndarray, "T n"],
) -> DerivativeCheck:
    """Compare ``linearize`` with central differences at an iterate.

    Args:
        residual: with the same rows at ``x`` and around it.
        state: that of the problem (``Problem.state``).
        x: (T, n); random values show more errors than round ones.

    Raises:
        DerivativeError: the rows of ``linearize`` are not those of ``value``, their Jacobian has the wrong shape, or
            the value is not finite or its number of rows changes.
    """
    term = type(residual).__name__
    here = state(x)
    names = tuple(getattr(here, "variable_names", ()))
    differences = Differences(lambda y: residual.value(state(y)), x, term, names)
    rows = residual.linearize(here)
    if rows.jacobian.shape != (len(differences.middle), x.size):
        raise DerivativeError(
            f"the Jacobian of '{term}' must have shape {(len(differences.middle), x.size)} (rows, waypoints times "
            f"variables), got {rows.jacobian.shape}"
        )
    off = np.flatnonzero(rows.value != differences.middle)
    if len(off):
        row = int(off[0])
        raise DerivativeError(
            f"row {row} of '{term}' is {rows.value[row]:.6g} in `linearize` and {differences.middle[row]:.6g} in "
            "`value`"
        )
    given, measured = rows.jacobian.toarray(), differences.linearize().jacobian.toarray()
    error = np.abs(given - measured) / np.maximum(1.0, np.abs(measured))
    if not error.size:
        return DerivativeCheck(term, 0.0, 0, 0, 0, "", 0.0, 0.0)
    row, column = divmod(int(np.argmax(error)), x.size)
    waypoint, variable = divmod(column, x.shape[1])
    return DerivativeCheck(
        term,
        float(error[row, column]),
        row,
        waypoint,
        variable,
        names[variable] if names else "",
        float(given[row, column]),
        float(measured[row, column]),
    )
