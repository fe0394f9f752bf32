"""Hypotheses of circles in a cloud: random triples near one another, scored by who lies on their circle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

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
    tree = cKDTree(points)
    found: list[Circle] = []
    for seed in rng.choice(len(points), min(n_seeds, len(points)), replace=False):
        for ball in _BALLS:
            near = np.asarray(tree.query_ball_point(points[seed], ball), dtype=int)
            if len(near) >= 12:
                found += _best_in(points, rng.permutation(np.sort(near))[:_MOST_POINTS], rng, radii, ball, n_triples)
    found.sort(key=lambda circle: -circle.score)
    return _distinct(found, most)


def _best_in(
    points: Float[np.ndarray, "N 3"],
    near: Int[np.ndarray, "K"],
    rng: np.random.Generator,
    radii: tuple[float, float],
    ball: float,
    n_triples: int,
) -> list[Circle]:
    """The best circle of one ball, if any."""
    local = points[near]
    centres, axes, radius = _circles_through(local[rng.integers(len(local), size=(n_triples, 3))])
    fits = (radius >= radii[0]) & (radius <= min(radii[1], 0.6 * ball))
    centres, axes, radius = centres[fits], axes[fits], radius[fits]
    if not len(radius):
        return []
    height = axes @ local.T - (axes * centres).sum(axis=1)[:, None]
    square = (local**2).sum(axis=1) - 2.0 * centres @ local.T + (centres**2).sum(axis=1)[:, None]
    distance = np.sqrt(np.maximum(square - height**2, 0.0))
    on = (distance - radius[:, None]) ** 2 + height**2 < _NEAR**2
    # Clutter fills a disc; a wheel is mostly rim.
    disc = (distance < radius[:, None] + 0.05) & (np.abs(height) < 0.05)
    share = on.sum(axis=1) / np.maximum(disc.sum(axis=1), 1)
    top = np.argsort(-on.sum(axis=1) * share, kind="stable")[:3]
    out = []
    for i in top:
        covered = _coverage(local[on[i]] - centres[i], axes[i])
        # Sampling noise of few points must not look like a full circle.
        score = covered**2 * share[i] * min(1.0, on[i].sum() / 25.0)
        out.append(Circle(centres[i], axes[i], float(radius[i]), covered, float(score)))
    return out


def _circles_through(
    triples: Float[np.ndarray, "H 3 3"],
) -> tuple[Float[np.ndarray, "K 3"], Float[np.ndarray, "K 3"], Float[np.ndarray, "K"]]:
    """Centre, axis and radius of the circle through each triple that is not nearly straight."""
    u, v = triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0]
    normal = np.cross(u, v)
    square = (normal**2).sum(axis=1)
    good = square > 1e-8
    u, v, normal, square = u[good], v[good], normal[good], square[good]
    uu, vv = (u**2).sum(axis=1)[:, None], (v**2).sum(axis=1)[:, None]
    to_centre = (uu * np.cross(v, normal) + vv * np.cross(normal, u)) / (2.0 * square[:, None])
    return triples[good, 0] + to_centre, normal / np.sqrt(square)[:, None], np.linalg.norm(to_centre, axis=1)


def _coverage(offset: Float[np.ndarray, "K 3"], axis: Float[np.ndarray, "3"]) -> float:
    helper = np.eye(3)[np.argmin(np.abs(axis))]
    first = np.cross(helper, axis)
    first /= np.linalg.norm(first)
    angle = np.arctan2(offset @ np.cross(axis, first), offset @ first)
    return len(np.unique(np.floor(angle / (2 * np.pi) * _BINS))) / _BINS


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
