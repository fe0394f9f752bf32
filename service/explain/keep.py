"""Why no motion at all can reach a goal and keep the relative poses it is asked to keep.

Each reason is a sufficient condition, as those of ``service.explain.goal``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from jaxtyping import Float

from costs.kinematics import frame_of
from costs.robot import RobotModel
from service.body.holds import KeptPose, relative_pose
from service.body.reach import chain_length
from service.body.whole_body import WholeBody
from service.verify import JointTarget, PoseTarget, Target


def find_never_kept(body: WholeBody, targets: Sequence[Target]) -> tuple[str, ...]:
    """Sentences, one for each reason why no motion that keeps what it shall ends as promised."""
    poses = [target for target in targets if isinstance(target, PoseTarget)]
    joints = {target.joint: target for target in targets if isinstance(target, JointTarget)}
    return tuple(
        line for kept in body.kept for line in (*_apart(body.robot, kept, poses), *_let_go(body, kept, joints))
    )


def _apart(robot: RobotModel, kept: KeptPose, poses: Sequence[PoseTarget]) -> Iterator[str]:
    """Two places that are not as far apart as what is kept holds them."""
    for one in poses:
        carried = _place_in(robot, kept.link, one.frame)
        if carried is None:
            continue
        held = kept.wanted[:3, :3] @ carried + kept.wanted[:3, 3]
        lever = 2.0 * np.linalg.norm(carried) * (1.0 if kept.free_axis is not None else np.sin(0.5 * _turn(kept)))
        slack = kept.position_tolerance_m + float(lever) + _shift(one)
        if kept.reference is None:
            off = float(np.linalg.norm(one.position - held))
            if off > slack:
                yield f"{one.frame} shall arrive {off:.2f} m from where keeping {kept.name} holds it"
            continue
        for other in poses:
            place = _place_in(robot, kept.reference, other.frame)
            if place is None:
                continue
            asked, kept_apart = (float(np.linalg.norm(d)) for d in (one.position - other.position, held - place))
            if abs(asked - kept_apart) > slack + _shift(other):
                yield (
                    f"{one.frame} and {other.frame} shall arrive {asked:.2f} m apart, and keeping {kept.name} holds "
                    f"them {kept_apart:.2f} m apart"
                )


def _place_in(robot: RobotModel, link: str, frame: str) -> Float[np.ndarray, "3"] | None:
    """Origin of a frame in a link's; None where a joint moves one against the other."""
    (joint, pose_joint_link), (other, pose_joint_frame) = frame_of(robot, link), frame_of(robot, frame)
    return np.asarray((np.linalg.inv(pose_joint_link) @ pose_joint_frame)[:3, 3]) if joint == other else None


def _shift(pose: PoseTarget) -> float:
    """How far the frame's origin may be from its target [m]."""
    return float(np.linalg.norm(pose.position_tolerance_m))


def _turn(kept: KeptPose) -> float:
    return min(kept.rotation_tolerance_rad, float(np.pi))


def _let_go(body: WholeBody, kept: KeptPose, joints: Mapping[str, JointTarget]) -> Iterator[str]:
    """Joint positions at the goal that are given for all joints between the two, and break the pose."""
    robot, supports = body.robot, body.engine.topology.supports
    chain = supports[frame_of(robot, kept.link)[0]]
    if kept.reference is not None:
        chain = chain ^ supports[frame_of(robot, kept.reference)[0]]
    between = [robot.joint_names[index] for index in np.flatnonzero(chain)]
    if not all(name in joints for name in between):
        return
    end = body.nominal.copy()
    for name in between:
        end[robot.joint_names.index(name)] = joints[name].value
    off, turn = kept.errors(relative_pose(robot, end, kept.link, kept.reference))
    play = sum(joints[name].tolerance for name in between)
    reach = max(chain_length(robot, kept.reference, kept.link), 1.0)
    if off > kept.position_tolerance_m + play * reach or turn > kept.rotation_tolerance_rad + play:
        yield (f"the goal does not keep {kept.name}: it is {1e3 * off:.0f} mm and {np.rad2deg(turn):.0f} deg off there")
