"""The executed curve, a C1 cubic Hermite spline through the waypoints, its time law, and curves of other planners."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

SAME_KNOT = 1e-9  # difference of path parameters that is rounding


@dataclass(frozen=True)
class Curve:
    """Cubic Hermite spline ``q(s)`` through waypoints.

    Attributes:
        knots: (K,) strictly increasing path parameter [-].
        positions: (K, n) configurations at the knots.
        tangents: (K, n) dq/ds at the knots.
    """

    knots: Float[np.ndarray, "K"]
    positions: Float[np.ndarray, "K n"]
    tangents: Float[np.ndarray, "K n"]

    def __post_init__(self) -> None:
        if len(self.knots) < 2 or np.any(np.diff(self.knots) <= 0.0):
            raise ValueError("a curve needs at least two knots, strictly increasing")
        if not (len(self.knots) == len(self.positions) == len(self.tangents)):
            raise ValueError("knots, positions and tangents must have the same length")

    def coefficients(self) -> Float[np.ndarray, "4 K-1 n"]:
        """Return per interval the coefficients of ``q(s) = sum_k c_k u^k`` with ``u = s - knots[i]``; read-only."""
        return self._coefficients

    @cached_property
    def _coefficients(self) -> Float[np.ndarray, "4 K-1 n"]:
        h = np.diff(self.knots)[:, None]
        q0, q1 = self.positions[:-1], self.positions[1:]
        v0, v1 = self.tangents[:-1], self.tangents[1:]
        chord = (q1 - q0) / h
        return np.stack([q0, v0, (3.0 * chord - 2.0 * v0 - v1) / h, (v0 + v1 - 2.0 * chord) / h**2])

    def __call__(self, s: Float[np.ndarray, "S"], order: int = 0) -> Float[np.ndarray, "S n"]:
        """Return the configuration (order 0), dq/ds (1) or d2q/ds2 (2, right-sided at knots) at ``s``."""
        s = np.minimum(np.maximum(np.atleast_1d(np.asarray(s, dtype=float)), self.knots[0]), self.knots[-1])
        i = np.searchsorted(self.knots[1:-1], s, side="right")
        u = (s - self.knots[i])[:, None]
        if order not in (0, 1, 2):
            raise ValueError(f"order must be 0, 1 or 2, got {order}")
        return evaluate_polynomials(differentiate(self.coefficients()[:, i], order), u)

    def find_knots(self, first: float, last: float) -> slice:
        """Return which knots lie from ``first`` to ``last``, both included, up to rounding."""
        begin, end = np.searchsorted(self.knots, (first - SAME_KNOT, last + SAME_KNOT)).tolist()
        return slice(begin, end)

    def cut(self, knots: slice) -> Curve:
        """Return the part of a spline through some of its knots."""
        return Curve(self.knots[knots], self.positions[knots], self.tangents[knots])


@dataclass(frozen=True)
class PolynomialCurve(Curve):
    """Curve of a given polynomial per interval, such as lines or quintics; continuous, but its slope may jump at knots.

    Attributes:
        pieces: (k, K-1, n) coefficients of ``q(s) = sum_k c_k u^k`` with ``u = s - knots[i]``, at least four rows.
    """

    pieces: Float[np.ndarray, "k K-1 n"]

    def __post_init__(self) -> None:
        super().__post_init__()
        rows, count, width = self.pieces.shape
        if rows < 4 or (count, width) != (len(self.knots) - 1, self.positions.shape[1]):
            raise ValueError(f"pieces must have at least 4 rows and one column per interval, got {self.pieces.shape}")

    def coefficients(self) -> Float[np.ndarray, "k K-1 n"]:
        """Return the coefficients of the polynomials."""
        return self.pieces

    def measure_position_error(self) -> float:
        """Return the largest distance of an interval's ends from ``positions`` (nan where one is not finite)."""
        h = np.diff(self.knots)[:, None]
        ends = evaluate_polynomials(self.pieces, h) - self.positions[1:]
        return float(max(np.abs(self.pieces[0] - self.positions[:-1]).max(), np.abs(ends).max()))

    def measure_slope_jumps(self) -> Float[np.ndarray, "K-2 n"]:
        """Return by how much dq/ds changes at each inner knot."""
        slopes = differentiate(self.pieces)
        return np.asarray(slopes[0, 1:] - evaluate_polynomials(slopes, np.diff(self.knots)[:, None])[:-1])


def differentiate(coefficients: Float[np.ndarray, "k ..."], order: int = 1) -> Float[np.ndarray, "l ..."]:
    """Return the coefficients of a derivative; the constant stands first."""
    for _ in range(order):
        powers = np.arange(1.0, len(coefficients)).reshape(-1, *(1,) * (coefficients.ndim - 1))
        coefficients = coefficients[1:] * powers
    return coefficients


def evaluate_polynomials(coefficients: Float[np.ndarray, "k ..."], u: Float[np.ndarray, "..."]) -> np.ndarray:
    """Return the values of polynomials, whose constants stand first, at ``u``."""
    value = np.asarray(coefficients[-1])
    for row in coefficients[-2::-1]:
        value = row + u * value
    return value


@dataclass(frozen=True)
class TimeLaw:
    """Path parameter over time: ``s(t)`` with constant ``d2s/dt2`` between grid points.

    Times and path are executed.  Where the speeds do not lead from one point of the path to the next, they are scaled
    step by step so that they do (:attr:`shares`); the verifier refuses a law with shares that differ from 1.

    Attributes:
        times: (M,) strictly increasing [s].
        path: (M,) non-decreasing path parameter at those times.
        speed: (M,) ds/dt there [1/s], >= 0.
    """

    times: Float[np.ndarray, "M"]
    path: Float[np.ndarray, "M"]
    speed: Float[np.ndarray, "M"]

    @staticmethod
    def accelerated(path: Float[np.ndarray, "M"], speed: Float[np.ndarray, "M"]) -> TimeLaw:
        """Return the law from time 0 on that passes increasing path parameters at the given speeds."""
        durations = 2.0 * np.diff(path) / (speed[:-1] + speed[1:])
        return TimeLaw(np.concatenate([[0.0], np.cumsum(durations)]), path, speed)

    def cut(self, first: float, last: float) -> TimeLaw | None:
        """Return the part between two of its path parameters, from time 0 on; None unless it rests at both."""
        begin, end = np.searchsorted(self.path, (first, last)).tolist()
        if end >= len(self.path) or (self.path[begin], self.path[end]) != (first, last):
            return None
        if self.speed[begin] > 0.0 or self.speed[end] > 0.0:
            return None
        part = slice(begin, end + 1)
        return TimeLaw(self.times[part] - self.times[begin], self.path[part], self.speed[part])

    @cached_property
    def shares(self) -> Float[np.ndarray, "M-1"]:
        """Length of each step over the integral of its speeds; 1 where both are 0, huge where only the latter is."""
        length, travelled = np.diff(self.path), 0.5 * (self.speed[:-1] + self.speed[1:]) * np.diff(self.times)
        shares = np.where(length == 0.0, 1.0, np.finfo(float).max)
        np.divide(length, travelled, out=shares, where=travelled > np.finfo(float).tiny * 1e16)
        return np.asarray(shares)

    def at(self, t: Float[np.ndarray, "S"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the path parameter, its speed and its acceleration (right-sided) at times ``t`` [s]."""
        t = np.clip(np.atleast_1d(np.asarray(t, dtype=float)), self.times[0], self.times[-1])
        i = np.clip(np.searchsorted(self.times, t, side="right") - 1, 0, len(self.times) - 2)
        share = self.shares[i]
        acceleration = share * np.diff(self.speed)[i] / np.diff(self.times)[i]
        dt, speed = t - self.times[i], share * self.speed[i]
        path = self.path[i] + dt * (speed + 0.5 * acceleration * dt)
        return path, speed + acceleration * dt, acceleration
