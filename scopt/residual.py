"""Residuals, the building blocks of costs and constraints."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Generic, TypeVar

import numpy as np
from jaxtyping import Float

from scopt.affine import AffineRows
from scopt.finite_difference import finite_differences

StateT = TypeVar("StateT")


class Residual(ABC, Generic[StateT]):
    """A vector measured on a state, with its derivative; rows may vary from call to call.

    ``state`` is what all residuals of a problem share at one iterate (see ``Problem.state``).
    ``linearize(state).value`` equals the first rows of nothing else than ``value(state)`` wherever both hold the
    same rows; a residual whose rows vary (collision) may linearise rows that are not violated yet.

    Attributes:
        is_smooth: whether the rows are always the same, smooth in the variables and measured on no more than
            ``Problem.smooth_state`` offers; trial steps are then corrected for their curvature.
    """

    is_smooth: bool = False

    @abstractmethod
    def value(self, state: StateT) -> Float[np.ndarray, "m"]:
        """Residual at the state."""

    def linearize(self, state: StateT) -> AffineRows:
        """Residual and derivative at the state; checked finite differences unless a subclass knows better.

        Raises:
            DerivativeError: the differences cannot be made (see ``scopt.finite_difference``).
        """
        return finite_differences(self.value, state, type(self).__name__)


def linearized(residual: Residual[StateT], state: StateT, term: str) -> AffineRows:
    """The residual's affine model; finite differences speak of it by the term's name."""
    if type(residual).linearize is Residual.linearize:
        return finite_differences(residual.value, state, term)
    return residual.linearize(state)
