"""Cache of ``perceive`` results, keyed by the content of the cloud and the settings."""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np

from perception.cloud import Cloud
from perception.perceived import Perceived, perceive

_MOST_BYTES = 512 * 2**20
# Part of every key: increase it when a code change gives another result for the same input.
_METHOD = 2


class Memory:
    """Cache of ``perceive`` results that drops the least recently used first.

    Attributes:
        most_bytes: largest total size of the cached arrays; a result larger than this is not cached.
    """

    def __init__(self, most_bytes: int = _MOST_BYTES) -> None:
        self.most_bytes = most_bytes
        self._kept: OrderedDict[str, tuple[Perceived, int]] = OrderedDict()

    def __len__(self) -> int:
        return len(self._kept)

    @property
    def n_bytes(self) -> int:
        """Size of the cached results in bytes."""
        return sum(size for _, size in self._kept.values())

    def perceive(self, cloud: Cloud, **settings: Any) -> Perceived:
        """Return ``perceive(cloud, **settings)``, from the cache if the same input was perceived before."""
        key = content_key(cloud, {name: value for name, value in settings.items() if name != "should_stop"})
        if key in self._kept:
            self._kept.move_to_end(key)
            return self._kept[key][0]
        return self._keep(key, perceive(cloud, **settings))

    def _keep(self, key: str, seen: Perceived) -> Perceived:
        size = _bytes_of(seen)
        if size <= self.most_bytes:
            self._kept[key] = seen, size
            while self.n_bytes > self.most_bytes:
                self._kept.popitem(last=False)
        return seen


def content_key(cloud: Cloud, settings: Mapping[str, Any]) -> str:
    """Return the SHA-256 of the cloud, the settings, and the version of the perception code."""
    digest = hashlib.sha256()
    for part in (_release(), _METHOD, cloud.points, cloud.origin, cloud.misses, cloud.miss_origin, cloud.notes):
        _feed(digest.update, part)
    _feed(digest.update, (cloud.sensor, cloud.origin_sigma))
    for name in sorted(settings):
        _feed(digest.update, name)
        _feed(digest.update, settings[name])
    return digest.hexdigest()


def _feed(update: Callable[[bytes], None], value: object) -> None:
    """Add a value to the hash with its type and length, so that different values give different bytes."""
    if isinstance(value, np.ndarray):
        update(f"array {value.dtype} {value.shape};".encode())
        update(np.ascontiguousarray(value).tobytes())
    elif isinstance(value, list | tuple):
        update(f"sequence {len(value)};".encode())
        for item in value:
            _feed(update, item)
    elif is_dataclass(value):
        _feed(update, [type(value).__name__, *(getattr(value, entry.name) for entry in fields(value))])
    else:
        text = repr(value).encode()
        update(f"{type(value).__name__} {len(text)};".encode() + text)


def _bytes_of(seen: Perceived) -> int:
    """Return the size of all arrays in a result [bytes], each array counted once."""
    arrays: dict[int, int] = {}

    def count(value: object) -> None:
        if isinstance(value, np.ndarray):
            owner = value if value.base is None else value.base
            arrays[id(owner)] = owner.nbytes if isinstance(owner, np.ndarray) else value.nbytes
        elif isinstance(value, Mapping):
            count(tuple(value.values()))
        elif isinstance(value, list | tuple):
            for item in value:
                count(item)
        elif is_dataclass(value):
            for entry in fields(value):
                count(getattr(value, entry.name))

    count(seen)
    return sum(arrays.values())


def _release() -> str:
    try:
        return version("scopt")
    except PackageNotFoundError:
        return "unreleased"
