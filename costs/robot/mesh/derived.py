"""Disk cache of what is derived from a robot's files: hulls, outer hulls, link pairs not to check."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import platformdirs
from jaxtyping import Float

from costs.array_cache import ArrayCache, Parts, split_points

VERSION = "2"
"""To be raised whenever the same files give other hulls or pairs."""

MAX_BYTES = 256 * 2**20


@dataclass(frozen=True)
class Derived:
    """What was derived from a robot's files.

    Attributes:
        hulls: vertices of each mesh file's convex hull, in the file's units, by the SHA-256 of the file.
        outers: outer hull of each body, in the robot's order.
        pairs: reason (``Adjacent``, ``Always``) by link pair not to check; None where the SRDF has them.
    """

    hulls: Mapping[str, Float[np.ndarray, "V 3"]]
    outers: Parts
    pairs: Mapping[tuple[str, str], str] | None


@dataclass(frozen=True)
class DerivedCache:
    """Files named by the hash of a robot's files; the least recently used are removed first.

    Attributes:
        folder: created when first needed, readable by the user alone.
    """

    folder: Path

    @staticmethod
    def of_user() -> DerivedCache:
        """Return the cache in the user's folder (``XDG_CACHE_HOME``)."""
        return DerivedCache(platformdirs.user_cache_path("scopt") / "robots")

    @property
    def _files(self) -> ArrayCache:
        return ArrayCache(self.folder, MAX_BYTES, mode=0o700)

    def get(self, key: str) -> Derived | None:
        """Return what is stored under ``key``; None if there is nothing or the file is damaged (it is then removed)."""
        return self._files.get(key, _unpack)

    def put(self, key: str, derived: Derived) -> None:
        """Store atomically; a folder that cannot be written is ignored."""
        self._files.put(key, _pack(derived))


def make_key(parts: Iterable[str]) -> str:
    """Return the key of a robot: the hash of its texts and of the hashes of its mesh files."""
    digest = hashlib.sha256(VERSION.encode())
    for part in parts:
        data = part.encode()
        digest.update(len(data).to_bytes(8, "little") + data)
    return digest.hexdigest()


def _pack(derived: Derived) -> dict[str, np.ndarray]:
    pairs = {} if derived.pairs is None else derived.pairs
    return {
        "digests": np.array(list(derived.hulls), dtype=str),
        "hulls": _join(list(derived.hulls.values())),
        "hull_counts": np.array([len(hull) for hull in derived.hulls.values()], dtype=int),
        "outers": _join(derived.outers),
        "outer_counts": np.array([len(outer) for outer in derived.outers], dtype=int),
        "has_pairs": np.array(derived.pairs is not None),
        "pairs": np.array([[*pair, reason] for pair, reason in pairs.items()], dtype=str).reshape(-1, 3),
    }


def _unpack(kept: Mapping[str, np.ndarray]) -> Derived:
    hulls, outers = (split_points(kept[name + "s"], kept[name + "_counts"]) for name in ("hull", "outer"))
    pairs = {(str(a), str(b)): str(reason) for a, b, reason in kept["pairs"].tolist()}
    by_digest = dict(zip(kept["digests"].tolist(), hulls, strict=True))
    return Derived(by_digest, outers, pairs if bool(kept["has_pairs"]) else None)


def _join(parts: Sequence[Float[np.ndarray, "V 3"]]) -> Float[np.ndarray, "N 3"]:
    return np.concatenate([np.zeros((0, 3)), *parts])
