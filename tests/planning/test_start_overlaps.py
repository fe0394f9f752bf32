"""Overlaps at one pose: exactly the pairs whose hulls meet by another distance, however the bodies are turned."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hull_reference import hull_distance
from small_robots import CUBE, box

from costs.robot import RobotModel, load_robot
from costs.scene import ConvexPiece, Scene
from service.start.overlaps import find_overlaps
from service.start.standing import place_bodies
from service.verify.ground import GROUND_TOLERANCE_M

FEET = ("l_foot", "r_foot")


@pytest.fixture(scope="module")
def atlas() -> RobotModel:
    return load_robot("atlas")


@pytest.mark.parametrize("seed", range(4))
def test_overlaps_are_the_pairs_whose_hulls_meet(atlas: RobotModel, seed: int) -> None:
    rng = np.random.default_rng(seed)
    q = atlas.postures["stand"].copy()
    q[3:] += rng.normal(size=atlas.n - 3) * 0.4
    centres = rng.uniform([-0.6, -0.6, 0.2], [0.6, 0.6, 1.8], size=(16, 3))
    pieces = tuple(box(f"piece{k}", tuple(c), tuple(rng.uniform(0.02, 0.2, 3))) for k, c in enumerate(centres))
    placed = place_bodies(atlas, q)
    met = {
        (body.link, piece.name)
        for body, points in placed
        for piece in pieces
        if hull_distance(points, piece.vertices) < 1e-6
    }
    for (one, points), (other, others) in combinations(placed, 2):
        pair = (min(one.link, other.link), max(one.link, other.link))
        is_checked = one.joint != other.joint and pair not in atlas.ignored_pairs
        if is_checked and hull_distance(points, others) < 1e-6:
            met.add(pair)
    found = find_overlaps(atlas, q, Scene(pieces), FEET)
    assert {(o.link, o.other) if o.kind else (min(o.link, o.other), max(o.link, o.other)) for o in found} == met
    assert met
    depths = [o.depth for o in found]
    assert depths == sorted(depths, reverse=True)


def test_a_planted_foot_may_stand_in_what_carries_it_and_nothing_else_may(atlas: RobotModel) -> None:
    q = atlas.postures["stand"]
    lowest = min(points[:, 2].min() for _, points in place_bodies(atlas, q))

    def floor(depth: float, kind: str) -> Scene:
        return Scene((ConvexPiece("ground", CUBE * [3.0, 3.0, 0.1] + [0.0, 0.0, lowest + depth - 0.1], kind),))

    assert find_overlaps(atlas, q, floor(GROUND_TOLERANCE_M - 1e-3, "floor"), FEET) == []
    assert {o.link for o in find_overlaps(atlas, q, floor(GROUND_TOLERANCE_M - 1e-3, "floor"), FEET[:1])} == {"r_foot"}
    assert find_overlaps(atlas, q, floor(GROUND_TOLERANCE_M - 1e-3, "table"), FEET) == []
    assert {o.link for o in find_overlaps(atlas, q, floor(GROUND_TOLERANCE_M - 1e-3, "unknown"), FEET)} == set(FEET)
    (deep, _) = find_overlaps(atlas, q, floor(GROUND_TOLERANCE_M + 1e-3, "floor"), FEET)
    assert deep.depth == pytest.approx(GROUND_TOLERANCE_M + 1e-3, abs=1e-6)
