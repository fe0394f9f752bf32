"""The files of a plan: from the store's tar file to chunks on the wire."""

from __future__ import annotations

import asyncio
import tarfile
from collections.abc import AsyncIterator, Iterator
from functools import partial
from typing import IO, cast

from service.proto.planner.v1.result_pb2 import FileChunk
from service.result.versions import list_unknown_files
from service.store import Store
from service.store.seals import hash_chunks

CHUNK_BYTES = 512 * 2**10


async def stream_files(store: Store, plan_id: str, known_format: int) -> AsyncIterator[FileChunk]:
    """Yield the files of a plan that a client knows in chunks, one file after the other.

    Args:
        known_format: highest format of results that the client knows; 0 stands for that of version 0.3.0.

    Raises:
        NotStoredError: the plan has no files.
        DamagedError: its files are not what was stored.
    """
    chunks = _split(store, plan_id, list_unknown_files(known_format))
    while (chunk := await asyncio.to_thread(next, chunks, None)) is not None:
        yield chunk


def read_files(store: Store, plan_id: str) -> dict[str, bytes]:
    """Read all files of a plan, by path.

    Raises:
        NotStoredError: the plan has no files.
    """
    return {name: content.read() for name, _, content in _open_members(store, plan_id)}


def hash_files(store: Store, plan_id: str) -> dict[str, str]:
    """Return the sha256 of all files of a plan, by path.

    Raises:
        NotStoredError: the plan has no files.
        DamagedError: its files are not what was stored.
    """
    return {
        name: hash_chunks(iter(partial(content.read, CHUNK_BYTES), b""))
        for name, _, content in _open_members(store, plan_id)
    }


def _split(store: Store, plan_id: str, left_out: frozenset[str]) -> Iterator[FileChunk]:
    for name, left, content in _open_members(store, plan_id):
        if name in left_out:
            continue
        while True:
            data = content.read(CHUNK_BYTES)
            left -= len(data)
            yield FileChunk(path=name, data=data, is_last=left <= 0)
            if left <= 0:
                break


def _open_members(store: Store, plan_id: str) -> Iterator[tuple[str, int, IO[bytes]]]:
    """Yield path, size and content of each file; the content is read before the next.

    Raises:
        NotStoredError: the plan has no files.
        DamagedError: its files are not what was stored, or have changed since they were opened.
    """
    with store.plans.open_archive(plan_id) as file:
        with tarfile.open(fileobj=cast(IO[bytes], file), mode="r|") as archive:
            for member in archive:
                content = archive.extractfile(member)
                if content is not None:
                    yield member.name, member.size, content
        file.finish()
