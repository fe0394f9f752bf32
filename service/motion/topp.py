"""The fastest motion along a path parameter, given linear limits of its speed squared and its acceleration.

TOPP-RA (Pham & Pham, T-RO 2018): ``x = (ds/dt)^2`` at grid points, ``u = d2s/dt2`` constant between them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from costs.stopping import poll

# Coefficients below this (in units of the limit) count as none.
_FLAT = 1e-10
_NEWTON_STEPS = 100


@dataclass(frozen=True)
class HalfRows:
    """Rows ``a u + b x <= room`` of ``M`` cells, ``m`` each; u = x = 0 keeps them all.

    Attributes:
        a, b: (M, m).
        room: (M, m) > 0; inf where there is no row.
    """

    a: Float[np.ndarray, "M m"]
    b: Float[np.ndarray, "M m"]
    room: Float[np.ndarray, "M m"]

    @staticmethod
    def both_ways(a: np.ndarray, b: np.ndarray, c: np.ndarray, limit: np.ndarray | float) -> HalfRows:
        """``|a u + b x + c| <= limit`` where ``|c| < limit``."""
        return HalfRows(np.hstack([a, -a]), np.hstack([b, -b]), np.hstack([limit - c, limit + c]))


class Limits:
    """All rows of ``M`` cells, and ``x <= limit``, ready to be asked cell by cell.

    Attributes:
        highest: (M,) largest x that the rows without u allow.
    """

    def __init__(self, rows: Sequence[HalfRows], limit: Float[np.ndarray, "M"]) -> None:
        a, b = (np.hstack([getattr(part, name) / part.room for part in rows]) for name in ("a", "b"))
        is_up, is_down = a > _FLAT, a < -_FLAT
        inverse = np.divide(1.0, a, out=np.zeros_like(a), where=is_up | is_down)
        # u lies between low + slope x and high + slope x.
        self._slope = -b * inverse
        self._low, self._high = np.where(is_down, inverse, -np.inf), np.where(is_up, inverse, np.inf)
        is_flat = ~(is_up | is_down) & (b > _FLAT)
        room = np.divide(1.0, b, out=np.full_like(b, np.inf), where=is_flat)
        self.highest = np.minimum(limit, room.min(axis=1, initial=np.inf))

    def bounds(self, i: int, x: float, width: float, highest: float) -> tuple[float, float, float, float]:
        """Least and greatest u at ``x`` that keep the rows and ``0 <= x + 2 width u <= highest``, and their slopes."""
        shift = self._slope[i] * x
        low, high = self._low[i] + shift, self._high[i] + shift
        k, j = low.argmax(), high.argmin()
        least, most = float(low[k]), float(high[j])
        least_slope, most_slope = float(self._slope[i, k]), float(self._slope[i, j])
        if -0.5 * x / width >= least:
            least, least_slope = -0.5 * x / width, -0.5 / width
        if 0.5 * (highest - x) / width <= most:
            most, most_slope = 0.5 * (highest - x) / width, -0.5 / width
        return least, most, least_slope, most_slope


def fastest_speed(limits: Limits, width: Float[np.ndarray, "M-1"]) -> Float[np.ndarray, "M"]:
    """Greatest ds/dt from rest to rest: controllable sets backwards, then greedily forwards.

    Rest is always controllable (u = x = 0 keeps every row), so each set is ``[0, reachable]``.
    """
    n = len(width)
    reachable = np.zeros(n + 1)
    for i in range(n - 1, -1, -1):
        poll()
        x = float(limits.highest[i])
        for _ in range(_NEWTON_STEPS):
            least, most, least_slope, most_slope = limits.bounds(i, x, width[i], reachable[i + 1])
            if least <= most or x <= 0.0:
                break
            # least - most is convex and piecewise linear in x: Newton from the right descends onto its root.
            x = max(0.0, x - (least - most) / (least_slope - most_slope) - 1e-12 * x)
        reachable[i] = x
    square = np.zeros(n + 1)
    for i in range(n):
        poll()
        _, most, _, _ = limits.bounds(i, square[i], width[i], reachable[i + 1])
        square[i + 1] = min(max(square[i] + 2.0 * width[i] * most, 0.0), reachable[i + 1])
    return np.asarray(np.sqrt(square))
