"""Random placed hulls, also touching, inside each other and degenerate: the compiled library against coal."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from costs.native import HullSet

KINDS = ("solid", "box", "flat", "segment", "point", "sliver")


def draw_hull(rng: np.random.Generator) -> Float[np.ndarray, "V 3"]:
    """Draw vertices of one of ``KINDS``, of 1 mm to 1 m."""
    kind, size = KINDS[rng.integers(len(KINDS))], 10.0 ** rng.uniform(-3.0, 0.0)
    points = rng.uniform(-1.0, 1.0, size=(int(rng.integers(4, 60)), 3))
    if kind == "box":
        points = np.stack(np.meshgrid([-1.0, 1.0], [-1.0, 1.0], [-1.0, 1.0]), axis=-1).reshape(-1, 3)
        points = points * rng.uniform(0.1, 1.0, 3)
    elif kind == "flat":
        points[:, 2] = 0.0
    elif kind == "segment":
        points[:, 1:] = 0.0
    elif kind == "point":
        points = points[:1]
    elif kind == "sliver":
        points[:, 2] *= 1e-6
    return np.asarray(points * size)


def draw_pairs(
    rng: np.random.Generator, count: int
) -> tuple[HullSet, Float[np.ndarray, "R 3 3"], Float[np.ndarray, "R 3"]]:
    """Draw hulls 2 k and 2 k + 1 of each pair, and rotation and translation of the first in the second's frame.

    A third of them are placed so that two faces or corners meet within rounding.
    """
    hulls, rotation, translation = [], np.empty((count, 3, 3)), np.empty((count, 3))
    for row in range(count):
        mover, holder = draw_hull(rng), draw_hull(rng)
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0] if rng.random() < 0.7 else np.eye(3)
        turn *= np.sign(np.linalg.det(turn))
        way = rng.normal(size=3) if rng.random() < 0.7 else np.eye(3)[rng.integers(3)]
        way /= np.linalg.norm(way)
        touch = (holder @ way).max() - (mover @ turn.T @ way).min()
        reach = np.linalg.norm(mover, axis=1).max() + np.linalg.norm(holder, axis=1).max()
        beyond = 0.0 if rng.random() < 0.3 else rng.uniform(-0.3, 0.6) * reach
        hulls += [mover, holder]
        rotation[row], translation[row] = turn, (touch + beyond) * way
    return HullSet.of(hulls), rotation, translation


def hull(hulls: HullSet, number: int) -> Float[np.ndarray, "V 3"]:
    """Return the points of a hull."""
    return hulls.points[hulls.first[number] : hulls.first[number + 1]]


def compare_with_coal(rng: np.random.Generator, count: int) -> tuple[int, int, list[str]]:
    """Compare ``count`` pairs; return how many the library answered and left, and what disagrees with coal.

    A distance that is answered has to be that of coal within its resolution, bounded from below by its own direction,
    and what is left has to be near.
    """
    from costs.native import find_library
    from service.verify import DistanceQuery, make_coal_convex

    library = find_library()
    assert library is not None
    hulls, rotation, translation = draw_pairs(rng, count)
    mover = np.arange(0, 2 * count, 2)
    distance, direction, is_left = hulls.measure_pairs(library, mover, mover + 1, rotation, translation)
    known, _ = DistanceQuery().closest(
        [make_coal_convex(hull(hulls, k)) for k in mover.tolist()],
        rotation,
        translation,
        [make_coal_convex(hull(hulls, k + 1)) for k in mover.tolist()],
    )
    faults = []
    for row, number in enumerate(mover.tolist()):
        if is_left[row]:
            if known[row] > 2e-6:
                faults.append(f"row {row}: left, but {known[row]:.3g} m apart")
            continue
        moved = hull(hulls, number) @ rotation[row].T + translation[row]
        least = (hull(hulls, number + 1) @ direction[row]).min() - (moved @ direction[row]).max()
        if abs(least - distance[row]) > 2e-7:
            faults.append(f"row {row}: {distance[row]:.9g} m, separated by {least:.9g} m")
        if distance[row] > known[row] + 1e-6 or known[row] > distance[row] + 2e-6 + 1e-5 * distance[row]:
            faults.append(f"row {row}: {distance[row]:.9g} m, by coal {known[row]:.9g} m")
    return int(count - is_left.sum()), int(is_left.sum()), faults
