"""Nearest neighbours of many points, some at a time so that a search can be stopped, and the threads they may use."""

from __future__ import annotations

import os

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from costs.stopping import poll

# Neighbours that one thread finds between two polls: some 30 ms.
_AT_ONCE = 50_000

_n_threads = 1


def use_threads(n_threads: int) -> None:
    """Have searches use so many threads from now on; results are the same for any number.

    One, unless a program says otherwise that has the machine to itself.
    """
    global _n_threads
    _n_threads = max(1, n_threads)


def use_all_cores() -> None:
    """Have searches use as many threads as this process may run at once."""
    use_threads(len(os.sched_getaffinity(0)))


def nearest(
    tree: cKDTree,
    points: Float[np.ndarray, "N d"],
    k: int | list[int] | Int[np.ndarray, "K"],
    within: float = np.inf,
) -> tuple[Float[np.ndarray, "N *K"], Int[np.ndarray, "N *K"]]:
    """``tree.query`` of the points: distances and indices, infinite and ``tree.n`` for neighbours beyond ``within``.

    Raises:
        Stopped: the search was asked to stop.
    """
    n_neighbours = k if isinstance(k, int) else int(np.max(k, initial=1))
    step = max(1, _n_threads * _AT_ONCE // max(n_neighbours, 4))
    found = []
    for first in range(0, max(len(points), 1), step):
        poll()
        found.append(tree.query(points[first : first + step], k=k, distance_upper_bound=within, workers=_n_threads))
    if len(found) == 1:
        return np.asarray(found[0][0]), np.asarray(found[0][1])
    return np.concatenate([distance for distance, _ in found]), np.concatenate([index for _, index in found])
