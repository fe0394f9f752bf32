"""The floor: found where it is, at all its levels, and not claimed where there is none."""

from __future__ import annotations

import numpy as np
import pytest

from perception import Reach, find_floor, floor_piece, on_floor


def floor_points(slope_deg: float, height: float, rng: np.random.Generator, n: int = 6000) -> np.ndarray:
    """A noisy floor that rises along x, seen in a 4 m square."""
    xy = rng.uniform(-2, 2, (n, 2))
    z = height + np.tan(np.radians(slope_deg)) * xy[:, 0] + rng.normal(0, 0.008, n)
    return np.column_stack([xy, z])


@pytest.mark.parametrize("slope_deg", [0.0, 2.0, 4.5])
@pytest.mark.parametrize("height", [0.0, -0.3])
def test_the_floor_is_found_though_a_table_holds_more_points(slope_deg: float, height: float) -> None:
    rng = np.random.default_rng(2)
    table = np.column_stack([rng.uniform(0.5, 1.5, 9000), rng.uniform(-0.5, 0.5, 9000), rng.normal(0.75, 0.008, 9000)])
    wall = np.column_stack([np.full(5000, 1.8), rng.uniform(-2, 2, 5000), rng.uniform(height, 2, 5000)])
    floor = find_floor(np.concatenate([floor_points(slope_deg, height, rng), table, wall]))
    assert floor is not None
    tilt = np.radians(slope_deg)
    angle = np.degrees(np.arccos(min(1.0, float(floor.normal @ [-np.sin(tilt), 0, np.cos(tilt)]))))
    assert angle < 0.2
    assert abs(floor.height(np.zeros((1, 2)))[0] - height) < 0.003


def test_no_floor_is_claimed_where_there_is_none() -> None:
    rng = np.random.default_rng(3)
    wall = np.column_stack([np.full(5000, 1.5), rng.uniform(-2, 2, 5000), rng.uniform(0, 2, 5000)])
    assert find_floor(wall) is None
    assert find_floor(np.concatenate([wall, wall[:, [1, 0, 2]], rng.uniform(0, 2, (3000, 3))])) is None
    assert find_floor(floor_points(20.0, 0.0, rng)) is None
    assert find_floor(np.zeros((0, 3))) is None


def test_a_table_with_things_under_it_is_no_floor() -> None:
    rng = np.random.default_rng(6)
    table = np.column_stack([rng.uniform(0.5, 1.5, 9000), rng.uniform(-0.5, 0.5, 9000), rng.normal(0.75, 0.008, 9000)])
    legs = np.column_stack([rng.choice([0.5, 1.5], 800), rng.choice([-0.5, 0.5], 800), rng.uniform(0.0, 0.7, 800)])
    assert find_floor(np.concatenate([table, legs])) is None


def test_what_lies_three_centimetres_over_the_floor_under_a_sole_is_floor() -> None:
    floor = find_floor(floor_points(0.0, 0.0, np.random.default_rng(4)))
    assert floor is not None
    sole = np.array([[-0.1, -0.05, 0], [0.1, -0.05, 0], [0.1, 0.05, 0], [-0.1, 0.05, 0]])[[2, 0, 3, 1]]
    points = np.array(
        [[0, 0, 0.028], [0.3, 0, 0.028], [0, 0, 0.04], [0.3, 0, 0.01], [0, 0, -0.2], [0.09, 0.049, 0.028]]
    )
    assert on_floor(points, floor, [sole]).tolist() == [True, False, False, True, True, True]
    assert on_floor(points, floor).tolist() == [False, False, False, True, True, False]


def test_the_floor_piece_lies_under_the_plane_and_reaches_beyond_the_reach() -> None:
    floor = find_floor(floor_points(3.0, 0.1, np.random.default_rng(5)))
    assert floor is not None
    piece = floor_piece(floor, Reach(x=0.5, radius=2.0))
    above = floor.above(piece.vertices)
    assert above.max() < 1e-9
    assert (above > -0.21).all()
    assert piece.lower[0] == -2.5
    assert piece.upper[0] == 3.5
    assert piece.name == piece.kind == "floor"
