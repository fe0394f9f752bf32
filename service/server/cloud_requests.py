"""Requests about clouds: known meshes, the scene to update, and problems under the fields of the client's message."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from service.errors import RequestError
from service.proto.planner.v1.planner_pb2 import BuildSceneRequest, DetectRequest
from service.request.choices import GIVEN
from service.request.file import parse_section
from service.request.scene import KnownRequest
from service.request.schema import RobotRequest, StartRequest
from service.server.refusals import refuse_invalid
from service.server.requests import select_uploads
from service.store import CloudStore, Scenes
from service.trust import BUILT, AllowedFolders
from service.wire.plain import to_plain
from service.wire.violations import make_violation

MESH, UPDATE, OBJECT = "--mesh", "--update", "--object"
# Fields for the options that perception names in its messages.
FIELD_OF_OPTION: Mapping[str, str] = {
    "KIND": "kind",
    "--detect": "detect",
    "--robot": "clouds.robot",
    "--transform": "clouds.clouds",
    "--sensor": "clouds.sensor",
    "--unit": "clouds.unit",
    MESH: "meshes",
    UPDATE: "update",
    OBJECT: "objects",
}
# Fields for the settings that an update takes over from the earlier scene.
FIELD_OF_SETTING: Mapping[str, str] = {
    "reach_m": "clouds.reach_m",
    "top_m": "clouds.top_m",
    "bottom_m": "clouds.bottom_m",
    "seed": "clouds.seed",
    "unknown": "unknown",
    "method": "method",
}
FIELDS = frozenset(FIELD_OF_SETTING.values())
KNOWN_FIELDS = ("meshes", "update", "objects")


@dataclass(frozen=True)
class NamedFile:
    """A file of a message: its field, the client's name for it, and its path on the server."""

    field: str
    name: str
    path: Path


@dataclass(frozen=True)
class KnownReader:
    """Reader of the known meshes, the scene to update, and the objects to detect.

    Attributes:
        folders: folders whose files requests may name.
        clouds: uploaded files, meshes among them.
        scenes: built scenes.
    """

    folders: AllowedFolders
    clouds: CloudStore
    scenes: Scenes

    def read(self, message: BuildSceneRequest | DetectRequest) -> KnownRequest:
        """Read and check a message.

        Raises:
            Refusal: INVALID_ARGUMENT naming every wrong field.
        """
        plain = to_plain(message)
        try:
            known = parse_section(KnownRequest, {key: plain[key] for key in KNOWN_FIELDS if key in plain})
        except RequestError as error:
            raise refuse_invalid(error.problems) from None
        checks = {field: self.folders.check(file, "mesh") for field, file in _list_meshes(known)}
        checks["update"] = "" if known.update is None else self.folders.check(known.update, "scene")
        if isinstance(message, DetectRequest) and (message.kind == GIVEN) != bool(known.objects):
            checks["objects"] = f"expected some with kind '{GIVEN}', and none with another"
        problems = [f"{field}: {problem}" for field, problem in checks.items() if problem]
        if problems:
            raise refuse_invalid(problems)
        return known

    @contextmanager
    def open_files(self, known: KnownRequest) -> Iterator[dict[str, Path]]:
        """Yield the paths of the meshes and of the scene to update by name; they stay readable for the body.

        Raises:
            NotStoredError: a file has been deleted since the request was read.
        """
        with ExitStack() as stack:
            files = {name: Path(name) for name in known.files}
            files |= stack.enter_context(self.clouds.open_files(select_uploads(known.files)))
            if known.update is not None and known.update.startswith(BUILT):
                files[known.update] = stack.enter_context(self.scenes.open_file(known.update))
            yield files


def list_settings(message: BuildSceneRequest) -> dict[str, str]:
    """List the settings that a message gives explicitly, with their fields."""
    clouds = message.clouds
    is_given = {name: clouds.HasField(name) for name in ("reach_m", "top_m", "bottom_m")}
    is_given |= {"seed": bool(clouds.seed), "unknown": bool(message.unknown), "method": bool(message.method)}
    return {name: FIELD_OF_SETTING[name] for name, given in is_given.items() if given}


def list_known_files(known: KnownRequest, paths: Mapping[str, Path]) -> list[NamedFile]:
    """List the files of known meshes, of the scene to update, and of objects to detect."""
    files = [NamedFile(field, file, paths[file]) for field, file in _list_meshes(known)]
    return files if known.update is None else [*files, NamedFile("update", known.update, paths[known.update])]


def _list_meshes(known: KnownRequest) -> list[tuple[str, str]]:
    """List the files of known meshes and of objects to detect, each with its field."""
    groups = (("meshes", known.meshes), ("objects", known.objects))
    return [
        (f"{name}[{k}].file", mesh.file)
        for name, group in groups
        for k, mesh in enumerate(group)
        if mesh.file is not None
    ]


def rename_fields(problems: Iterable[str], files: Sequence[NamedFile]) -> tuple[str, ...]:
    """Begin each problem with the message's field, and replace paths by the client's names."""
    return tuple(_rename_field(problem, files) for problem in problems)


def check_robot(name: str | None) -> tuple[str, ...]:
    """Return the problems of a robot's name, each beginning with the field."""
    try:
        if name is not None:
            parse_section(RobotRequest, {"name": name})
    except RequestError as error:
        return tuple(f"robot: {make_violation(problem).description}" for problem in error.problems)
    return ()


def check_start(data: object) -> tuple[str, ...]:
    """Return the problems of the robot's start, each beginning with the field."""
    try:
        parse_section(StartRequest, data)
    except RequestError as error:
        return tuple(f"start{'.' if make_violation(problem).field else ': '}{problem}" for problem in error.problems)
    return ()


def _rename_field(problem: str, files: Sequence[NamedFile]) -> str:
    option, colon, words = problem.partition(": ")
    if colon and option in (MESH, UPDATE, OBJECT):
        problem = words.replace("--mesh-scale", "scale")
    named = [file for file in files if str(file.path) in problem] or [
        file for file in files if file.path.name in problem
    ]
    if named:
        return f"{named[0].field}: {problem.replace(str(named[0].path), named[0].name)}"
    if colon and option in FIELD_OF_OPTION:
        return f"{FIELD_OF_OPTION[option]}: {words}"
    if colon and option in FIELDS:
        return problem
    return f"clouds.{make_violation(problem).field or 'clouds'}: {problem}"
