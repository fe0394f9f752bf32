"""Extents of point sets along fixed directions: two sets whose extents are apart in one of them are apart."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from costs.collision.sweep import find_extent

# Beside the axes, the normals of a cube's cut edges and corners: with them, discrete oriented polytopes of 26 faces
# (Klosowski et al., IEEE TVCG 1998), which leave a third of the pairs that boxes alone do.
DIRECTIONS = np.array(
    [[1, 1, 0], [1, -1, 0], [1, 0, 1], [1, 0, -1], [0, 1, 1], [0, 1, -1], [1, 1, 1], [1, 1, -1], [1, -1, 1], [-1, 1, 1]]
) / np.sqrt([[2.0]] * 6 + [[3.0]] * 4)


def find_slabs(points: Float[np.ndarray, "*m V 3"]) -> tuple[Float[np.ndarray, "*m K"], Float[np.ndarray, "*m K"]]:
    """Find the least and the largest height of many point sets along each of the directions."""
    return find_extent(points @ DIRECTIONS.T)


def find_slabs_of_sets(
    sets: Sequence[Float[np.ndarray, "V 3"]],
) -> tuple[Float[np.ndarray, "P K"], Float[np.ndarray, "P K"]]:
    """Find the same for point sets of different sizes."""
    if not sets:
        return np.zeros((0, len(DIRECTIONS))), np.zeros((0, len(DIRECTIONS)))
    heights = np.concatenate(sets) @ DIRECTIONS.T
    first = np.cumsum([0, *(len(points) for points in sets[:-1])])
    return np.minimum.reduceat(heights, first), np.maximum.reduceat(heights, first)
