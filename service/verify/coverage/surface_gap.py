"""Lower bound of the distance between the triangles of two links, one of which moves."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from costs.native import call, find_library
from costs.robot import LinkSurface
from service.verify.solids import DistanceQuery, make_coal_convex

LARGEST_M = 0.002
"""Gaps above this are not told apart."""

_ROUNDING_M = 1e-6  # of measured distances and of placed points


class HeldSurface:
    """A surface that stays where it is, with the boxes of its triangles.

    Attributes:
        surface: the surface.
        boxes: (F, 6) lower and upper corner around each triangle [m].
    """

    def __init__(self, surface: LinkSurface) -> None:
        """Compute the boxes."""
        self.surface = surface
        corners = surface.vertices[surface.triangles]
        self.boxes = np.ascontiguousarray(np.concatenate([corners.min(axis=1), corners.max(axis=1)], axis=1))

    def bound_gap(
        self, triangles: Int[np.ndarray, "F 3"], points: Float[np.ndarray, "K V 3"], stray: Float[np.ndarray, "V"]
    ) -> float:
        """Return a lower bound of the distance of moving triangles from this surface, at most ``LARGEST_M`` [m].

        It is 0 where the triangles are not shown to keep apart.

        Args:
            triangles: indices of their corners.
            points: the corners at each of at most 16 poses, in the frame of this surface.
            stray: largest distance of each corner from the hull of its places.
        """
        n_poses, n_vertices = points.shape[:2]
        if not len(triangles) or not len(self.surface.triangles):
            return LARGEST_M
        if not np.isfinite(stray).all():
            return 0.0
        library = find_library()
        if library is None:
            return self._bound_gap(triangles, points, stray)
        boxes, gap = np.empty((len(triangles), 6)), np.zeros(1)
        points, stray = np.ascontiguousarray(points), np.ascontiguousarray(stray)
        shape = (n_poses, n_vertices, points, stray, len(triangles), triangles, boxes)
        call(library.scopt_box_triangles, *shape)
        held = self.surface
        call(
            library.scopt_separate_surfaces,
            *shape,
            held.vertices,
            len(held.triangles),
            held.triangles,
            self.boxes,
            LARGEST_M,
            gap,
        )
        return float(gap[0])

    def _bound_gap(
        self, triangles: Int[np.ndarray, "F 3"], points: Float[np.ndarray, "K V 3"], stray: Float[np.ndarray, "V"]
    ) -> float:
        """Compute the same with numpy and coal."""
        corners, own = points[:, triangles], stray[triangles].max(axis=1)
        low = corners.min(axis=(0, 2)) - own[:, None]
        high = corners.max(axis=(0, 2)) + own[:, None]
        query, best = DistanceQuery(), LARGEST_M
        for k in range(len(triangles)):
            beyond = np.maximum(np.maximum(low[k] - self.boxes[:, 3:], self.boxes[:, :3] - high[k]), 0.0)
            for near in np.flatnonzero(np.linalg.norm(beyond, axis=1) < best).tolist():
                still = self.surface.vertices[self.surface.triangles[near]]
                distance = query.measure(make_coal_convex(corners[:, k].reshape(-1, 3)), make_coal_convex(still))
                if distance - own[k] <= 2.0 * _ROUNDING_M:
                    return 0.0
                best = min(best, distance - own[k] - _ROUNDING_M)
        return best
