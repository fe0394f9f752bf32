"""Circle hypotheses in a cloud: drawn from random triples of near points, refitted and scored by their inliers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from costs.stopping import poll
from perception.detect.shared.arithmetic import cross
from perception.detect.shared.slender import slim_places

# _BALLS: radius [m], number of points and of triples drawn, stride over the seeds.  In a larger ball a rim has a
# smaller share of the points, but a larger rim has more seeds.
_RADII = (0.04, 0.42)
_MOST_SEEDS, _MOST_CIRCLES = 200, 60
_BALLS = ((0.2, 200, 50, 1), (0.36, 250, 80, 1), (0.6, 400, 100, 2), (0.85, 500, 120, 2))
_REFITTED, _SAME_AXIS = 150, 0.9
_SLIM_BALL = 0.045  # [m]
_NEAR = 0.02
_AROUND = 0.05
_BINS = 24
_FULL = 25.0
_FEWEST = 6


@dataclass(frozen=True)
class Circle:
    """Circle with its coverage and score by the points.

    Attributes:
        coverage: share of its 24 sectors with a point on it.
        score: coverage squared times the share of the points in its disc that lie on it (:func:`scores`).
    """

    centre: Float[np.ndarray, "3"]
    axis: Float[np.ndarray, "3"]
    radius: float
    coverage: float
    score: float


def find_circles(
    points: Float[np.ndarray, "N 3"],
    rng: np.random.Generator,
) -> list[Circle]:
    """Return the best circles, best first; no two of nearly equal centre and radius.

    Args:
        points: (N, 3) downsampled, without walls and floor [m].
    """
    if len(points) < 12:
        return []
    hypotheses: list[Circle] = []
    for i, seed in enumerate(_seeds(points, rng, _MOST_SEEDS)):
        poll()
        square = ((points - points[seed]) ** 2).sum(axis=1)
        for ball, n_points, n_triples, every in _BALLS:
            near = np.flatnonzero(square <= ball**2)
            if i % every == 0 and len(near) >= 12:
                local = points[rng.permutation(near)[:n_points]]
                hypotheses += _best_in(local, points[seed], rng, (_RADII[0], min(_RADII[1], 0.6 * ball)), n_triples)
    hypotheses.sort(key=lambda circle: -circle.score)
    hypotheses = _sharpen(_drop_duplicates(hypotheses, _REFITTED, 0.15, _SAME_AXIS), points, _RADII)
    hypotheses.sort(key=lambda circle: -circle.score)
    return _drop_duplicates(hypotheses, _MOST_CIRCLES)


def _seeds(points: Float[np.ndarray, "N 3"], rng: np.random.Generator, most: int) -> Int[np.ndarray, "S"]:
    """Return indices of seed points: half of them random, half where points spread along one direction.

    In clutter a rim has few of all points, but a good share of the slender ones.
    """
    slim, _ = slim_places(points, cKDTree(points), _SLIM_BALL)
    some = rng.choice(slim, min(most // 2, len(slim)), replace=False)
    others = np.setdiff1d(np.arange(len(points)), some)
    return np.concatenate([some, rng.choice(others, min(most - len(some), len(others)), replace=False)])


def _best_in(
    local: Float[np.ndarray, "K 3"],
    seed: Float[np.ndarray, "3"],
    rng: np.random.Generator,
    radii: tuple[float, float],
    n_triples: int,
) -> list[Circle]:
    """Return the three best circles through the seed and two points in a ball about it, or fewer.

    In clutter, two points on the seed's rim are drawn sooner than three points on one rim.
    """
    poll()
    pairs = local[rng.integers(len(local), size=(n_triples, 2))]
    circles = _circles_through(np.concatenate([np.broadcast_to(seed, (n_triples, 1, 3)), pairs], axis=1))
    circles = circles.select((circles.radii >= radii[0]) & (circles.radii <= radii[1]))
    if not len(circles):
        return []
    agreed = agreement(local, circles)
    top = np.argsort(-agreed.count * agreed.share, kind="stable")[:3]
    return _score(local, circles.select(top), agreed.select(top))


def _sharpen(hypotheses: list[Circle], points: Float[np.ndarray, "N 3"], radii: tuple[float, float]) -> list[Circle]:
    """Return the circles refitted to all points, without those that leave the radii."""
    if not hypotheses:
        return []
    centres, axes = np.stack([circle.centre for circle in hypotheses]), np.stack([circle.axis for circle in hypotheses])
    circles = Circles(centres, axes, np.array([circle.radius for circle in hypotheses]))
    for _ in range(2):
        circles = refit_circles(points, circles, agreement(points, circles))
    circles = circles.select((circles.radii >= radii[0]) & (circles.radii <= radii[1]))
    return _score(points, circles, agreement(points, circles))


def _score(points: Float[np.ndarray, "N 3"], circles: Circles, agreed: Agreement) -> list[Circle]:
    covered, score = scores(points, circles, agreed)
    return [
        Circle(circles.centres[i], circles.axes[i], float(circles.radii[i]), float(covered[i]), float(score[i]))
        for i in range(len(circles))
    ]


def _circles_through(triples: Float[np.ndarray, "H 3 3"]) -> Circles:
    """Return the circle through each triple that is not nearly collinear."""
    u, v = triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0]
    normal = cross(u, v)
    square = (normal**2).sum(axis=1)
    good = square > 1e-8
    u, v, normal, square = u[good], v[good], normal[good], square[good]
    uu, vv = (u**2).sum(axis=1)[:, None], (v**2).sum(axis=1)[:, None]
    to_centre = (uu * cross(v, normal) + vv * cross(normal, u)) / (2.0 * square[:, None])
    radii = np.sqrt((to_centre**2).sum(axis=1))
    return Circles(triples[good, 0] + to_centre, normal / np.sqrt(square)[:, None], radii)


def _drop_duplicates(circles: list[Circle], most: int, apart: float = 0.3, least_cosine: float = -1.0) -> list[Circle]:
    """Return at most ``most`` circles: the first of each group of nearly equal centre, radius and axis.

    Args:
        circles: best first.
        apart: greatest distance between the centres of duplicates, as a share of the larger radius; their log radii
            differ by at most ``apart / 0.6``.
        least_cosine: least cosine of the angle between the axes of duplicates, either sign.
    """
    centres, axes = np.array([circle.centre for circle in circles]), np.array([circle.axis for circle in circles])
    radii = np.array([circle.radius for circle in circles])
    taken = np.zeros(len(circles), dtype=bool)
    kept: list[Circle] = []
    for i, circle in enumerate(circles):
        if taken[i]:
            continue
        kept.append(circle)
        if len(kept) == most:
            break
        is_near = ((centres - circle.centre) ** 2).sum(axis=1) <= (apart * np.maximum(radii, circle.radius)) ** 2
        is_alike = np.abs(np.log(radii / circle.radius)) <= apart / 0.6
        taken |= is_near & is_alike & (np.abs(axes @ circle.axis) >= least_cosine)
    return kept


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
class Agreement:
    """Inliers of circles.

    Attributes:
        on: (C, N) points that lie on each circle.
        count: (C,) their number.
        share: (C,) share of inliers among the points in each disc; clutter fills the disc, a wheel does not.
    """

    on: Bool[np.ndarray, "C N"]
    count: Int[np.ndarray, "C"]
    share: Float[np.ndarray, "C"]

    def select(self, keep: Int[np.ndarray, "K"]) -> Agreement:
        """Return the inliers of the selected circles."""
        return Agreement(self.on[keep], self.count[keep], self.share[keep])


def agreement(points: Float[np.ndarray, "N 3"], circles: Circles) -> Agreement:
    """Return the inliers of each circle: the points within 2 cm of it."""
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
    """Return (C,) coverage of the 24 sectors by inliers, and (C,) score: coverage squared times the inlier share.

    Below 25 inliers the score is lowered in proportion: few random points may look like a full circle.
    """
    covered = _coverage(points, circles, agreed.on)
    return covered, covered**2 * agreed.share * np.minimum(1.0, agreed.count / _FULL)


def refit_circles(points: Float[np.ndarray, "N 3"], circles: Circles, agreed: Agreement) -> Circles:
    """Return each circle after one least-squares fit to its inliers (Kasa, IEEE Trans. Instrum. Meas. 25, 1976).

    A circle through three points of a small noisy rim has an axis error of tens of degrees.
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
    is_known = (agreed.count >= _FEWEST) & np.isfinite(radii)
    pick = is_known[:, None]
    return Circles(
        np.where(pick, middle + mean + offset, circles.centres),
        np.where(pick, directions[:, :, 0], circles.axes),
        np.where(is_known, radii, circles.radii),
    )


def _coverage(
    points: Float[np.ndarray, "K 3"], circles: Circles, on: Bool[np.ndarray, "C K"]
) -> Float[np.ndarray, "C"]:
    """Return (C,) share of each circle's sectors that hold an inlier."""
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
