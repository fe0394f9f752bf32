"""Hashes of a result's trajectory and certificate, which reviews refer to."""

from __future__ import annotations

import hashlib
import sys
from array import array
from collections.abc import Sequence
from itertools import chain
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


def hash_trajectory(names: Sequence[str], times: ArrayLike, positions: ArrayLike) -> str:
    """Return the sha256 of a trajectory's samples.

    Args:
        names: names of the columns.
        times: (S,) times of the samples.
        positions: (S, columns), or the same row by row.
    """
    digest = hashlib.sha256("\n".join(names).encode() + b"\0")
    digest.update(_to_bytes(times))
    digest.update(_to_bytes(positions))
    return digest.hexdigest()


def hash_certificate(text: bytes) -> str:
    """Return the sha256 of a certificate's JSON."""
    return hashlib.sha256(text).hexdigest()


def _to_bytes(values: Any) -> bytes:
    """Return an array, numbers, or rows of numbers as little-endian doubles; clients need no numpy."""
    if hasattr(values, "astype"):
        return bytes(values.astype("<f8").tobytes())
    has_rows = len(values) > 0 and isinstance(values[0], Sequence)
    doubles = array("d", chain.from_iterable(values) if has_rows else values)
    if sys.byteorder == "big":
        doubles.byteswap()
    return doubles.tobytes()
