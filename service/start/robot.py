"""Loading of a request's robot with its carried bodies."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from costs.kinematics import locate_frame
from costs.robot import (
    AttachedBody,
    PatchData,
    RobotError,
    RobotHand,
    RobotModel,
    bundled_robots,
    find_package_folders,
    load_robot,
    with_attached,
    with_contacts,
)
from costs.robot.servo import list_servo_joints, make_stiffness
from costs.rotation import pose_matrix
from service.errors import RequestError, would_do
from service.request.attached import AttachedConvex, AttachedMesh, AttachedRequest
from service.request.keep import KeepRequest
from service.request.schema import PlanRequest
from service.start.configuration import find_unknown_joints
from service.start.split_links import split_links


def load_requested_robot(request: PlanRequest, *, finds_package: bool = False) -> RobotModel:
    """Load the bundled robot or the URDF of a request.

    Args:
        request: the request.
        finds_package: whether meshes may also be read from the package that the URDF lies in, where the request names
            no ``package_dirs``; not on a server, where a request reads only what it names.

    Raises:
        RequestError: a file is missing or cannot be used, or a contact patch is not on the robot's surface.
    """
    robot = request.robot
    try:
        if robot.urdf is None:
            if robot.name is not None and robot.name not in bundled_robots():
                known = would_do(robot.name, bundled_robots())
                raise RequestError(f"robot.name: unknown robot {robot.name!r}; expected {known}")
            loaded = load_robot(
                robot.name,
                root=robot.root,
                tool_distance_m=robot.tool_distance_m,
                hand=robot.hand,
                locked_joints=robot.locked,
            )
        else:
            loaded = load_robot(
                urdf=_find_file(request, robot.urdf, "robot.urdf"),
                srdf=None if robot.srdf is None else _find_file(request, robot.srdf, "robot.srdf"),
                package_dirs=_list_package_dirs(request, robot.urdf, finds_package),
                root=robot.root,
                locked_joints=robot.locked,
                drawn_links=robot.drawn_links,
                split=split_links(robot.decompose),
            )
    except RobotError as error:
        raise RequestError(f"robot: {error}") from None
    return add_request_parts(loaded, request)


def add_request_parts(robot: RobotModel, request: PlanRequest) -> RobotModel:
    """Return the robot with the contact patches, hands and torque limits that a request gives it.

    Raises:
        RequestError: a patch is not on the robot's surface, or a hand's frame or a servo's joint is unknown.
    """
    robot = _leave_torques_out(robot, request)
    robot = add_contact_patches(robot, request)
    frames = sorted({frame.name for frame in robot.model.frames} - {"universe"})
    hands = dict(robot.hands)
    for side, hand in request.robot.hands.items():
        for key in ("link", "hook", "tool", "peg", "stub"):
            frame = getattr(hand, key)
            if frame is not None and frame not in frames:
                words = f"unknown link {frame!r}; {robot.name} has {would_do(frame, frames)}"
                raise RequestError(f"robot.hands.{side}.{key}: {words}")
        for finger in hand.fingers or ():
            if finger not in frames:
                words = f"unknown link {finger!r}; {robot.name} has {would_do(finger, frames)}"
                raise RequestError(f"robot.hands.{side}.fingers: {words}")
        peg, stub = hand.peg or "", hand.stub or ""
        hands[side] = RobotHand(hand.link, hand.hook, hand.tool, peg, stub, hand.peg_radius_m, hand.fingers or ())
    try:
        resolve_stiffness(robot, request)
    except ValueError as error:
        raise RequestError(f"robot.servo.stiffness: {error}") from None
    return dataclasses.replace(robot, hands=hands)


def _leave_torques_out(robot: RobotModel, request: PlanRequest) -> RobotModel:
    """Return the robot without the torque limits that a request leaves out."""
    torque = request.robot.torque
    if torque is None:
        return robot
    unknown = find_unknown_joints(robot, torque.unchecked, "robot.torque.unchecked")
    if unknown:
        raise RequestError(unknown)
    is_left_out = np.array([not torque.check or name in torque.unchecked for name in robot.joint_names])
    return dataclasses.replace(robot, effort=np.where(is_left_out, np.inf, robot.effort))


def resolve_stiffness(robot: RobotModel, request: PlanRequest) -> dict[str, float]:
    """Return the stiffness of the robot's servos by joint, those that the request gives and defaults [N m/rad, N/m].

    Raises:
        ValueError: the request names a group that no joint belongs to.
    """
    servo = request.robot.servo
    values = make_stiffness(robot, {} if servo is None else servo.stiffness)
    return dict(zip(list_servo_joints(robot), values.tolist(), strict=True))


def add_contact_patches(robot: RobotModel, request: PlanRequest) -> RobotModel:
    """Return the robot with the contact patches of a request, which add to its own or override them.

    Raises:
        RequestError: one line that names the patch and the point or field.
    """
    try:
        patches = {name: PatchData(**dataclasses.asdict(patch)) for name, patch in request.robot.contacts.items()}
        return with_contacts(robot, patches)
    except RobotError as error:
        raise RequestError(f"robot.contacts.{error}") from None


def _list_package_dirs(request: PlanRequest, urdf: str, finds_package: bool) -> list[Path]:
    """Return the folders of meshes: the request's, or else the URDF's own and, if allowed, those about its package."""
    given = [request.resolve(folder) for folder in request.robot.package_dirs]
    path = request.resolve(urdf)
    if given or not finds_package:
        return given
    return [path.parent, *find_package_folders(path)]


def _find_file(request: PlanRequest, path: str, field: str) -> Path:
    resolved = request.resolve(path)
    if not resolved.is_file():
        raise RequestError(f"{field}: {resolved} is not there; paths start at the request's folder")
    return resolved


def attach_bodies(robot: RobotModel, request: PlanRequest) -> RobotModel:
    """Return the robot with its carried bodies.

    Raises:
        RequestError: one line per problem: a name in use, an unknown link, a holding link that ``keep`` does not fix.
    """
    attached = request.attached
    problems = [line for index in range(len(attached)) for line in _find_unusable(robot, attached, index)]
    if problems:
        raise RequestError(problems)
    try:
        carrying = with_attached(robot, [_make_body(item) for item in attached])
    except RobotError as error:
        raise RequestError(f"attached: {error}") from None
    problems = [line for k, item in enumerate(attached) for line in _find_loose(carrying, request.keep, item, k)]
    if problems:
        raise RequestError(problems)
    return carrying


def _make_body(item: AttachedRequest) -> AttachedBody:
    pose = pose_matrix(item.position, item.quaternion_wxyz)
    match item:
        case AttachedMesh():
            parts = tuple(np.array(part.points) for part in item.parts)
        case AttachedConvex():
            parts = (np.array(item.points),)
        case _:
            return AttachedBody(item.name, item.link, pose, item.type, item.lengths, item.mass_kg, item.touches)
    return AttachedBody(item.name, item.link, pose, "parts", (), item.mass_kg, item.touches, parts)


def _find_unusable(robot: RobotModel, attached: Sequence[AttachedRequest], index: int) -> Iterator[str]:
    """Yield a problem for each name in use and each unknown link."""
    item, field, names = attached[index], f"attached[{index}]", [other.name for other in attached]
    frames = sorted({frame.name for frame in robot.model.frames} - {"universe"})
    if item.name in frames or item.name in {body.name for body in robot.bodies}:
        yield f"{field}.name: {item.name!r} is a link of {robot.name}; expected another name"
    if item.name in names[:index]:
        yield f"{field}.name: {item.name!r} is given twice; expected another name"
    for key, links in (("link", (item.link,)), ("touches", item.touches)):
        for link in links:
            if link not in frames:
                yield f"unknown link {link!r} in {field}.{key}; {robot.name} has {would_do(link, frames)}"


def _find_loose(robot: RobotModel, keep: Sequence[KeepRequest], item: AttachedRequest, index: int) -> Iterator[str]:
    """Yield a problem for each holding link that may move relative to the body and so change their overlap."""
    kept = [
        {_joint(robot, other.link), _joint(robot, other.relative_to)} for other in keep if other.free_axis == "none"
    ]
    carrier = _joint(robot, item.link)
    for link in item.touches:
        joint = _joint(robot, link)
        if joint != carrier and {joint, carrier} not in kept:
            yield (
                f"attached[{index}].touches: {link} may move against {item.link}; "
                f"expected keep: [{{link: {link}, relative_to: {item.link}}}]"
            )


def _joint(robot: RobotModel, frame: str | None) -> int | None:
    """Return the joint that carries a frame; None for an unknown frame."""
    return locate_frame(robot, frame)[0] if frame is not None and robot.model.existFrame(frame) else None
