"""Exact bounds of the curve's first and second derivatives over sub-intervals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from costs.curve import Curve, differentiate
from service.verify.curves.polynomials import bound_range, bound_size, restrict
from service.verify.motion import VerifyError


@dataclass(frozen=True)
class RateBounds:
    """Bounds of the derivatives on ``I`` intervals of the curve, each inside one knot interval.

    Attributes:
        first, last: (I,) path parameters.
        speed: (I, n) largest ``|dq/ds|``.
        bend: (I, n) largest ``|d2q/ds2|``.
        step: (I,) longest gap between exported samples that touches the interval (0: no samples).
        step_speed, step_bend: (I, n) the same bounds over all such gaps (over the knot interval).
    """

    first: Float[np.ndarray, "I"]
    last: Float[np.ndarray, "I"]
    speed: Float[np.ndarray, "I n"]
    bend: Float[np.ndarray, "I n"]
    step: Float[np.ndarray, "I"]
    step_speed: Float[np.ndarray, "I n"]
    step_bend: Float[np.ndarray, "I n"]

    @property
    def length(self) -> Float[np.ndarray, "I"]:
        """Lengths in the path parameter."""
        return np.asarray(self.last - self.first)

    def take(self, rows: np.ndarray | slice) -> RateBounds:
        """Return these rows."""
        return RateBounds(*(column[rows] for column in vars(self).values()))


class Rates:
    """Bounds of a curve's derivatives and of the gaps between its exported samples."""

    def __init__(self, curve: Curve, samples: Float[np.ndarray, "M"] | None) -> None:
        """Prepare.

        Raises:
            VerifyError: when a knot is not among the samples.
        """
        if samples is not None and not np.all(np.isin(curve.knots, samples)):
            raise VerifyError("samples must contain every knot of the curve")
        self._knots, self._coefficients = curve.knots, curve.coefficients()
        self._samples = np.zeros(0) if samples is None else samples
        # No gap begins at the last sample.
        self._gaps = np.append(np.diff(self._samples), 0.0)
        lengths = np.diff(curve.knots)
        self._whole_speed, self._whole_bend = _derivative_bounds(self._coefficients, np.zeros(len(lengths)), lengths)

    def over(self, first: Float[np.ndarray, "I"], last: Float[np.ndarray, "I"]) -> RateBounds:
        """Return derivative bounds over ``[first, last]``; no interval may cross a knot.

        Raises:
            VerifyError: when an interval has no length or crosses a knot.
        """
        knots = self._knots
        piece = np.searchsorted(knots[1:-1], 0.5 * (first + last), side="right")
        if np.any((first < knots[piece]) | (last > knots[piece + 1]) | (last <= first)):
            raise VerifyError("every interval of the curve must have a length and lie between two neighbouring knots")
        speed, bend = _derivative_bounds(self._coefficients[:, piece], first - knots[piece], last - knots[piece])
        step = np.zeros(len(first))
        if len(self._samples):
            low = np.searchsorted(self._samples, first, side="right") - 1
            high = np.searchsorted(self._samples, last, side="left")
            step = np.maximum.reduceat(self._gaps, np.stack([low, high], axis=1).ravel())[::2]
        return RateBounds(first, last, speed, bend, step, self._whole_speed[piece], self._whole_bend[piece])


def _derivative_bounds(
    coefficients: Float[np.ndarray, "4 I n"], low: Float[np.ndarray, "I"], high: Float[np.ndarray, "I"]
) -> tuple[Float[np.ndarray, "I n"], Float[np.ndarray, "I n"]]:
    """Bound ``|q'|`` (ends and vertex of a parabola) and ``|q''|`` (ends of a line) for local parameters.

    Polynomials of higher degree are bounded by the coefficients of their Bernstein form.
    """
    if len(coefficients) > 4:
        inside = restrict(coefficients, low, high)
        return bound_size(differentiate(inside), high - low), bound_size(differentiate(inside, 2), high - low)
    _, c1, c2, c3 = coefficients
    u0, u1 = low[:, None], high[:, None]

    def slope(u: Float[np.ndarray, "I n"]) -> Float[np.ndarray, "I n"]:
        return np.asarray(np.abs(c1 + u * (2.0 * c2 + u * 3.0 * c3)))

    vertex = np.divide(-c2, 3.0 * c3, out=np.zeros_like(c2), where=np.abs(c3) > 1e-300)
    vertex = np.minimum(np.maximum(vertex, u0), u1)
    speed = np.maximum(np.maximum(slope(u0), slope(u1)), slope(vertex))
    bend = np.maximum(np.abs(2.0 * c2 + 6.0 * c3 * u0), np.abs(2.0 * c2 + 6.0 * c3 * u1))
    return speed, bend


def _inside(
    numerator: np.ndarray, denominator: np.ndarray, low: Float[np.ndarray, "I 1"], high: Float[np.ndarray, "I 1"]
) -> np.ndarray:
    """Return ``numerator / denominator`` where it lies in ``[low, high]``, else ``low``."""
    usable: Bool[np.ndarray, "I n"] = np.abs(denominator) > 1e-300
    ratio = np.divide(numerator, denominator, out=np.zeros_like(numerator), where=usable)
    return np.where(usable & (ratio > low) & (ratio < high), ratio, np.broadcast_to(low, ratio.shape))


def position_range(curve: Curve) -> tuple[Float[np.ndarray, "K-1 n"], Float[np.ndarray, "K-1 n"]]:
    """Return the smallest and largest value of every coordinate on every knot interval.

    They are exact for cubics, and outer bounds within a relative 1e-10 for polynomials of higher degree.
    """
    if len(curve.coefficients()) > 4:
        return bound_range(curve.coefficients(), np.diff(curve.knots))
    c0, c1, c2, c3 = curve.coefficients()
    h = np.diff(curve.knots)[:, None]
    zero = np.zeros_like(h)
    # Roots of c1 + 2 c2 u + 3 c3 u^2, in the form that stays right when c3 vanishes.
    root = np.sqrt(np.maximum(c2**2 - 3.0 * c1 * c3, 0.0))
    lean = -(c2 + np.where(c2 >= 0.0, root, -root))
    candidates = [np.broadcast_to(zero, c0.shape), np.broadcast_to(h, c0.shape)]
    candidates += [_inside(lean, 3.0 * c3, zero, h), _inside(c1, lean, zero, h)]
    values = np.stack([c0 + u * (c1 + u * (c2 + u * c3)) for u in candidates])
    return np.asarray(values.min(axis=0)), np.asarray(values.max(axis=0))
