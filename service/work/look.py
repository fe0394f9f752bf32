"""Perception, verification and listing of robots in a worker."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from costs.robot import BASE_NAMES, bundled_robots, read_followers
from service.errors import RequestError, ResultError
from service.executor import Control
from service.request.known_names import RobotNames
from service.request.scene import KnownMeshRequest
from service.request.schema import PlanRequest, RobotRequest
from service.request.tasks.reach import GoalRequest
from service.result.folder import write_files
from service.scan.cloud import CloudInput
from service.store import find_damaged_uploads
from service.work.plan import ROBOTS, Refused, stops_with

OVERRIDES = " (this server's own, which overrides scopt's robot of that name)"


KnownFiles = tuple[tuple[KnownMeshRequest, Path | None], ...]
"""Known objects and the paths of their files; None for an object given by its parts."""


@dataclass(frozen=True)
class SceneTask:
    """Task of ``build_scene``.

    Attributes:
        clouds: cloud files.
        kinds: kinds of objects to detect.
        hint: a point near the object to detect [m].
        unknown, method: parameters of ``perception.perceive``.
        meshes: known objects.
        update: path of the earlier scene's file, and the client's name for it.
        said: settings given explicitly, which must equal those of the earlier scene, and their fields.
    """

    clouds: CloudInput
    kinds: tuple[str, ...] = ()
    hint: tuple[float, float, float] | None = None
    unknown: str = "free"
    method: str = "planes"
    meshes: KnownFiles = ()
    update: tuple[Path, str] | None = None
    said: Mapping[str, str] = field(default_factory=dict)


def build_scene(task: SceneTask, control: Control) -> bytes | Refused:
    """Make a scene's file (docs/scene-format.md); reports the names of steps."""
    from service.scan.known_meshes import mesh_from_request
    from service.scan.make_scene import SceneInput, apply_earlier_settings, read_earlier_scene
    from service.scan.make_scene import build_scene as make_scene

    update = () if task.update is None else task.update[:1]
    damaged = find_damaged_uploads(map(str, (*task.clouds.files, *_list_paths(task.meshes), *update)))
    if damaged:
        return Refused((), damaged)
    meshes = tuple(mesh_from_request(mesh, path) for mesh, path in task.meshes)
    scene_input = SceneInput(task.clouds, task.kinds, task.hint, task.unknown, task.method, meshes)  # type: ignore[arg-type]
    try:
        with stops_with(control):
            if task.update is not None:
                earlier = replace(read_earlier_scene(task.update[0]), path=Path(task.update[1]))
                scene_input = apply_earlier_settings(earlier, scene_input, task.said, "update")
            return json.dumps(make_scene(scene_input, control.report).data, allow_nan=False).encode()
    except RequestError as error:
        return Refused(error.problems)


@dataclass(frozen=True)
class DetectTask:
    """Task of ``detect``.

    Attributes:
        clouds: cloud files.
        kind: kind of objects, or ``object`` for the given ones.
        hint: a point near the object [m].
        objects: given objects.
    """

    clouds: CloudInput
    kind: str
    hint: tuple[float, float, float] | None = None
    objects: KnownFiles = ()


def detect(task: DetectTask, control: Control) -> Mapping[str, Any] | Refused:
    """Detect objects; returns what ``scopt detect`` prints."""
    from service.scan.detect import detect_file
    from service.scan.known_meshes import mesh_from_request

    damaged = find_damaged_uploads(map(str, (*task.clouds.files, *_list_paths(task.objects))))
    if damaged:
        return Refused((), damaged)
    objects = tuple(mesh_from_request(given, path) for given, path in task.objects)
    try:
        with stops_with(control):
            return detect_file(task.clouds, task.kind, task.hint, control.report, objects=objects)
    except RequestError as error:
        return Refused(error.problems)


def _list_paths(known: KnownFiles) -> tuple[Path, ...]:
    return tuple(path for _, path in known if path is not None)


def verify(files: Mapping[str, bytes], control: Control) -> Mapping[str, Any] | Refused:
    """Verify a result folder, given as its files by path; returns what ``scopt verify`` prints."""
    from service.replay.replay import verify_result

    return with_result_folder(files, verify_result, control)


def with_result_folder(
    files: Mapping[str, bytes], work: Callable[[Path], Mapping[str, Any]], control: Control
) -> Mapping[str, Any] | Refused:
    """Return what a function makes of a result folder, given as its files by path."""
    with tempfile.TemporaryDirectory(prefix="scopt-") as scratch:
        folder = Path(scratch)
        try:
            write_files(folder, files)
            with stops_with(control):
                return work(folder)
        except (ResultError, RequestError) as error:
            # Name the files as the client does, without the temporary folder.
            lines = (line.removeprefix(f"{folder}: ").replace(f"{folder}/", "") for line in str(error).splitlines())
            return Refused(tuple(f"files: {line}" for line in lines))


def describe_robots(more: Mapping[str, RobotRequest]) -> list[dict[str, Any]]:
    """Describe the robots that requests may name: ``more`` by name, and those of the package."""
    texts = bundled_robots()
    bundled = {name: RobotRequest(name=name) for name in texts}
    own = [_describe(name, request, "", OVERRIDES if name in bundled else "") for name, request in more.items()]
    return own + [_describe(name, request, texts[name]) for name, request in bundled.items() if name not in more]


def list_names() -> tuple[RobotNames, ...]:
    """Return the names that requests may use with each robot of the package."""
    robots = (
        ROBOTS.get(PlanRequest(RobotRequest(name=name), goal=GoalRequest(posture="-"))) for name in bundled_robots()
    )
    return tuple(
        RobotNames(
            robot.name,
            (*(name for name in robot.joint_names if name not in BASE_NAMES), *read_followers(robot)),
            tuple(robot.postures),
            frozenset(frame.name for frame in robot.model.frames) - {"universe"},
        )
        for robot in robots
    )


def _describe(name: str, request: RobotRequest, description: str, suffix: str = "") -> dict[str, Any]:
    try:
        robot = ROBOTS.get(PlanRequest(robot=request, goal=GoalRequest(posture="-")))
    except RequestError as error:
        return {"name": name, "description": f"cannot be used: {error}{suffix}"}
    return {
        "name": name,
        "description": f"{description or f'{robot.n} degrees of freedom'}{suffix}",
        "joint_names": list(robot.joint_names),
        "postures": sorted(robot.postures),
        "contacts": [
            {
                "name": patch,
                "link": contact.link,
                "points": [{"value": point} for point in contact.points.tolist()],
                "normal": contact.normals[0].tolist(),
                "friction": contact.friction,
                "force_cap_n": contact.force_cap_n,
            }
            for patch, contact in robot.contacts.items()
        ],
    }
