"""Disk cache of convex parts, keyed by a hash of their input; limited in size and shared by processes."""

from __future__ import annotations

import os
import tempfile
import zipfile
import zlib
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import platformdirs
from jaxtyping import Float, Int

Parts = tuple[Float[np.ndarray, "V 3"], ...]

_BROKEN = (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error)


def _default_folder() -> Path:
    return platformdirs.user_cache_path("scopt") / "parts"


@dataclass(frozen=True)
class PartsCache:
    """Cache files named by the hash of their input; the least recently used are removed first.

    Attributes:
        folder: created when first needed.
        max_bytes: largest total size of the files.
    """

    folder: Path
    max_bytes: int = 256 * 2**20

    @staticmethod
    def of_user() -> PartsCache:
        """Return the cache in the user's folder (``XDG_CACHE_HOME``)."""
        return PartsCache(_default_folder())

    def get(self, key: str) -> Parts | None:
        """Return the parts stored under ``key``; None if there are none or the file is damaged (it is then removed)."""
        path = self._path(key)
        try:
            # Opened here because np.load leaves a broken file open.
            with path.open("rb") as file, np.load(file, allow_pickle=False) as kept:
                parts = _split_parts(kept["vertices"], kept["counts"])
            os.utime(path)
        except FileNotFoundError:
            return None
        except _BROKEN:
            with suppress(OSError):
                path.unlink()
            return None
        return parts

    def put(self, key: str, parts: Sequence[Float[np.ndarray, "V 3"]]) -> None:
        """Store parts under ``key`` atomically; a folder that cannot be written is ignored."""
        with suppress(OSError):
            self.folder.mkdir(parents=True, exist_ok=True)
            handle, fresh = tempfile.mkstemp(dir=self.folder, prefix=".", suffix=".npz")
            try:
                with os.fdopen(handle, "wb") as file:
                    np.savez_compressed(
                        file, vertices=np.concatenate(parts), counts=np.array([len(part) for part in parts])
                    )
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


def _split_parts(vertices: Float[np.ndarray, "N 3"], counts: Int[np.ndarray, "P"]) -> Parts:
    sound = vertices.ndim == 2 and vertices.shape[1] == 3 and np.isfinite(vertices).all() and (counts >= 4).all()
    if not sound or counts.sum() != len(vertices):
        raise ValueError("not what was written")
    return tuple(np.split(vertices, np.cumsum(counts)[:-1]))
