"""Polygons of places of the centre of mass with the forces that hold there: simpler ones, and what several share."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from costs.static_region.errors import DegenerateRegionError, NothingHoldsError

RESOLUTION_M = 1e-4  # shorter edges are merged, narrower regions are degenerate
_FLAT_M = 1e-7  # a corner that sticks out by less is left out


@dataclass(frozen=True)
class HeldPolygon:
    """Places held under one wrench: vertices (V, 2) counter-clockwise [m], and forces (V, C, 3) that hold there [N]."""

    vertices: Float[np.ndarray, "V 2"]
    forces: Float[np.ndarray, "V C 3"]

    @property
    def most_tangential(self) -> float:
        """Largest sum of horizontal forces of a vertex [N]."""
        return float(np.linalg.norm(self.forces[:, :, :2], axis=2).sum(axis=1).max())


def simplify_polygon(vertices: Float[np.ndarray, "V 2"]) -> list[int]:
    """Return the vertices of the hull to keep, counter-clockwise, so that no edge is short and no corner flat.

    The polygon only gets smaller.  Programs whose directions differ by rounding find the ends of one edge in any order,
    and several times.
    """
    points = vertices.tolist()
    kept = _list_hull(points)
    i = 0
    while i < len(kept) and len(kept) > 1:
        (x0, y0), (x1, y1), (x2, y2) = (points[kept[k % len(kept)]] for k in (i - 1, i, i + 1))
        turn = (x1 - x0) * (y2 - y0) - (y1 - y0) * (x2 - x0)
        is_short = math.hypot(x1 - x0, y1 - y0) < RESOLUTION_M
        is_flat = len(kept) > 2 and turn < _FLAT_M * math.hypot(x2 - x0, y2 - y0)
        if is_short or is_flat:
            del kept[i]
            i = max(i - 1, 0)
        else:
            i += 1
    return kept


def _list_hull(points: list[list[float]]) -> list[int]:
    """Return the corners of the convex hull, counter-clockwise (Andrew's monotone chain); of a line its two ends."""
    order = sorted(range(len(points)), key=points.__getitem__)
    chains = []
    for way in (order, order[::-1]):
        chain: list[int] = []
        for k in way:
            while len(chain) > 1:
                (x0, y0), (x1, y1), (x2, y2) = points[chain[-2]], points[chain[-1]], points[k]
                if (x1 - x0) * (y2 - y0) - (y1 - y0) * (x2 - x0) > 0.0:
                    break
                chain.pop()
            chain.append(k)
        chains.append(chain[:-1])
    return chains[0] + chains[1] or order


def refuse_degenerate(vertices: Float[np.ndarray, "V 2"], place: str, index: int | None) -> None:
    """Raise DegenerateRegionError for a polygon that is nowhere wider than the resolution."""
    apart = np.linalg.norm(vertices[:, None] - vertices, axis=2)
    i, j = np.unravel_index(int(apart.argmax()), apart.shape)
    length = float(apart[i, j])
    if length >= RESOLUTION_M:
        across = (vertices - vertices[i]) @ np.array([[0.0, -1.0], [1.0, 0.0]]) @ (vertices[j] - vertices[i]) / length
        if np.ptp(across) >= RESOLUTION_M:
            return
        shape = f"a line {length:.3f} m long from ({_xy(vertices[i])}) to ({_xy(vertices[j])})"
    else:
        shape = f"the point ({_xy(vertices[0])})"
    raise DegenerateRegionError(
        f"{place}, contact forces hold the robot only with its centre of mass on {shape}; "
        "a motion needs a region with an area (three contact points that are not on a line)",
        index,
    )


def _xy(point: Float[np.ndarray, "2"]) -> str:
    return f"{point[0]:.3f}, {point[1]:.3f}"


def intersect_polygons(regions: Sequence[HeldPolygon]) -> tuple[Float[np.ndarray, "V 2"], Float[np.ndarray, "V W C 3"]]:
    """Return the vertices of the intersection of the regions, and the forces that hold there under each wrench.

    Raises:
        NothingHoldsError: they have no point in common.
        DegenerateRegionError: what they have in common is a line or a point.
    """
    vertices = regions[0].vertices
    if len(regions) == 1:
        return vertices, regions[0].forces[:, None]
    together = f"under all {len(regions)} wrenches together"
    for region in regions[1:]:
        vertices = _clip(vertices, region.vertices)
        if not len(vertices):
            raise NothingHoldsError(
                f"each wrench alone is held somewhere, but no place of the centre of mass is held {together}", None
            )
    vertices = vertices[simplify_polygon(vertices)]
    refuse_degenerate(vertices, together, None)
    return vertices, np.stack([_combine_forces(region, vertices) for region in regions], axis=1)


def _clip(polygon: Float[np.ndarray, "V 2"], by: Float[np.ndarray, "E 2"]) -> Float[np.ndarray, "U 2"]:
    """Return the part of a convex polygon inside another (Sutherland and Hodgman, CACM 1974)."""
    for start, end in zip(by, np.roll(by, -1, axis=0), strict=True):
        if not len(polygon):
            break
        edge = end - start
        outside = ((polygon - start) @ np.array([edge[1], -edge[0]])) / np.linalg.norm(edge)
        if outside.max() <= 0.0:
            continue
        following, outside_next = np.roll(polygon, -1, axis=0), np.roll(outside, -1)
        parts = []
        for p, q, a, b in zip(polygon, following, outside, outside_next, strict=True):
            if a <= 0.0:
                parts.append(p)
            if (a < 0.0 < b) or (b < 0.0 < a):
                parts.append(p + a / (a - b) * (q - p))
        polygon = np.array(parts).reshape(-1, 2)
    return polygon


def _combine_forces(region: HeldPolygon, places: Float[np.ndarray, "N 2"]) -> Float[np.ndarray, "N C 3"]:
    """Return forces at places inside the region: the combination of a triangle of its vertices."""
    # Fan of triangles from the vertex with the least force, so that combinations need little.
    base = int(np.linalg.norm(region.forces, axis=2).sum(axis=1).argmin())
    order = np.roll(np.arange(len(region.vertices)), -base)
    corners = np.stack([np.full(len(order) - 2, order[0]), order[1:-1], order[2:]], axis=1)
    a, b, c = np.moveaxis(region.vertices[corners], 1, 0)
    areas = _turn(b - a, c - a)
    usable = areas > 1e-12
    corners, a, b, c, areas = corners[usable], a[usable], b[usable], c[usable], areas[usable]
    at = places[:, None]
    shares = np.stack([_turn(b - at, c - at), _turn(c - at, a - at), _turn(a - at, b - at)], axis=2) / areas[:, None]
    best = shares.min(axis=2).argmax(axis=1)
    chosen = np.maximum(shares[np.arange(len(places)), best], 0.0)
    chosen /= chosen.sum(axis=1, keepdims=True)
    return np.asarray(np.einsum("nk,nkci->nci", chosen, region.forces[corners[best]]))


def _turn(u: Float[np.ndarray, "... 2"], v: Float[np.ndarray, "... 2"]) -> Float[np.ndarray, "..."]:
    """Return the z of the cross products of vectors in the plane."""
    return np.asarray(u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0])
