"""A robot as it is drawn: what a client needs to place shapes from the numbers of a pose alone."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.robot import BASE_NAMES, RobotModel

PROBE = 0.1  # of a coordinate, by which the screw of its joint is measured: less than half a turn of any follower
STILL = 1e-12  # of a screw that does not move


@dataclass(frozen=True)
class DrawnJoint:
    """A joint: its pose in its parent is ``rest``, then the screw ``motion`` by its coordinate.

    Attributes:
        parent: number of its parent among the joints, from 1; 0 for the world.
        rest: x y z [m], qw qx qy qz; empty for the joint of a floating base, which is where the base of a pose is.
        motion: velocity [m] and angular velocity [rad] by a unit of the coordinate, in its own frame; empty without.
        position: number of its coordinate among the positions of a pose.
    """

    parent: int
    rest: tuple[float, ...] = ()
    motion: tuple[float, ...] = ()
    position: int = 0


@dataclass(frozen=True)
class DrawnFrame:
    """A frame in that of a joint: x y z [m], qw qx qy qz."""

    name: str
    joint: int
    pose: tuple[float, ...]


@dataclass(frozen=True)
class DrawnBody:
    """A convex shape of a link, with vertices (V, 3) in the frame of the joint that carries it [m]."""

    name: str
    link: str
    joint: int
    vertices: Float[np.ndarray, "V 3"]


@dataclass(frozen=True)
class RobotDrawing:
    """A robot as it is drawn.

    Attributes:
        joints: parents before what they carry.
        bodies: shapes of the links.
        frames: frames that may be led, and tools of hands.
        tools: tool frame by side of its hand.
    """

    joints: tuple[DrawnJoint, ...]
    bodies: tuple[DrawnBody, ...]
    frames: tuple[DrawnFrame, ...]
    tools: Mapping[str, str]


def draw_robot(robot: RobotModel, handles: Iterable[str]) -> RobotDrawing:
    """Return the drawing of a robot with the frames of ``handles``."""
    tools = {side: hand.tool for side, hand in robot.hands.items() if hand.tool}
    names = dict.fromkeys([*handles, *tools.values()])
    bodies = tuple(DrawnBody(body.name, body.link, body.joint, body.vertices) for body in robot.bodies)
    return RobotDrawing(_draw_joints(robot), bodies, tuple(_draw_frame(robot.model, name) for name in names), tools)


def _draw_joints(robot: RobotModel) -> tuple[DrawnJoint, ...]:
    """Return the joints, each measured: a joint of any kind, also a follower, moves by a screw of one coordinate."""
    model, first = robot.model, len(BASE_NAMES) if robot.is_floating else 0
    data = model.createData()
    pin.forwardKinematics(model, data, np.zeros(robot.n))
    rests = [placement.copy() for placement in data.liMi]
    motions: dict[int, tuple[int, tuple[float, ...]]] = {}
    for column in range(first, robot.n):
        pin.forwardKinematics(model, data, PROBE * np.eye(robot.n)[column])
        for joint in range(1, model.njoints):
            screw = pin.log6(rests[joint].actInv(data.liMi[joint])).vector / PROBE
            if np.abs(screw).max() > STILL:
                motions[joint] = (column - first, tuple(screw.tolist()))
    drawn = []
    for joint in range(1, model.njoints):
        position, motion = motions.get(joint, (0, ()))
        is_base = robot.is_floating and joint == 1
        rest = () if is_base else _write_pose(rests[joint])
        drawn.append(DrawnJoint(int(model.parents[joint]), rest, motion, position))
    return tuple(drawn)


def _draw_frame(model: pin.Model, name: str) -> DrawnFrame:
    frame = model.frames[model.getFrameId(name)]
    return DrawnFrame(name, int(frame.parentJoint), _write_pose(frame.placement))


def _write_pose(placement: pin.SE3) -> tuple[float, ...]:
    x, y, z, qx, qy, qz, qw = pin.SE3ToXYZQUAT(placement).tolist()
    return (x, y, z, qw, qx, qy, qz)
