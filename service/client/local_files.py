"""Local files of a request: paths that the server can find, and clouds, meshes and scenes on their way to it."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from service.errors import RequestError, shown
from service.proto.planner.v1.planner_pb2 import CloudHeader, UploadCloudRequest
from service.request.file import list_mesh_files, replace_mesh_files
from service.request.scene import MESH_SUFFIXES
from service.request.schema import PlanRequest, RobotRequest
from service.request.tasks.mechanism import MAX_TEXT, MechanismRequest, is_urdf_text
from service.request.tasks.registry import TaskRequest
from service.trust.folders import BUILT, UPLOADED, list_paths

CHUNK_BYTES = 512 * 2**10
NOT_UPLOADED = (
    "it is not uploaded; put it into a folder of the server (`scopt serve --allow FOLDER`) and give its absolute path "
    "there"
)


@dataclass(frozen=True)
class PendingUpload:
    """Local cloud, mesh or scene file with its hash, by which the server recognises a file it has."""

    path: Path
    format: str
    sha256: str
    n_bytes: int


class UploadParts(Iterator[UploadCloudRequest]):
    """Messages of an upload: header, then chunks; gRPC may take them from a thread of its own.

    Attributes:
        error: reason why the file could not be read to its end; None otherwise.
    """

    def __init__(self, upload: PendingUpload) -> None:
        header = CloudHeader(format=upload.format, sha256=upload.sha256, size_bytes=upload.n_bytes)
        self._header: CloudHeader | None = header
        self._chunks = _read_chunks(upload.path)
        self.error: RequestError | None = None

    def __next__(self) -> UploadCloudRequest:
        if self._header is not None:
            header, self._header = self._header, None
            return UploadCloudRequest(header=header)
        try:
            return UploadCloudRequest(chunk=next(self._chunks))
        except RequestError as error:
            self.error = error
            raise StopIteration from None


def hash_file(path: str | Path) -> PendingUpload:
    """Read a file once for its hash.

    Raises:
        RequestError: it cannot be read, or its name has no suffix.
    """
    path = Path(path)
    if not path.suffix[1:]:
        raise RequestError(f"{path} has no suffix; expected the suffix of its format (.pcd, .ply, ...)")
    digest, n_bytes = hashlib.sha256(), 0
    for chunk in _read_chunks(path):
        digest.update(chunk)
        n_bytes += len(chunk)
    return PendingUpload(path, path.suffix[1:].lower(), digest.hexdigest(), n_bytes)


def resolve_paths(request: PlanRequest, is_this_machine: bool) -> PlanRequest:
    """Return the request with absolute paths, except those of files to upload.

    The URDF of a mechanism is sent as text if it names no mesh.

    Args:
        is_this_machine: whether the server runs here; another machine gets the request as it is.

    Raises:
        RequestError: a file does not exist here or cannot be found by the server.
    """
    request = replace(request, task=_inline_urdfs(request))
    problems = []
    uploads_first = sorted(list_paths(request), key=lambda path: path[2] in ("file", "mesh"))
    for field, path, kind in uploads_first:
        if kind in ("cloud", "scene") or (kind == "mesh" and is_uploaded(path)):
            problem = find_upload_problem(field, path, request.resolve(path))
            problems += [] if problem is None else [problem]
        elif os.path.isabs(path):
            continue
        elif not request.resolve(path).exists():
            problems.append(_missing(field, path))
        elif not is_this_machine:
            problems.append(f"{field}: {shown(path)} is a path of this machine; {NOT_UPLOADED}")
    if problems:
        raise RequestError(problems)
    if not is_this_machine:
        return request
    request = replace_mesh_files(request, lambda name: name if is_uploaded(name) else _absolute(request, name))
    return replace(request, robot=_resolve_robot(request), task=_resolve_task(request))


def find_local_files(request: PlanRequest) -> dict[str, Path]:
    """Return the files of a request's scene that exist here, by their names in the request."""
    scene = request.scene
    names = [cloud.file for cloud in scene.cloud_files]
    names += [file for _, file in list_mesh_files(request) if is_uploaded(file)]
    names += [] if scene.file is None else [scene.file]
    paths = {name: request.resolve(name) for name in names}
    return {name: path for name, path in paths.items() if path.is_file()}


def replace_by_ids(request: PlanRequest, ids: Mapping[str, str]) -> PlanRequest:
    """Return the request with the ids of uploads in place of their files' names."""
    scene, cloud = request.scene, request.scene.cloud
    if not ids:
        return request
    if cloud is None or isinstance(cloud, str):
        renamed: object = None if cloud is None else ids.get(cloud, cloud)
    else:
        renamed = tuple(replace(part, file=ids.get(part.file, part.file)) for part in cloud)
    file = None if scene.file is None else ids.get(scene.file, scene.file)
    scene = replace(scene, cloud=renamed, file=file)  # type: ignore[arg-type]
    return replace_mesh_files(replace(request, scene=scene), lambda name: ids.get(name, name))


def is_uploaded(mesh: str) -> bool:
    """Whether a mesh file can be uploaded: all but a URDF, which may name other files."""
    return Path(mesh).suffix.lower() in MESH_SUFFIXES


def find_upload_problem(field: str, name: str, path: Path) -> str | None:
    """Return why a file cannot be uploaded; None if it can, or if the server has to find it.

    Args:
        name: path or id as the user wrote it.
        path: the same, resolved on this machine.
    """
    if path.is_dir() and not os.path.isabs(name):
        return f"{field}: {shown(name)} is a folder; expected a file in it, or an absolute path on the server"
    if path.exists() or os.path.isabs(name) or name.startswith((UPLOADED, BUILT)):
        return None
    return _missing(field, name)


def _missing(field: str, name: str) -> str:
    return f"{field}: {shown(name)} does not exist; expected an existing file"


def _resolve_robot(request: PlanRequest) -> RobotRequest:
    robot = request.robot
    urdf, srdf = (None if path is None else _absolute(request, path) for path in (robot.urdf, robot.srdf))
    folders = tuple(_absolute(request, path) for path in robot.package_dirs)
    return replace(robot, urdf=urdf, srdf=srdf, package_dirs=folders)


def _inline_urdfs(request: PlanRequest) -> TaskRequest | None:
    """Return the task with the text of its mechanisms' URDFs, where they are local files without meshes."""
    if request.task is None:
        return None
    return request.task.replace_mechanisms(lambda _, mechanism: _inline_urdf(request, mechanism))


def _inline_urdf(request: PlanRequest, mechanism: MechanismRequest) -> MechanismRequest:
    path = request.resolve(mechanism.urdf)
    try:
        if is_urdf_text(mechanism.urdf) or os.path.isabs(mechanism.urdf) or not path.is_file():
            return mechanism
        if path.stat().st_size > MAX_TEXT:
            return mechanism
        text = path.read_text(encoding="utf-8").lstrip("\ufeff \t\r\n")
    except (OSError, UnicodeDecodeError):
        return mechanism
    if "<mesh" in text or not is_urdf_text(text):
        return mechanism
    return replace(mechanism, urdf=text)


def _resolve_task(request: PlanRequest) -> TaskRequest | None:
    def resolve(_: str, mechanism: MechanismRequest) -> MechanismRequest:
        if is_urdf_text(mechanism.urdf):
            return mechanism
        return replace(mechanism, urdf=_absolute(request, mechanism.urdf))

    return None if request.task is None else request.task.replace_mechanisms(resolve)


def _absolute(request: PlanRequest, path: str) -> str:
    return os.path.abspath(request.resolve(path))


def _read_chunks(path: Path) -> Iterator[bytes]:
    try:
        with path.open("rb") as file:
            while chunk := file.read(CHUNK_BYTES):
                yield chunk
    except OSError as error:
        raise RequestError(f"{path} cannot be read: {error.strerror}") from None
