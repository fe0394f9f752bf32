"""How far apart the points of a surface lie where rays are few, and how far a piece may go on between them."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from perception.cleaning.neighbours import nearest
from perception.convex.nearby import nearby

_FOURTH = 4
_MOST_OF_RANGE = 0.025


def spacing_of(
    points: Float[np.ndarray, "N 3"], starts: Float[np.ndarray, "N 3"], chosen: Int[np.ndarray, "C"]
) -> Float[np.ndarray, "C"]:
    """Distance of each chosen point to its fourth nearest, at most 2.5 % of its range: what is farther is alone [m].

    Args:
        points: (N, 3) [m].
        starts: (N, 3) where their rays started [m].
        chosen: which are asked about.
    """
    if len(points) <= _FOURTH:
        return np.zeros(len(chosen))
    mine = points[chosen]
    most = _MOST_OF_RANGE * np.linalg.norm(mine - starts[chosen], axis=1)
    near = points[nearby(points, chosen, float(most.max(initial=0.0)) + 1e-6)]
    tree = cKDTree(near, balanced_tree=False, compact_nodes=False)
    fourth = nearest(tree, mine, [_FOURTH + 1])[0][:, 0]
    return np.asarray(np.minimum(fourth, most))
