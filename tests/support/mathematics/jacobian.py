"""The one check every residual's derivative goes through: central differences over all waypoints."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from scopt import Residual


def central_differences(value: Callable[[np.ndarray], np.ndarray], x: np.ndarray, step: float) -> np.ndarray:
    """(m, T * n) derivative of ``value(x)`` with respect to all waypoints' variables."""
    columns = []
    for index in range(x.size):
        forward, backward = x.copy(), x.copy()
        forward.flat[index] += step
        backward.flat[index] -= step
        columns.append((value(forward) - value(backward)) / (forward.flat[index] - backward.flat[index]))
    return np.stack(columns, axis=1)


def check_jacobian(
    residual: Residual[Any],
    make_state: Callable[[np.ndarray], Any],
    x: np.ndarray,
    *,
    tolerance: float = 1e-6,
    step: float = 1e-5,
) -> np.ndarray:
    """Assert what every residual promises at ``x`` and return its dense Jacobian.

    The linearisation at a zero step is the value itself, and its Jacobian agrees with central differences in every
    variable of every waypoint, also in those that a row does not touch.

    Args:
        residual: with the same rows at ``x`` and around it.
        make_state: maps an iterate (T, n) to the residual's state.
        x: (T, n) iterate.
        tolerance: largest difference, absolute for derivatives up to 1 and relative above.
        step: of the differences.
    """
    state = make_state(x)
    rows = residual.linearize(state)
    value = residual.value(state)
    np.testing.assert_array_equal(rows.at(np.zeros(x.size)), value)
    assert rows.jacobian.shape == (len(value), x.size)
    dense = rows.jacobian.toarray()
    expected = central_differences(lambda y: residual.value(make_state(y)), x, step)
    np.testing.assert_allclose(dense, expected, rtol=tolerance, atol=tolerance)
    return np.asarray(dense)
