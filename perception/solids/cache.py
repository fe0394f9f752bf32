"""Disk cache of convex parts, keyed by a hash of their input; limited in size and shared by processes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import platformdirs
from jaxtyping import Float

from costs.array_cache import ArrayCache, Parts, split_points


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

    @property
    def _files(self) -> ArrayCache:
        return ArrayCache(self.folder, self.max_bytes, is_compressed=True)

    def get(self, key: str) -> Parts | None:
        """Return the parts stored under ``key``; None if there are none or the file is damaged (it is then removed)."""
        return self._files.get(key, _unpack)

    def put(self, key: str, parts: Sequence[Float[np.ndarray, "V 3"]]) -> None:
        """Store parts under ``key`` atomically; a folder that cannot be written is ignored."""
        self._files.put(key, {"vertices": np.concatenate(parts), "counts": np.array([len(part) for part in parts])})


def _unpack(kept: Mapping[str, np.ndarray]) -> Parts:
    parts = split_points(kept["vertices"], kept["counts"])
    if not parts:
        raise ValueError("no parts are never written")
    return parts
