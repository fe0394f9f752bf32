"""Why no motion at all can reach a goal: reasons that hold for every configuration that keeps what is promised.

Each reason is a sufficient condition. A goal without one may still be out of reach.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations

import coal
import numpy as np
from jaxtyping import Float

from costs.kinematics import frame_of
from service.reachability import beyond_reach, too_far_apart
from service.start import Overlap, overlaps, penetration, placed_bodies
from service.verify import JointTarget, PoseTarget, Target
from service.verify.convex import convex_of
from service.whole_body import WholeBody

ROUNDING = 1e-5  # more than coal's distances are off [m]
POINT = 1e-9  # radius of the ball that stands for a point [m]


def never_reached(body: WholeBody, targets: Sequence[Target]) -> tuple[str, ...]:
    """Sentences, one for each reason why no motion ends as promised; none if there may be one.

    Args:
        body: the robot where it stands.
        targets: what the verifier will hold the end to.
    """
    poses = [target for target in targets if isinstance(target, PoseTarget)]
    joints = {target.joint: target for target in targets if isinstance(target, JointTarget)}
    return (
        *_beyond_reach(body, poses),
        *(f"the goal is in collision: {line}" for line in _given_joints_collide(body, joints)),
        *(f"the goal is in collision: {line}" for line in _given_poses_collide(body, poses)),
    )


def _beyond_reach(body: WholeBody, poses: Sequence[PoseTarget]) -> Iterator[str]:
    for pose in poses:
        reason = beyond_reach(body, pose.frame, pose.position, _shift(pose))
        if reason is not None:
            yield reason
    for one, other in combinations(poses, 2):
        ends = (one.frame, one.position), (other.frame, other.position)
        reason = too_far_apart(body.robot, *ends, _shift(one) + _shift(other))
        if reason is not None:
            yield reason


def _shift(pose: PoseTarget) -> float:
    """How far the frame's origin may be from its target [m]; infinite where an axis is free."""
    return float(np.linalg.norm(pose.position_tolerance_m))


def _given_joints_collide(body: WholeBody, joints: Mapping[str, JointTarget]) -> Iterator[str]:
    """Pairs that overlap however the joints stand that are not given, deeper than the given ones may be off."""
    robot = body.robot
    given = np.array([name in joints for name in robot.joint_names])
    if not given.any():
        return
    end = body.nominal.copy()
    for name, target in joints.items():
        end[robot.joint_names.index(name)] = target.value
    tolerance = max(target.tolerance for target in joints.values())
    supports = body.engine.topology.supports
    joint_of = {one.link: one.joint for one in robot.bodies}
    for overlap in overlaps(robot, end, body.scene, [foot.link for foot in body.planted]):
        chain = supports[joint_of[overlap.link]]
        if overlap.kind is None:
            chain = chain ^ supports[joint_of[overlap.other]]
        if (chain & ~given).any() or overlap.depth <= _play(body, end, overlap, chain, tolerance):
            continue
        yield str(overlap) if given.all() else f"{overlap}, wherever the other joints are"


def _play(body: WholeBody, q: Float[np.ndarray, "n"], overlap: Overlap, chain: np.ndarray, tolerance: float) -> float:
    """How far a point of the pair may move when each joint of its chain is off by at most the tolerance [m]."""
    kinematics, robot = body.engine(q[None]), body.robot
    vertices = np.concatenate(
        [placed for one, placed in placed_bodies(robot, q) if one.link in (overlap.link, overlap.other)]
    )
    play = 0.0
    for joint in range(1, robot.model.njoints):
        if chain[robot.model.joints[joint].idx_v]:
            # 1 rad moves a point by its distance from the axis at most, a sliding joint by 1 m for each metre.
            reach = np.linalg.norm(vertices - kinematics.position[0, joint], axis=1).max()
            play += tolerance * max(float(reach), 1.0)
    return 1.1 * play  # the distances themselves change by a little


def _given_poses_collide(body: WholeBody, poses: Sequence[PoseTarget]) -> Iterator[str]:
    """Links at a given pose that are in a piece whatever the rest of the robot does."""
    robot, planted = body.robot, {foot.link for foot in body.planted}
    pieces = [(piece, convex_of(piece.vertices)) for piece in body.scene.pieces]
    for pose in poses:
        joint, pose_joint_frame = frame_of(robot, pose.frame)
        carried = [one for one in robot.bodies if one.joint == joint > 0 and one.link not in planted]
        for one in carried:
            offset = one.vertices - pose_joint_frame[:3, 3]
            reach = float(np.linalg.norm(offset, axis=1).max())
            for piece, shape in pieces:
                if np.linalg.norm(pose.position - np.clip(pose.position, piece.lower, piece.upper)) > reach:
                    continue  # out of reach however it is turned
                depth = _depth_as_turned(pose, offset @ pose_joint_frame[:3, :3], shape)
                overlap = Overlap(one.link, piece.name, depth, piece.kind)
                at = np.round(pose.position, 3).tolist()
                if depth:
                    yield f"with {pose.frame} at {at}, turned as asked, {overlap}"
                elif _holds_anyhow(pose, offset, shape):
                    yield f"with {pose.frame} at {at}, however it is turned, {one.link} is {overlap.where}"


def _turn(pose: PoseTarget) -> float:
    """How far the frame may be turned from its target [rad]; pi where an axis is free."""
    if pose.rotation is None or not np.isfinite(pose.rotation_tolerance).all():
        return float(np.pi)
    sines = np.sin(np.minimum(pose.rotation_tolerance, 0.5 * np.pi))
    return float(np.arcsin(min(float(np.linalg.norm(sines)), 1.0)))


def _depth_as_turned(pose: PoseTarget, vertices: Float[np.ndarray, "V 3"], piece: coal.Convex) -> float:
    """How deep a body of the frame is in a piece at the target, 0 if tolerances may free it [m].

    A convex body cannot leave one it is ``d`` deep in while all of its points move by less than ``d``.
    """
    if pose.rotation is None:
        return 0.0
    radius = float(np.linalg.norm(vertices, axis=1).max())
    placed = vertices @ pose.rotation.T + pose.position
    depth = penetration(convex_of(placed), piece)
    return depth if depth > _shift(pose) + _turn(pose) * radius + ROUNDING else 0.0


def _holds_anyhow(pose: PoseTarget, offset: Float[np.ndarray, "V 3"], piece: coal.Convex) -> bool:
    """Whether a body of the frame is in a piece for every rotation.

    The body's point nearest to the frame's origin, or the ball about the origin that lies in the body, is in the piece
    when the target is deeper in it than that point is far (or nearer to it than the ball reaches).
    """
    away = -_depth_of(np.zeros(3), convex_of(offset))
    return _depth_of(pose.position, piece) > away + _shift(pose) + ROUNDING


def _depth_of(point: Float[np.ndarray, "3"], convex: coal.Convex) -> float:
    """How deep a point is in a convex, negative outside [m]."""
    at, here = coal.Transform3s(np.eye(3), point), coal.Transform3s()
    distance = coal.distance(coal.Sphere(POINT), at, convex, here, coal.DistanceRequest(), coal.DistanceResult())
    return -float(distance)
