"""Noise averaged along the rays, points near others, and hulls without air between the points of a scan line."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from perception.convex.coarse import measure_spacing, select_nearby, smooth_points
from perception.convex.pieces import make_pieces

EYE = np.array([0.1, 0.0, 1.6])
NOISE = 0.01


def seen(true: np.ndarray, rng: np.random.Generator, start: np.ndarray = EYE) -> np.ndarray:
    """The places with noise along their rays."""
    away = true - start
    length = np.linalg.norm(away, axis=1, keepdims=True)
    return np.asarray(true + away / length * rng.normal(0.0, NOISE, (len(true), 1)))


def slanted(rng: np.random.Generator, n: int = 3000) -> tuple[np.ndarray, np.ndarray]:
    """Places on a wall that stands at 60 degrees to the rays, and its normal."""
    normal = np.array([np.cos(np.pi / 3), np.sin(np.pi / 3), 0.0])
    across = np.array([-normal[1], normal[0], 0.0])
    flat = rng.uniform(-0.2, 0.2, (n, 2))
    return np.array([1.1, 0.0, 1.5]) + flat[:, :1] * across + flat[:, 1:] * np.array([0.0, 0.0, 1.0]), normal


def moved(points: np.ndarray, start: np.ndarray = EYE) -> np.ndarray:
    every = np.arange(len(points))
    return smooth_points(points, np.ones(len(points), dtype=np.int64), np.broadcast_to(start, points.shape), every)


def test_noise_of_a_slanted_wall_is_less_than_half_after_smoothing() -> None:
    rng = np.random.default_rng(0)
    true, normal = slanted(rng)
    noisy = seen(true, rng)
    off = (moved(noisy) - true) @ normal
    assert np.std(off) < 0.5 * np.std((noisy - true) @ normal)
    assert abs(np.mean(off)) < 0.0005
    # Its rim is as straight as its midst: depth is fitted with its slope.
    rim = np.abs(true[:, 2] - 1.5) > 0.19
    assert abs(np.mean(off[rim])) < 0.0015


def test_points_move_along_their_rays_only() -> None:
    rng = np.random.default_rng(1)
    noisy = seen(slanted(rng)[0], rng)
    before, after = noisy - EYE, moved(noisy) - EYE
    assert np.abs(np.cross(before, after)).max() < 1e-12


def test_what_lies_a_hand_behind_does_not_draw_points_to_it() -> None:
    rng = np.random.default_rng(2)
    yz = rng.uniform(-0.1, 0.1, (2000, 2)) + np.array([0.0, 1.6])
    depth = np.where(yz[:, 0] > 0.0, 1.0, 1.1)
    after = moved(seen(np.column_stack([depth, yz]), rng))
    assert np.abs(after[:, 0] - depth).max() < 0.03


def test_rays_from_elsewhere_bear_no_witness() -> None:
    rng = np.random.default_rng(3)
    one, other = slanted(rng, 500)[0], slanted(rng, 500)[0]
    there = EYE + np.array([0.0, 3.0, 0.0])
    points = np.concatenate([seen(one, rng), seen(other, rng, there)])
    starts = np.repeat([EYE, there], 500, axis=0)
    together = smooth_points(points, np.ones(1000, dtype=np.int64), starts, np.arange(1000))
    np.testing.assert_allclose(together[:500], moved(points[:500]), atol=1e-9)
    np.testing.assert_allclose(together[500:], moved(points[500:], there), atol=1e-9)
    few = smooth_points(points, np.ones(1000, dtype=np.int64), starts, np.array([3, 700]))
    np.testing.assert_allclose(few, together[[3, 700]], atol=1e-12)


def test_a_scan_line_round_a_corner_leaves_the_air_before_it_free() -> None:
    # One line of a scanner along a wall and round the corner of the room to the next.
    along = np.arange(0.0, 1.2, 0.01)
    ahead = np.column_stack([np.full(len(along), 1.5), 1.2 - along, np.zeros(len(along))])
    aside = np.column_stack([1.5 - along, np.full(len(along), 1.2), np.zeros(len(along))])
    line = np.concatenate([ahead, aside])
    line[:, 2] = 1.6 + 0.5 * line[:, 1]
    start = np.array([0.1, 0.0, 1.6])
    made = make_pieces(line, start, (start, line))
    air = start + 0.85 * (line - start)
    assert made.pieces
    assert not any(piece.hull.is_within(air, 0.0).any() for piece in made.pieces)
    assert np.any([piece.hull.is_within(line, 0.005) for piece in made.pieces], axis=0).all()


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.01, 1.0), st.integers(1, 20))
def test_all_points_near_the_chosen_ones_are_selected(seed: int, reach: float, n_chosen: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.uniform(-2.0, 2.0, (500, 3))
    chosen = rng.choice(len(points), n_chosen, replace=False)
    selected = select_nearby(points, chosen, reach)
    is_near = cKDTree(points[chosen]).query(points)[0] <= reach
    assert set(np.flatnonzero(is_near)) <= set(selected)
    assert (np.diff(selected) > 0).all()


def test_of_a_large_cloud_few_points_are_selected() -> None:
    points = np.random.default_rng(1).uniform(-2.0, 2.0, (5000, 3))
    assert len(select_nearby(points, np.array([7]), 0.1)) < 50


def test_a_few_points_are_moved_as_when_all_are_moved() -> None:
    rng = np.random.default_rng(2)
    points = np.column_stack([rng.uniform(1.0, 3.0, 6000), rng.uniform(-1.0, 1.0, (6000, 2))])
    points[:4000, 0] = 2.5 + rng.normal(0.0, 0.01, 4000)
    counts, starts = rng.integers(1, 5, 6000), np.zeros((6000, 3))
    chosen = rng.choice(6000, 200, replace=False)
    every = np.arange(6000)
    np.testing.assert_array_equal(
        smooth_points(points, counts, starts, chosen), smooth_points(points, counts, starts, every)[chosen]
    )
    np.testing.assert_array_equal(
        measure_spacing(points, starts, chosen), measure_spacing(points, starts, every)[chosen]
    )
