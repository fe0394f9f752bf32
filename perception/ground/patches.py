"""Surface patches (points of small cubes with a fitted plane), and candidate floor planes through them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from perception.cleaning.clean import voxel_index

MAX_SLOPE_DEG = 15.5
PATCH = 0.12
_MOST_TILTED = np.cos(np.radians(40.0))


@dataclass(frozen=True)
class Patches:
    """Surface patches: the points of 12 cm cubes, each with a fitted plane.

    Attributes:
        centre: (P, 3) mean of its points [m].
        normal: (P, 3) unit, upwards.
        count: (P,) number of points.
        is_upright: (P,) flat, with a normal within 40 degrees of the vertical.
        is_bare: (P,) too few points, or too narrow a row, for a normal.
        of_point: (N,) patch index of each point.
    """

    centre: Float[np.ndarray, "P 3"]
    normal: Float[np.ndarray, "P 3"]
    count: Int[np.ndarray, "P"]
    is_upright: Bool[np.ndarray, "P"]
    is_bare: Bool[np.ndarray, "P"]
    of_point: Int[np.ndarray, "N"]


def patches_of(points: Float[np.ndarray, "N 3"]) -> Patches:
    """Return the patch of each 12 cm cube: mean, normal and number of its points."""
    voxel, n = voxel_index(points, PATCH)
    count = np.bincount(voxel, minlength=n)

    def mean(values: Float[np.ndarray, "N"]) -> Float[np.ndarray, "P"]:
        return np.asarray(np.bincount(voxel, weights=values, minlength=n) / count)

    centre = np.stack([mean(points[:, axis]) for axis in range(3)], axis=1)
    relative = points - centre[voxel]
    covariance = np.empty((n, 3, 3))
    for i in range(3):
        for j in range(i, 3):
            covariance[:, i, j] = covariance[:, j, i] = mean(relative[:, i] * relative[:, j])
    spread, axes = np.linalg.eigh(covariance)
    normal = axes[:, :, 0]
    normal = normal * np.where(normal[:, 2:] < 0.0, -1.0, 1.0)
    is_bare = (count < 4) | (spread[:, 1] < 0.015**2)
    is_flat = spread[:, 0] < 0.02**2
    return Patches(centre, normal, count, ~is_bare & is_flat & (normal[:, 2] > _MOST_TILTED), is_bare, voxel)


def candidates(patches: Patches, rng: np.random.Generator) -> tuple[Float[np.ndarray, "H 3"], Float[np.ndarray, "H"]]:
    """Return normals and offsets of planes sloping at most 16.5 degrees through patch triples, and of level planes."""
    upright = patches.centre[patches.is_upright]
    if len(upright) < 3:
        return np.zeros((0, 3)), np.zeros(0)
    k = min(13, len(upright))
    first = rng.choice(len(upright), min(500, len(upright)), replace=False)
    near = np.asarray(cKDTree(upright).query(upright[first], k=np.arange(1, k + 1))[1])
    rows = np.arange(len(first))
    local = np.stack([first, near[rows, rng.integers(1, k, len(first))], near[rows, rng.integers(1, k, len(first))]], 1)
    # Triples of similar height, and random ones: triples far apart give large planes more exactly.
    order = np.argsort(upright[:, 2])
    start = rng.integers(max(1, len(order) - 40), size=(300, 1))
    layered = order[np.minimum(start + rng.integers(40, size=(300, 3)), len(order) - 1)]
    triples = upright[np.concatenate([local, layered, rng.integers(len(upright), size=(300, 3))])]
    normals = np.cross(triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    level = np.abs(normals[:, 2]) > np.cos(np.radians(MAX_SLOPE_DEG + 1.0)) * np.maximum(lengths, 1e-9)
    normals = normals[level] / (lengths[level] * np.sign(normals[level, 2]))[:, None]
    flat = upright[first[:200]]
    return (
        np.concatenate([normals, np.broadcast_to([0.0, 0.0, 1.0], flat.shape)]),
        np.concatenate([(normals * triples[level, 0]).sum(axis=1), flat[:, 2]]),
    )


def least_squares(
    points: Float[np.ndarray, "N 3"], normal: Float[np.ndarray, "3"], offset: float, bands: tuple[float, ...]
) -> tuple[Float[np.ndarray, "3"], float] | None:
    """Return the plane (normal, offset) refitted to the points within each band in turn; None if under 20 points."""
    for band in bands:
        chosen = points[np.abs(points @ normal - offset) < band]
        if len(chosen) < 20:
            return None
        normal, offset = plane_of(chosen)
    return normal, offset


def plane_of(points: Float[np.ndarray, "K 3"]) -> tuple[Float[np.ndarray, "3"], float]:
    """Return the least-squares plane: unit normal, upwards, and offset [m]."""
    centre = points.mean(axis=0)
    relative = points - centre
    normal = np.linalg.eigh(relative.T @ relative)[1][:, 0]
    normal = normal * (1.0 if normal[2] >= 0.0 else -1.0)
    return normal, float(normal @ centre)
