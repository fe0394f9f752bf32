"""Small residuals for tests of the optimiser: affine maps and user functions of the iterate itself."""

from collections.abc import Callable

import numpy as np
from scipy import sparse

from scopt import AffineRows, Residual


class Affine(Residual[np.ndarray]):
    """``A x - b`` with ``x`` flattened."""

    def __init__(self, A, b):
        self.A, self.b = sparse.csr_array(np.atleast_2d(A)), np.atleast_1d(np.asarray(b, dtype=float))

    def value(self, state):
        return self.A @ state.ravel() - self.b

    def linearize(self, state):
        return AffineRows(self.value(state), self.A)


class Function(Residual[np.ndarray]):
    """``f(x)`` with its Jacobian given as a function."""

    is_smooth = True

    def __init__(self, f: Callable, jacobian: Callable):
        self.f, self.jacobian = f, jacobian

    def value(self, state):
        return np.atleast_1d(self.f(state.ravel()))

    def linearize(self, state):
        return AffineRows(self.value(state), sparse.csr_array(np.atleast_2d(self.jacobian(state.ravel()))))


def identity_state(x):
    """The iterate is its own state."""
    return x
