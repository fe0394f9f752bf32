"""Clouds, meshes and scenes that are files of this machine, on their way to the server."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from service.errors import RequestError
from service.proto.planner.v1.planner_pb2 import CloudHeader, UploadCloudRequest
from service.request.scene import MESH_SUFFIXES, MeshRequest
from service.request.schema import PlanRequest

CHUNK_BYTES = 512 * 2**10


@dataclass(frozen=True)
class CloudToSend:
    """A cloud file and its hash; a server that knows it answers after the header, and no more is sent."""

    path: Path
    format: str
    sha256: str
    n_bytes: int


class CloudParts(Iterator[UploadCloudRequest]):
    """What is sent of a cloud, in order; gRPC takes it from a thread of its own.

    Attributes:
        error: why it ended early, for whoever waits for the answer; None if it did not.
    """

    def __init__(self, cloud: CloudToSend) -> None:
        header = CloudHeader(format=cloud.format, sha256=cloud.sha256, size_bytes=cloud.n_bytes)
        self._header: CloudHeader | None = header
        self._chunks = _chunks(cloud.path)
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


def cloud_to_send(path: str | Path) -> CloudToSend:
    """A cloud file, read once for its hash.

    Raises:
        RequestError: it cannot be read, or its name does not tell its kind.
    """
    path = Path(path)
    if not path.suffix[1:]:
        raise RequestError(f"{path} has no suffix; one that tells its kind (.pcd, .ply, ...) is needed")
    digest, n_bytes = hashlib.sha256(), 0
    for chunk in _chunks(path):
        digest.update(chunk)
        n_bytes += len(chunk)
    return CloudToSend(path, path.suffix[1:].lower(), digest.hexdigest(), n_bytes)


def local_files(request: PlanRequest) -> dict[str, Path]:
    """What a request's scene names and is a file here, by the name it gives it."""
    names = [cloud.file for cloud in request.scene.cloud_files]
    names += [one.file for one in request.scene.obstacles if isinstance(one, MeshRequest) and is_sent(one.file)]
    names += [] if request.scene.file is None else [request.scene.file]
    found = {name: request.resolve(name) for name in names}
    return {name: path for name, path in found.items() if path.is_file()}


def with_ids(request: PlanRequest, ids: Mapping[str, str]) -> PlanRequest:
    """The request with clouds, meshes and scenes named by id, where there is one for the name it gives them."""
    scene, cloud = request.scene, request.scene.cloud
    if not ids:
        return request
    if cloud is None or isinstance(cloud, str):
        renamed: object = None if cloud is None else ids.get(cloud, cloud)
    else:
        renamed = tuple(dataclasses.replace(one, file=ids.get(one.file, one.file)) for one in cloud)
    file = None if scene.file is None else ids.get(scene.file, scene.file)
    obstacles = tuple(
        dataclasses.replace(one, file=ids.get(one.file, one.file)) if isinstance(one, MeshRequest) else one
        for one in scene.obstacles
    )
    scene = dataclasses.replace(scene, cloud=renamed, file=file, obstacles=obstacles)  # type: ignore[arg-type]
    return dataclasses.replace(request, scene=scene)


def is_sent(mesh: str) -> bool:
    """Whether a mesh file can be uploaded: all but a URDF, which may name others."""
    return Path(mesh).suffix.lower() in MESH_SUFFIXES


def _chunks(path: Path) -> Iterator[bytes]:
    try:
        with path.open("rb") as file:
            while chunk := file.read(CHUNK_BYTES):
                yield chunk
    except OSError as error:
        raise RequestError(f"{path} cannot be read: {error.strerror}") from None
