"""Hashes of a result's trajectory and certificate, which reviews refer to."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike


def hash_trajectory(names: Sequence[str], times: ArrayLike, positions: ArrayLike) -> str:
    """Return the sha256 of a trajectory's samples.

    Args:
        names: names of the columns.
        times: (S,) times of the samples.
        positions: (S, columns), or the same row by row.
    """
    digest = hashlib.sha256("\n".join(names).encode() + b"\0")
    digest.update(np.ascontiguousarray(times, dtype="<f8").tobytes())
    digest.update(np.ascontiguousarray(positions, dtype="<f8").tobytes())
    return digest.hexdigest()


def hash_certificate(text: bytes) -> str:
    """Return the sha256 of a certificate's JSON."""
    return hashlib.sha256(text).hexdigest()
