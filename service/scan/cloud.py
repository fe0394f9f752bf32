"""What ``scopt scene`` and ``scopt detect`` are asked: which clouds, where they lie, what of them matters."""

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
from service.request.file import load_section, parse_section
from service.request.schema import RobotRequest, StartRequest
from service.start.configuration import make_start_configuration
from service.start.standing import FEET_GROUP, place_bodies, sole_corners

OnStep = Callable[[str], None]

_BETWEEN_NUMBERS = str.maketrans(dict.fromkeys(",;()[]", " "))


@dataclass(frozen=True)
class CloudInput:
    """Cloud files and how they are to be read.

    Attributes:
        files: one or several, merged.
        unit: of the files' lengths.
        transforms: pose_world_cloud as 6, 7 or 16 numbers in a text; one for all files, or one for each.
        apply_viewpoint: whether the points are in the sensor's frame.
        sensor: where the rays of files that do not say so started [m].
        topic: of a bag with clouds on several.
        message: of a bag; its number, or all of them merged.
        reach_m: horizontal radius about the world's origin that is kept [m].
        top_m, bottom_m: heights between which points are kept [m].
        robot: whose own points are left out.
        start: where that robot stands; None: as it stands by default.
        seed: of all random choices.
    """

    files: tuple[Path, ...]
    unit: str = "m"
    transforms: tuple[str, ...] = ()
    apply_viewpoint: bool = False
    sensor: tuple[float, float, float] | None = None
    topic: str | None = None
    message: int | Literal["all"] = 0
    reach_m: float = 4.0
    top_m: float = 3.0
    bottom_m: float = -0.5
    robot: RobotRequest | None = None
    start: StartRequest | None = None
    seed: int = 0

    @property
    def reach(self) -> Reach:
        """What matters."""
        return Reach(radius=self.reach_m, top=self.top_m, bottom=self.bottom_m)

    @property
    def named(self) -> str:
        """The files, as an error about what they show names them."""
        return ", ".join(map(str, self.files))


@dataclass(frozen=True)
class CloudRead:
    """The merged cloud, and the robot in it: hulls of its links and corners of its soles in the world."""

    cloud: Cloud
    hulls: Sequence[np.ndarray]
    soles: Sequence[np.ndarray]


def parse_cloud_options(options: Mapping[str, Any]) -> CloudInput:
    """What was asked on a command line.

    There ``sensor``, ``message`` and ``robot`` are texts, the last a bundled robot's name or a URDF, and ``posture`` is
    the name of a posture or a file with a request's ``start``.

    Raises:
        RequestError: the sensor is not three numbers, the message no number, or the file cannot be used.
    """
    given = dict(options)
    for height in ("top", "bottom"):
        if not np.isfinite(given[f"{height}_m"]):
            raise RequestError(f"--{height}: {given[f'{height}_m']:g} m is no height; expected a finite number")
    if given["top_m"] <= given["bottom_m"]:
        raise RequestError(f"--top: {given['top_m']:g} m is not above --bottom {given['bottom_m']:g} m; expected more")
    sensor, posture, message = given.pop("sensor"), given.pop("posture"), given.pop("message")
    robot = given.pop("robot")
    return CloudInput(
        **given,
        sensor=None if sensor is None else point(sensor, "--sensor"),
        robot=None if robot is None else _robot(robot),
        start=None if posture is None else _start(posture),
        message=_message(message),
    )


def read_input(asked: CloudInput, on_step: OnStep) -> CloudRead:
    """Read the files and place the robot.

    Raises:
        RequestError: one line for a file, name or value that cannot be used.
    """
    if asked.unit not in METRES_BY_UNIT:
        raise RequestError(f"--unit: unknown unit '{asked.unit}'; expected {would_do(asked.unit, METRES_BY_UNIT)}")
    poses = _poses(asked)
    hulls: list[np.ndarray] = []
    soles: list[np.ndarray] = []
    if asked.robot is not None:
        on_step("load robot")
        hulls, soles = _robot_in_the_way(asked.robot, asked.start)
    on_step("read cloud")
    try:
        cloud = read_clouds(
            list(zip(asked.files, poses, strict=True)),
            unit=asked.unit,
            apply_viewpoint=asked.apply_viewpoint,
            sensor=asked.sensor,
            topic=asked.topic,
            message=asked.message,
        )
    except PerceptionError as error:
        raise RequestError(str(error)) from None
    return CloudRead(cloud, hulls, soles)


def view_figures(read: CloudRead, view: View) -> dict[str, int]:
    """What became of the points: those that were read are the sum of all that follow but the rays."""
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


def numbers(text: str, option: str) -> tuple[float, ...]:
    """Numbers separated by spaces or commas, perhaps in the brackets in which programs print a matrix.

    Raises:
        RequestError: something in the text is no number.
    """
    try:
        return tuple(float(word) for word in text.translate(_BETWEEN_NUMBERS).split())
    except ValueError:
        raise RequestError(f"{option}: expected numbers separated by spaces or commas, got '{text}'") from None


def point(text: str, option: str) -> tuple[float, float, float]:
    """Three finite numbers.

    Raises:
        RequestError: the text holds something else.
    """
    values = numbers(text, option)
    if len(values) != 3 or not np.isfinite(values).all():
        raise RequestError(f"{option}: expected three numbers 'X Y Z' (in quotes), got '{text}'")
    return values[0], values[1], values[2]


def _message(text: str) -> int | Literal["all"]:
    """A message's number, or all.

    Raises:
        RequestError: the text is neither.
    """
    if text == "all":
        return "all"
    try:
        return int(text)
    except ValueError:
        raise RequestError(f"--message: expected a whole number, -1 for the last, or all, got '{text}'") from None


def _poses(asked: CloudInput) -> list[np.ndarray | None]:
    n_files, n_given = len(asked.files), len(asked.transforms)
    if n_given not in (0, 1, n_files):
        raise RequestError(
            f"--transform is given {n_given} times for {n_files} clouds; expected once, or once for each"
        )
    try:
        poses = [rigid_pose(numbers(text, "--transform")) for text in asked.transforms]
    except PerceptionError as error:
        raise RequestError(f"--transform: {error}") from None
    if not poses:
        return [None] * n_files
    return list(poses * n_files if n_given == 1 else poses)


def _robot(text: str) -> RobotRequest:
    """A bundled robot, or the one of a URDF whose meshes are in its folder."""
    path = Path(text)
    if path.suffix != ".urdf":
        try:
            return parse_section(RobotRequest, {"name": text})
        except RequestError as error:
            raise RequestError([f"--robot: {problem}" for problem in error.problems]) from None
    if not os.path.isfile(path):
        raise RequestError(f"--robot: {path} is not there; expected a URDF that exists, or a robot of `scopt robots`")
    return RobotRequest(urdf=str(path), package_dirs=(str(path.parent),))


def _start(posture: Path) -> StartRequest:
    if posture.suffix or os.path.exists(posture):
        return load_section(StartRequest, posture)
    return parse_section(StartRequest, {"posture": str(posture)})


def _robot_in_the_way(asked: RobotRequest, start: StartRequest | None) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Hulls and soles of a robot in the world."""
    try:
        if asked.urdf is None:
            robot = load_robot(asked.name, root=asked.root)
        else:
            srdf = None if asked.srdf is None else Path(asked.srdf)
            folders = [Path(folder) for folder in asked.package_dirs]
            robot = load_robot(urdf=Path(asked.urdf), srdf=srdf, package_dirs=folders, root=asked.root)
    except RobotError as error:
        raise RequestError(f"--robot: {error}") from None
    q, _ = make_start_configuration(robot, start or StartRequest())
    feet = robot.link_groups.get(FEET_GROUP, ()) if robot.is_floating else ()
    return [vertices for _, vertices in place_bodies(robot, q)], [sole_corners(robot, q, foot) for foot in feet]
