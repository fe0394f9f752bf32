"""Many circles at once: which points lie on each, and each refitted to those that do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from costs.stopping import poll
from perception.detect.shared.vectors import cross

_NEAR = 0.02
_AROUND = 0.05
_BINS = 24
_FULL = 25.0
_FEWEST = 6


@dataclass(frozen=True)
class Circles:
    """Circles in space.

    Attributes:
        centres: (C, 3) [m].
        axes: (C, 3) unit.
        radii: (C,) [m].
    """

    centres: Float[np.ndarray, "C 3"]
    axes: Float[np.ndarray, "C 3"]
    radii: Float[np.ndarray, "C"]

    def __len__(self) -> int:
        return len(self.radii)

    def selected(self, keep: Bool[np.ndarray, "C"] | Int[np.ndarray, "K"]) -> Circles:
        """Only these."""
        return Circles(self.centres[keep], self.axes[keep], self.radii[keep])


@dataclass(frozen=True)
class Agreement:
    """How points agree with circles.

    Attributes:
        on: (C, N) which points lie on each.
        count: (C,) of them.
        share: (C,) of the points about each one's disc that lie on it: clutter fills a disc, a wheel is mostly rim.
    """

    on: Bool[np.ndarray, "C N"]
    count: Int[np.ndarray, "C"]
    share: Float[np.ndarray, "C"]

    def selected(self, keep: Int[np.ndarray, "K"]) -> Agreement:
        """Only these circles."""
        return Agreement(self.on[keep], self.count[keep], self.share[keep])


def agreement(points: Float[np.ndarray, "N 3"], circles: Circles) -> Agreement:
    """Which of the points lie within 2 cm of each circle."""
    poll()
    centres, axes = circles.centres, circles.axes
    # Squares of the points' heights over each circle's plane and of their distances from its axis.
    places = np.column_stack([points, np.ones(len(points)), (points**2).sum(axis=1)]).T
    height = np.column_stack([axes, -(axes * centres).sum(axis=1)]) @ places[:4]
    height *= height
    distance = np.column_stack([-2.0 * centres, (centres**2).sum(axis=1), np.ones(len(centres))]) @ places
    distance -= height
    poll()
    np.sqrt(np.maximum(distance, 0.0, out=distance), out=distance)
    distance -= circles.radii[:, None]
    n_disc = np.count_nonzero((distance < _AROUND) & (height < _AROUND**2), axis=1)
    poll()
    distance *= distance
    distance += height
    on = distance < _NEAR**2
    count = np.count_nonzero(on, axis=1)
    return Agreement(on, count, count / np.maximum(n_disc, 1))


def scores(
    points: Float[np.ndarray, "N 3"], circles: Circles, agreed: Agreement
) -> tuple[Float[np.ndarray, "C"], Float[np.ndarray, "C"]]:
    """Share of each circle's 24 sectors with a point on it, and its score: that squared, times the share of the points
    about its disc that lie on it.

    Sampling noise of few points must not look like a full circle.
    """
    covered = _coverage(points, circles, agreed.on)
    return covered, covered**2 * agreed.share * np.minimum(1.0, agreed.count / _FULL)


def refitted(points: Float[np.ndarray, "N 3"], circles: Circles, agreed: Agreement) -> Circles:
    """Each circle after one step of least squares on the points that lie on it: their plane, and in it the algebraic
    circle fit of Kasa, IEEE Trans. Instrum. Meas. 25, 1976.

    The axis of a circle through three points of a small noisy rim is off by tens of degrees.
    """
    poll()
    middle = points.mean(axis=0)
    local = points - middle
    square = (local**2).sum(axis=1)
    # All moments of all circles' points in one product.
    pairs = local[:, [0, 0, 0, 1, 1, 2]] * local[:, [0, 1, 2, 1, 2, 2]]
    poll()
    moments = agreed.on.astype(float) @ np.column_stack([local, pairs, square[:, None] * local, square])
    n = np.maximum(agreed.count, 1).astype(float)[:, None]
    moments /= n
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
    told = (agreed.count >= _FEWEST) & np.isfinite(radii)
    pick = told[:, None]
    return Circles(
        np.where(pick, middle + mean + offset, circles.centres),
        np.where(pick, directions[:, :, 0], circles.axes),
        np.where(told, radii, circles.radii),
    )


def _coverage(
    points: Float[np.ndarray, "K 3"], circles: Circles, on: Bool[np.ndarray, "C K"]
) -> Float[np.ndarray, "C"]:
    """Share of each circle's sectors with one of the points that lie on it."""
    poll()
    axes = circles.axes
    first = cross(np.eye(3)[np.argmin(np.abs(axes), axis=1)], axes)
    first /= np.sqrt((first**2).sum(axis=1))[:, None]
    second = cross(axes, first)
    circle, point = np.nonzero(on)
    offset = points[point] - circles.centres[circle]
    angle = np.arctan2((offset * second[circle]).sum(axis=1), (offset * first[circle]).sum(axis=1))
    sector = np.floor(angle / (2 * np.pi) * _BINS).astype(np.int64) % _BINS
    filled = np.zeros((len(circles), _BINS), dtype=bool)
    filled[circle, sector] = True
    return np.asarray(filled.mean(axis=1))
