"""Disk cache of arrays, keyed by a hash of what they were made from; limited in size and shared by processes."""

from __future__ import annotations

import os
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
from jaxtyping import Float, Int

T = TypeVar("T")
Parts = tuple[Float[np.ndarray, "V 3"], ...]

_BROKEN = (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error)


@dataclass(frozen=True)
class ArrayCache:
    """Files named by their keys; the least recently used are removed first.

    Attributes:
        folder: created when first needed.
        max_bytes: largest total size of the files.
        mode: permissions of the folder, where this creates it.
        is_compressed: whether files are written compressed.
    """

    folder: Path
    max_bytes: int
    mode: int = 0o777
    is_compressed: bool = False

    def get(self, key: str, read: Callable[[Mapping[str, np.ndarray]], T]) -> T | None:
        """Return what ``read`` makes of the arrays under ``key``; None if there are none.

        A file that is damaged, or that ``read`` refuses with ``ValueError`` or ``KeyError``, is removed.
        """
        path = self._path(key)
        try:
            # Opened here because np.load leaves a broken file open.
            with path.open("rb") as file, np.load(file, allow_pickle=False) as kept:
                made = read(kept)
            os.utime(path)
        except FileNotFoundError:
            return None
        except _BROKEN:
            with suppress(OSError):
                path.unlink()
            return None
        return made

    def put(self, key: str, arrays: Mapping[str, np.ndarray]) -> None:
        """Store arrays under ``key`` atomically; a folder that cannot be written is ignored."""
        save = np.savez_compressed if self.is_compressed else np.savez
        with suppress(OSError):
            self.folder.mkdir(parents=True, exist_ok=True, mode=self.mode)
            handle, fresh = tempfile.mkstemp(dir=self.folder, prefix=".", suffix=".npz")
            try:
                with os.fdopen(handle, "wb") as file:
                    save(file, allow_pickle=False, **arrays)
                os.replace(fresh, self._path(key))
            except BaseException:
                with suppress(OSError):
                    os.unlink(fresh)
                raise
            self._evict()

    def _path(self, key: str) -> Path:
        return self.folder / f"{key}.npz"

    def _evict(self) -> None:
        """Remove the least recently used files until the rest fits; other processes may do so at the same time."""
        entries = []
        for path in self.folder.glob("*.npz"):
            with suppress(OSError):
                status = path.stat()
                entries.append((status.st_mtime_ns, status.st_size, path))
        excess = sum(size for _, size, _ in entries) - self.max_bytes
        for _, size, path in sorted(entries):
            if excess <= 0:
                break
            with suppress(OSError):
                path.unlink()
            excess -= size


def split_points(points: Float[np.ndarray, "N 3"], counts: Int[np.ndarray, "P"]) -> Parts:
    """Return the parts of points that were written one after the other, each of at least 4.

    Raises:
        ValueError: this is not what was written.
    """
    is_sound = points.ndim == 2 and points.shape[1] == 3 and np.isfinite(points).all() and (counts >= 4).all()
    if not is_sound or counts.sum() != len(points):
        raise ValueError("not what was written")
    return tuple(np.split(points, np.cumsum(counts)[:-1])) if len(counts) else ()
