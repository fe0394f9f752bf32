"""Nearest neighbours of many points, some at a time so that a search can be stopped."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from costs.stopping import poll
from costs.threads import thread_count

# Neighbours that one thread finds between two polls: some 30 ms.
_AT_ONCE = 50_000


def nearest(
    tree: cKDTree,
    points: Float[np.ndarray, "N d"],
    k: int | list[int] | Int[np.ndarray, "K"],
    within: float = np.inf,
) -> tuple[Float[np.ndarray, "N *K"], Int[np.ndarray, "N *K"]]:
    """Return distances and indices as ``tree.query`` does: infinite and ``tree.n`` beyond ``within``.

    It uses as many threads as ``costs.threads`` says; they have ended when it returns, or raises.

    Raises:
        Stopped: the caller wants to stop (``costs.stopping``).
    """
    n_neighbours, n_threads = k if isinstance(k, int) else int(np.max(k, initial=1)), thread_count()
    step = max(1, n_threads * _AT_ONCE // max(n_neighbours, 4))
    parts = []
    for first in range(0, max(len(points), 1), step):
        poll()
        parts.append(tree.query(points[first : first + step], k=k, distance_upper_bound=within, workers=n_threads))
    if len(parts) == 1:
        return np.asarray(parts[0][0]), np.asarray(parts[0][1])
    return np.concatenate([distance for distance, _ in parts]), np.concatenate([index for _, index in parts])
