"""Commands that lead plain position servos to the planned pose: their sag under the plan's load is taken off beforehand."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def lead_servos(
    q: Float[np.ndarray, "T k"],
    qd: Float[np.ndarray, "T k"],
    tau: Float[np.ndarray, "T k"],
    stiffness: Float[np.ndarray, "k"],
    step_s: float,
    feed_forward: float = 0.0,
) -> tuple[Float[np.ndarray, "T k"], Float[np.ndarray, "T k"]]:
    """Return positions and speeds that servos at rest turn into the planned ones, ``q + (1 - Kf) tau / Kp``.

    A servo makes ``Kp (q_d - q) + Kf tau``; with eq. 8 of Liu et al., Humanoids 2015, solved for the desired position, that
    is the plan's torque ``tau = rnea - J^T f`` at the plan's position ``q``.

    Args:
        q, qd, tau: of the plan at even times.
        stiffness: ``Kp`` of the servos [N m/rad, N/m].
        step_s: between two times [s].
        feed_forward: share ``Kf`` of the torques that the servos add.
    """
    sag = (1.0 - feed_forward) * tau / stiffness
    return q + sag, qd + np.gradient(sag, step_s, axis=0)
