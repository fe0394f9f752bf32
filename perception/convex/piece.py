"""Convex piece of a scene: its shape, its points, and the evidence from the rays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from costs.scene import ConvexPiece
from perception.convex.freespace import FreeSpace
from perception.convex.hulls import Hull

_AWAY = 0.05
_N_SAMPLES = 128
# Fractions of the plastic number: they fill the unit square evenly, however many are taken.
_SPREAD = np.array([0.7548776662466927, 0.5698402909980532])


@dataclass(frozen=True)
class Evidence:
    """Evidence for and against a piece from the rays of a scan.

    Attributes:
        free_cells: number of cells inside the piece that rays went through.
        free_share: share of the piece's volume in these cells.
        open_share: share of its surface next to free space; the rest is next to unseen space or other objects.
    """

    free_cells: int
    free_share: float
    open_share: float


@dataclass(frozen=True)
class Piece:
    """A convex piece, its points and its ray evidence.

    Attributes:
        shape: name, vertices and kind (``plane``, ``wall``, ``clutter``).
        points: indices of the obstacle points within 1 cm of it, without those of earlier pieces.
        evidence: from the rays of the scan it was made from.
        hull: its hull, without repeated half-spaces.
        plane: (4,) unit normal and offset of a slab's plane; None for other shapes.
    """

    shape: ConvexPiece
    points: Int[np.ndarray, "K"]
    evidence: Evidence
    hull: Hull
    plane: Float[np.ndarray, "4"] | None = None

    @property
    def name(self) -> str:
        """Name, unique in its scene."""
        return self.shape.name

    @property
    def kind(self) -> str:
        """``plane``, ``wall`` or ``clutter``."""
        return self.shape.kind

    def summary(self) -> dict[str, object]:
        """Return name, kind, number of points and evidence, ready for JSON."""
        return {
            "name": self.name,
            "kind": self.kind,
            "points": len(self.points),
            "free_cells": self.evidence.free_cells,
            "free_share": round(self.evidence.free_share, 4),
            "open_share": round(self.evidence.open_share, 3),
        }


def measure_evidence(hull: Hull, free: FreeSpace) -> Evidence:
    """Return the free cells inside the hull and the share of its surface that is next to free cells."""
    inside = free.count_inside(hull)
    around = _sample_around(hull)
    near = np.concatenate([around, *(around + sign * free.size * axis for axis in np.eye(3) for sign in (-1.0, 1.0))])
    is_open = free.contains(near).reshape(7, -1).any(axis=0)
    return Evidence(inside, inside * free.size**3 / hull.volume, float(is_open.mean()))


def _sample_around(hull: Hull) -> Float[np.ndarray, "K 3"]:
    """Return 128 positions 5 cm outside the hull, spread evenly over its surface [m]."""
    corners = hull.vertices[hull.triangles]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(across, axis=1)
    steps = (np.arange(_N_SAMPLES) + 0.5) / _N_SAMPLES
    chosen = np.searchsorted(np.cumsum(area) / area.sum(), steps).clip(max=len(area) - 1)
    u, v = (np.arange(1, _N_SAMPLES + 1)[:, None] * _SPREAD % 1.0).T
    flipped = u + v > 1.0
    u, v = np.where(flipped, 1.0 - u, u), np.where(flipped, 1.0 - v, v)
    first, second, third = np.moveaxis(corners[chosen], 1, 0)
    on_surface = first + u[:, None] * (second - first) + v[:, None] * (third - first)
    return np.asarray(on_surface + _AWAY * hull.faces[chosen, :3])
