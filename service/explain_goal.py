"""Why no motion at all can reach a goal: reasons that hold for every configuration that keeps what is promised.

Each reason is a sufficient condition, by the shapes as they were given. A goal without one may still be out of reach.
Where only the hulls that stand for round shapes overlap, nothing is impossible, but nothing can be certified either.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import coal
import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from costs.kinematics import frame_of, planted_poses
from costs.robot import BASE_NAMES, LinkBody, RobotModel
from costs.scene import ConvexPiece
from service.exact import EXACT_ROUNDING_M, ExactShape
from service.reachability import beyond_reach, too_far_apart
from service.start import Overlap, overlaps_and_unresolved
from service.verify import JointTarget, PoseTarget, Target
from service.whole_body import WholeBody

POINT = 1e-9  # radius of the ball that stands for a point [m]
SAME_STANCE = 1e-3  # planted links that place the base within this agree [m, rad]
STANCE_PLAY = 1e-2  # what a link may be moved by within the tolerance of the planted links [m]


@dataclass(frozen=True)
class GoalReasons:
    """What stands against a goal before anything is planned, in sentences.

    Attributes:
        impossible: reasons that hold for every motion.
        unresolved: where the goal is clear by its shapes while the hulls that stand for them overlap, however the rest
            of the robot stands: a motion may exist, and no plan made of these hulls can be certified.
    """

    impossible: tuple[str, ...]
    unresolved: tuple[str, ...]


def goal_reasons(body: WholeBody, targets: Sequence[Target]) -> GoalReasons:
    """What stands against a goal.

    Args:
        body: the robot where it stands.
        targets: what the verifier will hold the end to.
    """
    poses = [target for target in targets if isinstance(target, PoseTarget)]
    joints = {target.joint: target.value for target in targets if isinstance(target, JointTarget)}
    found = [*_given_joints(body, joints), *_given_poses(body, poses)]
    return GoalReasons(
        (
            *_beyond_reach(body, poses),
            *(f"the goal is in collision: {line}" for line, is_inside in found if is_inside),
        ),
        tuple(f"the goal is too near to plan to: {line}" for line, is_inside in found if not is_inside),
    )


def never_reached(body: WholeBody, targets: Sequence[Target]) -> tuple[str, ...]:
    """Sentences, one for each reason why no motion ends as promised; none if there may be one."""
    return goal_reasons(body, targets).impossible


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


def _given_joints(body: WholeBody, joints: Mapping[str, float]) -> Iterator[tuple[str, bool]]:
    """Pairs that overlap however the joints stand that are not given; whether by their shapes or by their hulls alone.

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
        if not overlap.kind:
            chain = chain ^ supports[joint_of[overlap.other]]
        depth = overlap.depth if overlap.depth > 0.0 else overlap.hull_depth
        rests_on_stance = bool((chain & ~given).any())
        if (chain & ~placed).any() or (rests_on_stance and depth <= STANCE_PLAY):
            continue
        text = str(overlap) if overlap in inside else overlap.nearness
        yield (text if given.all() else f"{text}, wherever the other joints are"), overlap in inside


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


def _given_poses(body: WholeBody, poses: Sequence[PoseTarget]) -> Iterator[tuple[str, bool]]:
    """Links at a given pose that are in something whatever the rest of the robot does, as ``_given_joints``."""
    robot, planted = body.robot, {foot.link for foot in body.planted}
    fixed: list[LinkBody | ConvexPiece] = [*body.scene.pieces, *(one for one in robot.bodies if one.joint == 0)]
    boxes = [(one.vertices.min(axis=0), one.vertices.max(axis=0)) for one in fixed]
    for pose in poses:
        joint, pose_joint_frame = frame_of(robot, pose.frame)
        carried = [one for one in robot.bodies if one.joint == joint > 0 and one.link not in planted]
        for one in carried:
            in_frame = _InFrame(one, np.linalg.inv(pose_joint_frame))
            for other, (lower, upper) in zip(fixed, boxes, strict=True):
                if np.linalg.norm(pose.position - np.clip(pose.position, lower, upper)) > in_frame.reach:
                    continue  # out of reach however it is turned
                if _is_checked(robot, one, other):
                    yield from _held_in(pose, in_frame, other)


def _is_checked(robot: RobotModel, one: LinkBody, other: LinkBody | ConvexPiece) -> bool:
    return isinstance(other, ConvexPiece) or (min(one.link, other.link), max(one.link, other.link)) not in (
        robot.ignored_pairs
    )


@dataclass(frozen=True)
class _InFrame:
    """A body that a goal's frame carries.

    Attributes:
        body: in its joint's frame.
        pose_frame_joint: (4, 4).
    """

    body: LinkBody
    pose_frame_joint: Float[np.ndarray, "4 4"]

    @property
    def reach(self) -> float:
        """Distance of the body's farthest point from the frame's origin [m]."""
        pose = self.pose_frame_joint
        return float(np.linalg.norm(self.body.vertices @ pose[:3, :3].T + pose[:3, 3], axis=1).max())


def _held_in(pose: PoseTarget, one: _InFrame, other: LinkBody | ConvexPiece) -> Iterator[tuple[str, bool]]:
    """At most one sentence, about shapes where they overlap, else about their hulls."""
    link = one.body.link
    name, kind = (other.link, "") if isinstance(other, LinkBody) else (other.name, other.kind)
    at = np.round(pose.position, 3).tolist()
    hulls = ExactShape.of_hull(one.body), ExactShape.of_hull(other)
    shapes = ExactShape.of(one.body), ExactShape.of(other)
    hull_depth = _depth_as_turned(pose, one, *hulls)
    if hull_depth:
        depth = _depth_as_turned(pose, one, *shapes)
        how = f"with {pose.frame} at {at}, turned as asked,"
        if depth:
            yield f"{how} {Overlap(link, name, depth, kind)}", True
        else:
            true_depth = shapes[0].depth_in(shapes[1], _pose_of_joint(pose, one))
            yield f"{how} {Overlap(link, name, true_depth, kind, hull_depth).nearness}", False
    elif _holds_anyhow(pose, one, *hulls):
        how = f"with {pose.frame} at {at}, however it is turned, {link} is"
        if _holds_anyhow(pose, one, *shapes):
            yield f"{how} {Overlap(link, name, 0.0, kind).where}", True
        else:
            yield f"{how} nearer to {name} than the planner's hulls resolve", False


def _turn(pose: PoseTarget) -> float:
    """How far the frame may be turned from its target [rad]; pi where an axis is free."""
    if pose.rotation is None or not np.isfinite(pose.rotation_tolerance).all():
        return float(np.pi)
    sines = np.sin(np.minimum(pose.rotation_tolerance, 0.5 * np.pi))
    return float(np.arcsin(min(float(np.linalg.norm(sines)), 1.0)))


def _pose_of_joint(pose: PoseTarget, one: _InFrame) -> Float[np.ndarray, "4 4"]:
    """Pose of the joint that carries a body, with the frame at its target."""
    pose_world_frame = np.eye(4)
    pose_world_frame[:3, :3] = np.eye(3) if pose.rotation is None else pose.rotation
    pose_world_frame[:3, 3] = pose.position
    return np.asarray(pose_world_frame @ one.pose_frame_joint)


def _depth_as_turned(pose: PoseTarget, one: _InFrame, shape: ExactShape, other: ExactShape) -> float:
    """How deep a body of the frame is in something at the target, 0 if tolerances may free it [m].

    A convex body cannot leave one it is ``d`` deep in while all of its points move by less than ``d``.
    """
    if pose.rotation is None:
        return 0.0
    depth = shape.depth_in(other, _pose_of_joint(pose, one))
    return depth if depth > _shift(pose) + _turn(pose) * one.reach + EXACT_ROUNDING_M else 0.0


def _holds_anyhow(pose: PoseTarget, one: _InFrame, shape: ExactShape, other: ExactShape) -> bool:
    """Whether a body of the frame is in something for every rotation.

    The body's point nearest to the frame's origin, or the ball about the origin that lies in the body, is in it when
    the target is deeper in it than that point is far (or nearer to it than the ball reaches).
    """
    away = -_depth_of(np.linalg.inv(one.pose_frame_joint)[:3, 3], shape)
    return _depth_of(pose.position, other) > away + _shift(pose) + EXACT_ROUNDING_M


def _depth_of(point: Float[np.ndarray, "3"], shape: ExactShape) -> float:
    """How deep a point is in a shape, negative outside [m]."""
    at = np.eye(4)
    at[:3, 3] = point
    return ExactShape(coal.Capsule(POINT, 0.0), at, True).depth_in(shape)
