"""What a request's ``keep`` demands along a whole motion: relative poses, from the configuration at the start on."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from costs.robot import RobotModel
from service.demands.goals import AXES
from service.request.schema import KeepRequest
from service.verify import RelativePoseTarget


def kept_target(robot: RobotModel, start: Float[np.ndarray, "n"], keep: KeepRequest) -> RelativePoseTarget:
    """Target of the verifier for one kept pose of a robot that has the links it names."""
    pose = wanted_pose(keep, _relative_pose(robot, start, keep.link, keep.relative_to))
    return RelativePoseTarget(
        keep.link,
        keep.relative_to,
        pose[:3, 3],
        pose[:3, :3],
        keep.position_tolerance_m,
        float(np.deg2rad(keep.rotation_tolerance_deg)),
        free_axis(keep),
    )


def wanted_pose(keep: KeepRequest, held: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    """Pose that is asked for: the request's where it gives one, else ``held``, the one at the start."""
    wanted = held.copy()
    if keep.position is not None:
        wanted[:3, 3] = keep.position
    if keep.quaternion_wxyz is not None:
        wanted[:3, :3] = Rotation.from_quat(keep.quaternion_wxyz, scalar_first=True).as_matrix()
    return wanted


def free_axis(keep: KeepRequest) -> Float[np.ndarray, "3"] | None:
    """Unit axis of the link about which it may turn, or None."""
    return None if keep.free_axis == "none" else np.eye(3)[AXES[keep.free_axis]]


def _relative_pose(
    robot: RobotModel, q: Float[np.ndarray, "n"], link: str, reference: str | None
) -> Float[np.ndarray, "4 4"]:
    """``pose_reference_link`` at one configuration."""
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    pose = data.oMf[robot.model.getFrameId(link)]
    if reference is not None:
        pose = data.oMf[robot.model.getFrameId(reference)].actInv(pose)
    return np.array(pose.homogeneous)
