"""UploadCloud."""

from __future__ import annotations

import asyncio
import re
from collections.abc import AsyncIterator, Callable

from service.errors import shown
from service.proto.planner.v1.planner_pb2 import UploadCloudRequest, UploadCloudResponse
from service.server.disk import Disk
from service.server.refusal import invalid, overloaded
from service.store import UPLOAD_SUFFIXES, CloudStore, TooLargeError, UploadRefusedError
from service.trust import Limits as ClientLimiter
from service.trust import current_caller
from service.trust.folders import UPLOADED
from service.trust.rpc import Context

SHA256 = re.compile(r"[0-9a-f]{64}")


class Uploading:
    """Takes clouds, meshes and the files of scenes in.

    Args:
        clouds: where they are kept; disk: that is on.
        limiter: of how much a client may upload.
        on_upload: told the bytes of every cloud that came.
    """

    def __init__(
        self, clouds: CloudStore, disk: Disk, limiter: ClientLimiter, on_upload: Callable[[int], None]
    ) -> None:
        self._clouds = clouds
        self._disk = disk
        self._limiter = limiter
        self._on_upload = on_upload

    async def upload(self, requests: AsyncIterator[UploadCloudRequest], context: Context) -> UploadCloudResponse:
        """Take a cloud in; one that is known need not be sent.

        Raises:
            Refusal: it cannot be taken.
        """
        client = current_caller()
        first = await anext(requests, None)
        if first is None or first.WhichOneof("part") != "header":
            raise invalid(["header: the first message of an upload needs one"])
        suffix = "." + first.header.format.removeprefix(".").lower()
        if suffix not in UPLOAD_SUFFIXES:
            formats = ", ".join(one.removeprefix(".") for one in UPLOAD_SUFFIXES)
            raise invalid([f"header.format: {formats} would do, got {shown(first.header.format)}"])
        claimed = first.header.sha256.lower()
        if claimed and not SHA256.fullmatch(claimed):
            raise invalid([f"header.sha256: 64 hexadecimal digits or nothing would do, got {shown(claimed)}"])
        announced, most = first.header.size_bytes, self._clouds.limits.max_cloud_bytes
        if announced > most:
            raise invalid([f"header.size_bytes: at most {most} would do, got {announced}; downsample the cloud first"])
        known = self._clouds.size(f"{UPLOADED}{claimed}{suffix}") if claimed else None
        if known is not None:
            return UploadCloudResponse(cloud_id=f"{UPLOADED}{claimed}{suffix}", size_bytes=known, was_known=True)
        self._disk.check()
        with self._clouds.upload(client.name, suffix) as upload:
            self._count(client.key, announced)
            async for request in requests:
                if request.WhichOneof("part") != "chunk":
                    raise invalid(["chunk: every message after the first needs one"])
                beyond = upload.n_bytes + len(request.chunk) - max(announced, upload.n_bytes)
                self._count(client.key, beyond, upload.n_bytes)
                try:
                    await asyncio.to_thread(upload.write, request.chunk)
                except TooLargeError as error:
                    raise invalid([f"chunk: {error}"]) from None
            size, sha256 = upload.n_bytes, upload.sha256
            if announced and size != announced:
                raise invalid([f"header.size_bytes: {announced} bytes were announced and {size} came"])
            if claimed and sha256 != claimed:
                raise invalid([f"header.sha256: {claimed} was announced, what came has {sha256}"])
            was_known = self._clouds.has(f"{UPLOADED}{sha256}{suffix}")
            cloud_id = await asyncio.to_thread(_kept, upload.finish)
        self._on_upload(size)
        return UploadCloudResponse(cloud_id=cloud_id, size_bytes=size, was_known=was_known)

    def _count(self, client: str, n_bytes: int, begun: int = 0) -> None:
        """Count bytes of a client's upload, what is announced before any of it is sent.

        Raises:
            Refusal: it brings too many, with the time after which all of it would do.
        """
        refusal = self._limiter.upload(client, n_bytes, begun) if n_bytes > 0 else None
        if refusal is not None:
            raise overloaded(refusal.text, refusal.retry_after_s or 0.0)


def _kept(finish: Callable[[], str]) -> str:
    try:
        return finish()
    except UploadRefusedError as error:
        raise invalid([f"chunk: {error}"]) from None
