"""The hashes of a result that reviews bind to."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike


def trajectory_sha256(names: Sequence[str], times: ArrayLike, positions: ArrayLike) -> str:
    """Of a trajectory's samples.

    Args:
        names: of the columns.
        times: (S,) of the samples.
        positions: (S, columns), or the same row by row.
    """
    digest = hashlib.sha256("\n".join(names).encode() + b"\0")
    digest.update(np.ascontiguousarray(times, dtype="<f8").tobytes())
    digest.update(np.ascontiguousarray(positions, dtype="<f8").tobytes())
    return digest.hexdigest()


def certificate_sha256(text: bytes) -> str:
    """Of a certificate's JSON."""
    return hashlib.sha256(text).hexdigest()
