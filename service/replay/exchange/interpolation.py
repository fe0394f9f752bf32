"""Curves through the points of a trajectory: lines, cubics, quintics, or a spline."""

from __future__ import annotations

from typing import Literal

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from costs.curve import Curve, PolynomialCurve, TimeLaw
from service.errors import RequestError, shown
from service.replay.exchange.joint_trajectory import JointTrajectory

Interpolation = Literal["auto", "linear", "cubic", "quintic", "spline"]
INTERPOLATIONS: tuple[Interpolation, ...] = ("auto", "linear", "cubic", "quintic", "spline")
SENTENCES = {
    "linear": "between its points every joint moves on a straight line (positions alone)",
    "cubic": "between its points every joint moves on the cubic of their positions and velocities",
    "quintic": "between its points every joint moves on the quintic of their positions, velocities and accelerations",
    "spline": "every joint moves on the cubic spline through its points that rests at both ends (positions alone)",
}
READ_AS = {"linear": "straight lines", "cubic": "cubics", "quintic": "quintics", "spline": "a cubic spline"}
NEEDS = {"cubic": ("velocities",), "quintic": ("velocities", "accelerations")}


def choose_interpolation(trajectory: JointTrajectory, wanted: Interpolation) -> str:
    """Return how a trajectory is read; ``auto`` is what ros2_control's joint_trajectory_controller does by default.

    Raises:
        RequestError: the trajectory lacks what the wanted interpolation needs.
    """
    if wanted not in INTERPOLATIONS:
        raise RequestError(f"interpolation: {shown(wanted)} is unknown; expected {', '.join(INTERPOLATIONS)}")
    if wanted != "auto":
        missing = [kind for kind in NEEDS.get(wanted, ()) if getattr(trajectory, kind) is None]
        if missing:
            raise RequestError(f"{trajectory.source}: {wanted} needs {missing[0]}, and the trajectory has none")
        return wanted
    if trajectory.times is None:
        return "linear"
    if trajectory.accelerations is not None:
        return "quintic"
    return "linear" if trajectory.velocities is None else "cubic"


def make_curve(
    s: Float[np.ndarray, "K"],
    positions: Float[np.ndarray, "K n"],
    velocities: Float[np.ndarray, "K n"] | None,
    accelerations: Float[np.ndarray, "K n"] | None,
    kind: str,
) -> Curve:
    """Return the curve through points by path parameter ``s`` (times, or numbers of the points).

    The quintic is that of two points with two derivatives each (the Hermite form, as in joint_trajectory_controller).
    """
    h = np.diff(s)[:, None]
    if kind == "linear":
        slopes = np.diff(positions, axis=0) / h
        zero = np.zeros_like(slopes)
        pieces = np.stack([positions[:-1], slopes, zero, zero])
        return PolynomialCurve(s, positions, np.vstack([slopes, slopes[-1:]]), pieces)
    if kind == "spline":
        velocities = np.asarray(CubicSpline(s, positions, bc_type="clamped")(s, 1))
    if velocities is None:
        raise ValueError(f"{kind} needs velocities")
    if kind != "quintic":
        cubic = Curve(s, positions, velocities).coefficients()
        return PolynomialCurve(s, positions, velocities, np.asarray(cubic))
    if accelerations is None:
        raise ValueError("quintic needs accelerations")
    q0, v0, a0 = positions[:-1], velocities[:-1], accelerations[:-1]
    v1, a1 = velocities[1:], accelerations[1:]
    rest = positions[1:] - q0 - h * (v0 + 0.5 * h * a0)  # what the three highest powers have to cover
    turn, bend = h * (v1 - v0 - h * a0), h**2 * (a1 - a0)
    pieces = np.stack(
        [
            q0,
            v0,
            0.5 * a0,
            (10.0 * rest - 4.0 * turn + 0.5 * bend) / h**3,
            (-15.0 * rest + 7.0 * turn - bend) / h**4,
            (6.0 * rest - 3.0 * turn + 0.5 * bend) / h**5,
        ]
    )
    return PolynomialCurve(s, positions, velocities, pieces)


def make_even_law(s: Float[np.ndarray, "K"]) -> TimeLaw:
    """Return the time law whose path parameter is the time [s]."""
    ends = np.array([s[0], s[-1]], dtype=float)
    return TimeLaw(ends, ends.copy(), np.ones(2))
