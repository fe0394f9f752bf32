"""The files of a plan, from the store's tar file to chunks on the wire."""

from __future__ import annotations

import asyncio
import tarfile
from collections.abc import AsyncIterator, Iterator

from service.proto.planner.v1.result_pb2 import FileChunk
from service.store import Store

CHUNK_BYTES = 512 * 2**10


async def chunks(store: Store, plan_id: str) -> AsyncIterator[FileChunk]:
    """All files of a plan, each to its end before the next.

    Raises:
        NotStoredError: the plan has no files.
    """
    reading = _chunks(store, plan_id)
    while (chunk := await asyncio.to_thread(next, reading, None)) is not None:
        yield chunk


def _chunks(store: Store, plan_id: str) -> Iterator[FileChunk]:
    with store.plans.open_archive(plan_id) as file, tarfile.open(fileobj=file, mode="r:") as archive:
        for member in archive:
            content = archive.extractfile(member)
            if content is None:
                continue
            left = member.size
            while True:
                data = content.read(CHUNK_BYTES)
                left -= len(data)
                yield FileChunk(path=member.name, data=data, is_last=left <= 0)
                if left <= 0:
                    break
