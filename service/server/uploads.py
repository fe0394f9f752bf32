"""UploadCloud."""

from __future__ import annotations

import asyncio
import re
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass

from service.errors import shown
from service.proto.planner.v1.planner_pb2 import UploadCloudRequest, UploadCloudResponse
from service.server.disk import DiskWatch
from service.server.refusals import refuse_invalid, refuse_overload
from service.store import UPLOAD_SUFFIXES, CloudStore, TooLargeError, Upload, UploadRefusedError
from service.trust import UPLOADED, ClientLimiter, current_caller
from service.trust.rpc import Context

SHA256 = re.compile(r"[0-9a-f]{64}")


class UploadHandler:
    """Handler of ``UploadCloud``: clouds, meshes and scene files.

    Args:
        clouds: store of the uploads.
        disk: watch on the store's disk.
        limiter: limits of each client's uploads.
        on_upload: called with the size of each upload [bytes].
    """

    def __init__(
        self, clouds: CloudStore, disk: DiskWatch, limiter: ClientLimiter, on_upload: Callable[[int], None]
    ) -> None:
        self._clouds = clouds
        self._disk = disk
        self._limiter = limiter
        self._on_upload = on_upload

    async def upload(self, requests: AsyncIterator[UploadCloudRequest], context: Context) -> UploadCloudResponse:
        """Store an upload; a known one ends with its header.

        Raises:
            Refusal: it cannot be stored.
        """
        client = current_caller()
        header = _read_header(await anext(requests, None), self._clouds.limits.max_cloud_bytes)
        known_id = f"{UPLOADED}{header.sha256}{header.suffix}"
        # A file that was damaged on the disk is removed, so that this upload replaces it.
        if header.sha256 and self._clouds.has(known_id) and await asyncio.to_thread(self._clouds.check, known_id):
            known_size = self._clouds.size(known_id)
            if known_size is not None:
                return UploadCloudResponse(cloud_id=known_id, size_bytes=known_size, was_known=True)
        self._disk.require_space()
        with self._clouds.upload(client.name, header.suffix) as upload:
            self._count(client.key, header.n_bytes)
            await self._receive(requests, upload, header.n_bytes, client.key)
            header.compare(upload)
            was_known = self._clouds.has(f"{UPLOADED}{upload.sha256}{header.suffix}")
            size = upload.n_bytes
            try:
                cloud_id = await asyncio.to_thread(upload.finish)
            except UploadRefusedError as error:
                raise refuse_invalid([f"chunk: {error}"]) from None
        self._on_upload(size)
        return UploadCloudResponse(cloud_id=cloud_id, size_bytes=size, was_known=was_known)

    async def _receive(
        self, requests: AsyncIterator[UploadCloudRequest], upload: Upload, announced: int, client: str
    ) -> None:
        """Write the chunks of an upload.

        Raises:
            Refusal: it is too large, or a message is no chunk.
        """
        async for request in requests:
            if request.WhichOneof("part") != "chunk":
                raise refuse_invalid(["chunk: every message after the first needs one"])
            beyond = upload.n_bytes + len(request.chunk) - max(announced, upload.n_bytes)
            self._count(client, beyond, upload.n_bytes)
            try:
                await asyncio.to_thread(upload.write, request.chunk)
            except TooLargeError as error:
                raise refuse_invalid([f"chunk: {error}"]) from None

    def _count(self, client: str, n_bytes: int, already_counted: int = 0) -> None:
        """Count bytes of a client's upload; announced bytes are counted before any is sent.

        Raises:
            Refusal: they exceed the client's limit; it says after which time the whole upload is allowed.
        """
        refusal = self._limiter.upload(client, n_bytes, already_counted) if n_bytes > 0 else None
        if refusal is not None:
            raise refuse_overload(refusal.text, refusal.retry_after_s or 0.0)


@dataclass(frozen=True)
class _UploadHeader:
    """What a client says of its upload.

    Attributes:
        suffix: of the file, with a dot.
        sha256: announced hash; empty without one.
        n_bytes: announced size; 0 without one.
    """

    suffix: str
    sha256: str
    n_bytes: int

    def compare(self, upload: Upload) -> None:
        """Compare the received bytes with what was announced.

        Raises:
            Refusal: they differ.
        """
        size, sha256 = upload.n_bytes, upload.sha256
        if self.n_bytes and size != self.n_bytes:
            raise refuse_invalid([f"header.size_bytes: {self.n_bytes} bytes were announced, {size} were received"])
        if self.sha256 and sha256 != self.sha256:
            raise refuse_invalid([f"header.sha256: {self.sha256} was announced, the received bytes have {sha256}"])


def _read_header(first: UploadCloudRequest | None, most: int) -> _UploadHeader:
    """Read the first message of an upload of at most ``most`` bytes.

    Raises:
        Refusal: INVALID_ARGUMENT.
    """
    if first is None or first.WhichOneof("part") != "header":
        raise refuse_invalid(["header: the first message of an upload needs one"])
    suffix = "." + first.header.format.removeprefix(".").lower()
    if suffix not in UPLOAD_SUFFIXES:
        formats = ", ".join(known.removeprefix(".") for known in UPLOAD_SUFFIXES)
        raise refuse_invalid([f"header.format: expected {formats}, got {shown(first.header.format)}"])
    claimed, announced = first.header.sha256.lower(), first.header.size_bytes
    if claimed and not SHA256.fullmatch(claimed):
        raise refuse_invalid([f"header.sha256: expected 64 hexadecimal digits or nothing, got {shown(claimed)}"])
    if announced > most:
        raise refuse_invalid(
            [f"header.size_bytes: expected at most {most}, got {announced}; downsample the cloud first"]
        )
    return _UploadHeader(suffix, claimed, announced)
