"""Convex vertex sets that contain the shapes a URDF knows."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull

_SIDES = 16


def box(size: Float[np.ndarray, "3"]) -> Float[np.ndarray, "8 3"]:
    """Corners of a box with full edge lengths ``size`` [m]."""
    signs = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
    return np.asarray(0.5 * signs * size)


def cylinder(radius: float, length: float) -> Float[np.ndarray, "32 3"]:
    """Prism of 16 sides around a cylinder along z: exact in length, at most 2.0 % of the radius outside it."""
    angle = 2.0 * np.pi * np.arange(_SIDES) / _SIDES
    ring = radius / np.cos(np.pi / _SIDES) * np.column_stack([np.cos(angle), np.sin(angle)])
    return np.vstack([np.column_stack([ring, np.full(_SIDES, z)]) for z in (-0.5 * length, 0.5 * length)])


def sphere(radius: float) -> Float[np.ndarray, "32 3"]:
    """Polytope of 32 vertices around a sphere, at most 8.4 % of the radius outside it.

    Pentakis dodecahedron: the 12 vertices of an icosahedron and the 20 of a dodecahedron, on one sphere.
    """
    golden = 0.5 * (1.0 + np.sqrt(5.0))
    icosahedron = _cyclic([(0.0, a, b * golden) for a in (-1.0, 1.0) for b in (-1.0, 1.0)])
    dodecahedron = np.vstack([
        [[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)],
        _cyclic([(0.0, a * golden, b / golden) for a in (-1.0, 1.0) for b in (-1.0, 1.0)]),
    ])  # fmt: skip
    points = np.vstack([icosahedron, dodecahedron])
    points = points / np.linalg.norm(points, axis=1, keepdims=True)
    return np.asarray(radius / _inradius(points) * points)


def capsule(radius: float, length: float) -> Float[np.ndarray, "32 3"]:
    """Polytope of 32 vertices around a capsule along z, at most 9.8 % of the radius outside it.

    ``length`` is without the caps.  Each cap is a ring of 9 vertices, one of 6 and a tip; the rings' radii and heights
    come from a numerical search for the smallest excess.
    """
    rings = []
    for count, ring_radius, height in ((9, 1.06331, 0.26930), (6, 0.74442, 0.80559), (1, 0.0, 1.09567)):
        angle = 2.0 * np.pi * np.arange(count) / count
        ring = [ring_radius * np.cos(angle), ring_radius * np.sin(angle), np.full(count, height)]
        rings.append(np.column_stack(ring))
    cap = np.vstack(rings)
    mirrored = cap * np.array([1.0, 1.0, -1.0])
    factor = radius / _inradius(np.vstack([cap, mirrored]))
    shift = np.array([0.0, 0.0, 0.5 * length])
    return np.asarray(np.vstack([factor * cap + shift, factor * mirrored - shift]))


def _cyclic(points: list[tuple[float, float, float]]) -> Float[np.ndarray, "V 3"]:
    array = np.array(points)
    return np.vstack([array, array[:, [1, 2, 0]], array[:, [2, 0, 1]]])


def _inradius(points: Float[np.ndarray, "V 3"]) -> float:
    """Largest radius of a sphere about the origin inside the hull of ``points``."""
    return float(-ConvexHull(points).equations[:, 3].max())
