"""Frames of steps: which a step leads, where they are, what others keep meanwhile, and what they may touch and push."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.allowance import Allowance, BodyRef
from costs.guide import Guide
from costs.robot import BASE_NAMES, RobotModel
from costs.work_space import borrow_data
from service.demands.hands import list_robot_hands
from service.demands.regions import find_axis
from service.errors import RequestError, would_do
from service.request.tasks.hand_steps import FollowStep, MoveStep, ScrewStep, TouchStep
from service.verify import HAND_DRIFT_M, WORLD, HandLoad

Company = tuple[frozenset[str], ...]
"""Frames that move as one: objects and the hands that hold them."""


def find_frames(robot: RobotModel, hand: str | None, frame: str | None) -> tuple[str, ...]:
    """Return the frames of a step's hand or hands, or its frame.

    Raises:
        RequestError: the robot has no such hand or frame.
    """
    if frame is not None:
        check_frame(robot, frame)
        return (frame,)
    tools = map_tools(robot)
    sides = ("left", "right") if hand == "both" else (str(hand),)
    missing = [side for side in sides if side not in tools]
    if missing:
        raise RequestError(
            f"robot '{robot.name}' has no {missing[0]} hand; name a frame of the robot, or give robot.hands"
        )
    return tuple(tools[side] for side in sides)


def check_frame(robot: RobotModel, frame: str) -> None:
    if not robot.model.existFrame(frame):
        known = [own.name for own in robot.model.frames if own.type == pin.FrameType.BODY]
        raise RequestError(f"unknown frame '{frame}'; {robot.name} has {would_do(frame, known)}")


def map_tools(robot: RobotModel) -> Mapping[str, str]:
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


def keep_others(
    robot: RobotModel, company: Company, q: Float[np.ndarray, "n"], frames: tuple[str, ...], how: str
) -> dict[str, tuple[object, ...]]:
    """Return what the hands that do not move keep: poses or joints."""
    frames = (*frames, *(name for group in company if group & set(frames) for name in group - set(frames)))
    others = [tool for tool in map_tools(robot).values() if tool not in frames]
    if how == "free" or not others or not set(frames) & set(map_tools(robot).values()):
        return {}
    if how == "keep":
        return {"kept": tuple((frame, locate(robot, q, frame)) for frame in others)}
    moving = frozenset().union(*(list_carriers(robot, frame) for frame in frames))
    locked = set().union(*(list_carriers(robot, frame) for frame in others)) - moving
    return {"locked": tuple(name for name in robot.joint_names if name in locked)}


def read_free(free_axis: str) -> dict[str, object]:
    if free_axis == "all":
        return {"turns_freely": True}
    return {"free_axis": find_axis(free_axis)}


def read_limits(step: MoveStep | ScrewStep | TouchStep | FollowStep) -> dict[str, float | None]:
    return {
        "tolerance_m": step.tolerance_m,
        "rotation_tolerance_rad": float(np.deg2rad(step.rotation_tolerance_deg)),
        "speed_m_s": step.speed_m_s,
    }


def allow(robot: RobotModel, frame: str, pieces: tuple[str, ...], depth: float) -> tuple[Allowance, ...]:
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


def make_thrust(frame: str, guide: Guide, force: Float[np.ndarray, "3"]) -> HandLoad:
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
