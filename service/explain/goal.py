"""Why no motion at all can reach a goal: reasons that hold for every configuration that keeps what is promised.

Each reason is a sufficient condition, by the shapes as they were given. A goal without one may still be out of reach.
Where only the hulls that stand for round shapes overlap, nothing is impossible, but nothing can be certified either.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from costs.kinematics import frame_of, planted_poses
from costs.robot import BASE_NAMES
from service.body.reach import beyond_reach, too_far_apart
from service.body.whole_body import WholeBody
from service.explain.goal_poses import Finding, How, given_poses, shift
from service.start.overlaps import overlaps_and_unresolved
from service.verify import JointTarget, PoseTarget, Target

SAME_STANCE = 1e-3  # planted links that place the base within this agree [m, rad]
STANCE_PLAY = 1e-2  # what a link may be moved by within the tolerance of the planted links [m]


@dataclass(frozen=True)
class GoalReasons:
    """What stands against a goal before anything is planned, in sentences.

    Attributes:
        impossible: reasons that hold for every motion.
        unresolved: where the goal is clear by its shapes while the hulls that stand for them overlap, however the rest
            of the robot stands: a motion may exist, and no plan made of these hulls can be certified.
        notes: where the goal as it is given is in collision, and only its tolerance may free it.
    """

    impossible: tuple[str, ...]
    unresolved: tuple[str, ...]
    notes: tuple[str, ...] = ()


def goal_reasons(body: WholeBody, targets: Sequence[Target]) -> GoalReasons:
    """What stands against a goal.

    Args:
        body: the robot where it stands.
        targets: what the verifier will hold the end to.
    """
    poses = [target for target in targets if isinstance(target, PoseTarget)]
    joints = {target.joint: target.value for target in targets if isinstance(target, JointTarget)}
    found = [*_given_joints(body, joints), *given_poses(body, poses)]
    in_collision = tuple(f"the goal is in collision: {one.text}" for one in found if one.how is How.INSIDE)
    return GoalReasons(
        (*_beyond_reach(body, poses), *in_collision),
        tuple(f"the goal is too near to plan to: {one.text}" for one in found if one.how is How.HULLS_ONLY),
        tuple(f"{one.text}; only its tolerance can free it" for one in found if one.how is How.TOLERANCE),
    )


def never_reached(body: WholeBody, targets: Sequence[Target]) -> tuple[str, ...]:
    """Sentences, one for each reason why no motion ends as promised; none if there may be one."""
    return goal_reasons(body, targets).impossible


def _beyond_reach(body: WholeBody, poses: Sequence[PoseTarget]) -> Iterator[str]:
    for pose in poses:
        reason = beyond_reach(body, pose.frame, pose.position, shift(pose))
        if reason is not None:
            yield reason
    for one, other in combinations(poses, 2):
        ends = (one.frame, one.position), (other.frame, other.position)
        reason = too_far_apart(body.robot, *ends, shift(one) + shift(other))
        if reason is not None:
            yield reason


def _given_joints(body: WholeBody, joints: Mapping[str, float]) -> Iterator[Finding]:
    """Pairs that overlap however the joints stand that are not given.

    The values are taken as they are given: how far a motion may end from them is the certificate's own tolerance.
    """
    robot = body.robot
    given = np.array([name in joints for name in robot.joint_names])
    if not given.any():
        return
    end = body.nominal.copy()
    for name, value in joints.items():
        end[robot.joint_names.index(name)] = value
    placed = given.copy()
    base = _standing_base(body, end, given)
    if base is not None:
        end[: len(BASE_NAMES)], placed[: len(BASE_NAMES)] = base, True
    supports = body.engine.topology.supports
    joint_of = {one.link: one.joint for one in robot.bodies}
    inside, near = overlaps_and_unresolved(robot, end, body.scene, [foot.link for foot in body.planted])
    for overlap in (*inside, *near):
        chain = supports[joint_of[overlap.link]]
        if overlap.kind is None:
            chain = chain ^ supports[joint_of[overlap.other]]
        depth = overlap.depth if overlap.depth > 0.0 else overlap.hull_depth
        rests_on_stance = bool((chain & ~given).any())
        if (chain & ~placed).any() or (rests_on_stance and depth <= STANCE_PLAY):
            continue
        text, how = (str(overlap), How.INSIDE) if overlap in inside else (overlap.nearness, How.HULLS_ONLY)
        yield Finding(text if given.all() else f"{text}, wherever the other joints are", how)


def _standing_base(
    body: WholeBody, q: Float[np.ndarray, "n"], given: Bool[np.ndarray, "n"]
) -> Float[np.ndarray, "6"] | None:
    """Base coordinates that the planted links leave to a robot whose legs are given; None where they leave more."""
    robot = body.robot
    if not robot.is_floating:
        return None
    found: list[np.ndarray] = []
    for foot in body.planted:
        chain = body.engine.topology.supports[frame_of(robot, foot.link)[0]].copy()
        chain[: len(BASE_NAMES)] = False
        if (chain & ~given).any():
            continue
        at_zero = q.copy()
        at_zero[: len(BASE_NAMES)] = 0.0
        pose_base_foot = planted_poses(body.engine, at_zero, [foot.link])[foot.link]
        pose = foot.pose_world_link @ np.linalg.inv(pose_base_foot)
        found.append(np.concatenate([pose[:3, 3], Rotation.from_matrix(pose[:3, :3]).as_euler("ZYX")]))
    if not found or any(np.abs(other - found[0]).max() > SAME_STANCE for other in found[1:]):
        return None
    return found[0]
