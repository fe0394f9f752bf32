"""Points, planes and places about a click, from which objects of every kind are proposed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from costs.stopping import poll
from perception.cleaning.clean import voxel_downsample
from perception.detect.engine.region import Mounting
from perception.detect.shared.local import best_about

_ABOUT = 0.45  # radius of what is looked at [m]
_VOXEL = 0.01
_N_SEEDS, _NEIGHBOURS = 90, 16  # places whose normals are planes to try, and points of each normal
_ON_PLANE, _LEAST_ON, _MOST_PLANES = 0.012, 60, 5
_SIGMA = (0.002, 0.02)
_ONE_HEIGHT = 0.04  # [m]
_LEVEL, _STEEP = 0.97, 0.85  # cosines of a normal with the vertical: least of a support, most of a face
CLICKED = 0.12
"""Distance up to which a click counts as on an object [m]."""
_SEED_STEP, _APART = 0.03, 0.015  # between seeds; between places [m]
_MOST_PLACES = 12


@dataclass(frozen=True)
class Surroundings:
    """What a scan shows about a click.

    Attributes:
        click: (3,) [m].
        points: (N, 3) thinned [m].
        planes: largest first; the third row of each frame points towards the sensor's side.
    """

    click: Float[np.ndarray, "3"]
    points: Float[np.ndarray, "N 3"]
    planes: tuple[Mounting, ...]

    @staticmethod
    def of(
        points: Float[np.ndarray, "N 3"], sensor: Float[np.ndarray, "3"], click: Float[np.ndarray, "3"]
    ) -> Surroundings:
        """Return what is about a click.

        Args:
            points: (N, 3) of the scan, floor included [m].
            sensor: (3,) from where they were seen [m].
        """
        near = points[(np.abs(points - click) < _ABOUT).all(axis=1)]
        near, _ = voxel_downsample(near[np.linalg.norm(near - click, axis=1) < _ABOUT], _VOXEL)
        return Surroundings(click, near, tuple(_find_planes(near, sensor)))

    @property
    def supports(self) -> list[Mounting]:
        """Level planes, their frames along the world's axes."""
        return [Mounting(np.eye(3), plane.point, plane.sigma) for plane in self.planes if plane.frame[2, 2] > _LEVEL]

    @property
    def faces(self) -> list[Mounting]:
        """Steep planes."""
        return [replace(plane, noise=plane.sigma) for plane in self.planes if abs(plane.frame[2, 2]) < _STEEP]

    def places(self, among: Float[np.ndarray, "K 3"], radius: float) -> Float[np.ndarray, "P 3"]:
        """Return middles of the points that lie within a radius about the click [m], nearest to it first."""
        if len(among) < 2:
            return np.zeros((0, 3))
        seeds, _ = voxel_downsample(among[np.linalg.norm(among - self.click, axis=1) < CLICKED], _SEED_STEP)
        seeds = np.concatenate([self.click[None], seeds])
        tree = cKDTree(among)
        for _ in range(2):
            seeds = np.array(
                [among[members].mean(axis=0) for members in tree.query_ball_point(seeds, radius) if members]
            ).reshape(-1, 3)
        seeds = seeds[np.argsort(np.linalg.norm(seeds - self.click, axis=1), kind="stable")]
        return np.asarray(seeds[best_about(seeds, _APART, 1)][:_MOST_PLACES])


def _find_planes(points: Float[np.ndarray, "N 3"], sensor: Float[np.ndarray, "3"]) -> list[Mounting]:
    """Return the planes that most points lie on, each without those of the planes before it."""
    planes: list[Mounting] = []
    rest = points
    while len(planes) < _MOST_PLANES and len(rest) >= _LEAST_ON:
        poll()
        best = _fullest(rest)
        if len(best) < _LEAST_ON:
            break
        on = rest[best]
        centre = on.mean(axis=0)
        normal = np.linalg.svd(on - centre, full_matrices=False)[2][2]
        normal = normal * (np.sign((sensor - centre) @ normal) or 1.0)
        height = (rest - centre) @ normal
        near = np.abs(height) < 2.0 * _ON_PLANE
        sigma = float(np.clip(1.4826 * np.median(np.abs(height[near])), *_SIGMA))
        planes.append(Mounting(_frame(normal), centre, sigma))
        rest = rest[~near]
    return planes


def _fullest(points: Float[np.ndarray, "N 3"]) -> Int[np.ndarray, "K"]:
    """Return the points on the fullest plane that neighbours span."""
    seeds = points[:: max(1, len(points) // _N_SEEDS)]
    near = points[cKDTree(points).query(seeds, min(_NEIGHBOURS, len(points)))[1]]
    centre = near.mean(axis=1)
    near = near - centre[:, None]
    normals = np.linalg.eigh(near.transpose(0, 2, 1) @ near)[1][:, :, 0]
    on = np.abs(normals @ points.T - np.einsum("si,si->s", normals, centre)[:, None]) < _ON_PLANE
    return np.flatnonzero(on[int(np.argmax(on.sum(axis=1)))])


def _frame(normal: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Return unit rows: level, as upright as possible, and the normal."""
    x = np.cross([0.0, 0.0, 1.0], normal)
    x = np.array([1.0, 0.0, 0.0]) if np.linalg.norm(x) < 1e-3 else x / np.linalg.norm(x)
    x = x - (x @ normal) * normal
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(normal, x), normal])
