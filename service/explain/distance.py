"""Goals beyond the length of the robot's chains or against a kept pose: sufficient reasons why no motion exists."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.kinematics import locate_frame
from costs.robot import RobotModel, read_joint_axis
from service.body.holds import KeptPose, relative_pose
from service.body.regions import KeptRegion
from service.body.whole_body import WholeBody
from service.verify import JointTarget, PoseTarget, Target, list_position_demands

FOOT_DRIFT = 5e-3  # of a planted link's origin within the tolerance of its sole [m]


def chain_length(robot: RobotModel, start: str | None, frame: str) -> float:
    """Return an upper bound of the distance between two frames of a robot for all joint positions [m].

    Args:
        robot: the robot.
        start: a link or frame; None for the world's origin (fixed base).
        frame: link or frame name.

    Returns:
        Infinity where a joint between them has no bound: a free base, a sliding joint without limits.
    """
    model = robot.model
    end_joint, pose_joint_end = locate_frame(robot, frame)
    length = float(np.linalg.norm(pose_joint_end[:3, 3]))
    end_path = _joints_to_root(model, end_joint)
    start_path: list[int] = []
    if start is not None:
        start_joint, pose_joint_start = locate_frame(robot, start)
        length += float(np.linalg.norm(pose_joint_start[:3, 3]))
        start_path = _joints_to_root(model, start_joint)
    for joint in {*end_path} ^ {*start_path}:
        length += float(np.linalg.norm(model.jointPlacements[joint].translation)) + _travel(robot, joint)
    return length


def _joints_to_root(model: pin.Model, joint: int) -> list[int]:
    path = []
    while joint > 0:
        path.append(joint)
        joint = int(model.parents[joint])
    return path


def _travel(robot: RobotModel, joint: int) -> float:
    """Return how far a joint moves its own origin [m]: none for a turning one, its farther limit for a sliding one."""
    kind, index = robot.model.joints[joint].shortname(), robot.model.joints[joint].idx_v
    if kind == "JointModelMimic":
        if np.any(read_joint_axis(robot, joint)[3:]):
            return 0.0
        follower = robot.model.joints[joint].extract()
        farthest = float(max(abs(robot.lower[index]), abs(robot.upper[index])))
        return abs(float(follower.scaling)) * farthest + abs(float(follower.offset))
    if robot.model.joints[joint].nv == 1 and kind.startswith("JointModelR"):
        return 0.0
    if robot.model.joints[joint].nv == 1 and kind.startswith("JointModelP"):
        return float(max(abs(robot.lower[index]), abs(robot.upper[index])))
    return float("inf")


def find_out_of_reach(
    body: WholeBody, frame: str, target: Float[np.ndarray, "3"], tolerance: float = 0.0
) -> str | None:
    """Return a sentence when no configuration on the planted links brings the frame to the target, else None.

    Args:
        body: the robot where it stands.
        frame: link or frame name.
        target: in the world [m].
        tolerance: of the distance from the target [m].
    """
    robot = body.robot
    supports: list[tuple[str | None, np.ndarray, float]] = [(None, np.zeros(3), 0.0)]
    if robot.is_floating:
        supports = [(foot.link, foot.pose_world_link[:3, 3], FOOT_DRIFT) for foot in body.planted]
    for link, position, drift in supports:
        distance = float(np.linalg.norm(target - position))
        reach = chain_length(robot, link, frame)
        if distance - tolerance - drift > reach:
            name = "the base" if link is None else link
            return (
                f"{frame} cannot reach {np.round(target, 3).tolist()}: it is {distance:.2f} m from {name}, "
                f"and the chain between them is at most {reach:.2f} m long"
            )
    return None


def find_too_far_apart(robot: RobotModel, first: PoseTarget, second: PoseTarget) -> str | None:
    """Return a sentence when no configuration brings two frames to their targets at once, else None."""
    distance = float(np.linalg.norm(first.position - second.position))
    reach = chain_length(robot, first.frame, second.frame)
    if distance - (position_slack(first) + position_slack(second)) <= reach:
        return None
    return (
        f"{first.frame} and {second.frame} cannot be at their targets at once: these are {distance:.2f} m apart, "
        f"and the chain between them is at most {reach:.2f} m long"
    )


def position_slack(pose: PoseTarget) -> float:
    """Return the largest distance of the frame's origin from its target [m]; infinite where an axis is free."""
    demands = list_position_demands(pose)
    if len(demands) == 1 and demands[0].axis is None:
        return demands[0].tolerance_m
    return float(np.linalg.norm(pose.position_tolerance_m))


def find_never_kept(body: WholeBody, targets: Sequence[Target]) -> tuple[str, ...]:
    """Return a sentence for each reason why a motion to the targets cannot keep the body's kept poses."""
    poses = [target for target in targets if isinstance(target, PoseTarget)]
    joints = {target.joint: target for target in targets if isinstance(target, JointTarget)}
    lines: list[str] = []
    for kept in body.kept:
        if isinstance(kept, KeptPose):
            lines += [*_compare_distances(body.robot, kept, poses), *_check_given_joints(body, kept, joints)]
        elif kept.region.during[1] >= 1.0:
            lines += _check_region(body, kept, joints)
    return tuple(lines)


def _check_region(body: WholeBody, kept: KeptRegion, joints: Mapping[str, JointTarget]) -> Iterator[str]:
    """Yield a sentence when the goal gives all joints between two frames and leaves a region."""
    frame, reference = kept.region.frame, kept.region.reference
    between = _list_between(body, frame, reference)
    if not all(name in joints for name in between):
        return
    end, play = _read_end(body, between, joints)
    reach = max(chain_length(body.robot, reference, frame), 1.0)
    for excess in kept.measure_excess(body.robot, end, {"m": play * reach, "rad": play}):
        yield f"the goal leaves what keep demands: there the {excess} outside"


def _compare_distances(robot: RobotModel, kept: KeptPose, poses: Sequence[PoseTarget]) -> Iterator[str]:
    """Yield targets whose distance is not that of the kept pose."""
    for pose in poses:
        offset = _position_in(robot, kept.link, pose.frame)
        if offset is None:
            continue
        held = kept.wanted[:3, :3] @ offset + kept.wanted[:3, 3]
        turn = min(kept.rotation_tolerance_rad, float(np.pi))
        lever = 2.0 * np.linalg.norm(offset) * (1.0 if kept.free_axis is not None else np.sin(0.5 * turn))
        slack = kept.position_tolerance_m + float(lever) + position_slack(pose)
        if kept.reference is None:
            distance = float(np.linalg.norm(pose.position - held))
            if distance > slack:
                yield f"the goal of {pose.frame} is {distance:.2f} m from where keeping {kept.name} holds it"
            continue
        for other in poses:
            anchor = _position_in(robot, kept.reference, other.frame)
            if anchor is None:
                continue
            at_goal, while_kept = (float(np.linalg.norm(d)) for d in (pose.position - other.position, held - anchor))
            if abs(at_goal - while_kept) > slack + position_slack(other):
                yield (
                    f"the goals of {pose.frame} and {other.frame} are {at_goal:.2f} m apart, and keeping {kept.name} "
                    f"holds them {while_kept:.2f} m apart"
                )


def _position_in(robot: RobotModel, link: str, frame: str) -> Float[np.ndarray, "3"] | None:
    """Return the origin of a frame in a link's; None where a joint is between them."""
    (joint, pose_joint_link), (other, pose_joint_frame) = locate_frame(robot, link), locate_frame(robot, frame)
    return np.asarray((np.linalg.inv(pose_joint_link) @ pose_joint_frame)[:3, 3]) if joint == other else None


def _check_given_joints(body: WholeBody, kept: KeptPose, joints: Mapping[str, JointTarget]) -> Iterator[str]:
    """Yield a sentence when the goal gives all joints of a kept pose's chain and breaks the pose."""
    robot, between = body.robot, _list_between(body, kept.link, kept.reference)
    if not all(name in joints for name in between):
        return
    end, play = _read_end(body, between, joints)
    distance, angle = kept.errors(relative_pose(robot, end, kept.link, kept.reference))
    reach = max(chain_length(robot, kept.reference, kept.link), 1.0)
    if distance > kept.position_tolerance_m + play * reach or angle > kept.rotation_tolerance_rad + play:
        error = f"{1e3 * distance:.0f} mm and {np.rad2deg(angle):.0f} deg"
        yield f"the goal does not keep {kept.name}: it is {error} off there"


def _list_between(body: WholeBody, frame: str, reference: str | None) -> list[str]:
    """Return the names of the coordinates that move a frame relative to another, or to the world."""
    robot, supports = body.robot, body.engine.topology.supports
    chain = supports[locate_frame(robot, frame)[0]]
    if reference is not None:
        chain = chain ^ supports[locate_frame(robot, reference)[0]]
    return [robot.joint_names[index] for index in np.flatnonzero(chain)]


def _read_end(
    body: WholeBody, between: Sequence[str], joints: Mapping[str, JointTarget]
) -> tuple[Float[np.ndarray, "n"], float]:
    """Return the nominal configuration with coordinates at their targets, and the sum of their tolerances [rad, m]."""
    end = body.nominal.copy()
    for name in between:
        end[body.robot.joint_names.index(name)] = joints[name].value
    return end, sum(joints[name].tolerance for name in between)
