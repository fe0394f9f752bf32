"""Rows in cones, in the one form that CVXPY and Clarabel share."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy import sparse

from scopt.errors import SolverError
from scopt.qp.program import QuadraticProgram


class ConeKind(Enum):
    """Cones as Clarabel names them."""

    ZERO = "ZeroConeT"
    NONNEGATIVE = "NonnegativeConeT"
    SECOND_ORDER = "SecondOrderConeT"
    PSD_TRIANGLE = "PSDTriangleConeT"
    EXPONENTIAL = "ExponentialConeT"
    POWER = "PowerConeT"


@dataclass(frozen=True)
class Cone:
    """A cone.

    Attributes:
        kind: as Clarabel names it.
        parameter: size; exponent of a power cone; None for an exponential cone.
    """

    kind: ConeKind
    parameter: float | None


@dataclass(frozen=True)
class ConicProgram(QuadraticProgram):
    """A quadratic program with further rows ``A x + s = b``, ``s`` in the product of the cones.

    Attributes:
        A: (C, N).
        b: (C,).
        cones: in the order of their rows.
    """

    A: sparse.csc_array
    b: Float[np.ndarray, "C"]
    cones: tuple[Cone, ...]


def read_cones(dims: Any) -> tuple[Cone, ...]:
    """Read the cones of a problem that CVXPY has written for Clarabel from their dimensions.

    Raises:
        SolverError: a kind of cone that is not in our mapping.
    """
    if getattr(dims, "pnd", None):
        raise SolverError(
            "the expression needs a power cone of more than three dimensions, which is not in our mapping"
        )
    flat = ((ConeKind.ZERO, dims.zero), (ConeKind.NONNEGATIVE, dims.nonneg))
    cones = [Cone(kind, int(size)) for kind, size in flat if size]
    cones += [Cone(ConeKind.SECOND_ORDER, int(size)) for size in dims.soc]
    cones += [Cone(ConeKind.PSD_TRIANGLE, int(size)) for size in dims.psd]
    cones += [Cone(ConeKind.EXPONENTIAL, None)] * int(dims.exp)
    cones += [Cone(ConeKind.POWER, float(exponent)) for exponent in dims.p3d]
    return tuple(cones)
