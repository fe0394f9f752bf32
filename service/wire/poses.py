"""Messages of pose sessions: drags read from them, poses written to them."""

from __future__ import annotations

import math
from collections.abc import Sequence

from service.errors import RequestError
from service.posing.drag import Drag, DragTarget, LedPose, StopKind
from service.posing.drawing import RobotDrawing
from service.proto.planner.v1 import pose_pb2 as wire

_KINDS = {
    StopKind.PAIR: wire.POSE_STOP_KIND_PAIR,
    StopKind.JOINT_LIMIT: wire.POSE_STOP_KIND_JOINT_LIMIT,
    StopKind.BALANCE: wire.POSE_STOP_KIND_BALANCE,
    StopKind.TORQUE: wire.POSE_STOP_KIND_TORQUE,
    StopKind.REACH: wire.POSE_STOP_KIND_REACH,
    StopKind.REFUSED: wire.POSE_STOP_KIND_REFUSED,
}
LEAST_LENGTH = 1e-6  # of a quaternion
MOST_TEXT = 120  # characters of a sentence: an answer has at most 1 kB


def read_drag(message: wire.Drag) -> Drag:
    """Read a drag.

    Raises:
        RequestError: a target has no place, or a number is not finite.
    """
    targets = tuple(_read_target(k, target) for k, target in enumerate(message.targets))
    joints = dict(message.joints)
    wrong = [
        f"drag.joints.{name}: {value} is no position" for name, value in joints.items() if not math.isfinite(value)
    ]
    if wrong:
        raise RequestError(wrong)
    return Drag(targets, joints)


def _read_target(number: int, message: wire.DragTarget) -> DragTarget:
    field = f"drag.targets[{number}]"
    position = _read_numbers(f"{field}.position", message.position, 3)
    if not message.quaternion_wxyz:
        return DragTarget(message.link, (position[0], position[1], position[2]))
    quaternion = _read_numbers(f"{field}.quaternion_wxyz", message.quaternion_wxyz, 4)
    length = math.hypot(*quaternion)
    if length < LEAST_LENGTH:
        raise RequestError(f"{field}.quaternion_wxyz: has no length; expected w x y z of a rotation")
    w, x, y, z = (value / length for value in quaternion)
    return DragTarget(message.link, (position[0], position[1], position[2]), (w, x, y, z))


def _read_numbers(field: str, numbers: Sequence[float], count: int) -> list[float]:
    if len(numbers) != count or not all(math.isfinite(value) for value in numbers):
        raise RequestError(f"{field}: expected {count} finite numbers, got {len(numbers)}")
    return list(numbers)


def pose_to_message(pose: LedPose, number: int, revision: int, undo_steps: int, redo_steps: int) -> wire.SessionPose:
    """Return the message of a pose that answers an event."""
    return wire.SessionPose(
        number=number,
        revision=revision,
        is_checked=pose.is_checked,
        base=pose.numbers.base,
        positions=pose.numbers.positions,
        miss_m=pose.miss_m,
        miss_rad=pose.miss_rad,
        stops=[
            wire.PoseStop(kind=_KINDS[stop.kind], names=stop.names, value=stop.value, text=stop.text[:MOST_TEXT])
            for stop in pose.stops
        ],
        clearance_m=pose.clearance_m,
        balance_margin_m=pose.balance_margin_m,
        torque_share=pose.torque_share,
        undo_steps=undo_steps,
        redo_steps=redo_steps,
    )


def drawing_to_message(drawing: RobotDrawing) -> wire.RobotDrawing:
    """Return the message of a robot as it is drawn."""
    return wire.RobotDrawing(
        joints=[
            wire.DrawnJoint(parent=joint.parent, rest=joint.rest, motion=joint.motion, position=joint.position)
            for joint in drawing.joints
        ],
        bodies=[
            wire.DrawnBody(name=body.name, link=body.link, joint=body.joint, vertices=body.vertices.ravel())
            for body in drawing.bodies
        ],
        frames=[wire.DrawnFrame(name=frame.name, joint=frame.joint, pose=frame.pose) for frame in drawing.frames],
        tools=drawing.tools,
    )
