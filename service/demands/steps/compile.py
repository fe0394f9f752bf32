"""Steps of a request as phases: the only place where fields of a step get a meaning.

The planner makes each phase at the configuration that it has reached, the verifier at the one that a record has there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial

import numpy as np
import pinocchio as pin
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from costs.guide import Guide
from costs.robot import BASE_NAMES, RobotModel
from costs.rotation import quaternion_matrix, turn_towards
from service.demands.grasping.gripper import Gripper
from service.demands.regions import find_axis
from service.demands.steps.blends import SHARPEST_RAD, find_turn, round_corner, shorten_line
from service.demands.steps.extent import NamedStep
from service.demands.steps.follow import list_follow
from service.demands.steps.frames import (
    Company,
    allow,
    check_frame,
    find_frames,
    keep_others,
    list_carriers,
    locate,
    make_thrust,
    map_tools,
    read_free,
    read_limits,
)
from service.demands.steps.holding import Holding
from service.demands.steps.objects import Taking, list_grasp, list_release, make_fit
from service.demands.steps.phases import Led, PhaseMaker, StepPhase
from service.demands.targets import make_pose_goal
from service.errors import RequestError
from service.request.tasks.hand_steps import MoveStep, ScrewStep, ShiftRequest, TouchStep
from service.request.tasks.reach import GoalRequest, PoseGoalRequest
from service.request.tasks.steps import BodyStep

UPRIGHT_GROUP = "upright"
CORNER, DOWN = "corner", "down"
ABOVE_M = 0.03  # of an object above the place to which a free motion brings it, before a line leads down
NEARLY_UP = float(np.cos(np.deg2rad(20.0)))  # upward part of a direction up to which it counts as upright
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
                holding if number == 0 else holding.settle(named.waits),
                lands if number == len(makers) - 1 else named.rests,
            ),
        )
        for number, maker in enumerate(makers)
    )


def _carry(maker: PhaseMaker, holding: Holding, lands: tuple[str, ...], q: Float[np.ndarray, "n"]) -> StepPhase:
    """Return a phase with the carriers of the objects; fingers that hold one stay, and so do idle hands."""
    made = maker.make(q)
    made = replace(made, kept=(*made.kept, *_keep_idle(holding, made, q)))
    fingers = {joint for hold in holding.held.values() for joint in hold.fingers}
    locked = (*made.locked, *sorted(fingers - set(made.locked)))
    straight = {joint: value for joint, value in made.straight.items() if joint not in fingers}
    goal = made.goal
    if goal is not None and not goal.poses and fingers:
        values = goal.joints if goal.posture is None else _read_posture(holding.robot, goal.posture)
        goal = GoalRequest(joints={joint: value for joint, value in values.items() if joint not in fingers})
    return replace(made, holding=holding, lands=lands, locked=locked, straight=straight, goal=goal)


def _keep_idle(
    holding: Holding, made: StepPhase, q: Float[np.ndarray, "n"]
) -> Iterator[tuple[str, Float[np.ndarray, "4 4"]]]:
    """Yield the poses of hands that hold something and that a phase says nothing of."""
    goal = made.goal
    if made.straight or (goal is not None and not goal.poses):
        return  # joints say where all hands are
    named = {led.frame for led in made.led} | {frame for frame, _ in made.kept}
    named |= {pose.link for pose in goal.poses} if goal is not None else set()
    for name, hold in holding.held.items():
        arms = {joint for tool in hold.tools for joint in list_carriers(holding.robot, tool)}
        if not named & {name, *hold.tools} and not arms & set(made.locked):
            yield hold.tools[0], locate(holding.placed, q, hold.tools[0])


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
        ups = {item: holding.items[item].body.start[2, :3] for item in named.sets_down if item in holding.held}
        make = partial(_make_move, robot, company, level, ups, step.move, name)
        put = [item for item in named.lands if item not in named.rests and item in holding.held]
        landing = _split_landing(step.move, put[0]) if put else None
        if landing is not None:
            above, down = (partial(_make_move, robot, company, level, ups, own) for own in landing)
            return (
                PhaseMaker(name, partial(above, name)),
                PhaseMaker(f"{name}: {DOWN}", partial(down, f"{name}: {DOWN}")),
            )
        if not named.entered_m and named.leads_to is None:
            return (PhaseMaker(name, make),)
        return tuple(_list_blended(robot, make, named, step.move, named.leads_to))
    if step.screw is not None:
        return (PhaseMaker(name, partial(_make_screw, robot, company, step.screw, name)),)
    if step.follow is not None:
        return tuple(list_follow(robot, company, step.follow, name))
    if step.touch is not None:
        return (PhaseMaker(name, partial(_make_touch, robot, company, step.touch, name)),)
    if step.body is not None:
        return (PhaseMaker(name, partial(_make_body, robot, step.body, name)),)
    if step.grasp is not None and taking is not None:
        return tuple(list_grasp(holding, step.grasp, name, taking))
    if step.release is not None:
        return tuple(list_release(holding, step.release, name, released))
    if step.fit is not None:
        return (PhaseMaker(name, partial(make_fit, holding, step, name)),)
    return ()


def _shift_guide(pose: Float[np.ndarray, "4 4"], by: ShiftRequest) -> Guide:
    """Return the straight way of a shift from a pose on."""
    axes = pose[:3, :3] if by.axes == "hand" else np.eye(3)
    turn = Rotation.from_euler("xyz", by.rotation_deg, degrees=True).as_rotvec()
    return Guide.line(pose[:3, 3], pose[:3, :3], axes @ np.asarray(by.translation), axes @ turn)


def _make_move(
    robot: RobotModel,
    company: Company,
    level: Company,
    ups: Mapping[str, Float[np.ndarray, "3"]],
    move: MoveStep,
    name: str,
    q: Float[np.ndarray, "n"],
) -> StepPhase:
    """Return a motion to joints or poses.

    What it brings above a place where it is put (``level``) is level there; ``ups`` are the directions of such objects
    that pointed upwards as they rested at first.
    """
    moving = find_frames(robot, move.hand, move.frame) if move.hand or move.frame else ()
    frames = moving or tuple(pose.link for pose in move.poses)
    base = StepPhase(name, duration_s=move.duration_s)
    if moving:
        base = replace(base, **keep_others(robot, company, q, moving, move.other_hand))  # type: ignore[arg-type]
    if move.joints or move.posture is not None:
        goal = GoalRequest(joints=move.joints, posture=move.posture)
        if not move.along.startswith("joint"):
            return replace(base, goal=goal)
        profile = {"joint_linear": "any", "joint_cubic": "cubic", "joint_quintic": "quintic"}[move.along]
        values = dict(move.joints) or _read_posture(robot, str(move.posture))
        return replace(base, straight=values, profile=profile)  # type: ignore[arg-type]
    for frame in frames:
        check_frame(robot, frame)
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
            carried = {name for group in company for name in group} - set(map_tools(robot).values())
            here = {link: _stand_up(pose, ups[link]) if link in ups else pose for link, pose in poses.items()}
            turned = (_keep_turn(pose, here[pose.link]) if pose.link in carried else pose for pose in move.poses)
            return replace(base, goal=GoalRequest(poses=tuple(_bring_level(pose, level) for pose in turned)))
        ends = {frame: guide.poses(np.ones(1))[0] for frame, guide in guides.items()}
        goals = tuple(
            make_pose_goal(frame, pose, move.tolerance_m, move.rotation_tolerance_deg, move.free_axis)
            for frame, pose in ends.items()
        )
        return replace(base, goal=GoalRequest(poses=tuple(_bring_level(pose, level) for pose in goals)))
    free, limits = read_free(move.free_axis), read_limits(move)
    if move.poses:
        led = [_lead_to_pose(pose, poses[pose.link], move) for pose in move.poses]
    else:
        led = [Led(frame, guide, **free, **limits) for frame, guide in guides.items()]  # type: ignore[arg-type]
    return replace(base, led=tuple(led))


def _split_landing(move: MoveStep, item: str) -> tuple[MoveStep, MoveStep] | None:
    """Return a free motion of an object to where it is let go as one to above that place, and a line down from there.

    None for any other motion: a free one ends within its tolerance, at which nothing rests.
    """
    own = next((pose for pose in move.poses if pose.link == item), None)
    if move.along != "free" or own is None or not own.is_plain:
        return None
    x, y, z = own.origin
    raised = replace(own, position=(x, y, z + ABOVE_M))
    above = replace(move, poses=tuple(raised if pose is own else pose for pose in move.poses))
    return above, replace(move, poses=(own,), along="line", duration_s=None)


def _list_blended(
    robot: RobotModel,
    make: Callable[[Float[np.ndarray, "n"]], StepPhase],
    named: NamedStep,
    move: MoveStep,
    leads_to: MoveStep | None,
) -> Iterator[PhaseMaker]:
    """Yield the phases of a line with rounded corners: the line between them, and the arc at its end."""
    entered = named.entered_m if move.by is not None else 0.0  # a way to a pose counts from where the frame is

    def line(q: Float[np.ndarray, "n"]) -> StepPhase:
        made = make(q)
        led = tuple(shorten_line(own, entered, move.blend_m) for own in made.led)
        return replace(made, led=led, flows=leads_to is not None, is_entered=named.entered_m > 0.0)

    yield PhaseMaker(named.name, line)
    if leads_to is None:
        return
    name = f"{named.name}: {CORNER}"

    def corner(q: Float[np.ndarray, "n"]) -> StepPhase:
        made, led = make(q), []
        for own in made.led:
            guide, before = own.guide, own.guide.shift / np.linalg.norm(own.guide.shift)
            after = _find_way(leads_to, own.frame, guide.position + move.blend_m * before, guide.rotation)
            arc = round_corner(guide.position, guide.rotation, before, after, move.blend_m)
            if arc is None:
                raise RequestError(
                    f"move.blend_m: the way turns by {np.rad2deg(find_turn(before, after)):.0f} deg there; "
                    f"expected at most {np.rad2deg(SHARPEST_RAD):.0f}, or no blend_m"
                )
            led.append(replace(own, guide=arc, is_corner=True))
        return replace(made, name=name, led=tuple(led), flows=True, is_entered=True)

    yield PhaseMaker(name, corner)


def _find_way(
    move: MoveStep, frame: str, corner: Float[np.ndarray, "3"], rotation: Float[np.ndarray, "3 3"]
) -> Float[np.ndarray, "3"]:
    """Return the straight way of a frame from a corner on [m]."""
    if move.by is not None:
        axes = rotation if move.by.axes == "hand" else np.eye(3)
        return np.asarray(axes @ np.asarray(move.by.translation))
    return np.asarray(next(pose.origin for pose in move.poses if pose.link == frame) - corner)


def _bring_level(pose: PoseGoalRequest, level: Company) -> PoseGoalRequest:
    """Return the pose of a frame, at which what moves along with it is level if it is put down later.

    A region has its own angles.
    """
    if not pose.is_plain or not any(pose.link in group for group in level):
        return pose
    return replace(pose, rotation_tolerance_deg=min(pose.rotation_tolerance_deg, LEVEL_DEG))


def _stand_up(pose: Float[np.ndarray, "4 4"], up: Float[np.ndarray, "3"]) -> Float[np.ndarray, "4 4"]:
    """Return a pose turned as little as it takes for a direction of its own to point upwards, if it nearly does."""
    upwards, turned = pose[:3, :3] @ up, pose.copy()
    if upwards[2] >= NEARLY_UP:
        least, _ = Rotation.align_vectors(np.array([[0.0, 0.0, 1.0]]), upwards[None])
        turned[:3, :3] = least.as_matrix() @ pose[:3, :3]
    return turned


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
    return Led(pose.link, guide, **read_free(free), **read_limits(move))  # type: ignore[arg-type]


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
        limits = read_limits(screw)
        if screw.rate_deg_s is not None and guide.has_length:
            limits["speed_m_s"] = guide.length * screw.rate_deg_s / abs(screw.rotation_deg)
        led.append(Led(frame, guide, **read_free(screw.free_axis), **limits))  # type: ignore[arg-type]
    keeping = keep_others(robot, company, q, frames, screw.other_hand)
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
    led = Led(frame, guide, **read_free(touch.free_axis), **read_limits(touch))  # type: ignore[arg-type]
    depth = touch.window_m[1] - touch.window_m[0]
    touches = allow(robot, frame, touch.pieces, depth)
    loads = (make_thrust(frame, guide, touch.force_n * way),)
    keeping = keep_others(robot, company, q, (frame,), touch.other_hand)
    return StepPhase(name, (led,), touches=touches, loads=loads, **keeping)  # type: ignore[arg-type]


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
    tools = tuple(map_tools(robot).values())
    if body.hands == "stay":
        kept = tuple((tool, locate(robot, q, tool)) for tool in tools)
        return StepPhase(name, tuple(led), kept=kept, duration_s=body.duration_s)
    trunk = list_carriers(robot, torsos[-1]) if torsos else frozenset()
    arms = set().union(*(list_carriers(robot, tool) for tool in tools)) - trunk if tools else set()
    locked = tuple(joint for joint in robot.joint_names if joint in arms)
    return StepPhase(name, tuple(led), locked=locked, duration_s=body.duration_s)
