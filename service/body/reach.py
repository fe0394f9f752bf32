"""What no configuration can reach: the length of the chain from where a robot stands, or from another frame."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.kinematics import frame_of
from costs.robot import RobotModel
from service.body.whole_body import WholeBody

FOOT_DRIFT = 5e-3  # a planted link's origin moves less within what its sole may drift [m]


def chain_length(robot: RobotModel, start: str | None, frame: str) -> float:
    """Upper bound of the distance between two frames of a robot, whatever its joints do [m].

    Args:
        robot: whose frames they are.
        start: a link or frame; None for the world's origin (fixed base).
        frame: link or frame name.

    Returns:
        Infinity where a joint between them has no bound: a free base, a sliding joint without limits.
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
    for joint in {*end_path} ^ {*start_path}:
        length += float(np.linalg.norm(model.jointPlacements[joint].translation)) + _travel(robot, joint)
    return length


def _to_root(model: pin.Model, joint: int) -> list[int]:
    path = []
    while joint > 0:
        path.append(joint)
        joint = int(model.parents[joint])
    return path


def find_out_of_reach(
    body: WholeBody, frame: str, target: Float[np.ndarray, "3"], tolerance: float = 0.0
) -> str | None:
    """A sentence when no configuration on the planted links brings the frame to the target, else None.

    Args:
        body: where the robot stands.
        frame: link or frame name.
        target: (3,) in the world [m].
        tolerance: distance from the target that is near enough [m].
    """
    robot = body.robot
    places: list[tuple[str | None, np.ndarray, float]] = [(None, np.zeros(3), 0.0)]
    if robot.is_floating:
        places = [(foot.link, foot.pose_world_link[:3, 3], FOOT_DRIFT) for foot in body.planted]
    for link, place, drift in places:
        distance = float(np.linalg.norm(target - place))
        reach = chain_length(robot, link, frame)
        if distance - tolerance - drift > reach:
            name = "the base" if link is None else link
            return (
                f"{frame} cannot reach {np.round(target, 3).tolist()}: it is {distance:.2f} m from {name}, "
                f"and the chain between them is at most {reach:.2f} m long"
            )
    return None


def too_far_apart(
    robot: RobotModel,
    first: tuple[str, Float[np.ndarray, "3"]],
    second: tuple[str, Float[np.ndarray, "3"]],
    tolerance: float = 0.0,
) -> str | None:
    """A sentence when no configuration brings two frames to their targets at once, else None.

    Args:
        robot: whose frames they are.
        first, second: frame and target in the world [m].
        tolerance: distance from the targets that is near enough, both together [m].
    """
    distance = float(np.linalg.norm(first[1] - second[1]))
    reach = chain_length(robot, first[0], second[0])
    if distance - tolerance <= reach:
        return None
    return (
        f"{first[0]} and {second[0]} cannot be at their targets at once: these are {distance:.2f} m apart, "
        f"and the chain between them is at most {reach:.2f} m long"
    )


def _travel(robot: RobotModel, joint: int) -> float:
    """How far a joint can carry its own origin [m]: a turning one not at all, a sliding one to its farther limit."""
    kind, index = robot.model.joints[joint].shortname(), robot.model.joints[joint].idx_v
    if robot.model.joints[joint].nv == 1 and kind.startswith("JointModelR"):
        return 0.0
    if robot.model.joints[joint].nv == 1 and kind.startswith("JointModelP"):
        return float(max(abs(robot.lower[index]), abs(robot.upper[index])))
    return float("inf")
