"""Hypotheses of circles in a cloud: random triples near one another, scored by who lies on their circle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from perception.detect.vectors import cross

_NEAR = 0.02
_BINS = 24
_MOST_POINTS = 250
_BALLS = (0.2, 0.36, 0.6, 0.85)


@dataclass(frozen=True)
class Circle:
    """A circle and how well points agree with it.

    Attributes:
        centre: (3,) [m].
        axis: (3,) unit.
        radius: [m].
        coverage: share of its 24 sectors with a point on it.
        score: coverage times the share of the points in its disc that lie on it.
    """

    centre: Float[np.ndarray, "3"]
    axis: Float[np.ndarray, "3"]
    radius: float
    coverage: float
    score: float


def find_circles(
    points: Float[np.ndarray, "N 3"],
    rng: np.random.Generator,
    radii: tuple[float, float] = (0.04, 0.42),
    n_seeds: int = 110,
    n_triples: int = 120,
    most: int = 60,
) -> list[Circle]:
    """The best circles, best first, no two about the same place.

    Args:
        points: (N, 3) downsampled, without walls and floor [m].
        rng: for the triples.
        radii: smallest and largest [m].
        n_seeds: places to look at, each with balls of several sizes.
        n_triples: triples per ball.
        most: how many to return.
    """
    if len(points) < 12:
        return []
    found: list[Circle] = []
    for seed in rng.choice(len(points), min(n_seeds, len(points)), replace=False):
        square = ((points - points[seed]) ** 2).sum(axis=1)
        for ball in _BALLS:
            near = np.flatnonzero(square <= ball**2)
            if len(near) >= 12:
                found += _best_in(points[rng.permutation(near)[:_MOST_POINTS]], rng, radii, ball, n_triples)
    found.sort(key=lambda circle: -circle.score)
    return _distinct(found, most)


def _best_in(
    local: Float[np.ndarray, "K 3"],
    rng: np.random.Generator,
    radii: tuple[float, float],
    ball: float,
    n_triples: int,
) -> list[Circle]:
    """The best circles of the points in one ball, if any."""
    centres, axes, radius = _circles_through(local[rng.integers(len(local), size=(n_triples, 3))])
    fits = (radius >= radii[0]) & (radius <= min(radii[1], 0.6 * ball))
    centres, axes, radius = centres[fits], axes[fits], radius[fits]
    if not len(radius):
        return []
    # Squares of the points' heights over each circle's plane and of their distances from its axis.
    places = np.column_stack([local, np.ones(len(local)), (local**2).sum(axis=1)]).T
    height = np.column_stack([axes, -(axes * centres).sum(axis=1)]) @ places[:4]
    height *= height
    distance = np.column_stack([-2.0 * centres, (centres**2).sum(axis=1), np.ones(len(centres))]) @ places
    distance -= height
    np.sqrt(np.maximum(distance, 0.0, out=distance), out=distance)
    distance -= radius[:, None]
    # Clutter fills a disc; a wheel is mostly rim.
    n_disc = np.count_nonzero((distance < 0.05) & (height < 0.05**2), axis=1)
    distance *= distance
    distance += height
    on = distance < _NEAR**2
    n_on = np.count_nonzero(on, axis=1)
    share = n_on / np.maximum(n_disc, 1)
    top = np.argsort(-n_on * share, kind="stable")[:3]
    covered = _coverage(local, centres[top], axes[top], on[top])
    # Sampling noise of few points must not look like a full circle.
    score = covered**2 * share[top] * np.minimum(1.0, n_on[top] / 25.0)
    return [
        Circle(centres[i], axes[i], float(radius[i]), float(covered[k]), float(score[k])) for k, i in enumerate(top)
    ]


def _circles_through(
    triples: Float[np.ndarray, "H 3 3"],
) -> tuple[Float[np.ndarray, "K 3"], Float[np.ndarray, "K 3"], Float[np.ndarray, "K"]]:
    """Centre, axis and radius of the circle through each triple that is not nearly straight."""
    u, v = triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0]
    normal = cross(u, v)
    square = (normal**2).sum(axis=1)
    good = square > 1e-8
    u, v, normal, square = u[good], v[good], normal[good], square[good]
    uu, vv = (u**2).sum(axis=1)[:, None], (v**2).sum(axis=1)[:, None]
    to_centre = (uu * cross(v, normal) + vv * cross(normal, u)) / (2.0 * square[:, None])
    return triples[good, 0] + to_centre, normal / np.sqrt(square)[:, None], np.sqrt((to_centre**2).sum(axis=1))


def _coverage(
    points: Float[np.ndarray, "K 3"],
    centres: Float[np.ndarray, "C 3"],
    axes: Float[np.ndarray, "C 3"],
    on: Bool[np.ndarray, "C K"],
) -> Float[np.ndarray, "C"]:
    """Share of each circle's sectors with one of the points that lie on it."""
    first = cross(np.eye(3)[np.argmin(np.abs(axes), axis=1)], axes)
    first /= np.sqrt((first**2).sum(axis=1))[:, None]
    second = cross(axes, first)
    circle, point = np.nonzero(on)
    offset = points[point] - centres[circle]
    angle = np.arctan2((offset * second[circle]).sum(axis=1), (offset * first[circle]).sum(axis=1))
    sector = np.floor(angle / (2 * np.pi) * _BINS).astype(np.int64) % _BINS
    filled = np.zeros((len(centres), _BINS), dtype=bool)
    filled[circle, sector] = True
    return np.asarray(filled.mean(axis=1))


def _distinct(circles: list[Circle], most: int) -> list[Circle]:
    kept: list[Circle] = []
    for circle in circles:
        if all(
            np.linalg.norm(circle.centre - other.centre) > 0.3 * max(circle.radius, other.radius)
            or abs(np.log(circle.radius / other.radius)) > 0.5
            for other in kept
        ):
            kept.append(circle)
            if len(kept) == most:
                break
    return kept
