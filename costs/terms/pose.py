"""Pose terms: a frame at a target, an axis along a direction, a point on one side of a plane."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from costs.kinematics import Kinematics, locate_frame
from costs.robot.model import RobotModel
from costs.rotation import log_derivative, log_rotation, make_tangent_basis, skew
from costs.state import MotionState
from scopt import AffineRows, Residual

ALL_AXES = (True,) * 6
_IDENTITY = np.eye(4)[None]
SMALLEST_SINE = 1e-12  # below it an axis has no direction across another
OPPOSITE_SINE = 1e-4  # below it an axis counts as opposite its direction [rad]


class FramePlace:
    """A frame carried by a joint (joint 0 is the world, which does not move), moved by an offset (in the frame)."""

    def __init__(self, robot: RobotModel, name: str | None, offset: Float[np.ndarray, "#S 4 4"] = _IDENTITY) -> None:
        self.joint, pose_joint_frame = (0, np.eye(4)) if name is None else locate_frame(robot, name)
        local = pose_joint_frame @ offset
        self._rotation = np.ascontiguousarray(local[:, :3, :3])
        self._position = np.ascontiguousarray(local[:, :3, 3])

    def pose(
        self, kinematics: Kinematics, waypoints: Int[np.ndarray, "S"]
    ) -> tuple[Float[np.ndarray, "S 3 3"], Float[np.ndarray, "S 3"]]:
        """Return world rotation and position at waypoints."""
        if not self.joint:
            count = len(waypoints)
            if len(self._rotation) == count:
                return self._rotation, self._position
            return np.broadcast_to(self._rotation, (count, 3, 3)), np.broadcast_to(self._position, (count, 3))
        rotation = kinematics.rotation[waypoints, self.joint]
        position = kinematics.position[waypoints, self.joint]
        return rotation @ self._rotation, (rotation @ self._position[:, :, None])[:, :, 0] + position


class FramePose(Residual[MotionState]):
    """Pose of a frame relative to its target, up to six rows per waypoint [m, rad].

    With ``E = pose_target_frame`` the rows are E's position and the rotation vector of E's rotation, both in the
    target's axes; ``axes`` picks the rows that count.  The target is fixed in the world or in another frame of the
    robot (a hand on a wheel, two hands on a beam).
    """

    is_smooth = True

    def __init__(
        self,
        robot: RobotModel,
        frame: str,
        waypoints: Int[np.ndarray, "S"] | Sequence[int],
        target: Float[np.ndarray, "#S 4 4"],
        axes: Sequence[bool] = ALL_AXES,
        reference: str | None = None,
        offset: Float[np.ndarray, "4 4"] | None = None,
    ) -> None:
        """
        Args:
            frame: link or frame name.
            waypoints: (S,) where the rows are measured.
            target: (4, 4) or (S, 4, 4) ``pose_reference_target``.
            axes: which of x, y, z, rx, ry, rz count.
            reference: frame the target is given in; the world if None.
            offset: (4, 4) pose in the frame of what is brought to the target; the frame itself if None.
        """
        self._waypoints = np.asarray(waypoints)
        self._axes: Bool[np.ndarray, "6"] = np.asarray(axes, dtype=bool)
        self._turns = bool(self._axes[3:].any())
        self._frame = FramePlace(robot, frame, _IDENTITY if offset is None else np.asarray(offset, dtype=float)[None])
        given = np.broadcast_to(np.asarray(target, dtype=float), (len(self._waypoints), 4, 4))
        self._reference = FramePlace(robot, reference, given)

    def value(self, state: MotionState) -> Float[np.ndarray, "m"]:
        return np.asarray(self._error(state.kinematics)[0][:, self._axes].ravel())

    def linearize(self, state: MotionState) -> AffineRows:
        kinematics = state.kinematics
        error, target_rotation, position = self._error(kinematics)
        here = self._waypoints
        to_target = target_rotation.transpose(0, 2, 1)
        of_twist = np.zeros((len(here), 6, 6))
        of_twist[:, :3, :3] = to_target
        of_twist[:, :3, 3:] = -to_target @ skew(position)
        if self._turns:
            of_twist[:, 3:, 3:] = log_derivative(error[:, 3:]) @ to_target
        columns = of_twist[:, self._axes] @ kinematics.jacobian[here]
        columns *= relative_axes(kinematics, self._frame, self._reference)
        return make_waypoint_rows(error[:, self._axes], kinematics.topology.add_followers(columns), here, kinematics)

    def _error(
        self, kinematics: Kinematics
    ) -> tuple[Float[np.ndarray, "S 6"], Float[np.ndarray, "S 3 3"], Float[np.ndarray, "S 3"]]:
        rotation, position = self._frame.pose(kinematics, self._waypoints)
        target_rotation, target_position = self._reference.pose(kinematics, self._waypoints)
        to_target = target_rotation.transpose(0, 2, 1)
        offset = (to_target @ (position - target_position)[:, :, None])[:, :, 0]
        turn = log_rotation(to_target @ rotation) if self._turns else np.zeros_like(offset)
        return np.concatenate([offset, turn], axis=1), target_rotation, position


class AxisDirection(Residual[MotionState]):
    """An axis of a frame along a direction, free to turn about it, two rows per waypoint [rad].

    The rows are the two tangent components of the rotation that carries the axis onto the direction, so that their
    norm is the angle between them.  Masking a component of the rotation vector instead is right for small errors only.
    """

    is_smooth = True

    def __init__(
        self,
        robot: RobotModel,
        frame: str,
        waypoints: Int[np.ndarray, "S"] | Sequence[int],
        axis: Float[np.ndarray, "3"],
        direction: Float[np.ndarray, "3"],
        reference: str | None = None,
    ) -> None:
        """
        Args:
            frame: link or frame name.
            waypoints: (S,) waypoints of the rows.
            axis: (3,) in the frame.
            direction: (3,) in the reference.
            reference: frame the direction is given in; the world if None.
        """
        self._waypoints = np.asarray(waypoints)
        self._frame = FramePlace(robot, frame)
        self._reference = FramePlace(robot, reference)
        self._axis = _unit(axis)
        self._direction = _unit(direction)
        self._tangents = make_tangent_basis(self._direction)

    def value(self, state: MotionState) -> Float[np.ndarray, "m"]:
        along, tangential, _ = self._components(state.kinematics)
        angle, unit, _ = measure_deviation(along, tangential)
        return np.asarray((angle[:, None] * unit).ravel())

    def linearize(self, state: MotionState) -> AffineRows:
        kinematics, here = state.kinematics, self._waypoints
        along, tangential, world_axis = self._components(kinematics)
        rotation, _ = self._reference.pose(kinematics, here)
        # The change of the axis relative to the reference is a turn about the world's axes, then seen from there.
        turned = -(rotation.transpose(0, 2, 1) @ skew(world_axis))
        basis = np.concatenate([self._direction[None], self._tangents])
        moved = basis @ turned @ kinematics.jacobian[here, 3:]
        moved *= relative_axes(kinematics, self._frame, self._reference)
        return make_deviation_rows(along, tangential, kinematics.topology.add_followers(moved), here, kinematics)

    def _components(
        self, kinematics: Kinematics
    ) -> tuple[Float[np.ndarray, "S"], Float[np.ndarray, "S 2"], Float[np.ndarray, "S 3"]]:
        """Return cosine, tangent components (in the reference) and world direction of the axis."""
        rotation, _ = self._frame.pose(kinematics, self._waypoints)
        reference, _ = self._reference.pose(kinematics, self._waypoints)
        world_axis = rotation @ self._axis
        local = (world_axis[:, None] @ reference)[:, 0]
        return local @ self._direction, local @ self._tangents.T, world_axis


def measure_deviation(
    cosine: Float[np.ndarray, "S"], tangential: Float[np.ndarray, "S 2"]
) -> tuple[Float[np.ndarray, "S"], Float[np.ndarray, "S 2"], Float[np.ndarray, "S"]]:
    """Return the angle, the unit tangent of the deviation, and the rows' change per change across it [rad/rad].

    Exactly opposite the direction all ways back are equally short; the first tangent is taken.  Near it the derivative
    across the deviation has no bound, so that only the way back is linearised there.
    """
    sine = np.linalg.norm(tangential, axis=1)
    angle = np.arctan2(sine, cosine)
    vanishes = sine < SMALLEST_SINE
    unit = tangential / np.where(vanishes, 1.0, sine)[:, None]
    unit[vanishes & (cosine < 0.0)] = (1.0, 0.0)
    across = np.where(vanishes, 1.0, angle / np.where(vanishes, 1.0, sine))
    return angle, unit, np.where((sine < OPPOSITE_SINE) & (cosine < 0.0), 0.0, across)


def make_deviation_rows(
    cosine: Float[np.ndarray, "S"],
    tangential: Float[np.ndarray, "S 2"],
    moved: Float[np.ndarray, "S 3 n"],
    waypoints: Int[np.ndarray, "S"],
    kinematics: Kinematics,
) -> AffineRows:
    """Make the two rows per waypoint of an axis beside its direction: the angle along the unit tangent [rad].

    Args:
        cosine, tangential: components of the axis along the direction and across it.
        moved: derivatives of these three components by a waypoint's coordinates.
        waypoints: (S,) of the rows.
    """
    angle, unit, across = measure_deviation(cosine, tangential)
    d_along, d_tangential = moved[:, 0], moved[:, 1:]
    d_sine = (unit[:, None] @ d_tangential)[:, 0]
    d_angle = cosine[:, None] * d_sine - np.linalg.norm(tangential, axis=1)[:, None] * d_along
    rows = across[:, None, None] * d_tangential
    rows = rows + unit[:, :, None] * (d_angle - across[:, None] * d_sine)[:, None, :]
    return make_waypoint_rows(angle[:, None] * unit, rows, waypoints, kinematics)


class PointHalfSpace(Residual[MotionState]):
    """``normal . p - offset`` of a point of a frame, one row per waypoint [m]; at most zero inside the half-space."""

    is_smooth = True

    def __init__(
        self,
        robot: RobotModel,
        frame: str,
        waypoints: Int[np.ndarray, "S"] | Sequence[int],
        normal: Float[np.ndarray, "3"],
        offset: float,
        point: Float[np.ndarray, "3"] | None = None,
    ) -> None:
        """
        Args:
            frame: link or frame name.
            waypoints: (S,) where the row is measured.
            normal: (3,) in the world.
            offset: of the plane along the normal [m].
            point: (3,) in the frame; its origin if None.
        """
        self._waypoints = np.asarray(waypoints)
        local = np.eye(4)[None].copy()
        local[0, :3, 3] = np.zeros(3) if point is None else point
        self._frame = FramePlace(robot, frame, local)
        self._normal = _unit(normal)
        self._offset = float(offset)

    def value(self, state: MotionState) -> Float[np.ndarray, "m"]:
        _, position = self._frame.pose(state.kinematics, self._waypoints)
        return np.asarray(position @ self._normal - self._offset)

    def linearize(self, state: MotionState) -> AffineRows:
        kinematics, here = state.kinematics, self._waypoints
        _, position = self._frame.pose(kinematics, here)
        direction = np.broadcast_to(self._normal, position.shape)
        rows = kinematics.directional_jacobian(here, np.full(len(here), self._frame.joint), position, direction)
        return make_waypoint_rows((position @ self._normal - self._offset)[:, None], rows[:, None], here, kinematics)


def relative_axes(kinematics: Kinematics, frame: FramePlace, reference: FramePlace) -> Float[np.ndarray, "m"]:
    """Return by axis 1 where it moves the frame alone, -1 where the reference alone, 0 where both or none."""
    moves = kinematics.topology.moves
    if not reference.joint:
        return np.asarray(moves[frame.joint], dtype=float)
    return np.asarray(moves[frame.joint].astype(float) - moves[reference.joint])


def _unit(v: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    v = np.asarray(v, dtype=float)
    norm = float(np.linalg.norm(v))
    if not norm > 0.0:
        raise ValueError("a direction must not be zero")
    return v / norm


def make_waypoint_rows(
    value: Float[np.ndarray, "..."],
    jacobian: Float[np.ndarray, "S k n"],
    waypoints: Int[np.ndarray, "S"],
    kinematics: Kinematics,
) -> AffineRows:
    """Make k rows per waypoint from values and their derivatives by that waypoint's coordinates."""
    n_rows, k, n = jacobian.shape
    return AffineRows.from_blocks(
        value.ravel(), np.repeat(waypoints, k), jacobian.reshape(n_rows * k, 1, n), kinematics.n_waypoints
    )
