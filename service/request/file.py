"""Request files: parsing of YAML or JSON into a ``PlanRequest``, and its canonical JSON for hashing."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from service.errors import RequestError, shown
from service.request.attached import AttachedMesh
from service.request.formats import FORMAT
from service.request.plain_file import adapter_of, load_section, parse_section, read_text, read_yaml
from service.request.scene import CarriedMesh, MeshRequest, MovableMesh, SceneRequest
from service.request.schema import PlanRequest
from service.request.task_files.expand import use_task
from service.request.versions import find_first_format, write_as

__all__ = [
    "adapter_of",
    "has_hash",
    "hash_request_data",
    "list_mesh_files",
    "load_request",
    "load_section",
    "parse_request",
    "parse_section",
    "read_plain_request",
    "replace_cloud",
    "replace_clouds",
    "replace_mesh_files",
    "replace_options",
    "request_hash",
    "to_json",
]
TASKS_FOLDER = "tasks"  # beside a request file, with task files of its own


def load_request(path: str | Path) -> PlanRequest:
    """Read and check a request file; its paths are relative to the file's folder.

    Raises:
        RequestError: one line per problem.
    """
    path = Path(path)
    data = read_plain_request(path)
    try:
        request = parse_section(PlanRequest, use_task(data, (path.parent / TASKS_FOLDER,)))
    except RequestError as error:
        raise RequestError([f"{path.name or path}: {problem}" for problem in error.problems]) from None
    return dataclasses.replace(request, folder=path.parent)


def read_plain_request(path: Path) -> dict[str, Any]:
    """Return a request file as the plain data that it holds, of which only the form is checked.

    Raises:
        RequestError: the file cannot be read, or holds no mapping.
    """
    try:
        data = read_yaml(read_text(path))
    except RequestError as error:
        raise RequestError([f"{path.name or path}: {problem}" for problem in error.problems]) from None
    if not isinstance(data, Mapping):
        raise RequestError(f"{path.name}: a mapping is needed, got {shown(data)}")
    return dict(data)


def parse_request(data: object, folder: str | Path = ".") -> PlanRequest:
    """Check a request given as plain mappings, lists and scalars; its paths are relative to ``folder``.

    Raises:
        RequestError: one line per problem.
    """
    path = Path(folder)
    used = use_task(data, (path / TASKS_FOLDER,)) if isinstance(data, Mapping) else data
    request = parse_section(PlanRequest, used)
    return request if request.folder == path else dataclasses.replace(request, folder=path)  # which checks it again


def replace_cloud(request: PlanRequest, cloud: Path) -> PlanRequest:
    """Return the request with another cloud file, whose path is relative to the working directory."""
    return _with_scene(request, cloud=_relative(request, cloud))


def replace_options(request: PlanRequest, changes: Mapping[str, Any]) -> PlanRequest:
    """Return the request with other values of some fields of its options; the same one without changes."""
    if not changes:
        return request
    return dataclasses.replace(request, options=dataclasses.replace(request.options, **changes))


def replace_clouds(request: PlanRequest, clouds: Sequence[Path]) -> PlanRequest:
    """Return the request with other paths of its cloud files or its scene file, relative to the working directory.

    Raises:
        RequestError: the number of paths differs from the request's number of files.
    """
    paths = [_relative(request, path) for path in clouds]
    scene = request.scene
    names = [scene.file] if scene.file is not None else [file.file for file in scene.cloud_files]
    if len(paths) != len(names):
        listed = ", ".join(shown(name) for name in names) or "no scan"
        raise RequestError(f"--cloud: {len(paths)} files given; the request's scene has {listed}")
    if scene.file is not None:
        return _with_scene(request, file=paths[0])
    if isinstance(scene.cloud, str):
        return _with_scene(request, cloud=paths[0])
    files = tuple(dataclasses.replace(file, file=path) for file, path in zip(scene.cloud_files, paths, strict=True))
    return _with_scene(request, cloud=files)


def list_mesh_files(request: PlanRequest) -> Iterator[tuple[str, str]]:
    """Yield field and file of each mesh that is to be read: of obstacles, movable objects and carried bodies."""
    yield from list_scene_meshes(request.scene)
    yield from list_attached_meshes(request)


def list_attached_meshes(request: PlanRequest) -> Iterator[tuple[str, str]]:
    """Yield the same of carried bodies alone."""
    yield from _list_files("attached", request.attached)


def list_scene_meshes(scene: SceneRequest) -> Iterator[tuple[str, str]]:
    """Yield the same of a scene alone."""
    yield from _list_files("scene.obstacles", scene.obstacles)
    yield from _list_files("scene.objects", scene.objects)


def _list_files(field: str, items: Sequence[Any]) -> Iterator[tuple[str, str]]:
    for index, item in enumerate(items):
        if _is_read(item):
            yield f"{field}[{index}].file", item.file


def replace_mesh_files(request: PlanRequest, rename: Callable[[str], str]) -> PlanRequest:
    """Return the request with other names of the files that ``list_mesh_files`` lists."""
    if not any(True for _ in list_mesh_files(request)):
        return request
    scene = request.scene
    obstacles, objects = _rename_files(scene.obstacles, rename), _rename_files(scene.objects, rename)
    attached = _rename_files(request.attached, rename)
    return dataclasses.replace(_with_scene(request, obstacles=obstacles, objects=objects), attached=attached)


def _rename_files(items: Sequence[Any], rename: Callable[[str], str]) -> tuple[Any, ...]:
    return tuple(dataclasses.replace(item, file=rename(item.file)) if _is_read(item) else item for item in items)


def _is_read(item: object) -> bool:
    """Return whether a shape is a mesh that has not been read into the request."""
    is_known = (isinstance(item, MovableMesh) and item.points) or (isinstance(item, AttachedMesh) and item.parts)
    return isinstance(item, CarriedMesh | MeshRequest) and not is_known


def _relative(request: PlanRequest, path: Path) -> str:
    return os.path.relpath(path.absolute(), request.folder.absolute())


def _with_scene(request: PlanRequest, **changes: Any) -> PlanRequest:
    return dataclasses.replace(request, scene=dataclasses.replace(request.scene, **changes))


def to_json(request: PlanRequest) -> dict[str, Any]:
    """Return the request as plain JSON data, without the folder and the defaults of later fields.

    Which these are, ``service.request.versions`` says.
    """
    return write_as(request, FORMAT)


def request_hash(request: PlanRequest) -> str:
    """Return the hash of the request's data (``to_json``)."""
    return hash_request_data(to_json(request))


def has_hash(request: PlanRequest, sha256: str) -> bool:
    """Return whether this version, or an earlier one, gives the same request this hash."""
    if request_hash(request) == sha256:
        return True
    earlier = range(FORMAT - 1, find_first_format(request) - 1, -1)
    return any(hash_request_data(write_as(request, version)) == sha256 for version in earlier)


def hash_request_data(data: object) -> str:
    """Return ``sha256:`` and the hash of a request's data as canonical JSON (sorted keys, no blanks)."""
    text = json.dumps(data, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return "sha256:" + hashlib.sha256(text.encode()).hexdigest()
