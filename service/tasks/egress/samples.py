"""Places drawn evenly in a rectangle."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.stats.qmc import Halton


def draw_places(
    middle: Float[np.ndarray, "2"], lengths: Float[np.ndarray, "2"], count: int, seed: int = 0
) -> Float[np.ndarray, "N 2"]:
    """Draw points of a Halton sequence in a rectangle [m]; more of them keep the first ones.

    Liu et al., Humanoids 2015, sec. II-A, draw contact places in this way.
    """
    points = Halton(2, rng=np.random.default_rng(seed)).random(count)
    return np.asarray(middle + (points - 0.5) * lengths)
