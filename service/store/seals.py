"""Seals of stored rows: a hash of all columns, which tells whether a row is still what was written."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

CHUNK_BYTES = 2**20
SEAL = "seal"
LOCAL_COLUMNS = frozenset({"number", SEAL})  # not part of what a row says


def compute_seal(row: Mapping[str, Any], previous: str = "") -> str:
    """Return the sha256 over names, types and values of a row's columns.

    Args:
        row: value by column.
        previous: seal of the row before, which ties a list of rows together.
    """
    parts = [previous.encode()]
    for name in _sort_columns(tuple(row)):
        value = row[name]
        data = value if isinstance(value, bytes) else repr(value).encode()
        parts += f"\n{name} {type(value).__name__} {len(data)} ".encode(), data
    return hash_bytes(b"".join(parts))


@cache
def _sort_columns(names: tuple[str, ...]) -> list[str]:
    return sorted(set(names) - LOCAL_COLUMNS)


def hash_bytes(data: bytes) -> str:
    """Return the sha256 of bytes as hexadecimals."""
    return hashlib.sha256(data).hexdigest()


def hash_chunks(chunks: Iterable[bytes]) -> str:
    """Return the sha256 of consecutive chunks as hexadecimals."""
    digest = hashlib.sha256()
    for chunk in chunks:
        digest.update(chunk)
    return digest.hexdigest()


def hash_file(path: Path) -> str:
    """Return the sha256 of a file's content as hexadecimals (OSError where it cannot be read)."""
    with path.open("rb") as file:
        return hash_chunks(iter(lambda: file.read(CHUNK_BYTES), b""))
