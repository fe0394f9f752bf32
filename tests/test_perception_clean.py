"""Cleaning: reach, voxels, outliers, the floor and the robot's own points."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from perception import (
    PerceptionError,
    Reach,
    find_floor,
    floor_piece,
    inliers,
    inside_hulls,
    on_floor,
    voxel_downsample,
)

CUBE = np.array([[x, y, z] for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (-0.1, 0.1)])


def floor_points(slope_deg: float, height: float, rng: np.random.Generator, n: int = 6000) -> np.ndarray:
    """A noisy floor that rises along x, seen in a 4 m square."""
    xy = rng.uniform(-2, 2, (n, 2))
    z = height + np.tan(np.radians(slope_deg)) * xy[:, 0] + rng.normal(0, 0.008, n)
    return np.column_stack([xy, z])


def test_reach_is_a_cylinder_with_lids() -> None:
    reach = Reach(x=1.0, radius=2.0, top=2.0, bottom=-0.1)
    points = np.array([[2.9, 0, 0], [3.1, 0, 0], [1, 1.9, 1.9], [1, 0, 2.1], [1, 0, -0.2]])
    assert reach.contains(points).tolist() == [True, False, True, False, False]
    with pytest.raises(PerceptionError, match="radius"):
        Reach(radius=0.0)
    with pytest.raises(PerceptionError, match=r"reach\.top"):
        Reach(top=-1.0)


@given(st.integers(1, 300), st.floats(0.02, 0.5), st.integers(0, 9))
def test_every_point_lies_within_a_voxel_of_its_mean_and_none_is_lost(n: int, size: float, seed: int) -> None:
    points = np.random.default_rng(seed).uniform(-1, 1, (n, 3))
    means, counts = voxel_downsample(points, size)
    assert counts.sum() == n
    np.testing.assert_allclose(counts @ means, points.sum(axis=0), atol=1e-9)
    nearest = np.linalg.norm(points[:, None] - means, axis=2).min(axis=1)
    assert nearest.max() <= np.sqrt(3) * size


def test_outliers_are_judged_by_a_radius_that_grows_with_range() -> None:
    rng = np.random.default_rng(0)
    near = rng.uniform(-0.04, 0.04, (80, 3)) + np.array([1, 0, 0])
    far = rng.uniform(-0.2, 0.2, (60, 3)) + np.array([8, 0, 0])
    stray = np.array([[1.5, 0.5, 0.0], [4.0, 1.0, 0.0]])
    keep = inliers(np.concatenate([near, far, stray]), np.zeros(3))
    assert keep[:80].all()
    assert keep[80:140].mean() > 0.9
    assert not keep[140:].any()
    # The far cluster's spacing, near by, is no cluster.
    assert not inliers(far - np.array([7, 0, 0]), np.zeros(3)).all()


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


@given(st.integers(0, 30))
def test_robot_points_are_those_within_the_margin_of_a_hull(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.3, 0.3, (400, 3))
    distance = np.linalg.norm(np.maximum(np.abs(points) - 0.1, 0.0), axis=1)
    own = inside_hulls(points, [CUBE + np.array([2, 0, 0]), CUBE], margin=0.025)
    assert own[distance <= 0.025 - 1e-9].all()
    assert not own[distance > 0.025 * np.sqrt(3) + 1e-9].any()


def test_without_hulls_no_point_is_the_robots() -> None:
    assert not inside_hulls(np.zeros((5, 3)), []).any()


def test_a_flat_hull_is_refused() -> None:
    with pytest.raises(PerceptionError, match="spans no volume"):
        inside_hulls(np.zeros((5, 3)), [CUBE * [1, 1, 0]])
