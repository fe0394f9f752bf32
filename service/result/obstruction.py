"""The requested end of a motion that was not found, as JSON data, with the pieces that overlap the robot there."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import coal
import numpy as np
from jaxtyping import Float

from costs.kinematics import KinematicsEngine, locate_frame, locate_links
from costs.robot import RobotModel
from costs.scene import Scene
from service.body.whole_body import Aims, WholeBody
from service.demands.targets import make_goal_rotation
from service.result.motion_json import file_positions
from service.result.phase_json import read_rotation, targets_json, write_rotation
from service.setup.prepare import PlanSetup
from service.start.overlaps import find_overlaps
from service.tasks.reach.goal import Goal
from service.verify import CircleTarget, JointTarget, PoseTarget, Target
from service.verify.solids import make_coal_convex

if TYPE_CHECKING:
    from service.trajopt import Program

FREE = np.full(3, np.inf)


@dataclass(frozen=True)
class _End:
    """Requested end of a motion.

    Attributes:
        targets: targets of frames and joints.
        q: (n,) requested configuration, other joints as at the start; None if no joint is requested.
        poses: frame, pose in the world (4, 4), and whether its orientation is requested; else it is the start's.
    """

    targets: tuple[Target, ...] = ()
    q: Float[np.ndarray, "n"] | None = None
    poses: tuple[tuple[str, Float[np.ndarray, "4 4"], bool], ...] = ()


def describe_obstruction(setup: PlanSetup) -> dict[str, Any] | None:
    """Return ``obstruction`` of ``result.json`` (docs/result-format.md); None if the request names no end."""
    robot, planted = setup.robot, tuple(setup.soles)
    end = _get_end(setup)
    if end is None:
        return None
    poses: dict[str, np.ndarray] = {}
    overlaps: list[dict[str, Any]] = []
    if end.q is not None:
        poses |= locate_links(KinematicsEngine(robot), end.q, sorted({body.link for body in robot.bodies}))
        hits = find_overlaps(robot, end.q, setup.scene, planted)
        overlaps += [{"link": hit.link, "other": hit.other, "depth_m": hit.depth} for hit in hits]
    for frame, pose, is_oriented in end.poses:
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


def _get_end(setup: PlanSetup) -> _End | None:
    request, robot = setup.request, setup.robot
    if request.goal is not None:
        body = WholeBody.standing(robot, setup.scene, setup.start, setup.contacts, Aims())
        goal = Goal.of(body, request.goal)
        poses = [(pose.link, np.array(pose.position), make_goal_rotation(pose)) for pose in goal.request.poses]
        q = goal.apply_joints(setup.start) if goal.joints else None
        return _End(goal.targets(0.0), q, _complete_poses(setup, poses))
    if setup.program is not None:
        return _get_program_end(setup, setup.program)
    valve = None if request.task is None else request.task.valve
    if valve is not None and valve.centre is not None and valve.axis is not None:
        radius = valve.radius if valve.lever is None else valve.lever.length_m
        if radius is not None:
            axis = np.array(valve.axis) / np.linalg.norm(valve.axis)
            return _End((CircleTarget("rim", np.array(valve.centre), axis, radius, 0.0),))
    return None


def _get_program_end(setup: PlanSetup, program: Program) -> _End:
    """Return the first fixed waypoint after the start that overlaps something, else the last, and pose constraints."""
    from service.trajopt.problem import PoseTerm  # slow to import

    fixed = [q for step, q in sorted(program.fixed.items()) if step]
    hit = [q for q in fixed if find_overlaps(setup.robot, q, setup.scene, tuple(setup.soles))]
    poses = [
        (term.frame, np.array(term.xyz), read_rotation(term.wxyz) if all(term.rot_coeffs) else None)
        for term in program.problem.terms
        if isinstance(term, PoseTerm) and not term.is_cost and term.reference is None and not any(term.offset_xyz)
    ]
    targets: list[Target] = [PoseTarget(frame, place, turn, FREE, FREE, 0.0) for frame, place, turn in poses]
    shown = [*hit[:1], *fixed[-1:]]
    if not shown:
        return _End(tuple(targets), None, _complete_poses(setup, poses))
    q = shown[0]
    names = setup.robot.joint_names
    targets += [JointTarget(names[column], float(q[column]), 0.0, 0.0) for column in program.columns.tolist()]
    return _End(tuple(targets), q)


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
