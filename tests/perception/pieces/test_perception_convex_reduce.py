"""Whole scenes get fewer pieces: small ones are merged while they hold little free space."""

from __future__ import annotations

import numpy as np

from perception.convex.body import Body
from perception.convex.freespace import FreeSpace
from perception.convex.hulls import make_hull
from perception.convex.reduce import reduce_bodies

CORNERS = np.array([[x, y, z] for x in (0.0, 0.05) for y in (0.0, 0.05) for z in (0.0, 0.05)])


def _row(n: int, gap: float) -> list[Body]:
    return [Body("clutter", CORNERS + np.array([i * (0.05 + gap), 0.0, 0.0]), None) for i in range(n)]


def _space(is_free: bool) -> FreeSpace:
    return FreeSpace(np.array([-0.1, -0.1, -0.1]), 0.02, np.full((120, 20, 20), is_free))


def test_few_bodies_stay_as_they_are() -> None:
    bodies = _row(5, 0.01)
    assert reduce_bodies(bodies, _space(False), most=5) == bodies


def test_bodies_are_merged_down_to_the_number_and_cover_what_they_covered() -> None:
    bodies = _row(12, 0.01)
    reduced = reduce_bodies(bodies, _space(False), most=6)
    assert len(reduced) == 6
    corners = np.concatenate([body.vertices for body in bodies])
    inside = np.any([make_hull(body.vertices).is_within(corners, 1e-6) for body in reduced], axis=0)
    assert inside.all()


def test_bodies_with_free_space_between_them_stay_apart() -> None:
    free = np.zeros((120, 20, 20), dtype=bool)
    cells = np.arange(120) * 0.02 - 0.09
    free[(cells % 0.11 > 0.055) & (cells > 0.0), :, :] = True
    apart = reduce_bodies(_row(12, 0.06), FreeSpace(np.array([-0.1, -0.1, -0.1]), 0.02, free), most=3)
    assert len(apart) > 6
