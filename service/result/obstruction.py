"""Where a motion that was never planned should have ended, as plain data: to be drawn beside what stands in the way."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import coal
import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from costs.kinematics import KinematicsEngine, locate_frame, locate_links
from costs.robot import RobotModel
from costs.scene import Scene
from service.body.whole_body import Aims, WholeBody
from service.demands.targets import make_goal_rotation
from service.result.motion_json import file_positions
from service.result.phase_json import targets_json
from service.setup.prepare import PlanSetup
from service.start.overlaps import find_overlaps
from service.tasks.goal import Goal
from service.verify import CircleTarget, JointTarget, PoseTarget, Target
from service.verify.solids import make_coal_convex

FREE = np.full(3, np.inf)


@dataclass(frozen=True)
class _End:
    """What was asked of the end.

    Attributes:
        targets: of frames and joints.
        q: (n,) the configuration asked for, joints that are not given as at the start; None where no joint is given.
        poses: frame, pose in the world (4, 4), and whether its orientation was asked for; else it is the start's.
    """

    targets: tuple[Target, ...] = ()
    q: Float[np.ndarray, "n"] | None = None
    poses: tuple[tuple[str, Float[np.ndarray, "4 4"], bool], ...] = ()


def describe_obstruction(setup: PlanSetup) -> dict[str, Any] | None:
    """What a result without a motion shows of its goal; None where the request names no end.

    Keys: ``targets`` as in a result's phases; ``configuration``, a row of the trajectory's columns, or null;
    ``links``, where links are drawn at the goal; ``overlaps``, what they are in there, with the depth [m], which is
    null where the orientation is free.
    """
    robot, planted = setup.robot, tuple(setup.soles)
    end = _end_of(setup)
    if end is None:
        return None
    placed: dict[str, np.ndarray] = {}
    found: list[dict[str, Any]] = []
    if end.q is not None:
        placed |= locate_links(KinematicsEngine(robot), end.q, sorted({body.link for body in robot.bodies}))
        inside = find_overlaps(robot, end.q, setup.scene, planted)
        found += [{"link": one.link, "other": one.other, "depth_m": one.depth} for one in inside]
    for frame, pose, is_turned in end.poses:
        carried = _carried(robot, frame, pose)
        placed |= carried
        found += _inside(robot, setup.scene, carried, planted, is_turned)
    return {
        "targets": targets_json(end.targets, np.zeros(1)),
        "configuration": None if end.q is None else file_positions(robot, end.q[None])[0].tolist(),
        "links": [{"link": link, **_pose_json(pose)} for link, pose in sorted(placed.items())],
        "overlaps": found,
    }


def _end_of(setup: PlanSetup) -> _End | None:
    request, robot = setup.request, setup.robot
    if request.goal is not None:
        body = WholeBody.standing(robot, setup.scene, setup.start, setup.contacts, Aims())
        goal = Goal.of(body, request.goal)
        poses = [(one.link, np.array(one.position), make_goal_rotation(one)) for one in goal.request.poses]
        q = goal.apply_joints(setup.start) if goal.joints else None
        return _End(goal.targets(0.0), q, _turned_as_at_start(setup, poses))
    if setup.program is not None:
        return _end_of_program(setup)
    valve = None if request.task is None else request.task.valve
    if valve is not None and valve.centre is not None and valve.axis is not None and valve.radius is not None:
        axis = np.array(valve.axis) / np.linalg.norm(valve.axis)
        return _End((CircleTarget("rim", np.array(valve.centre), axis, valve.radius, 0.0),))
    return None


def _end_of_program(setup: PlanSetup) -> _End:
    """The first fixed waypoint after the start that is in something, else the last; and the poses it asks for."""
    from service.trajopt.problem import PoseTerm  # takes a while, and few requests need it

    program = setup.program
    if program is None:
        return _End()
    fixed = [q for step, q in sorted(program.fixed.items()) if step]
    hit = [q for q in fixed if find_overlaps(setup.robot, q, setup.scene, tuple(setup.soles))]
    poses = [
        (term.frame, np.array(term.xyz), _rotation(term.wxyz) if all(term.rot_coeffs) else None)
        for term in program.problem.terms
        if isinstance(term, PoseTerm) and not term.is_cost and term.reference is None and not any(term.offset_xyz)
    ]
    targets: list[Target] = [PoseTarget(frame, place, turn, FREE, FREE, 0.0) for frame, place, turn in poses]
    shown = [*hit[:1], *fixed[-1:]]
    if not shown:
        return _End(tuple(targets), None, _turned_as_at_start(setup, poses))
    q = shown[0]
    names = setup.robot.joint_names
    targets += [JointTarget(names[column], float(q[column]), 0.0, 0.0) for column in program.columns.tolist()]
    return _End(tuple(targets), q)


def _turned_as_at_start(
    setup: PlanSetup, poses: Sequence[tuple[str, np.ndarray, np.ndarray | None]]
) -> tuple[tuple[str, Float[np.ndarray, "4 4"], bool], ...]:
    """Each frame's pose, with the start's orientation where none is asked for."""
    frames = sorted({frame for frame, *_ in poses})
    now = locate_links(KinematicsEngine(setup.robot), setup.start, frames)
    found = []
    for frame, position, rotation in poses:
        pose = now[frame].copy()
        pose[:3, 3] = position
        if rotation is not None:
            pose[:3, :3] = rotation
        found.append((frame, pose, rotation is not None))
    return tuple(found)


def _carried(robot: RobotModel, frame: str, pose: Float[np.ndarray, "4 4"]) -> dict[str, np.ndarray]:
    """World poses of the links with bodies that are rigidly connected with a frame, which is at a pose."""
    joint, pose_joint_frame = locate_frame(robot, frame)
    pose_world_joint = pose @ np.linalg.inv(pose_joint_frame)
    links = {body.link for body in robot.bodies if body.joint == joint > 0}
    return {link: pose_world_joint @ locate_frame(robot, link)[1] for link in links}


def _inside(
    robot: RobotModel, scene: Scene, placed: dict[str, np.ndarray], planted: Sequence[str], is_turned: bool
) -> Iterator[dict[str, Any]]:
    """Pairs of a placed link and a piece that overlap, each once."""
    here, deepest = coal.Transform3s(), dict[tuple[str, str], float]()
    for body in robot.bodies:
        if body.link not in placed or body.link in planted:
            continue
        pose = placed[body.link] @ np.linalg.inv(locate_frame(robot, body.link)[1])
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
        yield {"link": link, "other": other, "depth_m": depth if is_turned else None}


def _pose_json(pose: Float[np.ndarray, "4 4"]) -> dict[str, Any]:
    quaternion = Rotation.from_matrix(pose[:3, :3]).as_quat(scalar_first=True, canonical=True)
    return {"position": pose[:3, 3].tolist(), "quaternion_wxyz": quaternion.tolist()}


def _rotation(wxyz: Sequence[float]) -> Float[np.ndarray, "3 3"]:
    return np.asarray(Rotation.from_quat(wxyz, scalar_first=True).as_matrix())
