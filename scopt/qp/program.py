"""The form of quadratic programs and solutions that all back ends share."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from typing import Protocol

import numpy as np
from jaxtyping import Float
from scipy import sparse


@dataclass(frozen=True)
class QuadraticProgram:
    """Minimise ``1/2 x'Px + c'x`` subject to ``G x <= h``, ``lower <= x <= upper`` and, where given, ``E x = f``.

    Attributes:
        P: (N, N) symmetric positive semidefinite, both triangles stored.
        c: (N,).
        G: (M, N).
        h: (M,).
        lower, upper: (N,), may be infinite.
        E: (Q, N), each row with an entry; None without equalities.
        f: (Q,).
    """

    P: sparse.csc_array
    c: Float[np.ndarray, "N"]
    G: sparse.csc_array
    h: Float[np.ndarray, "M"]
    lower: Float[np.ndarray, "N"]
    upper: Float[np.ndarray, "N"]
    E: sparse.csc_array | None = field(default=None, kw_only=True)
    f: Float[np.ndarray, "Q"] | None = field(default=None, kw_only=True)

    def objective(self, x: Float[np.ndarray, "N"]) -> float:
        """Return the objective at ``x``."""
        return float(0.5 * x @ (self.P @ x) + self.c @ x)


class QPStatus(Enum):
    """Status of a back end's solution."""

    SOLVED = "solved"
    INACCURATE = "inaccurate"
    INFEASIBLE = "infeasible"
    FAILED = "failed"


@dataclass(frozen=True)
class QPMultipliers:
    """Lagrange multipliers of a program's inequalities, all >= 0.

    Attributes:
        rows: (M,) of ``G x <= h``.
        lower, upper: (N,) of the bounds; zero where they are infinite.
    """

    rows: Float[np.ndarray, "M"]
    lower: Float[np.ndarray, "N"]
    upper: Float[np.ndarray, "N"]

    @staticmethod
    def of_parts(
        rows: np.ndarray, lower: np.ndarray, upper: np.ndarray, has_lower: np.ndarray, has_upper: np.ndarray
    ) -> QPMultipliers:
        """Make them from the multipliers of the finite bounds; negative rounding errors become zero."""
        full = [np.zeros(len(has_lower)), np.zeros(len(has_upper))]
        full[0][has_lower], full[1][has_upper] = lower, upper
        return QPMultipliers(*(np.maximum(part, 0.0) for part in (rows, *full)))


@dataclass(frozen=True)
class QPSolution:
    """Solution of a program; ``x`` and ``multipliers`` are meaningful when ``status`` is SOLVED or INACCURATE.

    ``multipliers`` is None where a back end does not return them.
    """

    x: Float[np.ndarray, "N"]
    status: QPStatus
    multipliers: QPMultipliers | None = None

    @property
    def is_usable(self) -> bool:
        """Whether a step may be taken from it."""
        return self.status in (QPStatus.SOLVED, QPStatus.INACCURATE) and bool(np.isfinite(self.x).all())


class QPBackend(Protocol):
    """A solver of quadratic programs."""

    def __call__(self, program: QuadraticProgram) -> QPSolution:
        """Solve one program."""
        ...
