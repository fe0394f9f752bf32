"""A frame on its way: how far it is off the nearest pose of a line, an arc or a screw."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int
from scipy import sparse

from costs.guide import Guide
from costs.kinematics import locate_frame
from costs.robot.model import RobotModel
from costs.rotation import turn_towards
from costs.state import MotionState
from costs.terms.pose import FramePose
from scopt import AffineRows, Residual


class OnGuide(Residual[MotionState]):
    """Distance of a frame from its way, up to six rows per waypoint [m, rad].

    The rows are the pose of the frame relative to the nearest pose of the way, without the direction in which the way
    goes on there: how much of it is done stays free.  A frame that may turn about an axis of its own has one row less,
    one of any orientation has rows of its place alone.  The derivative is that on the way; off it, the change of the
    directions that are left out is missing.
    """

    is_smooth = True

    def __init__(
        self,
        robot: RobotModel,
        frame: str,
        waypoints: Int[np.ndarray, "S"] | Sequence[int],
        guide: Guide,
        free_axis: Float[np.ndarray, "3"] | None = None,
        *,
        turns_freely: bool = False,
        moves_freely: bool = False,
    ) -> None:
        """
        Args:
            frame: link or frame name.
            waypoints: (S,) where the rows are measured.
            guide: the way.
            free_axis: (3,) unit, in the frame, about which it may turn; None for none.
            turns_freely: whether its orientation does not count.
            moves_freely: whether its place does not count.
        """
        self._robot, self._frame, self._waypoints = robot, frame, np.asarray(waypoints)
        self._guide, self._free_axis = guide, free_axis
        self._counts = np.repeat([not moves_freely, not turns_freely], 3)
        self._joint, self._pose_joint_frame = locate_frame(robot, frame)

    def value(self, state: MotionState) -> Float[np.ndarray, "m"]:
        pose, directions = self._place(state)
        error = pose.value(state).reshape(len(self._waypoints), -1)
        return np.asarray(np.einsum("skr,sr->sk", directions, error).ravel())

    def linearize(self, state: MotionState) -> AffineRows:
        pose, directions = self._place(state)
        rows = pose.linearize(state)
        blocks = sparse.block_diag(list(directions), format="csr")
        return AffineRows(np.asarray(blocks @ rows.value), sparse.csr_array(blocks @ rows.jacobian))

    def _place(self, state: MotionState) -> tuple[FramePose, Float[np.ndarray, "S k r"]]:
        """Return the pose relative to the nearest poses of the way, and the directions in it that count."""
        kinematics, here = state.kinematics, self._waypoints
        joint = kinematics.rotation[here, self._joint]
        rotation = joint @ self._pose_joint_frame[:3, :3]
        position = (joint @ self._pose_joint_frame[:3, 3]) + kinematics.position[here, self._joint]
        share = self._guide.find_shares(position, rotation)
        targets = self._guide.poses(share)
        if self._free_axis is not None:
            targets[:, :3, :3] = turn_towards(targets[:, :3, :3], rotation, self._free_axis)
        pose = FramePose(self._robot, self._frame, here, targets, self._counts.tolist())
        inwards = targets[:, :3, :3].transpose(0, 2, 1)
        along = np.einsum("sij,sj->si", inwards, self._guide.tangents(share))
        onwards = np.concatenate([along, inwards @ self._guide.turn], axis=1)[:, self._counts]
        left_out = [onwards] if np.abs(onwards).max(initial=0.0) > 0.0 else []
        if self._free_axis is not None and self._counts[3]:
            free = np.concatenate([np.zeros(3), self._free_axis])[self._counts]
            left_out.append(np.tile(free, (len(here), 1)))
        return pose, _find_complements(left_out, len(here), int(self._counts.sum()))


def _find_complements(
    left_out: Sequence[Float[np.ndarray, "S r"]], count: int, rows: int
) -> Float[np.ndarray, "S k r"]:
    """Return orthonormal directions across those that are left out, per waypoint."""
    if not left_out:
        return np.tile(np.eye(rows), (count, 1, 1))
    _, _, basis = np.linalg.svd(np.stack(left_out, axis=1), full_matrices=True)
    return np.asarray(basis[:, len(left_out) :])
