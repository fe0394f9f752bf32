"""Perception, verification and robots in a worker: functions of data that end in data."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from costs.robot import bundled_robots
from service.errors import RequestError, ResultError, shown
from service.executor import Control
from service.request.scene import KnownMeshRequest
from service.request.schema import GoalRequest, PlanRequest, RobotRequest
from service.scan.cloud import CloudInput
from service.work.plan import Refused, warm_robots
from service.work.stopping import stops_with

# Of a server's own robot, for those who know the other.
IN_PLACE = " (this server's own, in place of the one of that name that comes with scopt)"


@dataclass(frozen=True)
class SceneTask:
    """What ``scopt scene`` is asked.

    Attributes:
        clouds: the files.
        kinds: of objects to look for.
        hint: a point near the object that is looked for [m].
        unknown, method: of ``perception.perceive``.
        meshes: known objects, and where their files are kept here.
        update: the file of an earlier scene, and what it is called.
        said: settings that have to be those of the earlier scene, and what they are called.
    """

    clouds: CloudInput
    kinds: tuple[str, ...] = ()
    hint: tuple[float, float, float] | None = None
    unknown: str = "free"
    method: str = "planes"
    meshes: tuple[tuple[KnownMeshRequest, Path], ...] = ()
    update: tuple[Path, str] | None = None
    said: Mapping[str, str] = field(default_factory=dict)


def build_scene(task: SceneTask, control: Control) -> bytes | Refused:
    """The scene's file (docs/scene-format.md); what it reports are the names of steps."""
    from service.scan.earlier import read_earlier_scene
    from service.scan.known_meshes import mesh_from_request
    from service.scan.make_scene import SceneInput, apply_earlier_settings, build_scene

    meshes = tuple(mesh_from_request(one, path) for one, path in task.meshes)
    asked = SceneInput(task.clouds, task.kinds, task.hint, task.unknown, task.method, meshes)  # type: ignore[arg-type]
    try:
        with stops_with(control):
            if task.update is not None:
                before = replace(read_earlier_scene(task.update[0]), path=Path(task.update[1]))
                asked = apply_earlier_settings(before, asked, task.said, "update")
            return json.dumps(build_scene(asked, control.report).data, allow_nan=False).encode()
    except RequestError as error:
        return Refused(error.problems)


def detect(
    clouds: CloudInput, kind: str, hint: tuple[float, float, float] | None, control: Control
) -> Mapping[str, Any] | Refused:
    """What ``scopt detect`` prints."""
    from service.scan.detect import detect_file

    try:
        with stops_with(control):
            return detect_file(clouds, kind, hint, control.report)
    except RequestError as error:
        return Refused(error.problems)


def verify(files: Mapping[str, bytes], control: Control) -> Mapping[str, Any] | Refused:
    """What ``scopt verify`` prints.

    Args:
        files: of a result folder, by their path in it.
        control: says when to stop.
    """
    from service.replay.replay import verify_result

    with tempfile.TemporaryDirectory(prefix="scopt-") as scratch:
        folder = Path(scratch)
        for name, content in files.items():
            try:
                path = (folder / name).resolve()
                if not path.is_relative_to(folder.resolve()):
                    return Refused((f"files: {shown(name)} lies outside the result folder",))
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(content)
            except (OSError, ValueError):
                return Refused((f"files: {shown(name)} is no path of a file",))
        try:
            with stops_with(control):
                return verify_result(folder)
        except (ResultError, RequestError) as error:
            # Speak of the files as the client named them, not of where they lie for a moment.
            lines = (line.removeprefix(f"{folder}: ").replace(f"{folder}/", "") for line in str(error).splitlines())
            return Refused(tuple(f"files: {line}" for line in lines))


def describe_robots(more: Mapping[str, RobotRequest]) -> list[dict[str, Any]]:
    """Robots that can be named: ``more`` by name, those of the package; one that cannot be read says why."""
    texts = bundled_robots()
    bundled = {name: RobotRequest(name=name) for name in texts}
    own = [_described(name, request, "", IN_PLACE if name in bundled else "") for name, request in more.items()]
    return own + [_described(name, request, texts[name]) for name, request in bundled.items() if name not in more]


def _described(name: str, request: RobotRequest, description: str, besides: str = "") -> dict[str, Any]:
    try:
        robot = warm_robots().get(PlanRequest(robot=request, goal=GoalRequest(posture="-")))
    except RequestError as error:
        return {"name": name, "description": f"cannot be used: {error}{besides}"}
    return {
        "name": name,
        "description": f"{description or f'{robot.n} degrees of freedom'}{besides}",
        "joint_names": list(robot.joint_names),
        "postures": sorted(robot.postures),
    }
