"""Regions of a frame's pose: how far rows leave a box or a ball, and an axis that points to a place."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int
from scipy import sparse

from costs.kinematics import Kinematics
from costs.robot.model import RobotModel
from costs.rotation import make_tangent_basis, skew
from costs.state import MotionState
from costs.terms.pose import FramePlace, make_deviation_rows, measure_deviation, relative_axes
from scopt import AffineRows, Residual
from scopt.residual import StateT

NEAREST_M = 1e-3  # of the place to the frame's origin, below which an axis has no direction to it


class BeyondBox(Residual[StateT]):
    """``r`` less the nearest value within ``lower <= r <= upper``, for each row; (k,) bounds repeat over the rows.

    Zero inside, where it has no derivatives; with one more row beyond a bound its derivative is that of ``r``.
    """

    def __init__(
        self, residual: Residual[StateT], lower: Float[np.ndarray, "k"], upper: Float[np.ndarray, "k"]
    ) -> None:
        self.is_smooth = residual.is_smooth
        self._residual = residual
        self._lower, self._upper = np.atleast_1d(lower), np.atleast_1d(upper)

    def value(self, state: StateT) -> Float[np.ndarray, "m"]:
        return self._split(self._residual.value(state))[0]

    def linearize(self, state: StateT) -> AffineRows:
        rows = self._residual.linearize(state)
        beyond, is_beyond = self._split(rows.value)
        return AffineRows(beyond, rows.scale_rows(is_beyond).jacobian)

    def _split(self, value: Float[np.ndarray, "m"]) -> tuple[Float[np.ndarray, "m"], Float[np.ndarray, "m"]]:
        """Return the excess of each row, and 1.0 where there is one."""
        rows = value.reshape(-1, len(self._lower))
        beyond = (rows - np.clip(rows, self._lower, self._upper)).ravel()
        return beyond, (beyond != 0.0).astype(float)


class BeyondBall(Residual[StateT]):
    """``r`` less the nearest vector of a ball, for the ``k`` rows of each waypoint; zero inside the ball."""

    def __init__(self, residual: Residual[StateT], k: int, limit: float) -> None:
        self.is_smooth = residual.is_smooth
        self._residual, self._k, self._limit = residual, k, limit

    def value(self, state: StateT) -> Float[np.ndarray, "m"]:
        vectors, _, share = self._split(self._residual.value(state))
        return np.asarray((share[:, None] * vectors).ravel())

    def linearize(self, state: StateT) -> AffineRows:
        rows = self._residual.linearize(state)
        vectors, norms, share = self._split(rows.value)
        unit = vectors / np.maximum(norms, 1e-12)[:, None]
        along = np.where(share > 0.0, 1.0 - share, 0.0)  # limit / norm outside
        blocks = share[:, None, None] * np.eye(self._k) + along[:, None, None] * unit[:, :, None] * unit[:, None, :]
        turned = sparse.block_diag(list(blocks), format="csr")
        return AffineRows((share[:, None] * vectors).ravel(), sparse.csr_array(turned @ rows.jacobian))

    def _split(
        self, value: Float[np.ndarray, "m"]
    ) -> tuple[Float[np.ndarray, "S k"], Float[np.ndarray, "S"], Float[np.ndarray, "S"]]:
        """Return the vectors, their lengths, and the share of each that is beyond the ball."""
        vectors = value.reshape(-1, self._k)
        norms = np.linalg.norm(vectors, axis=1)
        return vectors, norms, np.maximum(1.0 - self._limit / np.maximum(norms, 1e-12), 0.0)


class LookAt(Residual[MotionState]):
    """An axis of a frame that points to a place, two rows per waypoint [rad].

    The rows are the tangent components of the rotation that carries the axis onto the direction of the place, in a
    basis across that direction; their norm is the angle between them.
    """

    is_smooth = True

    def __init__(
        self,
        robot: RobotModel,
        frame: str,
        waypoints: Int[np.ndarray, "S"] | Sequence[int],
        axis: Float[np.ndarray, "3"],
        place: Float[np.ndarray, "3"],
        reference: str | None = None,
    ) -> None:
        """
        Args:
            frame: link or frame name.
            waypoints: (S,) waypoints of the rows.
            axis: (3,) unit, in the frame.
            place: (3,) in the reference [m].
            reference: frame the place is given in; the world if None.
        """
        self._waypoints = np.asarray(waypoints)
        self._frame = FramePlace(robot, frame)
        self._reference = FramePlace(robot, reference)
        self._axis = np.asarray(axis, dtype=float)
        self._place = np.asarray(place, dtype=float)
        self._tangents = make_tangent_basis(self._axis)

    def value(self, state: MotionState) -> Float[np.ndarray, "m"]:
        local, _, _, _ = self._direct(state.kinematics)
        angle, unit, _ = measure_deviation(local @ self._axis, local @ self._tangents.T)
        return np.asarray((angle[:, None] * unit).ravel())

    def linearize(self, state: MotionState) -> AffineRows:
        kinematics, here = state.kinematics, self._waypoints
        local, distance, rotation, sight = self._direct(kinematics)
        position = self._frame.pose(kinematics, here)[1]
        # A twist (v, w) of the frame about the world's origin moves its origin by v + w x p, and turns its axes by w.
        moves = np.zeros((len(here), 3, 6))
        moves[:, :, :3] = np.eye(3)
        moves[:, :, 3:] = -skew(position)
        unit_sight = sight / distance[:, None]
        across = np.eye(3) - unit_sight[:, :, None] * unit_sight[:, None, :]
        d_direction = -across / distance[:, None, None] @ moves
        d_direction[:, :, 3:] += skew(unit_sight)  # as seen from the frame, which turns
        d_local = rotation.transpose(0, 2, 1) @ d_direction
        basis = np.concatenate([self._axis[None], self._tangents])
        moved = basis @ d_local @ kinematics.jacobian[here]
        moved *= relative_axes(kinematics, self._frame, self._reference)
        moved = kinematics.topology.add_followers(moved)
        return make_deviation_rows(local @ self._axis, local @ self._tangents.T, moved, here, kinematics)

    def _direct(
        self, kinematics: Kinematics
    ) -> tuple[Float[np.ndarray, "S 3"], Float[np.ndarray, "S"], Float[np.ndarray, "S 3 3"], Float[np.ndarray, "S 3"]]:
        """Return the direction of the place in the frame, its distance, the frame's axes, and the line of sight."""
        rotation, position = self._frame.pose(kinematics, self._waypoints)
        reference, origin = self._reference.pose(kinematics, self._waypoints)
        sight = reference @ self._place + origin - position
        distance = np.maximum(np.linalg.norm(sight, axis=1), NEAREST_M)
        local = (rotation.transpose(0, 2, 1) @ (sight / distance[:, None])[:, :, None])[:, :, 0]
        return local, distance, rotation, sight
