"""Steps of a request as phases: the only place where fields of a step get a meaning.

The planner makes each phase at the configuration that it has reached, the verifier at the one that a record has there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np
import pinocchio as pin
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from costs.allowance import Allowance, BodyRef
from costs.guide import Guide
from costs.robot import BASE_NAMES, RobotModel
from costs.rotation import quaternion_matrix, turn_towards
from costs.work_space import borrow_data
from service.demands.grasping.gripper import Gripper
from service.demands.hands import list_robot_hands
from service.demands.regions import find_axis
from service.demands.steps.extent import NamedStep
from service.demands.steps.faces import UP, find_middle, lean_tool, list_places, point_along
from service.demands.steps.holding import Holding
from service.demands.steps.objects import Taking, list_grasp, list_release, make_fit
from service.demands.steps.phases import Led, PhaseMaker, StepPhase
from service.demands.targets import make_pose_goal
from service.errors import RequestError, would_do
from service.request.fields import HAND_FRICTION
from service.request.tasks.reach import GoalRequest, PoseGoalRequest
from service.request.tasks.steps import (
    BodyStep,
    FollowStep,
    MoveStep,
    ScrewStep,
    ShiftRequest,
    TouchStep,
)
from service.verify import HAND_DRIFT_M, WORLD, HandLoad

UPRIGHT_GROUP = "upright"
Company = tuple[frozenset[str], ...]
"""Frames that move as one: objects and the hands that hold them."""

STEEPEST_DEG = float(np.rad2deg(np.arctan(HAND_FRICTION[0])))  # lean of a tool that is pressed onto a face
OFF_FACE_M = 1e-4  # tolerance of where a line to a face begins
LEVEL_DEG = 0.03  # of an object above the place where it is put: beyond it touches with an edge, which holds no weight


def compile_step(
    holding: Holding,
    named: NamedStep,
    taking: Taking | None = None,
    released: tuple[Gripper, ...] = (),
) -> tuple[PhaseMaker, ...]:
    """Return the phases of a step, with who carries the objects in them.

    Args:
        holding: at its beginning; of a release with the object carried by the world already.
        named: the step.
        taking: the hands of a grasp.
        released: the hands of a release.

    Raises:
        RequestError: the robot has no such hand, frame or link.
    """
    makers, lands = _list_makers(holding, named, taking, released), named.lands
    return tuple(
        PhaseMaker(
            maker.name,
            partial(
                _carry,
                maker,
                holding if number == 0 else holding.settle(),
                (lands,) if lands is not None and number == len(makers) - 1 else (),
            ),
        )
        for number, maker in enumerate(makers)
    )


def _carry(maker: PhaseMaker, holding: Holding, lands: tuple[str, ...], q: Float[np.ndarray, "n"]) -> StepPhase:
    """Return a phase with the carriers of the objects; fingers that hold one stay as they are."""
    made = maker.make(q)
    fingers = {joint for hold in holding.held.values() for joint in hold.fingers}
    locked = (*made.locked, *sorted(fingers - set(made.locked)))
    straight = {joint: value for joint, value in made.straight.items() if joint not in fingers}
    goal = made.goal
    if goal is not None and not goal.poses and fingers:
        values = goal.joints if goal.posture is None else _read_posture(holding.robot, goal.posture)
        goal = GoalRequest(joints={joint: value for joint, value in values.items() if joint not in fingers})
    return replace(made, holding=holding, lands=lands, locked=locked, straight=straight, goal=goal)


def _list_makers(
    holding: Holding, named: NamedStep, taking: Taking | None, released: tuple[Gripper, ...]
) -> tuple[PhaseMaker, ...]:
    step, name = named.step, named.name
    robot, company = holding.placed, holding.list_company()
    for own in (step.move, step.screw, step.touch):
        if own is not None and (own.hand or own.frame):
            find_frames(robot, own.hand, own.frame)
    if step.body is not None and not robot.is_floating:
        raise RequestError(f"body: the base of '{robot.name}' is fixed; a step of the body needs a robot on feet")
    if step.move is not None:
        level = tuple(group for group in company if group & named.sets_down)
        return (PhaseMaker(name, partial(_make_move, robot, company, level, step.move, name)),)
    if step.screw is not None:
        return (PhaseMaker(name, partial(_make_screw, robot, company, step.screw, name)),)
    if step.follow is not None:
        return tuple(_list_follow(robot, company, step.follow, name))
    if step.touch is not None:
        return (PhaseMaker(name, partial(_make_touch, robot, company, step.touch, name)),)
    if step.body is not None:
        return (PhaseMaker(name, partial(_make_body, robot, step.body, name)),)
    if step.grasp is not None and taking is not None:
        return tuple(list_grasp(holding, step.grasp, name, taking))
    if step.release is not None:
        return tuple(list_release(holding, step.release, name, released))
    if step.fit is not None:
        return (PhaseMaker(name, partial(make_fit, holding, step.fit, name)),)
    return ()


def find_frames(robot: RobotModel, hand: str | None, frame: str | None) -> tuple[str, ...]:
    """Return the frames of a step's hand or hands, or its frame.

    Raises:
        RequestError: the robot has no such hand or frame.
    """
    if frame is not None:
        _check_frame(robot, frame)
        return (frame,)
    tools = _map_tools(robot)
    sides = ("left", "right") if hand == "both" else (str(hand),)
    missing = [side for side in sides if side not in tools]
    if missing:
        raise RequestError(
            f"robot '{robot.name}' has no {missing[0]} hand; name a frame of the robot, or give robot.hands"
        )
    return tuple(tools[side] for side in sides)


def _check_frame(robot: RobotModel, frame: str) -> None:
    if not robot.model.existFrame(frame):
        known = [own.name for own in robot.model.frames if own.type == pin.FrameType.BODY]
        raise RequestError(f"unknown frame '{frame}'; {robot.name} has {would_do(frame, known)}")


def _map_tools(robot: RobotModel) -> Mapping[str, str]:
    """Return the tool frames by side."""
    return {hand.side: hand.tool for hand in list_robot_hands(robot) if robot.model.existFrame(hand.tool)}


def locate(robot: RobotModel, q: Float[np.ndarray, "n"], frame: str) -> Float[np.ndarray, "4 4"]:
    """Return pose_world_frame at a configuration."""
    data = borrow_data(robot.model)
    pin.framesForwardKinematics(robot.model, data, q)
    return np.array(data.oMf[robot.model.getFrameId(frame)].homogeneous)


def list_carriers(robot: RobotModel, frame: str) -> frozenset[str]:
    """Return the joints that carry a frame, a floating base aside."""
    joint = int(robot.model.frames[robot.model.getFrameId(frame)].parentJoint)
    names = set()
    while joint > 0:
        own = robot.model.joints[joint]
        names |= set(robot.joint_names[own.idx_v : own.idx_v + own.nv])
        joint = int(robot.model.parents[joint])
    return frozenset(names - set(BASE_NAMES))


def _keep_others(
    robot: RobotModel, company: Company, q: Float[np.ndarray, "n"], frames: tuple[str, ...], how: str
) -> dict[str, tuple[object, ...]]:
    """Return what the hands that do not move keep: poses or joints."""
    frames = (*frames, *(name for group in company if group & set(frames) for name in group - set(frames)))
    others = [tool for tool in _map_tools(robot).values() if tool not in frames]
    if how == "free" or not others or not set(frames) & set(_map_tools(robot).values()):
        return {}
    if how == "keep":
        return {"kept": tuple((frame, locate(robot, q, frame)) for frame in others)}
    moving = frozenset().union(*(list_carriers(robot, frame) for frame in frames))
    locked = set().union(*(list_carriers(robot, frame) for frame in others)) - moving
    return {"locked": tuple(name for name in robot.joint_names if name in locked)}


def _read_free(free_axis: str) -> dict[str, object]:
    if free_axis == "all":
        return {"turns_freely": True}
    return {"free_axis": find_axis(free_axis)}


def _read_limits(step: MoveStep | ScrewStep | TouchStep | FollowStep) -> dict[str, float | None]:
    return {
        "tolerance_m": step.tolerance_m,
        "rotation_tolerance_rad": float(np.deg2rad(step.rotation_tolerance_deg)),
        "speed_m_s": step.speed_m_s,
    }


def _shift_guide(pose: Float[np.ndarray, "4 4"], by: ShiftRequest) -> Guide:
    """Return the straight way of a shift from a pose on."""
    axes = pose[:3, :3] if by.axes == "hand" else np.eye(3)
    turn = Rotation.from_euler("xyz", by.rotation_deg, degrees=True).as_rotvec()
    return Guide.line(pose[:3, 3], pose[:3, :3], axes @ np.asarray(by.translation), axes @ turn)


def _make_move(
    robot: RobotModel, company: Company, level: Company, move: MoveStep, name: str, q: Float[np.ndarray, "n"]
) -> StepPhase:
    """Return a motion to joints or poses; what it brings above a place where it is put (``level``) is level there."""
    moving = find_frames(robot, move.hand, move.frame) if move.hand or move.frame else ()
    frames = moving or tuple(pose.link for pose in move.poses)
    base = StepPhase(name, duration_s=move.duration_s)
    if moving:
        base = replace(base, **_keep_others(robot, company, q, moving, move.other_hand))  # type: ignore[arg-type]
    if move.joints or move.posture is not None:
        goal = GoalRequest(joints=move.joints, posture=move.posture)
        if not move.along.startswith("joint"):
            return replace(base, goal=goal)
        profile = {"joint_linear": "any", "joint_cubic": "cubic", "joint_quintic": "quintic"}[move.along]
        values = dict(move.joints) or _read_posture(robot, str(move.posture))
        return replace(base, straight=values, profile=profile)  # type: ignore[arg-type]
    for frame in frames:
        _check_frame(robot, frame)
    poses = {frame: locate(robot, q, frame) for frame in frames}
    guides: dict[str, Guide] = {}
    if move.arc is not None:
        arc = move.arc
        axis, centre = np.asarray(arc.axis, dtype=float), np.asarray(arc.centre, dtype=float)
        for frame, pose in poses.items():
            angle = float(np.deg2rad(arc.angle_deg))
            guides[frame] = Guide.screw(pose[:3, 3], pose[:3, :3], centre, axis, angle, turns=arc.turns)
    elif move.by is not None:
        guides = {frame: _shift_guide(pose, move.by) for frame, pose in poses.items()}
    if move.along == "free":
        if move.poses:
            carried = {name for group in company for name in group} - set(_map_tools(robot).values())
            turned = (_keep_turn(pose, poses[pose.link]) if pose.link in carried else pose for pose in move.poses)
            return replace(base, goal=GoalRequest(poses=tuple(_bring_level(pose, level) for pose in turned)))
        ends = {frame: guide.poses(np.ones(1))[0] for frame, guide in guides.items()}
        goals = tuple(
            make_pose_goal(frame, pose, move.tolerance_m, move.rotation_tolerance_deg, move.free_axis)
            for frame, pose in ends.items()
        )
        return replace(base, goal=GoalRequest(poses=tuple(_bring_level(pose, level) for pose in goals)))
    free, limits = _read_free(move.free_axis), _read_limits(move)
    if move.poses:
        led = [_lead_to_pose(pose, poses[pose.link], move) for pose in move.poses]
    else:
        led = [Led(frame, guide, **free, **limits) for frame, guide in guides.items()]  # type: ignore[arg-type]
    return replace(base, led=tuple(led))


def _bring_level(pose: PoseGoalRequest, level: Company) -> PoseGoalRequest:
    """Return the pose of a frame, at which what moves along with it is level if it is put down later.

    A region has its own angles.
    """
    if not pose.is_plain or not any(pose.link in group for group in level):
        return pose
    return replace(pose, rotation_tolerance_deg=min(pose.rotation_tolerance_deg, LEVEL_DEG))


def _keep_turn(pose: PoseGoalRequest, at: Float[np.ndarray, "4 4"]) -> PoseGoalRequest:
    """Return the pose of a carried object; one without orientation keeps the one that it has, unless it is a region."""
    if pose.quaternion_wxyz is not None or not pose.is_plain:
        return pose
    w, x, y, z = Rotation.from_matrix(at[:3, :3]).as_quat(scalar_first=True).tolist()
    return replace(pose, quaternion_wxyz=(w, x, y, z))


def _lead_to_pose(pose: PoseGoalRequest, at: Float[np.ndarray, "4 4"], move: MoveStep) -> Led:
    """Return a frame on a line to a pose; a pose without orientation keeps the one that it has."""
    shift = np.asarray(pose.origin) - at[:3, 3]
    free = pose.free_axis if pose.free_axis != "none" else move.free_axis
    turn = np.zeros(3)
    if pose.quaternion_wxyz is not None:
        wanted = quaternion_matrix(pose.quaternion_wxyz)
        axis = None if free == "all" else find_axis(free)
        if axis is not None:
            wanted = turn_towards(wanted[None], at[None, :3, :3], axis)[0]
        turn = Rotation.from_matrix(wanted @ at[:3, :3].T).as_rotvec()
    guide = Guide.line(at[:3, 3], at[:3, :3], shift, turn)
    return Led(pose.link, guide, **_read_free(free), **_read_limits(move))  # type: ignore[arg-type]


def _read_posture(robot: RobotModel, posture: str) -> dict[str, float]:
    values = robot.postures[posture]
    first = len(BASE_NAMES) if robot.is_floating else 0
    return {robot.joint_names[k]: float(values[k]) for k in range(first, len(values))}


def _make_screw(
    robot: RobotModel, company: Company, screw: ScrewStep, name: str, q: Float[np.ndarray, "n"]
) -> StepPhase:
    frames = find_frames(robot, screw.hand, screw.frame)
    led = []
    for frame in frames:
        pose = locate(robot, q, frame)
        axis = np.asarray(screw.axis, dtype=float)
        axis = pose[:3, :3] @ axis if screw.axes == "hand" else axis
        centre = pose[:3, 3] if screw.centre is None else np.asarray(screw.centre, dtype=float)
        angle = float(np.deg2rad(screw.rotation_deg))
        guide = Guide.screw(pose[:3, 3], pose[:3, :3], centre, axis, angle, screw.translation_m)
        limits = _read_limits(screw)
        if screw.rate_deg_s is not None and guide.has_length:
            limits["speed_m_s"] = guide.length * screw.rate_deg_s / abs(screw.rotation_deg)
        led.append(Led(frame, guide, **_read_free(screw.free_axis), **limits))  # type: ignore[arg-type]
    keeping = _keep_others(robot, company, q, frames, screw.other_hand)
    duration = screw.duration_s
    if screw.rate_deg_s is not None and not any(own.guide.has_length for own in led):
        duration = abs(screw.rotation_deg) / screw.rate_deg_s
    return StepPhase(name, tuple(led), duration_s=duration, **keeping)  # type: ignore[arg-type]


def _make_touch(
    robot: RobotModel, company: Company, touch: TouchStep, name: str, q: Float[np.ndarray, "n"]
) -> StepPhase:
    (frame,) = find_frames(robot, touch.hand, touch.frame)
    pose = locate(robot, q, frame)
    way = np.asarray(touch.direction, dtype=float)
    way = way / np.linalg.norm(way)
    way = pose[:3, :3] @ way if touch.axes == "hand" else way
    guide = Guide.line(pose[:3, 3], pose[:3, :3], touch.window_m[1] * way)
    led = Led(frame, guide, **_read_free(touch.free_axis), **_read_limits(touch))  # type: ignore[arg-type]
    depth = touch.window_m[1] - touch.window_m[0]
    touches = _allow(robot, frame, touch.pieces, depth)
    loads = (_make_thrust(frame, guide, touch.force_n * way),)
    keeping = _keep_others(robot, company, q, (frame,), touch.other_hand)
    return StepPhase(name, (led,), touches=touches, loads=loads, **keeping)  # type: ignore[arg-type]


def _allow(robot: RobotModel, frame: str, pieces: tuple[str, ...], depth: float) -> tuple[Allowance, ...]:
    """Return the allowances of the link that carries a frame with pieces [m]."""
    link = find_carrying_link(robot, frame)
    return tuple(Allowance(BodyRef.of_link(link), BodyRef.of_piece(piece), depth) for piece in pieces)


def find_carrying_link(robot: RobotModel, frame: str) -> str:
    """Return the link with a shape that carries a frame: the frame itself if it is one, else the nearest to it."""
    links = {body.link for body in robot.bodies}
    if frame in links:
        return frame
    placed = robot.model.frames[robot.model.getFrameId(frame)]
    own = [body for body in robot.bodies if body.joint == placed.parentJoint]
    if not own:
        raise RequestError(f"no link with a shape carries the frame '{frame}'; name a frame of a tool")
    at = placed.placement.translation
    return min(own, key=lambda body: float(np.linalg.norm(body.vertices - at, axis=1).min())).link


def _make_body(robot: RobotModel, body: BodyStep, name: str, q: Float[np.ndarray, "n"]) -> StepPhase:
    upright = robot.link_groups.get(UPRIGHT_GROUP, ())
    base = next(
        frame.name for frame in robot.model.frames if frame.type == pin.FrameType.BODY and frame.parentJoint == 1
    )
    torsos = [link for link in upright if link != base]
    pose = locate(robot, q, base)
    turn = Rotation.from_euler("xyz", body.pelvis_rpy_deg, degrees=True).as_rotvec()
    led = [Led(base, Guide.line(pose[:3, 3], pose[:3, :3], np.asarray(body.pelvis_m), turn))]
    if torsos:
        torso = locate(robot, q, torsos[-1])
        turn = Rotation.from_euler("xyz", body.torso_rpy_deg, degrees=True).as_rotvec()
        guide = Guide.line(torso[:3, 3], torso[:3, :3], np.zeros(3), turn)
        led.append(Led(torsos[-1], guide, moves_freely=True))
    elif any(body.torso_rpy_deg):
        raise RequestError(f"body.torso_rpy_deg: {robot.name} names no torso in its group '{UPRIGHT_GROUP}'")
    tools = tuple(_map_tools(robot).values())
    if body.hands == "stay":
        kept = tuple((tool, locate(robot, q, tool)) for tool in tools)
        return StepPhase(name, tuple(led), kept=kept, duration_s=body.duration_s)
    trunk = list_carriers(robot, torsos[-1]) if torsos else frozenset()
    arms = set().union(*(list_carriers(robot, tool) for tool in tools)) - trunk if tools else set()
    locked = tuple(joint for joint in robot.joint_names if joint in arms)
    return StepPhase(name, tuple(led), locked=locked, duration_s=body.duration_s)


def _list_follow(robot: RobotModel, company: Company, step: FollowStep, name: str) -> Iterator[PhaseMaker]:
    """Yield the phases of a path on a face: reach, approach, the path, retreat."""
    (frame,) = find_frames(robot, step.hand, step.frame)
    normal = np.asarray(step.face.normal, dtype=float)
    normal = normal / np.linalg.norm(normal)
    axis = lean_tool(-normal, step)
    places = list_places(step, normal)
    off = -step.approach_m * axis

    def begin(q: Float[np.ndarray, "n"]) -> StepPhase:
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = point_along(axis), places[0] + off
        goal = make_pose_goal(frame, pose, OFF_FACE_M, 0.1, "z")
        kept = _keep_others(robot, company, q, (frame,), step.other_hand)
        return StepPhase(f"{name}: reach", goal=GoalRequest(poses=(goal,)), **kept)  # type: ignore[arg-type]

    yield PhaseMaker(f"{name}: reach", begin)
    ways: list[tuple[str, Float[np.ndarray, "3"], Callable[[Float[np.ndarray, "3 3"]], Guide], bool]] = [
        ("approach", places[0] + off, lambda R: Guide.line(places[0] + off, R, -off), False)
    ]
    if step.circle is not None:
        middle, angle = find_middle(step, normal), float(np.deg2rad(step.circle.angle_deg))
        sense = -1.0 if step.circle.sense == "clockwise" else 1.0
        ways.append(
            ("path", places[0], lambda R: Guide.screw(places[0], R, middle, normal, sense * angle, turns=False), True)
        )
    else:
        for number, (first, last) in enumerate(pairwise(places), start=1):
            part = "path" if len(places) == 2 else f"path {number}"
            ways.append((part, first, lambda R, first=first, last=last: Guide.line(first, R, last - first), True))  # type: ignore[misc]
    end = places[-1] if step.circle is None else ways[-1][2](np.eye(3)).positions(np.ones(1))[0]
    ways.append(("retreat", end, lambda R: Guide.line(end, R, off), False))
    touches = _allow(robot, frame, step.face.pieces, max(step.depth_m, 0.0) + step.touch_depth_m)
    if step.thrust_n and step.tilt_deg > STEEPEST_DEG:
        raise RequestError(
            f"follow.tilt_deg: {step.tilt_deg:g} deg with a thrust_n: the tool would slide off; expected at most "
            f"{STEEPEST_DEG:.1f} deg, the angle of friction of {HAND_FRICTION[0]:g}, or no thrust"
        )
    for part, _, guide, is_path in ways:
        yield PhaseMaker(
            f"{name}: {part}",
            lambda q, part=part, guide=guide, is_path=is_path: _make_part(  # type: ignore[misc]
                robot, company, step, f"{name}: {part}", frame, axis, guide, is_path, touches, q
            ),
        )


def _make_part(
    robot: RobotModel,
    company: Company,
    step: FollowStep,
    name: str,
    frame: str,
    axis: Float[np.ndarray, "3"],
    guide: Callable[[Float[np.ndarray, "3 3"]], Guide],
    is_path: bool,
    touches: tuple[Allowance, ...],
    q: Float[np.ndarray, "n"],
) -> StepPhase:
    """Return one line or arc of a path; the tool keeps the turn about its axis, or is free to turn."""
    here = locate(robot, q, frame)[:3, :3]
    rotation = turn_towards(point_along(axis)[None], here[None], UP)[0]
    limits = {**_read_limits(step), **({} if is_path else {"speed_m_s": None})}
    free = UP if step.turn == "free" else None
    led = Led(frame, guide(rotation), free_axis=free, **limits)  # type: ignore[arg-type]
    keeping = _keep_others(robot, company, q, (frame,), step.other_hand)
    loads = (_make_thrust(frame, led.guide, step.thrust_n * axis),) if is_path and step.thrust_n else ()
    return StepPhase(name, (led,), touches=touches, loads=loads, **keeping)  # type: ignore[arg-type]


def _make_thrust(frame: str, guide: Guide, force: Float[np.ndarray, "3"]) -> HandLoad:
    """Return the force of the tool on what it meets, anywhere on its way: about the middle of an arc, or along a line.

    Args:
        frame: of the tool.
        guide: its way.
        force: largest, in the world [N].
    """
    if guide.angle:
        return HandLoad(frame, WORLD, guide.centre, force, None, guide.radius + HAND_DRIFT_M)
    half = 0.5 * guide.shift
    return HandLoad(frame, WORLD, guide.position + half, force, half, HAND_DRIFT_M)
