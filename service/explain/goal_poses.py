"""Links that given poses of a goal put into obstacles, or into each other, whatever the rest of the robot does."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import combinations

import coal
import numpy as np
from jaxtyping import Float

from costs.kinematics import frame_of
from costs.robot import LinkBody, RobotModel
from costs.scene import ConvexPiece
from service.body.whole_body import WholeBody
from service.start.exact import EXACT_ROUNDING_M, ExactShape
from service.start.overlaps import Overlap
from service.verify import PoseTarget

POINT = 1e-9  # radius of the ball that stands for a point [m]


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


def given_poses(body: WholeBody, poses: Sequence[PoseTarget]) -> Iterator[Finding]:
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
