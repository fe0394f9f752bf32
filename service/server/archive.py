"""The files of a plan, from the store's tar file to chunks on the wire."""

from __future__ import annotations

import asyncio
import tarfile
from collections.abc import AsyncIterator, Iterator
from typing import IO

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


def files_of(store: Store, plan_id: str) -> dict[str, bytes]:
    """All files of a plan by their path.

    Raises:
        NotStoredError: the plan has no files.
    """
    return {name: content.read() for name, _, content in _opened(store, plan_id)}


def _chunks(store: Store, plan_id: str) -> Iterator[FileChunk]:
    for name, left, content in _opened(store, plan_id):
        while True:
            data = content.read(CHUNK_BYTES)
            left -= len(data)
            yield FileChunk(path=name, data=data, is_last=left <= 0)
            if left <= 0:
                break


def _opened(store: Store, plan_id: str) -> Iterator[tuple[str, int, IO[bytes]]]:
    """Path, size and content of each file, to be read before the next."""
    with store.plans.open_archive(plan_id) as file, tarfile.open(fileobj=file, mode="r:") as archive:
        for member in archive:
            content = archive.extractfile(member)
            if content is not None:
                yield member.name, member.size, content
