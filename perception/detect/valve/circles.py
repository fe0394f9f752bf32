"""Circle hypotheses in a cloud: drawn from triples of near points, refitted and scored by their inliers.

Every place of the cloud has its own seeds, draws and limits, so that a wheel is proposed whatever else a scan shows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from costs.stopping import poll
from perception.detect.shared.arithmetic import cross
from perception.detect.shared.local import best_about, draws_at, pick_per_cell
from perception.detect.shared.slender import slim_places

_RADII = (0.04, 0.42)
# _BALLS: radius [m], radii of the circles drawn in it [m], number of points and of triples drawn; edge of the cells [m]
# that have seeds of their own, and the number of slender seeds and of others.  In a larger ball a rim has a smaller
# share of the points, but a larger rim has seeds in more cells.
_BALLS = (
    (0.13, (0.04, 0.08), 150, 40, 0.15, (1, 1)),
    (0.2, (0.07, 0.12), 200, 50, 0.25, (2, 1)),
    (0.36, (0.09, 0.22), 250, 80, 0.25, (1, 1)),
    (0.6, (0.17, 0.36), 400, 110, 0.35, (1, 1)),
    (0.85, (0.27, 0.42), 500, 130, 0.5, (2, 1)),
)
_SUBSAMPLE, _LOOKED_AT = 80, 8
_SLIM_BALL = 0.045  # [m]
# Least score in a ball about a seed, and least score and coverage by all points.
_LEAST_SCORE, _LEAST_REFITTED, _LEAST_COVERAGE = 0.03, 0.1, 0.5
# Limits for each class of radii about each place: least radius of a class, and radius of its places [m].
_MOST_HERE, _MOST_REFITTED_HERE = 3, 6
_CLASSES, _PLACES = (0.065, 0.09, 0.14, 0.22, 0.31), np.array([0.06, 0.1, 0.15, 0.2, 0.25, 0.25])
_BLOCK, _BEYOND = 0.75, 0.48
_SAME_AXIS = 0.9
# Discs: radii of the face about a hint [m], number of directions of its widths, and their greatest deviation by radius.
_DISC_BALLS, _DISC_WAYS, _ROUND = (0.08, 0.12, 0.18), 12, 0.15
_NEAR, _WIDER = (0.02, 0.035), 0.1  # [m], and as a share of the radius: large rims may be wide
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


def find_circles(points: Float[np.ndarray, "N 3"], more: int = 1) -> list[Circle]:
    """Return the best circles about each place, best first; no two of nearly equal centre and radius.

    Args:
        points: (N, 3) downsampled, without walls and floor [m].
        more: factor on the seeds of each cell.
    """
    if len(points) < 12:
        return []
    tree = cKDTree(points)
    slim, _ = slim_places(points, tree, _SLIM_BALL)
    others = np.setdiff1d(np.arange(len(points)), slim)
    hypotheses: list[Circle] = []
    for ball, radii, n_points, n_triples, cell, counts in _BALLS:
        # In clutter a rim has few of all points, but a good share of the slender ones.
        seeds = [
            these[pick_per_cell(points[these], cell, more * count)]
            for these, count in zip((slim, others), counts, strict=True)
        ]
        for seed in np.concatenate(seeds):
            near = np.sort(np.asarray(tree.query_ball_point(points[seed], ball), dtype=np.int64))
            if len(near) >= 12:
                draws = draws_at(points[seed])
                local = points[near[draws.permutation(len(near))[:n_points]]]
                hypotheses += _best_in(local, points[seed], draws, radii, n_triples)
    hypotheses = [circle for circle in hypotheses if circle.score > _LEAST_SCORE]
    hypotheses = _limit(_drop_duplicates(_first_of_alike(_in_order(hypotheses)), 0.15, _SAME_AXIS), _MOST_REFITTED_HERE)
    sharp = [
        circle
        for circle in _sharpen(hypotheses, points, _RADII)
        if circle.coverage > _LEAST_COVERAGE and circle.score > _LEAST_REFITTED
    ]
    return _limit(_drop_duplicates(_in_order(sharp)), _MOST_HERE)


def find_discs(points: Float[np.ndarray, "N 3"], hint: Float[np.ndarray, "3"]) -> list[Circle]:
    """Return the outlines of flat round parts about a hint; the points of a solid wheel lie on no circle.

    Args:
        points: (N, 3) downsampled [m].
        hint: (3,) a point near the middle [m].
    """
    discs = []
    near = np.linalg.norm(points - hint, axis=1)
    for ball in _DISC_BALLS:
        face = points[near < ball]
        if len(face) < _FULL:
            continue
        axis = np.linalg.eigh(np.cov((face - face.mean(axis=0)).T))[1][:, 0]
        level = float(np.median(face @ axis))
        slab = points[(np.abs(points @ axis - level) < _NEAR[0]) & (near < _RADII[1])]
        first = cross(np.eye(3)[np.argmin(np.abs(axis))], axis)
        first /= np.linalg.norm(first)
        angle = np.linspace(0.0, np.pi, _DISC_WAYS, endpoint=False)
        ways = np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * cross(axis, first)
        if len(slab) < _FULL:
            continue
        low, high = np.percentile(slab @ ways.T, [1.0, 99.0], axis=0)
        radius = 0.5 * float((high - low).mean())
        if _RADII[0] <= radius <= _RADII[1] and np.std(high - low) < _ROUND * radius:
            centre = level * axis + (2.0 / _DISC_WAYS) * (0.5 * (low + high)) @ ways
            discs.append(Circle(centre, axis, radius, 1.0, 1.0))
    return discs


def _in_order(circles: list[Circle]) -> list[Circle]:
    """Return the circles, best first; equal ones by their coordinates."""
    return sorted(circles, key=lambda circle: (-circle.score, *circle.centre.tolist()))


def _limit(circles: list[Circle], most: int) -> list[Circle]:
    """Return the circles with fewer than ``most`` better ones of their class about their centre."""
    if not circles:
        return []
    classes = np.digitize([circle.radius for circle in circles], _CLASSES)
    places = np.array([circle.centre for circle in circles]) / _PLACES[classes, None]
    # Classes are far apart along a fourth coordinate.
    return best_about(circles, np.column_stack([places, 2.0 * classes]), 1.0, most)


def _first_of_alike(circles: list[Circle]) -> list[Circle]:
    """Return the first of the circles in each small cell of centres, radii and axes; a quick first selection."""
    first: dict[tuple[int, ...], Circle] = {}
    for circle in circles:
        axis = circle.axis * np.sign(circle.axis[np.argmax(np.abs(circle.axis))])
        cell = [*(circle.centre / (0.15 * circle.radius)), np.log(circle.radius) / 0.2, *(axis / 0.2)]
        first.setdefault(tuple(np.floor(cell).astype(int).tolist()), circle)
    return list(first.values())


def _best_in(
    local: Float[np.ndarray, "K 3"],
    seed: Float[np.ndarray, "3"],
    rng: np.random.Generator,
    radii: tuple[float, float],
    n_triples: int,
) -> list[Circle]:
    """Return the two best circles through the seed and two points in a ball about it, or fewer.

    In clutter, two points on the seed's rim are drawn sooner than three points on one rim.  The most likely ones by a
    part of the points are compared on all of them.
    """
    poll()
    pairs = local[rng.integers(len(local), size=(n_triples, 2))]
    circles = _circles_through(np.concatenate([np.broadcast_to(seed, (n_triples, 1, 3)), pairs], axis=1))
    circles = circles.select((circles.radii >= radii[0]) & (circles.radii <= radii[1]))
    if not len(circles):
        return []
    if len(local) > 1.5 * _SUBSAMPLE and len(circles) > _LOOKED_AT:
        rough = agreement(local[:_SUBSAMPLE], circles)
        circles = circles.select(np.argsort(-rough.count * rough.share, kind="stable")[:_LOOKED_AT])
    agreed = agreement(local, circles)
    top = np.argsort(-agreed.count * agreed.share, kind="stable")[:2]
    return _score(local, circles.select(top), agreed.select(top))


def _sharpen(hypotheses: list[Circle], points: Float[np.ndarray, "N 3"], radii: tuple[float, float]) -> list[Circle]:
    """Return the circles refitted to all points, without those that leave the radii; block by block of the world."""
    blocks: dict[tuple[int, ...], list[Circle]] = {}
    for circle in hypotheses:
        blocks.setdefault(tuple(np.floor(circle.centre / _BLOCK).astype(int).tolist()), []).append(circle)
    sharp: list[Circle] = []
    for block, mine in blocks.items():
        poll()
        low = np.array(block) * _BLOCK - _BEYOND
        near = points[((points > low) & (points < low + _BLOCK + 2.0 * _BEYOND)).all(axis=1)]
        if not len(near):
            continue
        circles = Circles(
            np.stack([circle.centre for circle in mine]),
            np.stack([circle.axis for circle in mine]),
            np.array([circle.radius for circle in mine]),
        )
        for _ in range(2):
            circles = refit_circles(near, circles, agreement(near, circles))
        circles = circles.select((circles.radii >= radii[0]) & (circles.radii <= radii[1]))
        sharp += _score(near, circles, agreement(near, circles))
    return sharp


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


def _drop_duplicates(circles: list[Circle], apart: float = 0.3, least_cosine: float = -1.0) -> list[Circle]:
    """Return the first circle of each group of nearly equal centre, radius and axis.

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
    """Return the inliers of each circle: the points within 2 cm of it, or up to 3.5 cm of one larger than 20 cm."""
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
    on = distance < np.clip(_WIDER * circles.radii, *_NEAR)[:, None] ** 2
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
