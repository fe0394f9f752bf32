"""Paths through configurations: straight lines, lines through corners, and even waypoints on them."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

LEAST_WAYPOINTS = 3  # of a path with something between its ends


def straight_path(
    first: Float[np.ndarray, "n"], last: Float[np.ndarray, "n"], n_waypoints: int
) -> Float[np.ndarray, "T n"]:
    """Return waypoints on the straight line between two configurations."""
    return np.asarray(first + (last - first) * np.linspace(0.0, 1.0, n_waypoints)[:, None])


def path_via(
    first: Float[np.ndarray, "n"],
    middle: Float[np.ndarray, "n"],
    last: Float[np.ndarray, "n"],
    n_waypoints: int,
) -> Float[np.ndarray, "T n"]:
    """Return waypoints on two straight lines through a configuration between."""
    half = n_waypoints // 2
    return np.concatenate(
        [straight_path(first, middle, half + 1)[:-1], straight_path(middle, last, n_waypoints - half)]
    )


def bend_path(
    path: Float[np.ndarray, "T n"], first: Float[np.ndarray, "n"], last: Float[np.ndarray, "n"]
) -> Float[np.ndarray, "T n"]:
    """Return a path displaced so that it has other ends; between them each displacement falls with the way done."""
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    way = np.concatenate([[0.0], np.cumsum(steps)])
    share = (way / way[-1] if way[-1] > 0.0 else np.linspace(0.0, 1.0, len(path)))[:, None]
    return np.asarray(path + (1.0 - share) * (first - path[0]) + share * (last - path[-1]))


def cut_path(path: Float[np.ndarray, "T n"], at: Float[np.ndarray, "n"]) -> Float[np.ndarray, "S n"] | None:
    """Return a path from its waypoint nearest to a configuration on; None where nothing between its ends is left."""
    rest = path[int(np.abs(path - at).max(axis=1).argmin()) :]
    return rest if len(rest) >= LEAST_WAYPOINTS else None


def measure_length(corners: Float[np.ndarray, "K n"]) -> float:
    """Return the length of a polyline in joint space [rad, m]."""
    return float(np.linalg.norm(np.diff(corners, axis=0), axis=1).sum())


def resample_path(corners: Float[np.ndarray, "K n"], n_waypoints: int) -> Float[np.ndarray, "T n"]:
    """Return evenly spread waypoints on a polyline, with every corner among them if there are enough."""
    lengths = np.abs(np.diff(corners, axis=0)).max(axis=1)
    ends = np.concatenate([[0.0], np.cumsum(np.maximum(lengths, 1e-9))])
    at = np.linspace(0.0, ends[-1], n_waypoints)
    for end in ends[1:-1]:
        at[1 + int(np.argmin(np.abs(at[1:-1] - end)))] = end
    at.sort()
    return np.stack([np.interp(at, ends, corners[:, i]) for i in range(corners.shape[1])], axis=1)
