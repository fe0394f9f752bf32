"""Reasons why no motion can reach a goal, valid for every configuration that keeps the stance.

Each reason is a sufficient condition, by the shapes as they were given. A goal without one may still be out of reach.
Where only the hulls that replace round shapes overlap, a motion may exist, but none can be certified.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import combinations

import coal
import numpy as np
from jaxtyping import Bool, Float

from costs.kinematics import locate_frame, locate_links
from costs.robot import BASE_NAMES, LinkBody, RobotModel
from costs.scene import ConvexPiece
from service.body.whole_body import WholeBody
from service.explain.distance import find_never_kept, find_out_of_reach, find_too_far_apart, position_slack
from service.explain.regions import find_contradicting_regions, find_regions_out_of_reach
from service.start.overlaps import EXACT_ROUNDING_M, ExactShape, Overlap, find_overlaps_and_unresolved
from service.verify import JointTarget, PoseTarget, Target, limits_rotation

SAME_STANCE = 1e-3  # largest difference of the base poses that two planted links give [m, rad]
STANCE_PLAY = 1e-2  # largest displacement of a link within the tolerance of the planted links [m]
POINT = 1e-9  # radius of the ball that stands for a point [m]


@dataclass(frozen=True)
class GoalReasons:
    """Reasons against a goal that are known before planning, in sentences.

    Attributes:
        impossible: reasons that hold for every motion.
        unresolved: overlaps of the hulls alone, for every posture of the rest of the robot: a motion may exist, and no
            plan made of these hulls can be certified.
        notes: overlaps at the goal's nominal pose that its tolerance may avoid.
    """

    impossible: tuple[str, ...]
    unresolved: tuple[str, ...]
    notes: tuple[str, ...] = ()


class OverlapScope(Enum):
    """For which motions and shapes a goal puts a link into something."""

    INSIDE = "inside"  # given shapes, every motion that ends at the goal
    HULLS_ONLY = "hulls only"  # hulls alone, every such motion
    TOLERANCE = "tolerance"  # given shapes at the nominal goal; perhaps not within its tolerance


@dataclass(frozen=True)
class GoalOverlap:
    """An overlap that a goal leads to, in words."""

    text: str
    scope: OverlapScope


def find_goal_reasons(body: WholeBody, targets: Sequence[Target]) -> GoalReasons:
    """Return the reasons against a goal, given the verifier's targets of the motion's end."""
    poses = [target for target in targets if isinstance(target, PoseTarget)]
    joints = {target.joint: target.value for target in targets if isinstance(target, JointTarget)}
    overlaps = [*_check_joints(body, joints), *_check_poses(body, poses)]
    in_collision = [f"the goal is in collision: {o.text}" for o in overlaps if o.scope is OverlapScope.INSIDE]
    return GoalReasons(
        (
            *_find_beyond_reach(body, poses),
            *find_regions_out_of_reach(body, targets),
            *in_collision,
            *find_never_kept(body, targets),
            *find_contradicting_regions(body, targets),
        ),
        tuple(f"the goal is too near to plan to: {o.text}" for o in overlaps if o.scope is OverlapScope.HULLS_ONLY),
        tuple(f"{o.text}; only its tolerance can free it" for o in overlaps if o.scope is OverlapScope.TOLERANCE),
    )


def _find_beyond_reach(body: WholeBody, poses: Sequence[PoseTarget]) -> Iterator[str]:
    for pose in poses:
        reason = find_out_of_reach(body, pose.frame, pose.position, position_slack(pose))
        if reason is not None:
            yield reason
    for first, second in combinations(poses, 2):
        reason = find_too_far_apart(body.robot, first, second)
        if reason is not None:
            yield reason


def _check_joints(body: WholeBody, joints: Mapping[str, float]) -> Iterator[GoalOverlap]:
    """Yield pairs that overlap at the goal's joint positions for all positions of the other joints.

    The certificate's own tolerance bounds how far a motion may end from these positions; they are taken as exact.
    """
    robot = body.robot
    given = np.array([name in joints for name in robot.joint_names])
    if not given.any():
        return
    end = body.nominal.copy()
    for name, value in joints.items():
        end[robot.joint_names.index(name)] = value
    known = given.copy()
    base = _find_standing_base(body, end, given)
    if base is not None:
        end[: len(BASE_NAMES)], known[: len(BASE_NAMES)] = base, True
    supports = body.engine.topology.supports
    joint_of = {member.link: member.joint for member in robot.bodies}
    inside, near = find_overlaps_and_unresolved(robot, end, body.scene, [foot.link for foot in body.planted])
    for overlap in (*inside, *near):
        chain = supports[joint_of[overlap.link]]
        if overlap.kind is None:
            chain = chain ^ supports[joint_of[overlap.other]]
        depth = overlap.depth if overlap.depth > 0.0 else overlap.hull_depth
        rests_on_stance = bool((chain & ~given).any())
        if (chain & ~known).any() or (rests_on_stance and depth <= STANCE_PLAY):
            continue
        scope = OverlapScope.INSIDE if overlap in inside else OverlapScope.HULLS_ONLY
        text = str(overlap) if overlap in inside else overlap.nearness
        yield GoalOverlap(text if given.all() else f"{text}, wherever the other joints are", scope)


def _find_standing_base(
    body: WholeBody, q: Float[np.ndarray, "n"], given: Bool[np.ndarray, "n"]
) -> Float[np.ndarray, "6"] | None:
    """Return the base coordinates that planted links and given leg joints fix; None where they do not."""
    from scipy.spatial.transform import Rotation  # slow to import

    robot = body.robot
    if not robot.is_floating:
        return None
    bases: list[np.ndarray] = []
    for foot in body.planted:
        chain = body.engine.topology.supports[locate_frame(robot, foot.link)[0]].copy()
        chain[: len(BASE_NAMES)] = False
        if (chain & ~given).any():
            continue
        at_zero = q.copy()
        at_zero[: len(BASE_NAMES)] = 0.0
        pose_base_foot = locate_links(body.engine, at_zero, [foot.link])[foot.link]
        pose = foot.pose_world_link @ np.linalg.inv(pose_base_foot)
        bases.append(np.concatenate([pose[:3, 3], Rotation.from_matrix(pose[:3, :3]).as_euler("ZYX")]))
    if not bases or any(np.abs(other - bases[0]).max() > SAME_STANCE for other in bases[1:]):
        return None
    return bases[0]


@dataclass(frozen=True)
class _CarriedBody:
    """A body that a goal's frame carries, with the pose of its joint in that frame."""

    body: LinkBody
    pose_frame_joint: Float[np.ndarray, "4 4"]

    @property
    def reach(self) -> float:
        """Distance of the body's farthest point from the frame's origin [m]."""
        pose = self.pose_frame_joint
        return float(np.linalg.norm(self.body.vertices @ pose[:3, :3].T + pose[:3, 3], axis=1).max())

    def play(self, pose: PoseTarget) -> float:
        """Return the largest distance of a point from its place at the target [m]; infinite with a free rotation."""
        return position_slack(pose) + _rotation_slack(pose) * self.reach + EXACT_ROUNDING_M

    def pose_of_joint(self, pose: PoseTarget) -> Float[np.ndarray, "4 4"]:
        """Return the joint's pose with the frame at its target."""
        pose_world_frame = np.eye(4)
        pose_world_frame[:3, :3] = np.eye(3) if pose.rotation is None else pose.rotation
        pose_world_frame[:3, 3] = pose.position
        return np.asarray(pose_world_frame @ self.pose_frame_joint)


def _check_poses(body: WholeBody, poses: Sequence[PoseTarget]) -> Iterator[GoalOverlap]:
    """Yield overlaps of links at a target pose with pieces, fixed links, and links at another target pose."""
    robot, planted = body.robot, {foot.link for foot in body.planted}
    fixed: list[LinkBody | ConvexPiece] = [*body.scene.pieces, *(link for link in robot.bodies if link.joint == 0)]
    boxes = [(obstacle.vertices.min(axis=0), obstacle.vertices.max(axis=0)) for obstacle in fixed]
    carried = [[c for c in _list_carried(robot, pose.frame) if c.body.link not in planted] for pose in poses]
    for pose, members in zip(poses, carried, strict=True):
        for member in members:
            for obstacle, (lower, upper) in zip(fixed, boxes, strict=True):
                if np.linalg.norm(pose.position - np.clip(pose.position, lower, upper)) > member.reach:
                    continue  # out of reach for every rotation
                if _is_checked(robot, member.body, obstacle):
                    yield from _overlap_fixed(pose, member, obstacle)
    for (pose, members), (other_pose, other_members) in combinations(zip(poses, carried, strict=True), 2):
        for member in members:
            for other in other_members:
                near = np.linalg.norm(pose.position - other_pose.position) <= member.reach + other.reach
                if near and member.body.joint != other.body.joint and _is_checked(robot, member.body, other.body):
                    yield from _overlap_carried(pose, member, other_pose, other)


def _list_carried(robot: RobotModel, frame: str) -> list[_CarriedBody]:
    """Return the bodies that a frame carries; none where no joint moves it."""
    joint, pose_joint_frame = locate_frame(robot, frame)
    pose_frame_joint = np.linalg.inv(pose_joint_frame)
    return [_CarriedBody(member, pose_frame_joint) for member in robot.bodies if member.joint == joint > 0]


def _is_checked(robot: RobotModel, body: LinkBody, other: LinkBody | ConvexPiece) -> bool:
    return isinstance(other, ConvexPiece) or (min(body.link, other.link), max(body.link, other.link)) not in (
        robot.ignored_pairs
    )


def _overlap_fixed(pose: PoseTarget, member: _CarriedBody, other: LinkBody | ConvexPiece) -> Iterator[GoalOverlap]:
    """Yield at most one overlap: of the shapes if they overlap, else of their hulls."""
    at, overlap = np.round(pose.position, 3).tolist(), None
    if pose.rotation is not None:
        overlap = _overlap(member.body, other, member.play(pose), member.pose_of_joint(pose), np.eye(4))
        if overlap is not None and overlap.scope is not OverlapScope.TOLERANCE:
            yield GoalOverlap(f"with {pose.frame} at {at}, turned as requested, {overlap.text}", overlap.scope)
            return
    if _overlaps_anyhow(pose, member, ExactShape.of_hull(member.body), ExactShape.of_hull(other)):
        how = f"with {pose.frame} at {at}, however it is turned, {member.body.link} is"
        if _overlaps_anyhow(pose, member, ExactShape.of(member.body), ExactShape.of(other)):
            yield GoalOverlap(f"{how} {_name_overlap(member.body, other, 0.0, 0.0).where}", OverlapScope.INSIDE)
        else:
            name = other.link if isinstance(other, LinkBody) else other.name
            yield GoalOverlap(f"{how} nearer to {name} than the planner's hulls resolve", OverlapScope.HULLS_ONLY)
    elif overlap is not None:
        yield GoalOverlap(f"with {pose.frame} at {at}, turned as requested, {overlap.text}", overlap.scope)


def _overlap_carried(
    pose: PoseTarget, member: _CarriedBody, other_pose: PoseTarget, other: _CarriedBody
) -> Iterator[GoalOverlap]:
    """Yield at most one overlap of bodies at two target poses."""
    if pose.rotation is None or other_pose.rotation is None:
        return
    play = member.play(pose) + other.play(other_pose)
    poses = member.pose_of_joint(pose), other.pose_of_joint(other_pose)
    overlap = _overlap(member.body, other.body, play, *poses)
    if overlap is not None:
        at = [np.round(each.position, 3).tolist() for each in (pose, other_pose)]
        how = f"with {pose.frame} at {at[0]} and {other_pose.frame} at {at[1]}, turned as requested,"
        yield GoalOverlap(f"{how} {overlap.text}", overlap.scope)


def _overlap(
    body: LinkBody,
    other: LinkBody | ConvexPiece,
    play: float,
    pose: Float[np.ndarray, "4 4"],
    pose_other: Float[np.ndarray, "4 4"],
) -> GoalOverlap | None:
    """Return the overlap of a body at a target whose points may be off by as much as the play [m].

    A convex body cannot leave one it is ``d`` deep in while all of its points move by less than ``d``.
    """
    hull_depth = ExactShape.of_hull(body).depth_in(ExactShape.of_hull(other), pose, pose_other)
    if hull_depth <= EXACT_ROUNDING_M:
        return None
    depth = min(ExactShape.of(body).depth_in(ExactShape.of(other), pose, pose_other), hull_depth)
    overlap = _name_overlap(body, other, depth, hull_depth)
    if depth > play:
        return GoalOverlap(str(overlap), OverlapScope.INSIDE)
    if hull_depth > play:
        return GoalOverlap(overlap.nearness, OverlapScope.HULLS_ONLY)
    return GoalOverlap(str(overlap), OverlapScope.TOLERANCE) if depth > EXACT_ROUNDING_M else None


def _name_overlap(body: LinkBody, other: LinkBody | ConvexPiece, depth: float, hull_depth: float) -> Overlap:
    name, kind = (other.link, "") if isinstance(other, LinkBody) else (other.name, other.kind)
    return Overlap(body.link, name, depth, kind, hull_depth)


def _rotation_slack(pose: PoseTarget) -> float:
    """Return the largest rotation of the frame from its target [rad]; pi where any will do."""
    return min(float(pose.rotation_tolerance[0]), float(np.pi)) if limits_rotation(pose) else float(np.pi)


def _overlaps_anyhow(pose: PoseTarget, member: _CarriedBody, shape: ExactShape, other: ExactShape) -> bool:
    """Return whether a body of the frame overlaps another for every rotation.

    That holds when the target is deeper in the other than the body's nearest point is from the frame's origin, or
    nearer to it than the radius of the ball about the origin that lies in the body.
    """
    away = -_depth_of(np.linalg.inv(member.pose_frame_joint)[:3, 3], shape)
    return _depth_of(pose.position, other) > away + position_slack(pose) + EXACT_ROUNDING_M


def _depth_of(point: Float[np.ndarray, "3"], shape: ExactShape) -> float:
    """Return the depth of a point in a shape, negative outside [m]."""
    at = np.eye(4)
    at[:3, 3] = point
    return ExactShape(coal.Capsule(POINT, 0.0), at, True).depth_in(shape)
