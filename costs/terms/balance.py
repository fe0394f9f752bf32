"""Balance terms: the centre of mass, or the cart-table ZMP, inside a support polygon."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from costs.state import MotionState
from costs.support import SupportPolygon
from costs.terms.pose import make_waypoint_rows
from scopt import AffineRows, Residual

GRAVITY = 9.81


class CentreOfMassInPolygon(Residual[MotionState]):
    """Distance of the COM's ground projection outside a support polygon, one row per waypoint and edge [m].

    Row ``(t, e)`` is ``normal_e . com_t - offset_e + margin``, positive outside the polygon shrunk by ``margin``.  The
    ZMP of a motion slow enough to be static.
    """

    is_smooth = True

    def __init__(
        self, polygon: SupportPolygon, waypoints: Int[np.ndarray, "S"] | Sequence[int], margin: float = 0.0
    ) -> None:
        self._polygon = polygon
        self._waypoints = np.asarray(waypoints)
        self._margin = margin

    def value(self, state: MotionState) -> Float[np.ndarray, "m"]:
        com = state.kinematics.com[self._waypoints, :2]
        return np.asarray((com @ self._polygon.normals.T - self._polygon.offsets + self._margin).ravel())

    def linearize(self, state: MotionState) -> AffineRows:
        kinematics = state.kinematics
        rows = np.einsum("ek,skn->sen", self._polygon.normals, kinematics.com_jacobian[self._waypoints, :2])
        return make_waypoint_rows(self.value(state), rows, self._waypoints, kinematics)


class CentreOfMassAt(Residual[MotionState]):
    """Offset of the COM's ground projection from a point, or one per waypoint: two rows (x, y) per waypoint [m]."""

    def __init__(
        self, point: Float[np.ndarray, "2"] | Float[np.ndarray, "S 2"], waypoints: Int[np.ndarray, "S"] | Sequence[int]
    ) -> None:
        self._point = np.asarray(point, dtype=float)
        self._waypoints = np.asarray(waypoints)

    def value(self, state: MotionState) -> Float[np.ndarray, "m"]:
        return np.asarray((state.kinematics.com[self._waypoints, :2] - self._point).ravel())

    def linearize(self, state: MotionState) -> AffineRows:
        kinematics = state.kinematics
        rows = kinematics.com_jacobian[self._waypoints, :2]
        return make_waypoint_rows(self.value(state), rows, self._waypoints, kinematics)


class CartTableZmpInPolygon(Residual[MotionState]):
    """Distance of the cart-table ZMP outside a support polygon, one row per inner waypoint and edge [m].

    ``zmp = c - (c_z - ground) / g * c''`` with ``c''`` the second difference of the COM over ``dt``
    (Kajita et al., ICRA 2003, eq. 3).
    """

    def __init__(
        self,
        polygon: SupportPolygon,
        waypoints: Int[np.ndarray, "S"] | Sequence[int],
        dt: float,
        margin: float = 0.0,
        ground: float = 0.0,
    ) -> None:
        """
        Args:
            waypoints: (S,) inner waypoints (neither first nor last of the trajectory).
            dt: time between waypoints [s].
            margin: how far inside the ZMP shall be [m].
            ground: height of the contact plane [m].
        """
        if not dt > 0.0:
            raise ValueError(f"dt must be positive, got {dt}")
        self._polygon = polygon
        self._waypoints = np.asarray(waypoints)
        self._dt, self._margin, self._ground = dt, margin, ground

    def value(self, state: MotionState) -> Float[np.ndarray, "m"]:
        com, here = state.kinematics.com, self._waypoints
        acceleration = (com[here + 1, :2] - 2.0 * com[here, :2] + com[here - 1, :2]) / self._dt**2
        zmp = com[here, :2] - (com[here, 2:] - self._ground) / GRAVITY * acceleration
        return np.asarray((zmp @ self._polygon.normals.T - self._polygon.offsets + self._margin).ravel())

    def linearize(self, state: MotionState) -> AffineRows:
        kinematics, here = state.kinematics, self._waypoints
        com, jacobian = kinematics.com, kinematics.com_jacobian
        acceleration = (com[here + 1, :2] - 2.0 * com[here, :2] + com[here - 1, :2]) / self._dt**2
        gain = ((com[here, 2] - self._ground) / (GRAVITY * self._dt**2))[:, None, None]
        before = -gain * jacobian[here - 1, :2]
        after = -gain * jacobian[here + 1, :2]
        middle = (1.0 + 2.0 * gain) * jacobian[here, :2]
        middle = middle - acceleration[:, :, None] / GRAVITY * jacobian[here, 2][:, None, :]
        blocks = np.stack([before, middle, after], axis=2)  # (S, 2, 3, n)
        rows = np.einsum("ek,sktn->setn", self._polygon.normals, blocks)
        n_edges = len(self._polygon.offsets)
        return AffineRows.from_blocks(
            self.value(state),
            np.repeat(here - 1, n_edges),
            rows.reshape(-1, 3, rows.shape[3]),
            kinematics.n_waypoints,
        )
