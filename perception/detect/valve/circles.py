"""Circle hypotheses in a cloud: drawn about seeds, refitted and scored by their inliers.

Every place of the cloud has its own seeds, draws and limits, so that a wheel is proposed whatever else a scan shows.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from perception.detect.shared.arithmetic import cross
from perception.detect.shared.local import best_about, pick_per_cell
from perception.detect.shared.nearby import Nearby
from perception.detect.shared.slender import slim_places
from perception.detect.valve.circle_draws import Ball, draw_circles
from perception.detect.valve.circle_fit import (
    Circle,
    ScoredCircles,
    find_inliers,
    join_circles,
    refit_circles,
    score_circles,
)

_RADII = (0.04, 0.42)
# In a larger ball a rim has a smaller share of the points, but a larger rim has seeds in more cells.
_BALLS = (
    Ball(0.13, (0.04, 0.08), 150, 40, 0.15, (2, 1)),
    Ball(0.2, (0.07, 0.12), 200, 50, 0.25, (2, 1)),
    Ball(0.36, (0.09, 0.22), 250, 80, 0.25, (1, 1)),
    Ball(0.6, (0.17, 0.36), 400, 110, 0.35, (1, 1)),
    Ball(0.85, (0.27, 0.42), 500, 130, 0.5, (2, 1)),
)
_SLIM_BALL = 0.045  # [m]
# Least score in a ball about a seed, and least score and coverage by all points.
_LEAST_SCORE, _LEAST_REFITTED, _LEAST_COVERAGE = 0.03, 0.1, 0.5
# Limits for each class of radii about each place: least radius of a class, and radius of its places [m].
_MOST_HERE, _MOST_REFITTED_HERE = 3, 6
_CLASSES, _PLACES = (0.065, 0.09, 0.14, 0.22, 0.31), np.array([0.06, 0.1, 0.15, 0.2, 0.25, 0.25])
_REFITS = 2
# Greatest distance of the centres of duplicates, as a share of the larger radius, before and after the refit; their
# log radii differ by at most this share over _RADII_APART.  Before it, least cosine between their axes.
_ALIKE, _DUPLICATES, _RADII_APART, _SAME_AXIS = 0.15, 0.3, 0.6, 0.9
_FEWEST = 12
# Discs: radii of the face about a hint and half depth of its points [m], number of directions of its widths, their
# greatest deviation by radius, and least number of points.
_DISC_BALLS, _DISC_DEEP, _DISC_WAYS, _ROUND, _FULL = (0.08, 0.12, 0.18), 0.02, 12, 0.15, 25


def find_circles(points: Float[np.ndarray, "N 3"], more: int = 1) -> list[Circle]:
    """Return the best circles about each place, best first; no two of nearly equal centre and radius.

    Args:
        points: (N, 3) downsampled, without walls and floor [m].
        more: factor on the seeds of each cell.
    """
    if len(points) < _FEWEST:
        return []
    slim, _ = slim_places(points, cKDTree(points), _SLIM_BALL)
    others = np.setdiff1d(np.arange(len(points)), slim)
    nearby = Nearby.of(points)
    parts: list[ScoredCircles] = []
    for ball in _BALLS:
        # In clutter a rim has few of all points, but a good share of the slender ones.
        seeds = [
            these[pick_per_cell(points[these], ball.cell, more * count)]
            for these, count in zip((slim, others), ball.n_seeds, strict=True)
        ]
        for circles in draw_circles(nearby, np.concatenate(seeds), ball):
            parts.append(circles.select(circles.scores > _LEAST_SCORE))
    if not parts:
        return []
    drawn = _limit(_drop_duplicates(join_circles(parts).in_order(), _ALIKE, _SAME_AXIS), _MOST_REFITTED_HERE)
    sharp = _sharpen(drawn, nearby)
    sharp = sharp.select((sharp.coverage > _LEAST_COVERAGE) & (sharp.scores > _LEAST_REFITTED))
    return _limit(_drop_duplicates(sharp.in_order(), _DUPLICATES), _MOST_HERE).list_all()


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
        slab = points[(np.abs(points @ axis - level) < _DISC_DEEP) & (near < _RADII[1])]
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


def _limit(circles: ScoredCircles, most: int) -> ScoredCircles:
    """Return the circles with fewer than ``most`` better ones of their class about their centre."""
    classes = np.digitize(circles.circles.radii, _CLASSES)
    places = circles.circles.centres / _PLACES[classes, None]
    # Classes are far apart along a fourth coordinate.
    return circles.select(best_about(np.column_stack([places, 2.0 * classes]), 1.0, most))


def _sharpen(drawn: ScoredCircles, nearby: Nearby) -> ScoredCircles:
    """Return the circles refitted to all points, without those that leave the radii."""
    circles = drawn.circles
    for _ in range(_REFITS):
        circles = refit_circles(circles, find_inliers(circles, nearby))
    circles = circles.select((circles.radii >= _RADII[0]) & (circles.radii <= _RADII[1]))
    return score_circles(circles, find_inliers(circles, nearby))


def _drop_duplicates(circles: ScoredCircles, apart: float, least_cosine: float = -1.0) -> ScoredCircles:
    """Return the first circle of each group of nearly equal centre, radius and axis.

    Args:
        circles: best first.
        apart: greatest distance between the centres of duplicates, as a share of the larger radius.
        least_cosine: least cosine of the angle between the axes of duplicates, either sign.
    """
    if not len(circles):
        return circles
    centres, axes, radii = circles.circles.centres, circles.circles.axes, circles.circles.radii
    i, j = cKDTree(centres).query_pairs(apart * float(radii.max()), output_type="ndarray").T
    is_near = ((centres[i] - centres[j]) ** 2).sum(axis=1) <= (apart * np.maximum(radii[i], radii[j])) ** 2
    is_alike = np.abs(np.log(radii[i] / radii[j])) <= apart / _RADII_APART
    alike = is_near & is_alike & (np.abs((axes[i] * axes[j]).sum(axis=1)) >= least_cosine)
    return circles.select(_first_of_groups(len(circles), np.column_stack([i, j])[alike]))


def _first_of_groups(n: int, pairs: Int[np.ndarray, "K 2"]) -> Int[np.ndarray, "M"]:
    """Return which of n items to keep, so that none is paired with a kept earlier one."""
    pairs = np.sort(pairs, axis=1)
    pairs = pairs[np.argsort(pairs[:, 0], kind="stable")]
    borders = np.searchsorted(pairs[:, 0], np.arange(n + 1))
    taken = np.zeros(n, dtype=bool)
    for k in np.flatnonzero(np.diff(borders)):
        if not taken[k]:
            taken[pairs[borders[k] : borders[k + 1], 1]] = True
    return np.flatnonzero(~taken)
