"""What no configuration can reach: the length of the chain from where a robot stands to the frame that shall arrive."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.kinematics import frame_of
from costs.robot import RobotModel
from service.whole_body import WholeBody


def chain_length(robot: RobotModel, start: str | None, frame: str) -> float:
    """Upper bound of the distance between two frames of a robot, whatever its joints do [m].

    Args:
        robot: whose frames they are; joints between them must be revolute.
        start: a link; None for the root joint's place in the world (fixed base).
        frame: link or frame name.
    """
    model = robot.model
    end_joint, pose_joint_end = frame_of(robot, frame)
    length = float(np.linalg.norm(pose_joint_end[:3, 3]))
    end_path = _to_root(model, end_joint)
    start_path: list[int] = []
    if start is not None:
        start_joint, pose_joint_start = frame_of(robot, start)
        length += float(np.linalg.norm(pose_joint_start[:3, 3]))
        start_path = _to_root(model, start_joint)
    shared = set(end_path) & set(start_path)
    for joint in (*end_path, *start_path):
        if joint not in shared:
            length += float(np.linalg.norm(model.jointPlacements[joint].translation))
    return length


def _to_root(model: pin.Model, joint: int) -> list[int]:
    path = []
    while joint > 0:
        path.append(joint)
        joint = int(model.parents[joint])
    return path


def beyond_reach(body: WholeBody, frame: str, target: Float[np.ndarray, "3"], tolerance: float = 0.0) -> str | None:
    """A sentence when no configuration on the planted links brings the frame to the target, else None."""
    robot = body.robot
    if any(not _is_revolute(robot, joint) for joint in _to_root(robot.model, frame_of(robot, frame)[0])):
        return None
    places = [(foot.link, foot.pose_world_link[:3, 3]) for foot in body.planted]
    if not robot.is_floating:
        places = [("the base", np.zeros(3))]
    for name, place in places:
        distance = float(np.linalg.norm(target - place)) - tolerance
        reach = chain_length(robot, None if name == "the base" else name, frame)
        if distance > reach:
            return (
                f"{frame} cannot reach {np.round(target, 3).tolist()}: it is {distance:.2f} m from {name}, "
                f"and the chain between them is at most {reach:.2f} m long"
            )
    return None


def _is_revolute(robot: RobotModel, joint: int) -> bool:
    """Whether a joint keeps its links' distance: revolute, or the floating base, which the chain does not pass."""
    kind = robot.model.joints[joint].shortname()
    return "JointModelR" in kind or (joint == 1 and robot.is_floating)
