"""Places and orientations at which a scan may show an object: its surface is compared with the cells of the scan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage
from scipy.spatial.transform import Rotation

from costs.stopping import poll
from perception.convex.cells import number_cells
from perception.convex.freespace import carve
from perception.solids.fit import Surface
from perception.solids.mesh import Mesh
from perception.view import View

# Orientations, samples of the surface, and places that are left, of each of two passes.
_PASSES = ((60, 24, 400), (240, 64, 40))
_TURNS_HERE = 24  # orientations kept at a place
_CELL, _CELL_LIMITS = 0.12, (0.012, 0.06)  # of the object's radius; [m]
_STRIDE = 2  # cells between places
_MOST_PLACES = 150_000
_BLOCK = 2_000_000  # comparisons at a time
_APART = 0.5  # of the object's radius: between two places
_ABOUT_HINT = 0.5, 0.12  # of the object's radius, and [m]
_FREE, _SEEN = -1, 1
_AWAY, _BESIDE = 0.35, 0.5  # distance of the places beside the object by its radius, and their weight


@dataclass(frozen=True)
class Candidate:
    """Place with its likeliest orientations.

    Attributes:
        place: (3,) of the object's centre [m].
        rotations: (B, 3, 3), best first.
        score: share of the surface where points are, less the share where rays passed; and half the opposite beside it.
    """

    place: Float[np.ndarray, "3"]
    rotations: Float[np.ndarray, "B 3 3"]
    score: float


@dataclass(frozen=True)
class LabelledCells:
    """Cells of a scan: 1 beside a point of a loose object, -1 where rays passed, 0 elsewhere; padded with 0."""

    labels: Int[np.ndarray, "X Y Z"]
    lower: Float[np.ndarray, "3"]
    size: float

    def compare(self, places: Int[np.ndarray, "P 3"], offsets: Int[np.ndarray, "O S 3"]) -> Float[np.ndarray, "P O"]:
        """Return the mean label of a surface's samples at each place and orientation.

        Args:
            places: (P, 3) cells.
            offsets: (O, S, 3) cells of the samples from the place's.
        """
        _, y, z = self.labels.shape
        flat_places = (places[:, 0] * y + places[:, 1]) * z + places[:, 2]
        flat_offsets = (offsets[..., 0] * y + offsets[..., 1]) * z + offsets[..., 2]
        grid = self.labels.reshape(-1)
        means = np.empty((len(places), len(offsets)), dtype=np.float32)
        size = max(1, _BLOCK // flat_offsets.size)
        for first in range(0, len(places), size):
            poll()
            some = flat_places[first : first + size, None, None]
            means[first : first + size] = grid.take(some + flat_offsets).sum(axis=2, dtype=np.int32)
        return np.asarray(means / offsets.shape[1])

    def rate(
        self,
        samples: Float[np.ndarray, "S 3"],
        beside: Float[np.ndarray, "E 3"],
        rotations: Float[np.ndarray, "B 3 3"],
        shifts: Float[np.ndarray, "B 3"],
    ) -> Float[np.ndarray, "B"]:
        """Return the score of each pose from places on the object and beside it, in its frame [m]."""
        on, off = (
            self._read(some @ rotations.transpose(0, 2, 1) + shifts[:, None]).mean(axis=1) for some in (samples, beside)
        )
        return np.asarray(on - _BESIDE * off)

    def _read(self, places: Float[np.ndarray, "B S 3"]) -> Int[np.ndarray, "B S"]:
        """Return the labels at places in the world [m]; 0 outside of the cells."""
        cell, inside = number_cells(places, self.lower, self.size, self.labels.shape)
        return np.asarray(self.labels.reshape(-1)[cell] * inside)


def find_candidates(
    view: View,
    loose: Bool[np.ndarray, "N"],
    samples: tuple[Float[np.ndarray, "S 3"], Float[np.ndarray, "E 3"]],
    radius: float,
    hint: Float[np.ndarray, "3"] | None,
) -> tuple[LabelledCells, list[Candidate]] | None:
    """Return the cells of a scan, and places of an object's centre with its likeliest orientations, best first.

    None if no loose point is near.

    Args:
        loose: (N,) obstacle points that lie on no plane wider than the object.
        samples: places on its surface (S, 3) and beside it (E, 3), from its centre, in random order [m].
        radius: of the sphere about it [m].
        hint: (3,) a point on or near the object; None to search everywhere [m].
    """
    cells = _label(view, loose, radius, hint)
    if cells is None:
        return None
    turns = Rotation.random(_PASSES[-1][0], rng=np.random.default_rng(0)).as_matrix()
    places = _list_places(cells, radius, hint)
    scores = np.zeros((len(places), 0))
    for n_turns, n_samples, n_left in _PASSES:
        on, beside = (
            cells.compare(
                places, np.rint(some[:n_samples] @ turns[:n_turns].transpose(0, 2, 1) / cells.size).astype(int)
            )
            for some in samples
        )
        scores = on - _BESIDE * beside
        best = _apart(places, scores.max(axis=1), _APART * radius / cells.size, n_left)
        places, scores = places[best], scores[best]
    found = []
    for place, mine in zip(places, scores, strict=True):
        order = np.argsort(-mine, kind="stable")[:_TURNS_HERE]
        found.append(Candidate((place + 0.5) * cells.size + cells.lower, turns[order], float(mine.max())))
    return cells, found


def spread_samples(mesh: Mesh, n: int) -> tuple[Float[np.ndarray, "S 3"], Float[np.ndarray, "S 3"]]:
    """Return places spread evenly by area over a mesh, in random order [m], and the unit normals there."""
    rng = np.random.default_rng(0)
    a, b, c = np.moveaxis(mesh.vertices[mesh.triangles], 1, 0)
    normal = np.cross(b - a, c - a)
    area = np.linalg.norm(normal, axis=1)
    chosen = rng.choice(len(area), n, p=area / area.sum())
    u, v = np.sqrt(rng.random(n))[:, None], rng.random(n)[:, None]
    places = (1.0 - u) * a[chosen] + u * (1.0 - v) * b[chosen] + u * v * c[chosen]
    return np.asarray(places), np.asarray(normal[chosen] / area[chosen, None])


def list_beside(
    surface: Surface, places: Float[np.ndarray, "S 3"], normals: Float[np.ndarray, "S 3"], radius: float
) -> Float[np.ndarray, "E 3"]:
    """Return places in front of a surface that are as far from all of it [m].

    Args:
        radius: of the sphere about the object [m].
    """
    away = _AWAY * radius
    beside = places + away * normals
    return np.asarray(beside[np.linalg.norm(beside - surface.nearest(beside)[0], axis=1) > 0.9 * away])


def _label(
    view: View, loose: Bool[np.ndarray, "N"], radius: float, hint: Float[np.ndarray, "3"] | None
) -> LabelledCells | None:
    """Return the cells about the loose points, or about a hint; None without such points."""
    points = view.obstacles[loose]
    about = radius * (1.0 + _ABOUT_HINT[0]) + _ABOUT_HINT[1]
    if hint is not None:
        points = points[np.linalg.norm(points - hint, axis=1) < about + radius]
    if not len(points):
        return None
    size = float(np.clip(_CELL * radius, *_CELL_LIMITS))
    pad = 2.2 * radius + 2.0 * size
    lower, upper = points.min(axis=0) - pad, points.max(axis=0) + pad
    free = carve(*view.cloud.rays, view.obstacles, lower, upper, size)
    cells = np.floor((points - lower) / free.size).astype(np.int64)
    seen = np.zeros(free.free.shape, dtype=bool)
    seen[tuple(cells.T)] = True
    seen = ndimage.binary_dilation(seen, np.ones((3, 3, 3), dtype=bool))
    labels = np.where(seen, _SEEN, np.where(free.free, _FREE, 0)).astype(np.int8)
    return LabelledCells(labels, lower, free.size)


def _list_places(cells: LabelledCells, radius: float, hint: Float[np.ndarray, "3"] | None) -> Int[np.ndarray, "P 3"]:
    """Return cells at which an object's centre may be: within its radius of a point, at most 150,000."""
    reach = int(np.ceil(1.1 * radius / cells.size)) + 1
    near = ndimage.uniform_filter((cells.labels == _SEEN).astype(np.float32), 2 * reach // 2 + 1) > 1e-6
    near[:reach] = near[-reach:] = near[:, :reach] = near[:, -reach:] = near[..., :reach] = near[..., -reach:] = False
    stride = _STRIDE
    while True:
        places = stride * np.argwhere(near[::stride, ::stride, ::stride])
        if hint is not None:
            away = np.linalg.norm((places + 0.5) * cells.size + cells.lower - hint, axis=1)
            places = places[away < _ABOUT_HINT[0] * radius + _ABOUT_HINT[1]]
        if len(places) <= _MOST_PLACES:
            return np.asarray(places)
        stride += 1


def _apart(
    places: Int[np.ndarray, "P 3"], scores: Float[np.ndarray, "P"], apart: float, most: int
) -> Int[np.ndarray, "K"]:
    """Return the best places, no two of which are nearer than ``apart`` cells, unless few are left."""
    order = np.argsort(-scores, kind="stable")[: 20 * most]
    left = np.ones(len(order), dtype=bool)
    kept: list[int] = []
    for i in range(len(order)):
        if left[i]:
            kept.append(int(order[i]))
            if len(kept) == most:
                break
            left &= ((places[order] - places[order[i]]) ** 2).sum(axis=1) >= apart**2
    return np.array(kept, dtype=np.int64)
