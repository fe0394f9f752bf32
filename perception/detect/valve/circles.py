"""Hypotheses of circles in a cloud: random triples near one another, scored by who lies on their circle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from costs.stopping import poll
from perception.detect.shared.slim import slim_places
from perception.detect.shared.vectors import cross
from perception.detect.valve.circle_fit import Agreement, Circles, agreement, refitted, scores

# Radius [m], points and triples looked at, at every how many places: in a larger ball a rim has a smaller share, but
# there are more places on a larger rim.
_BALLS = ((0.2, 200, 50, 1), (0.36, 250, 80, 1), (0.6, 400, 100, 2), (0.85, 500, 120, 2))
_REFITTED, _SAME_AXIS = 150, 0.9
_SLIM_BALL = 0.045  # [m]


@dataclass(frozen=True)
class Circle:
    """A circle and how well points agree with it.

    Attributes:
        centre: (3,) [m].
        axis: (3,) unit.
        radius: [m].
        coverage: share of its 24 sectors with a point on it.
        score: its square times the share of the points in its disc that lie on it.
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
    n_seeds: int = 200,
    most: int = 60,
) -> list[Circle]:
    """The best circles, best first, no two about the same place.

    Args:
        points: (N, 3) downsampled, without walls and floor [m].
        rng: for the triples.
        radii: smallest and largest [m].
        n_seeds: places to look at, with balls of several sizes.
        most: how many to return.
    """
    if len(points) < 12:
        return []
    found: list[Circle] = []
    for i, seed in enumerate(_seeds(points, rng, n_seeds)):
        poll()
        square = ((points - points[seed]) ** 2).sum(axis=1)
        for ball, n_points, n_triples, every in _BALLS:
            near = np.flatnonzero(square <= ball**2)
            if i % every == 0 and len(near) >= 12:
                local = points[rng.permutation(near)[:n_points]]
                found += _best_in(local, points[seed], rng, (radii[0], min(radii[1], 0.6 * ball)), n_triples)
    found.sort(key=lambda circle: -circle.score)
    found = _sharpened(_distinct(found, _REFITTED, 0.15, _SAME_AXIS), points, radii)
    found.sort(key=lambda circle: -circle.score)
    return _distinct(found, most)


def _seeds(points: Float[np.ndarray, "N 3"], rng: np.random.Generator, most: int) -> Int[np.ndarray, "S"]:
    """Where to look: half of the places anywhere, half where points spread along one direction, as those of a rim do.

    Among many other things a rim has few of all places, but a good part of the slim ones.
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
    """The best circles through a seed and two of the points in a ball about it, if any.

    Among many other things, two more points on the rim that a seed lies on are drawn sooner than three.
    """
    poll()
    pairs = local[rng.integers(len(local), size=(n_triples, 2))]
    circles = _circles_through(np.concatenate([np.broadcast_to(seed, (n_triples, 1, 3)), pairs], axis=1))
    circles = circles.selected((circles.radii >= radii[0]) & (circles.radii <= radii[1]))
    if not len(circles):
        return []
    agreed = agreement(local, circles)
    top = np.argsort(-agreed.count * agreed.share, kind="stable")[:3]
    return _scored(local, circles.selected(top), agreed.selected(top))


def _sharpened(found: list[Circle], points: Float[np.ndarray, "N 3"], radii: tuple[float, float]) -> list[Circle]:
    """Refitted to all points, those that stay within the radii."""
    if not found:
        return []
    centres, axes = np.stack([one.centre for one in found]), np.stack([one.axis for one in found])
    circles = Circles(centres, axes, np.array([one.radius for one in found]))
    for _ in range(2):
        circles = refitted(points, circles, agreement(points, circles))
    circles = circles.selected((circles.radii >= radii[0]) & (circles.radii <= radii[1]))
    return _scored(points, circles, agreement(points, circles))


def _scored(points: Float[np.ndarray, "N 3"], circles: Circles, agreed: Agreement) -> list[Circle]:
    covered, score = scores(points, circles, agreed)
    return [
        Circle(circles.centres[i], circles.axes[i], float(circles.radii[i]), float(covered[i]), float(score[i]))
        for i in range(len(circles))
    ]


def _circles_through(triples: Float[np.ndarray, "H 3 3"]) -> Circles:
    """The circle through each triple that is not nearly straight."""
    u, v = triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0]
    normal = cross(u, v)
    square = (normal**2).sum(axis=1)
    good = square > 1e-8
    u, v, normal, square = u[good], v[good], normal[good], square[good]
    uu, vv = (u**2).sum(axis=1)[:, None], (v**2).sum(axis=1)[:, None]
    to_centre = (uu * cross(v, normal) + vv * cross(normal, u)) / (2.0 * square[:, None])
    radii = np.sqrt((to_centre**2).sum(axis=1))
    return Circles(triples[good, 0] + to_centre, normal / np.sqrt(square)[:, None], radii)


def _distinct(circles: list[Circle], most: int, apart: float = 0.3, least_cosine: float = -1.0) -> list[Circle]:
    """The first of those about the same place: of much the same centre, radius and axis.

    Args:
        circles: best first.
        most: how many to return.
        apart: centres further apart than this are not the same place, as a share of the larger radius; neither are
            radii whose ratio differs from one by nearly twice that.
        least_cosine: between axes that are taken for the same.
    """
    centres, axes = np.array([one.centre for one in circles]), np.array([one.axis for one in circles])
    radii = np.array([one.radius for one in circles])
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
