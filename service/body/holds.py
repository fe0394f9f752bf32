"""What stays put along a motion, and how configurations and velocities are brought to keep it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float, Int

from costs.collision import Contacts
from costs.kinematics import KinematicsEngine
from costs.state import MotionState
from costs.stopping import poll
from scopt import Residual

Hold = Callable[[Int[np.ndarray, "S"]], Residual[MotionState]]
"""Makes the residual that a hold keeps at zero at the given waypoints."""

DRIFT = 5e-4  # between waypoints, of what is held [m, rad]
PROJECTION_STEPS = 8
PROJECTION_TOLERANCE = 1e-9  # [m, rad]


def linearized(
    engine: KinematicsEngine, q: Float[np.ndarray, "S n"], holds: Sequence[Hold]
) -> tuple[Float[np.ndarray, "S k"], Float[np.ndarray, "S k n"]]:
    """Residuals and Jacobians of all holds at separate configurations."""
    poll()
    state = MotionState(engine(q), Contacts.none())
    everywhere = np.arange(len(q))
    n = q.shape[1]
    values, jacobians = [], []
    for hold in holds:
        rows = hold(everywhere).linearize(state)
        k = len(rows.value) // len(q)
        values.append(rows.value.reshape(len(q), k))
        # A row touches the columns of its own configuration only.
        entries, own = rows.jacobian.tocoo(), np.zeros((len(rows.value), n))
        entries.sum_duplicates()
        own[entries.row, entries.col % n] = entries.data
        jacobians.append(own.reshape(len(q), k, n))
    return np.concatenate(values, axis=1), np.concatenate(jacobians, axis=1)


def projected(engine: KinematicsEngine, q: Float[np.ndarray, "S n"], holds: Sequence[Hold]) -> Float[np.ndarray, "S n"]:
    """The nearest configurations that keep the holds (Gauss-Newton with least-norm steps)."""
    poll()
    if not holds or not len(q):
        return q
    for _ in range(PROJECTION_STEPS):
        value, jacobian = linearized(engine, q, holds)
        if np.abs(value).max() < PROJECTION_TOLERANCE:
            break
        q = q - least_norm(jacobian, value)
    return q


def least_norm(jacobian: Float[np.ndarray, "S k n"], value: Float[np.ndarray, "S k"]) -> Float[np.ndarray, "S n"]:
    """The shortest step that changes the value by as much."""
    return np.asarray(np.einsum("snk,sk->sn", np.linalg.pinv(jacobian, rcond=1e-6), value))


def largest(engine: KinematicsEngine, q: Float[np.ndarray, "S n"], holds: Sequence[Hold]) -> Float[np.ndarray, "S"]:
    """Largest residual of any hold at each configuration."""
    if not holds:
        return np.zeros(len(q))
    state = MotionState(engine(q), Contacts.none())
    everywhere = np.arange(len(q))
    parts = [np.abs(hold(everywhere).value(state)).reshape(len(q), -1) for hold in holds]
    return np.asarray(np.concatenate(parts, axis=1).max(axis=1))
