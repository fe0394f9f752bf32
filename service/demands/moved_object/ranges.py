"""Exact least and largest values of functions of one joint, from their values at a few places."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def bound_waves(values: Float[np.ndarray, "5"], low: float, high: float) -> tuple[float, float]:
    """Return the least and largest value between two angles of a sum of 1, cos a, sin a, cos 2a and sin 2a.

    Args:
        values: at five angles that divide a turn, the first at 0.
        low, high: the range [rad].
    """
    factors = np.fft.fft(values) / len(values)  # of exp(i k a), for k = 0, 1, 2, -2, -1
    by_order = factors[[-2, -1, 0, 1, 2]]
    orders = np.arange(-2, 3)
    slope = orders * by_order  # times exp(2 i a) it is a polynomial of exp(i a)
    scale = np.abs(by_order).max()
    roots = np.roots(np.where(np.abs(slope) > 1e-12 * scale, slope, 0.0)[::-1]) if scale > 0.0 else np.zeros(0)
    turns = np.arange(np.floor(low / (2.0 * np.pi)) - 1.0, np.ceil(high / (2.0 * np.pi)) + 2.0)
    angles = (np.angle(roots)[:, None] + 2.0 * np.pi * turns).ravel()
    at = np.concatenate([[low, high], angles[(angles > low) & (angles < high)]])
    found = (by_order * np.exp(1j * at[:, None] * orders)).sum(axis=1).real
    return float(found.min()), float(found.max())


def bound_polynomial(values: Float[np.ndarray, "3"], low: float, high: float) -> tuple[float, float]:
    """Return the least and largest value of a quadratic between two places, from its values at -1, 0 and 1."""
    before, middle, after = values.tolist()
    square, slope = 0.5 * (before + after) - middle, 0.5 * (after - before)
    at = [low, high]
    if square != 0.0 and low < -0.5 * slope / square < high:
        at.append(-0.5 * slope / square)
    found = [middle + slope * x + square * x * x for x in at]
    return min(found), max(found)
