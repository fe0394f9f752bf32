"""What moved between two scans: groups of points that are near to none of the other scan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

CELL_M = 0.02  # one point a cell is compared
APART_M = 0.05  # farther from all points of the other scan than noise and gaps between points are
LEAST_CELLS = 15  # of a group; smaller ones are strays


@dataclass(frozen=True)
class ScanGroup:
    """Points of one scan that the other one lacks.

    Attributes:
        centre: of their bounding box [m].
        size_m: its longest side.
        points: one per cell.
    """

    centre: Float[np.ndarray, "3"]
    size_m: float
    points: Float[np.ndarray, "N 3"]


def find_groups(points: Float[np.ndarray, "N 3"], others: Float[np.ndarray, "K 3"]) -> list[ScanGroup]:
    """Return the groups of points that are ``APART_M`` or more from all others, the one of most cells first."""
    thinned = thin_to_cells(points)
    if len(thinned) == 0:
        return []
    if len(others):
        distances, _ = cKDTree(others).query(thinned, distance_upper_bound=APART_M)
        thinned = thinned[~np.isfinite(distances)]
    pairs = cKDTree(thinned).query_pairs(APART_M, output_type="ndarray") if len(thinned) else np.empty((0, 2), int)
    links = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(thinned), len(thinned)))
    n_groups, labels = connected_components(links, directed=False)
    sizes = np.bincount(labels, minlength=n_groups)
    order = np.argsort(-sizes, kind="stable")
    return [_make_group(thinned[labels == label]) for label in order if sizes[label] >= LEAST_CELLS]


def thin_to_cells(points: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "K 3"]:
    """Return the first point of every cell."""
    finite = np.asarray(points[np.isfinite(points).all(axis=1)])
    _, first = np.unique(np.floor(finite / CELL_M).astype(np.int64), axis=0, return_index=True)
    return np.asarray(finite[np.sort(first)])


def describe_groups(groups: list[ScanGroup], what: str) -> str:
    """Return in a line how many pieces there are, and where the three largest are; empty for none."""
    if not groups:
        return ""
    places = [
        f"{group.size_m:.2f} m at {', '.join(f'{value:.2f}' for value in group.centre)} m" for group in groups[:3]
    ]
    more = f" and {len(groups) - 3} more" if len(groups) > 3 else ""
    return f"{len(groups)} {what}: {'; '.join(places)}{more}"


def _make_group(points: Float[np.ndarray, "N 3"]) -> ScanGroup:
    low, high = points.min(axis=0), points.max(axis=0)
    return ScanGroup(0.5 * (low + high), float(np.max(high - low)), points)
