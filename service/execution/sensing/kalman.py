"""Steady-state Kalman filters: the gain to which the filter of a constant linear system converges."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from service.errors import ExecutionError

MAX_DOUBLINGS, TOLERANCE = 60, 1e-13


@dataclass(frozen=True)
class SteadyKalmanFilter:
    """Filter of ``x_k = A x_(k-1) + B u_k + w``, ``z_k = C x_k + v`` with a constant gain.

    Attributes:
        A: (n, n) transition.
        B: (n, k) effect of the input.
        C: (m, n) measurement.
        gain: (n, m) correction of the state per difference between measurement and prediction.
    """

    A: Float[np.ndarray, "n n"]
    B: Float[np.ndarray, "n k"]
    C: Float[np.ndarray, "m n"]
    gain: Float[np.ndarray, "n m"]

    def step(self, x: np.ndarray, u: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Return the state after one input and one measurement.

        Args:
            x: (n,) state, or (n, a) of independent axes.
            u: (k,) or (k, a) input.
            z: (m,) or (m, a) measurement.
        """
        predicted = self.A @ x + self.B @ u
        return np.asarray(predicted + self.gain @ (z - self.C @ predicted))


def make_steady_filter(
    A: Float[np.ndarray, "n n"],
    B: Float[np.ndarray, "n k"],
    C: Float[np.ndarray, "m n"],
    process_noise: Float[np.ndarray, "n n"],
    sensor_noise: Float[np.ndarray, "m m"],
) -> SteadyKalmanFilter:
    """Return the filter with the gain ``P C' (C P C' + R)^-1`` of the covariance P of the prediction.

    Args:
        A, B, C: the system.
        process_noise, sensor_noise: covariances of w and v; the latter is positive definite.

    Raises:
        ExecutionError: the covariance does not converge (a state that the measurement does not show).
    """
    P = solve_riccati(A, C, process_noise, sensor_noise)
    innovation = C @ P @ C.T + sensor_noise
    return SteadyKalmanFilter(A, B, C, np.linalg.solve(innovation, C @ P).T)


def solve_riccati(
    A: Float[np.ndarray, "n n"],
    C: Float[np.ndarray, "m n"],
    process_noise: Float[np.ndarray, "n n"],
    sensor_noise: Float[np.ndarray, "m m"],
) -> Float[np.ndarray, "n n"]:
    """Return the covariance of the prediction that one step of the filter leaves unchanged.

    Each doubling takes twice as many steps of the filter at once (Chu, Fan, Lin and Wang, Int. J. Control 2004).

    Raises:
        ExecutionError: it does not converge.
    """
    F, G, H = A.T, C.T @ np.linalg.solve(sensor_noise, C), np.asarray(process_noise, dtype=float)
    for _ in range(MAX_DOUBLINGS):
        with np.errstate(over="ignore", invalid="ignore"):  # of a state that grows unseen
            W = np.linalg.inv(np.eye(len(A)) + G @ H)
            step = F.T @ H @ W @ F
            F, G, H = F @ W @ F, G + F @ W @ G @ F.T, H + step
        if not np.all(np.isfinite(H)):
            break
        if np.abs(step).max() <= TOLERANCE * np.abs(H).max():
            return np.asarray(0.5 * (H + H.T))
    raise ExecutionError("the Kalman gain does not converge; does the measurement show every state?")
