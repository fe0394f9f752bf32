"""The robot of a request: loaded, with the bodies that its links carry."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from costs.kinematics import frame_of
from costs.robot import AttachedBody, RobotError, RobotModel, load_robot, with_attached
from service.errors import RequestError, would_do
from service.request.schema import AttachedBox, AttachedRequest, AttachedSphere, KeepRequest, PlanRequest


def load_requested_robot(request: PlanRequest) -> RobotModel:
    """Load the robot that a request names or points to.

    Raises:
        RequestError: its files are missing or cannot be used.
    """
    robot = request.robot
    try:
        if robot.urdf is None:
            return load_robot(robot.name, root=robot.root, tool_distance_m=robot.tool_distance_m)
        return load_robot(
            urdf=_existing(request, robot.urdf, "robot.urdf"),
            srdf=None if robot.srdf is None else _existing(request, robot.srdf, "robot.srdf"),
            package_dirs=[request.resolve(folder) for folder in robot.package_dirs],
            root=robot.root,
        )
    except RobotError as error:
        raise RequestError(f"robot: {error}") from None


def _existing(request: PlanRequest, path: str, field: str) -> Path:
    resolved = request.resolve(path)
    if not resolved.is_file():
        raise RequestError(f"{field}: {resolved} is not there; paths start at the request's folder")
    return resolved


def attach_bodies(robot: RobotModel, request: PlanRequest) -> RobotModel:
    """Return the robot with the bodies that it carries.

    Raises:
        RequestError: one line per problem: a name in use, an unknown link, a link that holds without being kept.
    """
    attached = request.attached
    problems = [line for index in range(len(attached)) for line in _find_unusable(robot, attached, index)]
    if problems:
        raise RequestError(problems)
    try:
        carrying = with_attached(robot, [_body(one) for one in attached])
    except RobotError as error:
        raise RequestError(f"attached: {error}") from None
    problems = [line for k, one in enumerate(attached) for line in _find_loose(carrying, request.keep, one, k)]
    if problems:
        raise RequestError(problems)
    return carrying


def _body(one: AttachedRequest) -> AttachedBody:
    pose: Float[np.ndarray, "4 4"] = np.eye(4)
    pose[:3, :3] = Rotation.from_quat(one.quaternion_wxyz, scalar_first=True).as_matrix()
    pose[:3, 3] = one.position
    size: tuple[float, ...]
    if isinstance(one, AttachedBox):
        size = one.size
    elif isinstance(one, AttachedSphere):
        size = (one.radius,)
    else:
        size = (one.radius, one.height)
    return AttachedBody(one.name, one.link, pose, one.type, size, one.mass_kg, one.touches)


def _find_unusable(robot: RobotModel, attached: Sequence[AttachedRequest], index: int) -> Iterator[str]:
    """Names in use, and links that the robot does not have."""
    one, field, names = attached[index], f"attached[{index}]", [other.name for other in attached]
    frames = sorted({frame.name for frame in robot.model.frames} - {"universe"})
    if one.name in frames or one.name in {body.name for body in robot.bodies}:
        yield f"{field}.name: {one.name!r} is a link of {robot.name}; another name would do"
    if one.name in names[:index]:
        yield f"{field}.name: {one.name!r} is given twice; another name would do"
    for key, links in (("link", (one.link,)), ("touches", one.touches)):
        for link in links:
            if link not in frames:
                yield f"unknown link {link!r} in {field}.{key}; {robot.name} has {would_do(link, frames)}"


def _find_loose(robot: RobotModel, keep: Sequence[KeepRequest], one: AttachedRequest, index: int) -> Iterator[str]:
    """Links that hold the body and may move against it: nothing would be known of how deep they are in it."""
    kept = [
        {_joint(robot, other.link), _joint(robot, other.relative_to)} for other in keep if other.free_axis == "none"
    ]
    carrier = _joint(robot, one.link)
    for link in one.touches:
        joint = _joint(robot, link)
        if joint != carrier and {joint, carrier} not in kept:
            yield (
                f"attached[{index}].touches: {link} may move against {one.link}; "
                f"keep: [{{link: {link}, relative_to: {one.link}}}] would do"
            )


def _joint(robot: RobotModel, frame: str | None) -> int | None:
    """The joint that carries a frame; None for a frame that the robot does not have."""
    return frame_of(robot, frame)[0] if frame is not None and robot.model.existFrame(frame) else None
