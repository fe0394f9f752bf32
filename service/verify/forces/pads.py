"""Patches of pads: where a flat surface of a hand lies on a body, as points that carry its force and torsion.

The pressure of a pad is not known.  An even one resists torsion by ``mu N r``, with the mean distance ``r`` of the
patch's points from its middle.  Forces act at points towards the corners, none farther away than ``r``, so that no
choice of forces resists more.  Seen from the middle, a patch consists of triangles; the mean distance of one is at
least the distance of its centroid.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

PATCH_DEPTH_M = 5e-4  # by which pad and body give way: what is no farther from the foremost points touches
_LEAST_AREA = 1e-7  # of a patch; a smaller one is a point [m2]


def find_patch(
    pad: Float[np.ndarray, "K 3"], body: Float[np.ndarray, "V 3"], normal: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "P 3"]:
    """Return the points at which a pad presses a body, beside each other along the surface; none of a single point.

    Args:
        pad: corners of the pad's core.
        body: corners of the body, in the same frame.
        normal: (3,) unit, from the pad to the body.
    """
    corners, basis = _find_common(pad, body, normal)
    if not len(corners):
        return np.zeros((0, 3))
    middle, radius = _measure_middle(corners)
    beside = corners - middle
    size = np.linalg.norm(beside, axis=1, keepdims=True)
    return np.asarray((middle + np.minimum(1.0, radius / size) * beside) @ basis)


def find_contact_corners(
    lower: Float[np.ndarray, "K 3"], upper: Float[np.ndarray, "V 3"], normal: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "P 3"]:
    """Return the corners of the area in which two bodies touch, beside each other along it; none of a single point.

    Args:
        lower, upper: corners of the bodies.
        normal: (3,) unit, from the first to the second.
    """
    corners, basis = _find_common(lower, upper, normal)
    return np.asarray(corners @ basis)


def _find_common(
    first: Float[np.ndarray, "K 3"], second: Float[np.ndarray, "V 3"], normal: Float[np.ndarray, "3"]
) -> tuple[Float[np.ndarray, "P 2"], Float[np.ndarray, "2 3"]]:
    """Return the corners that the foremost faces of two bodies have in common, and the axes that they are along."""
    basis = np.linalg.svd(normal[None])[2][1:]
    faces = [
        points[points @ towards >= (points @ towards).max() - PATCH_DEPTH_M] @ basis.T
        for points, towards in ((first, normal), (second, -normal))
    ]
    outlines = [_list_corners(face) for face in faces]
    if not all(len(outline) for outline in outlines):
        return np.zeros((0, 2)), basis
    return _list_corners(_intersect(*outlines)), basis


def _measure_middle(corners: Float[np.ndarray, "P 2"]) -> tuple[Float[np.ndarray, "2"], float]:
    """Return the centroid of a convex polygon, and the least mean distance of its points from there [m]."""
    inside = corners.mean(axis=0)
    middle, areas = _split(corners, inside)
    centroid = inside + areas @ middle / areas.sum()
    middle, areas = _split(corners, centroid)
    return centroid, float(areas @ np.linalg.norm(middle, axis=1) / areas.sum())


def _split(
    corners: Float[np.ndarray, "P 2"], point: Float[np.ndarray, "2"]
) -> tuple[Float[np.ndarray, "P 2"], Float[np.ndarray, "P"]]:
    """Return the centroids, from there, of the triangles between a point inside and each edge, and their areas."""
    a, b = corners - point, np.roll(corners, -1, axis=0) - point
    return (a + b) / 3.0, 0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def _list_corners(points: Float[np.ndarray, "N 2"]) -> Float[np.ndarray, "P 2"]:
    """Return the corners of points' hull, counter-clockwise; none of a line or a point."""
    from scipy.spatial import ConvexHull, QhullError  # slow to import

    if len(points) < 3:
        return np.zeros((0, 2))
    try:
        hull = ConvexHull(points)
    except QhullError:
        return np.zeros((0, 2))
    return np.asarray(points[hull.vertices] if hull.volume >= _LEAST_AREA else np.zeros((0, 2)))


def _intersect(first: Float[np.ndarray, "N 2"], second: Float[np.ndarray, "M 2"]) -> Float[np.ndarray, "P 2"]:
    """Return the corners that two convex polygons, both counter-clockwise, have in common (Sutherland and Hodgman)."""
    corners = first
    for a, b in zip(second, np.roll(second, -1, axis=0), strict=True):
        edge = b - a
        left = edge[0] * (corners[:, 1] - a[1]) - edge[1] * (corners[:, 0] - a[0])
        kept = []
        for k in range(len(corners)):
            after = (k + 1) % len(corners)
            if left[k] >= 0.0:
                kept.append(corners[k])
            if left[k] * left[after] < 0.0:
                kept.append(corners[k] + left[k] / (left[k] - left[after]) * (corners[after] - corners[k]))
        corners = np.array(kept).reshape(-1, 2)
        if not len(corners):
            break
    return corners
