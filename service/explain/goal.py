"""Why no motion at all can reach a goal: reasons that hold for every configuration that keeps what is promised.

Each reason is a sufficient condition, by the shapes as they were given. A goal without one may still be out of reach.
Where only the hulls that stand for round shapes overlap, nothing is impossible, but nothing can be certified either.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import combinations

import coal
import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from costs.kinematics import frame_of, planted_poses
from costs.robot import BASE_NAMES, LinkBody, RobotModel
from costs.scene import ConvexPiece
from service.body.reach import find_out_of_reach, too_far_apart
from service.body.whole_body import WholeBody
from service.start.overlaps import EXACT_ROUNDING_M, ExactShape, Overlap, find_overlaps_and_unresolved
from service.verify import JointTarget, PoseTarget, Target

SAME_STANCE = 1e-3  # planted links that place the base within this agree [m, rad]
STANCE_PLAY = 1e-2  # what a link may be moved by within the tolerance of the planted links [m]
POINT = 1e-9  # radius of the ball that stands for a point [m]


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


def find_goal_reasons(body: WholeBody, targets: Sequence[Target]) -> GoalReasons:
    """What stands against a goal.

    Args:
        body: the robot where it stands.
        targets: what the verifier will hold the end to.
    """
    poses = [target for target in targets if isinstance(target, PoseTarget)]
    joints = {target.joint: target.value for target in targets if isinstance(target, JointTarget)}
    found = [*_given_joints(body, joints), *check_given_poses(body, poses)]
    in_collision = tuple(f"the goal is in collision: {one.text}" for one in found if one.how is How.INSIDE)
    return GoalReasons(
        (*_beyond_reach(body, poses), *in_collision),
        tuple(f"the goal is too near to plan to: {one.text}" for one in found if one.how is How.HULLS_ONLY),
        tuple(f"{one.text}; only its tolerance can free it" for one in found if one.how is How.TOLERANCE),
    )


def never_reached(body: WholeBody, targets: Sequence[Target]) -> tuple[str, ...]:
    """Sentences, one for each reason why no motion ends as promised; none if there may be one."""
    return find_goal_reasons(body, targets).impossible


def _beyond_reach(body: WholeBody, poses: Sequence[PoseTarget]) -> Iterator[str]:
    for pose in poses:
        reason = find_out_of_reach(body, pose.frame, pose.position, shift(pose))
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
    inside, near = find_overlaps_and_unresolved(robot, end, body.scene, [foot.link for foot in body.planted])
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


class How(Enum):
    """In which way a goal and something overlap."""

    INSIDE = "inside"  # by their shapes, for every motion that ends at the goal
    HULLS_ONLY = "hulls only"  # by the hulls that stand for them, for every such motion
    TOLERANCE = "tolerance"  # by their shapes at the goal as it is given; within its tolerance perhaps not


@dataclass(frozen=True)
class Finding:
    """Something that a goal puts a link into, in words."""

    text: str
    how: How


def check_given_poses(body: WholeBody, poses: Sequence[PoseTarget]) -> Iterator[Finding]:
    """Links at a given pose that are in a piece, in a link that no joint moves, or in a link at another given pose."""
    robot, planted = body.robot, {foot.link for foot in body.planted}
    fixed: list[LinkBody | ConvexPiece] = [*body.scene.pieces, *(one for one in robot.bodies if one.joint == 0)]
    boxes = [(one.vertices.min(axis=0), one.vertices.max(axis=0)) for one in fixed]
    carried = [[one for one in _carried(robot, pose.frame) if one.body.link not in planted] for pose in poses]
    for pose, links in zip(poses, carried, strict=True):
        for one in links:
            for other, (lower, upper) in zip(fixed, boxes, strict=True):
                if np.linalg.norm(pose.position - np.clip(pose.position, lower, upper)) > one.reach:
                    continue  # out of reach however it is turned
                if _is_checked(robot, one.body, other):
                    yield from _held_in(pose, one, other)
    for (pose, links), (other_pose, other_links) in combinations(zip(poses, carried, strict=True), 2):
        for one in links:
            for two in other_links:
                near = np.linalg.norm(pose.position - other_pose.position) <= one.reach + two.reach
                if near and one.body.joint != two.body.joint and _is_checked(robot, one.body, two.body):
                    yield from _in_each_other(pose, one, other_pose, two)


def _carried(robot: RobotModel, frame: str) -> list[_InFrame]:
    """The bodies that a frame carries along; none where no joint moves it."""
    joint, pose_joint_frame = frame_of(robot, frame)
    pose_frame_joint = np.linalg.inv(pose_joint_frame)
    return [_InFrame(one, pose_frame_joint) for one in robot.bodies if one.joint == joint > 0]


def shift(pose: PoseTarget) -> float:
    """How far the frame's origin may be from its target [m]; infinite where an axis is free."""
    return float(np.linalg.norm(pose.position_tolerance_m))


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

    def play(self, pose: PoseTarget) -> float:
        """How far a point of the body may be from where the target puts it [m]; infinite where it may turn freely."""
        return shift(pose) + _turn(pose) * self.reach + EXACT_ROUNDING_M


def _held_in(pose: PoseTarget, one: _InFrame, other: LinkBody | ConvexPiece) -> Iterator[Finding]:
    """At most one finding: about shapes where they overlap, else about their hulls."""
    at, found = np.round(pose.position, 3).tolist(), None
    if pose.rotation is not None:
        found = _overlap(one.body, other, one.play(pose), _pose_of_joint(pose, one), np.eye(4))
        if found is not None and found.how is not How.TOLERANCE:
            yield Finding(f"with {pose.frame} at {at}, turned as asked, {found.text}", found.how)
            return
    if _holds_anyhow(pose, one, ExactShape.of_hull(one.body), ExactShape.of_hull(other)):
        how = f"with {pose.frame} at {at}, however it is turned, {one.body.link} is"
        if _holds_anyhow(pose, one, ExactShape.of(one.body), ExactShape.of(other)):
            yield Finding(f"{how} {_named(one.body, other, 0.0, 0.0).where}", How.INSIDE)
        else:
            name = other.link if isinstance(other, LinkBody) else other.name
            yield Finding(f"{how} nearer to {name} than the planner's hulls resolve", How.HULLS_ONLY)
    elif found is not None:
        yield Finding(f"with {pose.frame} at {at}, turned as asked, {found.text}", found.how)


def _in_each_other(pose: PoseTarget, one: _InFrame, other_pose: PoseTarget, two: _InFrame) -> Iterator[Finding]:
    """At most one finding about bodies that two poses place."""
    if pose.rotation is None or other_pose.rotation is None:
        return
    play = one.play(pose) + two.play(other_pose)
    placed = _pose_of_joint(pose, one), _pose_of_joint(other_pose, two)
    found = _overlap(one.body, two.body, play, *placed)
    if found is not None:
        at = [np.round(each.position, 3).tolist() for each in (pose, other_pose)]
        how = f"with {pose.frame} at {at[0]} and {other_pose.frame} at {at[1]}, turned as asked,"
        yield Finding(f"{how} {found.text}", found.how)


def _overlap(
    body: LinkBody,
    other: LinkBody | ConvexPiece,
    play: float,
    pose: Float[np.ndarray, "4 4"],
    pose_other: Float[np.ndarray, "4 4"],
) -> Finding | None:
    """How a body placed by a target is in something, each of its points perhaps off by as much as the play [m].

    A convex body cannot leave one it is ``d`` deep in while all of its points move by less than ``d``.
    """
    hull_depth = ExactShape.of_hull(body).depth_in(ExactShape.of_hull(other), pose, pose_other)
    if hull_depth <= EXACT_ROUNDING_M:
        return None
    depth = min(ExactShape.of(body).depth_in(ExactShape.of(other), pose, pose_other), hull_depth)
    overlap = _named(body, other, depth, hull_depth)
    if depth > play:
        return Finding(str(overlap), How.INSIDE)
    if hull_depth > play:
        return Finding(overlap.nearness, How.HULLS_ONLY)
    return Finding(str(overlap), How.TOLERANCE) if depth > EXACT_ROUNDING_M else None


def _named(body: LinkBody, other: LinkBody | ConvexPiece, depth: float, hull_depth: float) -> Overlap:
    name, kind = (other.link, "") if isinstance(other, LinkBody) else (other.name, other.kind)
    return Overlap(body.link, name, depth, kind, hull_depth)


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


def _holds_anyhow(pose: PoseTarget, one: _InFrame, shape: ExactShape, other: ExactShape) -> bool:
    """Whether a body of the frame is in something for every rotation.

    The body's point nearest to the frame's origin, or the ball about the origin that lies in the body, is in it when
    the target is deeper in it than that point is far (or nearer to it than the ball reaches).
    """
    away = -_depth_of(np.linalg.inv(one.pose_frame_joint)[:3, 3], shape)
    return _depth_of(pose.position, other) > away + shift(pose) + EXACT_ROUNDING_M


def _depth_of(point: Float[np.ndarray, "3"], shape: ExactShape) -> float:
    """How deep a point is in a shape, negative outside [m]."""
    at = np.eye(4)
    at[:3, 3] = point
    return ExactShape(coal.Capsule(POINT, 0.0), at, True).depth_in(shape)
