"""Inverse kinematics of many guesses at once: damped least squares within the joint limits.

Damping after Nakamura and Hanafusa, JDSMC 1986; a coordinate at its limit that would leave it is held there in the
next step.  Obstacles are left to the optimiser, which such configurations are guesses for.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from costs.robot import BASE_NAMES
from service.body.holds import Hold, linearize_residuals, make_residuals
from service.body.whole_body import WholeBody

STEPS = 40
DAMPING = 0.03  # beside singular values of the Jacobian [m/rad, -]
LARGEST_STEP = 0.5  # of a coordinate in one step [rad, m]
REACHED = 1e-4  # largest residual of a configuration at its goal [m, rad]
SPREAD_M, SPREAD_RAD = 0.15, 0.25  # of random places of a floating base about the nominal one
UNLIMITED_RAD = np.pi  # range of random values of a coordinate without limits


def draw_configurations(body: WholeBody, count: int, rng: np.random.Generator) -> Float[np.ndarray, "B n"]:
    """Return random configurations: joints evenly within their limits, a floating base near the nominal one."""
    robot, nominal = body.robot, body.nominal
    low = np.where(np.isfinite(robot.lower), robot.lower, nominal - UNLIMITED_RAD)
    high = np.where(np.isfinite(robot.upper), robot.upper, nominal + UNLIMITED_RAD)
    if robot.is_floating:
        spread = np.repeat([SPREAD_M, SPREAD_RAD], 3)
        low[: len(BASE_NAMES)], high[: len(BASE_NAMES)] = nominal[:6] - spread, nominal[:6] + spread
    return rng.uniform(low, high, size=(count, robot.n))


def solve_holds(
    body: WholeBody,
    guesses: Float[np.ndarray, "B n"],
    holds: Sequence[Hold],
    fixed: Bool[np.ndarray, "n"],
    steps: int = STEPS,
) -> tuple[Float[np.ndarray, "B n"], Float[np.ndarray, "B"]]:
    """Return configurations nearer to the holds than the guesses, and the largest residual of each [m, rad].

    Args:
        body: whose joint limits count.
        guesses: one per row.
        holds: residuals to make zero; planted links among them.
        fixed: coordinates that keep their values.
        steps: of the descent.
    """
    lower, upper = (bound[0] for bound in body.bounds(1, {}))
    lower, upper = np.where(fixed, -np.inf, lower), np.where(fixed, np.inf, upper)
    q = np.clip(guesses, lower, upper)
    error = np.full(len(q), np.inf)
    is_held = np.zeros(q.shape, dtype=bool)
    active = np.arange(len(q))
    residuals = make_residuals(holds, len(active))
    for _ in range(steps + 1):
        value, jacobian = linearize_residuals(body.engine, q[active], residuals)
        error[active] = np.abs(value).max(axis=1)
        is_open = error[active] > 0.1 * REACHED
        active, value, jacobian = active[is_open], value[is_open], jacobian[is_open]
        if not len(active):
            break
        if not is_open.all():
            residuals = make_residuals(holds, len(active))
        moving = np.where((fixed | is_held[active])[:, None, :], 0.0, jacobian)
        squared = moving @ np.swapaxes(moving, 1, 2)
        # Less damping where little is left, so that the last steps are Newton's.
        damping = DAMPING * np.minimum(1.0, error[active])
        squared += (damping**2)[:, None, None] * np.eye(value.shape[1])
        step = -np.einsum("bkn,bk->bn", moving, np.linalg.solve(squared, value[..., None])[..., 0])
        longest = np.abs(step).max(axis=1, keepdims=True)
        step *= np.minimum(1.0, LARGEST_STEP / np.maximum(longest, 1e-12))
        moved = np.clip(q[active] + step, lower, upper)
        is_held[active] = (moved <= lower) & (step < 0.0) | (moved >= upper) & (step > 0.0)
        q[active] = moved
    return q, error
