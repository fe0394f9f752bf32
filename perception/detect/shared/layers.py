"""Sums over the layers about each layer of a histogram."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float


def sum_about(counts: Float[np.ndarray, "L"], weights: Sequence[float]) -> Float[np.ndarray, "L"]:
    """Weighted sum of the layers about each one; there is nothing beyond the first and the last.

    Args:
        counts: (L,) at least one, perhaps fewer than the weights.
        weights: an odd number of them, from below; the middle one is the layer's own.
    """
    # Of np.convolve's modes "same" gives as many values as there are weights where those are more than the counts.
    half = len(weights) // 2
    return np.asarray(np.convolve(counts, weights[::-1])[half : half + len(counts)])
