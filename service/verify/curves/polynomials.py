"""Outer bounds of polynomials on intervals, by their Bernstein form.

A polynomial on [0, 1] lies between the least and the greatest coefficient of its Bernstein form, of which the first and
the last are its values at the ends (Farouki, CAGD 2012, sec. 3).  Halving an interval brings both closer.
"""

from __future__ import annotations

from math import comb

import numpy as np
from jaxtyping import Float

_MAX_HALVINGS = 24
_RESOLUTION = 1e-10  # relative to the largest coefficient


def restrict(
    coefficients: Float[np.ndarray, "k I n"], low: Float[np.ndarray, "I"], high: Float[np.ndarray, "I"]
) -> Float[np.ndarray, "k I n"]:
    """Return the coefficients of ``p(low + u)``, whose interval is then ``0 <= u <= high - low``."""
    shift = low[:, None]
    rows = [row.copy() for row in coefficients]
    for first in range(len(rows) - 1):  # Horner's scheme, once for every derivative
        for k in range(len(rows) - 2, first - 1, -1):
            rows[k] = rows[k] + shift * rows[k + 1]
    return np.stack(rows)


def bound_size(coefficients: Float[np.ndarray, "k I n"], length: Float[np.ndarray, "I"]) -> Float[np.ndarray, "I n"]:
    """Return an upper bound of ``|p(u)|`` for ``0 <= u <= length``; it exceeds the truth by O(length^2)."""
    return np.asarray(np.abs(_to_bernstein(coefficients, length)).max(axis=0))


def bound_range(
    coefficients: Float[np.ndarray, "k I n"], length: Float[np.ndarray, "I"]
) -> tuple[Float[np.ndarray, "I n"], Float[np.ndarray, "I n"]]:
    """Return lower and upper bounds of polynomials on ``0 <= u <= length``, within a relative 1e-10 of the truth."""
    bernstein = _to_bernstein(coefficients, length)
    shape = bernstein.shape[1:]
    flat = bernstein.reshape(len(bernstein), -1)
    return -_bound_largest(-flat).reshape(shape), _bound_largest(flat).reshape(shape)


def _bound_largest(bernstein: Float[np.ndarray, "k E"]) -> Float[np.ndarray, "E"]:
    """Return an upper bound of each polynomial's largest value; pieces that cannot hold it are dropped."""
    tolerance = _RESOLUTION * np.abs(bernstein).max(axis=0)
    reached = np.maximum(bernstein[0], bernstein[-1])
    bound = np.full(bernstein.shape[1], -np.inf)
    owner = np.arange(bernstein.shape[1])
    for _ in range(_MAX_HALVINGS):
        upper = bernstein.max(axis=0)
        is_open = upper > reached[owner] + tolerance[owner]
        np.maximum.at(bound, owner[~is_open], upper[~is_open])
        bernstein, owner = _halve(bernstein[:, is_open]), np.tile(owner[is_open], 2)
        if not len(owner):
            break
        np.maximum.at(reached, owner, np.maximum(bernstein[0], bernstein[-1]))
    if len(owner):
        np.maximum.at(bound, owner, bernstein.max(axis=0))
    return np.asarray(np.maximum(bound, reached))


def _to_bernstein(coefficients: Float[np.ndarray, "k I n"], length: Float[np.ndarray, "I"]) -> np.ndarray:
    """Return the coefficients of the Bernstein form on ``0 <= u <= length``."""
    degree = len(coefficients) - 1
    scaled = [row * length[:, None] ** k for k, row in enumerate(coefficients)]
    return np.stack(
        [
            sum((comb(i, k) / comb(degree, k) * scaled[k] for k in range(i + 1)), np.zeros_like(scaled[0]))
            for i in range(degree + 1)
        ]
    )


def _halve(bernstein: Float[np.ndarray, "k E"]) -> Float[np.ndarray, "k 2E"]:
    """Return the Bernstein forms on both halves, the first halves first (de Casteljau)."""
    row, first, last = bernstein, [bernstein[0]], [bernstein[-1]]
    while len(row) > 1:
        row = 0.5 * (row[:-1] + row[1:])
        first.append(row[0])
        last.append(row[-1])
    return np.concatenate([np.stack(first), np.stack(last[::-1])], axis=1)
