"""Fits of an object that begin where one of its parts was found: a lever with its pipe where the lever is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from perception.detect.engine.refine import Hypotheses, rate_ends
from perception.detect.engine.search import LED, Fit, Site, drop_same, search
from perception.detect.engine.template import Template
from perception.sightlines import SightIndex

_SCREENED = 120  # hypotheses left after a look at the points alone
_POINTS_OF_ALL = 200
_SAME_MIDDLE, _SAME_WAY, _MOST_PARTS = 0.03, 0.97, 3  # [m], cosine


def extend_parts(
    template: Template, parts: Sequence[Hypotheses], points: Float[np.ndarray, "N 3"], index: SightIndex
) -> list[Fit]:
    """Return fits of whole objects about the best distinct parts, best first.

    Args:
        parts: fits of the template's part, best first.
        points: (N, 3) of the scan, thinned evenly [m].
    """
    # Each part gets answers of its own: a pipe taken for a lever would have more rays than a slim lever.
    sites = [_extend(template, one, points) for one in _drop_turned(parts)]
    fits = drop_same([fit for site in sites for fit in search(template, [site], index, effort=LED)])
    return sorted(fits, key=lambda fit: -fit.gain)


def _drop_turned(parts: Sequence[Hypotheses]) -> list[Hypotheses]:
    """Return bars along their x axis, best first, without those that a better one repeats, whichever way it points."""
    kept: list[tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"], Hypotheses]] = []
    for one in parts:
        x = one.rotation[0][:, 0]
        middle = one.place[0] + 0.5 * one.sizes[0, 0] * x
        if all(np.linalg.norm(middle - other) > _SAME_MIDDLE or abs(x @ way) < _SAME_WAY for other, way, _ in kept):
            kept.append((middle, x, one))
    return [one for _, _, one in kept[:_MOST_PARTS]]


def _extend(template: Template, part: Hypotheses, points: Float[np.ndarray, "N 3"]) -> Site:
    """Return a site with hypotheses of an object about its fitted part: held at either end, turned about its x axis."""
    starts = template.starts
    assert starts is not None
    sizes = np.repeat(starts.sizes, 2 * starts.n_spins, axis=0)
    n = len(sizes)
    names = [size.name for size in template.sizes]
    length, first, second = part.sizes[0]
    tail = sizes[:, names.index("tail")]
    angles = np.tile(np.repeat(spread_angles(starts.n_spins), 2), len(starts.sizes))
    # A quarter of a turn swaps the sides of the section; between, both are alike.
    swap = np.sin(angles) ** 2
    sizes[:, 0], sizes[:, 1] = length - tail, first + swap * (second - first)
    sizes[:, 2] = second + swap * (first - second)
    is_back = np.arange(n) % 2 == 1
    frame = part.rotation[0] @ np.where(is_back[:, None, None], np.diag([-1.0, -1.0, 1.0]), np.eye(3))
    rotation = frame @ Rotation.from_rotvec(np.outer(angles, [1.0, 0.0, 0.0])).as_matrix()
    along = np.where(is_back, length - tail, tail)
    place = part.place[0] + along[:, None] * part.rotation[0][:, 0]
    begun = Hypotheses.of(rotation, place, template.clip(sizes), np.array([0.0, 0.0, 1.0]))
    middle = part.place[0] + 0.5 * length * part.rotation[0][:, 0]
    near = points[np.linalg.norm(points - middle, axis=1) < template.radius + 0.5 * length]
    rating = rate_ends(template, begun, near[:: max(1, len(near) // _POINTS_OF_ALL)])
    return Site(middle, None, begun.select(np.argsort(-rating, kind="stable")[:_SCREENED]))


def spread_angles(n: int) -> Float[np.ndarray, "n"]:
    """Return n angles that divide a turn evenly [rad]."""
    return np.arange(n) * (2.0 * np.pi / n)
