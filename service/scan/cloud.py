"""Cloud input of ``scopt scene`` and ``scopt detect``: options, poses, cropping, and the robot seen in the cloud."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from costs.robot import RobotError, load_robot
from perception import METRES_BY_UNIT, Cloud, PerceptionError, Reach, View, read_clouds, rigid_pose
from service.errors import RequestError, would_do
from service.request.choices import SensorModel
from service.request.file import load_section, parse_section
from service.request.schema import RobotRequest, StartRequest
from service.start.configuration import make_start_configuration
from service.start.standing import FEET_GROUP, place_bodies, sole_corners

OnStep = Callable[[str], None]
DEFAULT_REACH_M = Reach().radius
"""Horizontal radius in which points are kept, the same for scenes, detections and plans [m]."""

_BETWEEN_NUMBERS = str.maketrans(dict.fromkeys(",;()[]", " "))


@dataclass(frozen=True)
class CloudInput:
    """Cloud files and how to read them.

    Attributes:
        files: paths of one or several files, which are merged.
        unit: length unit of the files.
        transforms: texts with pose_world_cloud as 6, 7 or 16 numbers; one for all files, or one for each.
        apply_viewpoint: whether the points are in the sensor's frame.
        sensor: start of the rays if the files do not give it [m].
        level: whether the merged cloud is turned z up and lifted to its floor.
        sensor_model: kind of sensor.
        sensor_sigma: standard deviation of the start of the rays [m].
        topic: topic of a bag with several clouds.
        message: index of a bag's message, or ``all`` to merge them.
        reach_m: horizontal radius around the world's origin in which points are kept [m].
        top_m, bottom_m: heights between which points are kept [m].
        robot: the robot whose own points are removed.
        start: its configuration; None for its default.
        seed: seed of all random choices.
    """

    files: tuple[Path, ...]
    unit: str = "m"
    transforms: tuple[str, ...] = ()
    apply_viewpoint: bool = False
    sensor: tuple[float, float, float] | None = None
    level: bool = False
    sensor_model: SensorModel = "auto"
    sensor_sigma: float = 0.0
    topic: str | None = None
    message: int | Literal["all"] = 0
    reach_m: float = DEFAULT_REACH_M
    top_m: float = 3.0
    bottom_m: float = -0.5
    robot: RobotRequest | None = None
    start: StartRequest | None = None
    seed: int = 0

    @property
    def reach(self) -> Reach:
        """Volume in which points are kept."""
        return Reach(radius=self.reach_m, top=self.top_m, bottom=self.bottom_m)

    @property
    def files_text(self) -> str:
        """Names of the files for errors."""
        return ", ".join(map(str, self.files))


@dataclass(frozen=True)
class CloudRead:
    """Merged cloud, with the hulls of the robot's links and the corners of its soles in the world [m]."""

    cloud: Cloud
    hulls: Sequence[np.ndarray]
    soles: Sequence[np.ndarray]


def parse_cloud_options(options: Mapping[str, Any]) -> CloudInput:
    """Parse the cloud options of a command line.

    Its ``sensor``, ``message`` and ``robot`` are texts (a robot is a bundled name or a URDF), and ``posture`` is the
    name of a posture or a file with a request's ``start``.

    Raises:
        RequestError: the sensor is not three numbers, the message is not a number, or the file cannot be used.
    """
    values = dict(options)
    for height in ("top", "bottom"):
        if not np.isfinite(values[f"{height}_m"]):
            raise RequestError(f"--{height}: {values[f'{height}_m']:g} m is no height; expected a finite number")
    if values["top_m"] <= values["bottom_m"]:
        raise RequestError(
            f"--top: {values['top_m']:g} m is not above --bottom {values['bottom_m']:g} m; expected more"
        )
    sensor, posture, message = values.pop("sensor"), values.pop("posture"), values.pop("message")
    robot = values.pop("robot")
    return CloudInput(
        **values,
        sensor=None if sensor is None else parse_point(sensor, "--sensor"),
        robot=None if robot is None else _parse_robot(robot),
        start=None if posture is None else _parse_start(posture),
        message=_parse_message(message),
    )


def read_input(clouds: CloudInput, on_step: OnStep) -> CloudRead:
    """Read the cloud files, and compute the robot's hulls and soles in the world.

    Raises:
        RequestError: a file, name or value cannot be used.
    """
    if clouds.unit not in METRES_BY_UNIT:
        raise RequestError(f"--unit: unknown unit '{clouds.unit}'; expected {would_do(clouds.unit, METRES_BY_UNIT)}")
    poses = _poses(clouds)
    hulls: list[np.ndarray] = []
    soles: list[np.ndarray] = []
    if clouds.robot is not None:
        on_step("load robot")
        hulls, soles = _place_robot(clouds.robot, clouds.start)
    on_step("read cloud")
    try:
        cloud = read_clouds(
            list(zip(clouds.files, poses, strict=True)),
            unit=clouds.unit,
            apply_viewpoint=clouds.apply_viewpoint,
            sensor=clouds.sensor,
            level=clouds.level,
            sensor_model=clouds.sensor_model,
            sensor_sigma=clouds.sensor_sigma,
            topic=clouds.topic,
            message=clouds.message,
        )
    except PerceptionError as error:
        raise RequestError(str(error)) from None
    return CloudRead(cloud, hulls, soles)


def count_points(read: CloudRead, view: View) -> dict[str, int]:
    """Return the number of points of each kind; ``points`` is the sum of all others except the rays."""
    return {
        "points": len(read.cloud.points),
        "copied_points": len(read.cloud.points) - len(view.cloud.points),
        "cropped_points": view.n_cropped,
        "robot_points": view.n_own,
        "floor_points": view.n_floor,
        "stray_points": view.n_strays,
        "obstacle_points": len(view.obstacles),
        "rays_without_return": len(read.cloud.misses),
    }


def parse_numbers(text: str, option: str) -> tuple[float, ...]:
    """Read numbers separated by spaces or commas, with or without the brackets of a printed matrix.

    Raises:
        RequestError: part of the text is not a number.
    """
    try:
        return tuple(float(word) for word in text.translate(_BETWEEN_NUMBERS).split())
    except ValueError:
        raise RequestError(f"{option}: expected numbers separated by spaces or commas, got '{text}'") from None


def parse_point(text: str, option: str) -> tuple[float, float, float]:
    """Parse three finite numbers.

    Raises:
        RequestError: the text is not three finite numbers.
    """
    values = parse_numbers(text, option)
    if len(values) != 3 or not np.isfinite(values).all():
        raise RequestError(f"{option}: expected three numbers 'X Y Z' (in quotes), got '{text}'")
    return values[0], values[1], values[2]


def _parse_message(text: str) -> int | Literal["all"]:
    if text == "all":
        return "all"
    try:
        return int(text)
    except ValueError:
        raise RequestError(f"--message: expected a whole number, -1 for the last, or all, got '{text}'") from None


def _poses(clouds: CloudInput) -> list[np.ndarray | None]:
    n_files, n_poses = len(clouds.files), len(clouds.transforms)
    if n_poses not in (0, 1, n_files):
        raise RequestError(
            f"--transform is given {n_poses} times for {n_files} clouds; expected once, or once for each"
        )
    try:
        poses = [rigid_pose(parse_numbers(text, "--transform")) for text in clouds.transforms]
    except PerceptionError as error:
        raise RequestError(f"--transform: {error}") from None
    if not poses:
        return [None] * n_files
    return list(poses * n_files if n_poses == 1 else poses)


def _parse_robot(text: str) -> RobotRequest:
    """Parse a bundled robot's name, or the path of a URDF whose meshes are in its folder."""
    path = Path(text)
    if path.suffix != ".urdf":
        try:
            return parse_section(RobotRequest, {"name": text})
        except RequestError as error:
            raise RequestError([f"--robot: {problem}" for problem in error.problems]) from None
    if not os.path.isfile(path):
        raise RequestError(f"--robot: {path} is not there; expected a URDF that exists, or a robot of `scopt robots`")
    return RobotRequest(urdf=str(path), package_dirs=(str(path.parent),))


def _parse_start(posture: Path) -> StartRequest:
    if posture.suffix or os.path.exists(posture):
        return load_section(StartRequest, posture)
    return parse_section(StartRequest, {"posture": str(posture)})


def _place_robot(request: RobotRequest, start: StartRequest | None) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Return the vertices of a robot's hulls and soles in the world [m]."""
    try:
        if request.urdf is None:
            robot = load_robot(request.name, root=request.root)
        else:
            srdf = None if request.srdf is None else Path(request.srdf)
            folders = [Path(folder) for folder in request.package_dirs]
            robot = load_robot(urdf=Path(request.urdf), srdf=srdf, package_dirs=folders, root=request.root)
    except RobotError as error:
        raise RequestError(f"--robot: {error}") from None
    q, _ = make_start_configuration(robot, start or StartRequest())
    feet = robot.link_groups.get(FEET_GROUP, ()) if robot.is_floating else ()
    return [vertices for _, vertices in place_bodies(robot, q)], [sole_corners(robot, q, foot) for foot in feet]
