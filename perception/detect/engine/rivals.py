"""Rivals of a template: how much of what it explains lies on one plane, or on two, as on a wall or a carton."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

_N_WAYS = 72
_FEWEST = 6


def _ways() -> Float[np.ndarray, "W 3"]:
    """Return directions spread evenly over a half sphere (Fibonacci lattice)."""
    i = np.arange(_N_WAYS) + 0.5
    z = i / _N_WAYS
    angle = np.pi * (1.0 + np.sqrt(5.0)) * i
    r = np.sqrt(1.0 - z * z)
    return np.column_stack([r * np.cos(angle), r * np.sin(angle), z])


_WAYS = _ways()


def flat_shares(points: Float[np.ndarray, "K 3"], sigma: float) -> tuple[float, float]:
    """Return the share of points on their best plane, and on that and a second one."""
    if len(points) < _FEWEST:
        return 1.0, 1.0
    first = _on_plane(points, sigma)
    rest = points[~first]
    second = int(_on_plane(rest, sigma).sum()) if len(rest) >= _FEWEST else len(rest)
    return float(first.mean()), float((first.sum() + second) / len(points))


def _on_plane(points: Float[np.ndarray, "K 3"], sigma: float) -> Bool[np.ndarray, "K"]:
    """Return which points lie within two standard deviations of their fullest plane."""
    width = 4.0 * sigma
    # Coarse: directions are 0.2 rad apart, so that a plane's points fill a slab that grows with their extent.
    extent = float(np.linalg.norm(points.std(axis=0)))
    heights = np.sort(points @ _WAYS.T, axis=0)
    n_within = [
        (np.searchsorted(column, column + width + 0.1 * extent, side="right") - np.arange(len(column)))
        for column in heights.T
    ]
    best = int(np.argmax([counts.max() for counts in n_within]))
    low = heights[int(np.argmax(n_within[best])), best]
    height = points @ _WAYS[best]
    near = (height >= low) & (height <= low + width + 0.1 * extent)
    for _ in range(4):
        if near.sum() < 4:
            break
        centre = points[near].mean(axis=0)
        _, _, axes = np.linalg.svd(points[near] - centre, full_matrices=False)
        near = np.abs((points - centre) @ axes[2]) < 0.5 * width
    return np.asarray(near)
