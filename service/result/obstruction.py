"""The requested end of a motion that was not found, as JSON data, with the pieces that overlap the robot there."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import coal
import numpy as np
from jaxtyping import Float

from costs.kinematics import KinematicsEngine, locate_frame, locate_links
from costs.robot import RobotModel
from costs.scene import Scene
from service.result.motion_json import file_positions
from service.result.phase_json import targets_json, write_rotation
from service.setup.prepare import PlanSetup
from service.start.overlaps import find_overlaps
from service.tasks.kind import find_plan_part
from service.verify import make_coal_convex

if TYPE_CHECKING:
    pass


def describe_obstruction(setup: PlanSetup) -> dict[str, Any] | None:
    """Return ``obstruction`` of ``result.json`` (docs/result-format.md); None if the request names no end."""
    robot, planted = setup.robot, tuple(setup.soles)
    end = find_plan_part(setup.request).get_end(setup.request.section, setup)
    if end is None:
        return None
    poses: dict[str, np.ndarray] = {}
    overlaps: list[dict[str, Any]] = []
    if end.q is not None:
        poses |= locate_links(KinematicsEngine(robot), end.q, sorted({body.link for body in robot.bodies}))
        hits = find_overlaps(robot, end.q, setup.scene, planted)
        overlaps += [{"link": hit.link, "other": hit.other, "depth_m": hit.depth} for hit in hits]
    for frame, pose, is_oriented in _complete_poses(setup, end.poses):
        links = _locate_rigid_links(robot, frame, pose)
        poses |= links
        overlaps += _list_overlaps(robot, setup.scene, links, planted, is_oriented)
    return {
        "targets": targets_json(end.targets, np.zeros(1)),
        "configuration": None if end.q is None else file_positions(robot, end.q[None])[0].tolist(),
        "links": [
            {"link": link, "position": pose[:3, 3].tolist(), "quaternion_wxyz": write_rotation(pose[:3, :3])}
            for link, pose in sorted(poses.items())
        ],
        "overlaps": overlaps,
    }


def _complete_poses(
    setup: PlanSetup, poses: Sequence[tuple[str, np.ndarray, np.ndarray | None]]
) -> tuple[tuple[str, Float[np.ndarray, "4 4"], bool], ...]:
    """Return each frame's pose, with the start's orientation where none is requested."""
    frames = sorted({frame for frame, *_ in poses})
    now = locate_links(KinematicsEngine(setup.robot), setup.start, frames)
    complete = []
    for frame, position, rotation in poses:
        pose = now[frame].copy()
        pose[:3, 3] = position
        if rotation is not None:
            pose[:3, :3] = rotation
        complete.append((frame, pose, rotation is not None))
    return tuple(complete)


def _locate_rigid_links(robot: RobotModel, frame: str, pose: Float[np.ndarray, "4 4"]) -> dict[str, np.ndarray]:
    """Return the world poses of the links with bodies that are rigidly connected to a frame at a pose."""
    joint, pose_joint_frame = locate_frame(robot, frame)
    pose_world_joint = pose @ np.linalg.inv(pose_joint_frame)
    links = {body.link for body in robot.bodies if body.joint == joint > 0}
    return {link: pose_world_joint @ locate_frame(robot, link)[1] for link in links}


def _list_overlaps(
    robot: RobotModel, scene: Scene, poses: dict[str, np.ndarray], planted: Sequence[str], is_oriented: bool
) -> Iterator[dict[str, Any]]:
    """Yield pairs of a located link and a piece that overlap, each once."""
    here, deepest = coal.Transform3s(), dict[tuple[str, str], float]()
    for body in robot.bodies:
        if body.link not in poses or body.link in planted:
            continue
        pose = poses[body.link] @ np.linalg.inv(locate_frame(robot, body.link)[1])
        shape, at = make_coal_convex(body.vertices), coal.Transform3s(pose[:3, :3], pose[:3, 3])
        low, high = (end(body.vertices @ pose[:3, :3].T + pose[:3, 3], axis=0) for end in (np.min, np.max))
        for piece in scene.pieces:
            if np.any(low > piece.upper) or np.any(high < piece.lower):
                continue
            convex = make_coal_convex(piece.vertices)
            depth = -float(coal.distance(shape, at, convex, here, coal.DistanceRequest(), coal.DistanceResult()))
            if depth > 0.0:
                key = (body.link, piece.name)
                deepest[key] = max(depth, deepest.get(key, 0.0))
    for (link, other), depth in sorted(deepest.items(), key=lambda item: -item[1]):
        yield {"link": link, "other": other, "depth_m": depth if is_oriented else None}
