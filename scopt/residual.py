"""Residuals, the building blocks of costs and constraints."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Generic, TypeVar

import numpy as np
from jaxtyping import Float

from scopt.affine import AffineRows
from scopt.finite_difference import differentiate

StateT = TypeVar("StateT")


class Residual(ABC, Generic[StateT]):
    """A vector measured on a state, with its derivative; rows may vary from call to call.

    ``state`` is shared by all residuals of a problem at one iterate (see ``Problem.state``).
    ``linearize(state).value`` equals ``value(state)`` wherever both hold the same rows; a residual whose rows vary
    (collision) may linearise rows that are not violated yet.

    Attributes:
        is_smooth: whether the rows are always the same, smooth in the variables and measured on
            ``Problem.smooth_state``; trial steps are then corrected for their curvature.
    """

    is_smooth: bool = False

    @abstractmethod
    def value(self, state: StateT) -> Float[np.ndarray, "m"]:
        """Return the residual at the state."""

    def linearize(self, state: StateT) -> AffineRows:
        """Return residual and derivative at the state; checked finite differences unless a subclass overrides it.

        Raises:
            DerivativeError: the differences cannot be computed (see ``scopt.finite_difference``).
        """
        return differentiate(self.value, state, type(self).__name__)


def linearize_residual(residual: Residual[StateT], state: StateT, term: str) -> AffineRows:
    """Return the residual's affine model; messages of finite differences name the term."""
    if type(residual).linearize is Residual.linearize:
        return differentiate(residual.value, state, term)
    return residual.linearize(state)
