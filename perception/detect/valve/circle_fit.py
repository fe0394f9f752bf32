"""Circles fitted to the points of a cloud that lie on them, many at once, and their scores."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from costs.stopping import poll
from perception.detect.shared.arithmetic import cross
from perception.detect.shared.nearby import Nearby, Neighbours

_NEAR, _WIDER = (0.02, 0.035), 0.1  # [m], and as a share of the radius: large rims may be wide
_AROUND = 0.05
_SECTORS = 24
_FULL = 25.0
_FEWEST = 6


@dataclass(frozen=True)
class Circle:
    """Circle with its coverage and score by the points.

    Attributes:
        coverage: share of its 24 sectors with a point on it.
        score: coverage squared times the share of the points in its disc that lie on it (:func:`score_circles`).
    """

    centre: Float[np.ndarray, "3"]
    axis: Float[np.ndarray, "3"]
    radius: float
    coverage: float
    score: float


@dataclass(frozen=True)
class Circles:
    """Circles in space."""

    centres: Float[np.ndarray, "C 3"]
    axes: Float[np.ndarray, "C 3"]
    radii: Float[np.ndarray, "C"]

    def __len__(self) -> int:
        return len(self.radii)

    def select(self, keep: Bool[np.ndarray, "C"] | Int[np.ndarray, "K"]) -> Circles:
        """Return the selected circles."""
        return Circles(self.centres[keep], self.axes[keep], self.radii[keep])


@dataclass(frozen=True)
class ScoredCircles:
    """Circles, with coverage (C,) and score (C,) as in :class:`Circle`."""

    circles: Circles
    coverage: Float[np.ndarray, "C"]
    scores: Float[np.ndarray, "C"]

    def __len__(self) -> int:
        return len(self.circles)

    def select(self, keep: Bool[np.ndarray, "C"] | Int[np.ndarray, "K"]) -> ScoredCircles:
        """Return the selected circles."""
        return ScoredCircles(self.circles.select(keep), self.coverage[keep], self.scores[keep])

    def in_order(self) -> ScoredCircles:
        """Return the circles, best first; equal ones by their coordinates."""
        return self.select(np.lexsort((*self.circles.centres.T[::-1], -self.scores)))

    def list_all(self) -> list[Circle]:
        """Return the circles one by one."""
        columns = (self.circles.centres, self.circles.axes, self.circles.radii, self.coverage, self.scores)
        return [
            Circle(centre, axis, float(radius), float(coverage), float(score))
            for centre, axis, radius, coverage, score in zip(*columns, strict=True)
        ]


def join_circles(parts: Sequence[ScoredCircles]) -> ScoredCircles:
    """Return the circles of all parts, of which there must be one."""
    return ScoredCircles(
        Circles(
            np.concatenate([part.circles.centres for part in parts]),
            np.concatenate([part.circles.axes for part in parts]),
            np.concatenate([part.circles.radii for part in parts]),
        ),
        np.concatenate([part.coverage for part in parts]),
        np.concatenate([part.scores for part in parts]),
    )


@dataclass(frozen=True)
class Inliers:
    """Points that lie on circles.

    Attributes:
        circle: (K,) number of the circle, ascending.
        offset: (K, 3) from its centre to the point [m].
        count: (C,) number of points on each circle.
        share: (C,) share of them among the points in each disc; clutter fills the disc, a wheel does not.
    """

    circle: Int[np.ndarray, "K"]
    offset: Float[np.ndarray, "K 3"]
    count: Int[np.ndarray, "C"]
    share: Float[np.ndarray, "C"]


def find_inliers(circles: Circles, nearby: Nearby) -> Inliers:
    """Return the points within 2 cm of each circle, or up to 3.5 cm of one larger than 20 cm."""
    reach = np.hypot(circles.radii + _AROUND, _AROUND)
    parts = [_inliers_among(circles, nearby, near) for near in nearby.list_near(circles.centres, reach)]
    none = (np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros(0, dtype=np.int64))
    circle, offset, in_disc = (np.concatenate(columns) for columns in zip(none, *parts, strict=True))
    count = np.bincount(circle, minlength=len(circles))
    return Inliers(circle, offset, count, count / np.maximum(in_disc, 1))


def _inliers_among(
    circles: Circles, nearby: Nearby, near: Neighbours
) -> tuple[Int[np.ndarray, "K"], Float[np.ndarray, "K 3"], Int[np.ndarray, "P"]]:
    """Return circle and offset of each inlier among the neighbours of some circles, and the counts in their discs."""
    of = np.repeat(np.arange(near.first, near.last), near.counts)
    offset = nearby.points.take(near.points, 0) - circles.centres.take(of, 0)
    height = np.einsum("ki,ki->k", offset, circles.axes.take(of, 0))
    on, in_disc = sort_points(height**2, np.einsum("ki,ki->k", offset, offset), circles.radii.take(of))
    keep = np.flatnonzero(on)
    n_disc = np.bincount(of[in_disc] - near.first, minlength=near.last - near.first)
    return of[keep], offset[keep], n_disc


def sort_points(
    height: Float[np.ndarray, "*n"], square: Float[np.ndarray, "*n"], radii: Float[np.ndarray, "*n"]
) -> tuple[Bool[np.ndarray, "*n"], Bool[np.ndarray, "*n"]]:
    """Return which points lie on their circle, and which in its disc.

    Args:
        height: square of the point's height over the circle's plane [m^2].
        square: square of its distance from the centre [m^2]; overwritten.
        radii: of the circle [m].
    """
    square -= height
    beyond = np.sqrt(np.maximum(square, 0.0, out=square), out=square)
    beyond -= radii
    in_disc = (beyond < _AROUND) & (height < _AROUND**2)
    beyond *= beyond
    beyond += height
    return beyond < np.clip(_WIDER * radii, *_NEAR) ** 2, in_disc


def score_circles(circles: Circles, inliers: Inliers) -> ScoredCircles:
    """Return the circles with the coverage of their 24 sectors by inliers, and coverage squared times inlier share.

    Below 25 inliers the score is lowered in proportion: few random points may look like a full circle.
    """
    poll()
    axes = circles.axes
    first = cross(np.eye(3)[np.argmin(np.abs(axes), axis=1)], axes)
    first /= np.sqrt((first**2).sum(axis=1))[:, None]
    second = cross(axes, first)
    x, y = (np.einsum("ki,ki->k", inliers.offset, way.take(inliers.circle, 0)) for way in (first, second))
    sector = np.floor(np.arctan2(y, x) / (2 * np.pi) * _SECTORS).astype(np.int64) % _SECTORS
    filled = np.zeros(len(circles) * _SECTORS, dtype=bool)
    filled[inliers.circle * _SECTORS + sector] = True
    covered = filled.reshape(-1, _SECTORS).mean(axis=1)
    return ScoredCircles(circles, covered, covered**2 * inliers.share * np.minimum(1.0, inliers.count / _FULL))


def refit_circles(circles: Circles, inliers: Inliers) -> Circles:
    """Return each circle after one least-squares fit to its inliers (Kasa, IEEE Trans. Instrum. Meas. 25, 1976).

    A circle through three points of a small noisy rim has an axis error of tens of degrees.
    """
    poll()
    n_circles, local = len(circles), inliers.offset
    square = (local**2).sum(axis=1)
    pairs = local[:, [0, 0, 0, 1, 1, 2]] * local[:, [0, 1, 2, 1, 2, 2]]
    terms = np.column_stack([local, pairs, square[:, None] * local, square])
    moments = np.stack([np.bincount(inliers.circle, term, n_circles) for term in terms.T], axis=1)
    moments = moments / np.maximum(inliers.count, 1)[:, None]
    mean, third, spread = moments[:, :3], moments[:, 9:12], moments[:, 12:]
    second = moments[:, [3, 4, 5, 4, 6, 7, 5, 7, 8]].reshape(-1, 3, 3)
    covariance = second - mean[:, :, None] * mean[:, None, :]
    variances, directions = np.linalg.eigh(covariance)
    far = (mean**2).sum(axis=1)[:, None]
    # Mean of |p - m|^2 (p - m).
    lean = third - 2.0 * (second @ mean[:, :, None])[:, :, 0] - mean * spread + 2.0 * far * mean
    along = (lean[:, None, :] @ directions)[:, 0, 1:] / np.maximum(2.0 * variances[:, 1:], 1e-9)
    offset = (directions[:, :, 1:] @ along[:, :, None])[:, :, 0]
    radii = np.sqrt((along**2).sum(axis=1) + variances[:, 1:].sum(axis=1))
    is_known = (inliers.count >= _FEWEST) & np.isfinite(radii)
    pick = is_known[:, None]
    return Circles(
        np.where(pick, circles.centres + mean + offset, circles.centres),
        np.where(pick, directions[:, :, 0], circles.axes),
        np.where(is_known, radii, circles.radii),
    )
