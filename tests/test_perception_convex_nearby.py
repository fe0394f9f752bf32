"""Points near some others."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from perception.convex.smooth import measure_spacing, select_nearby, smooth_points


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.01, 1.0), st.integers(1, 20))
def test_all_points_near_the_chosen_ones_are_told(seed: int, reach: float, n_chosen: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.uniform(-2.0, 2.0, (500, 3))
    chosen = rng.choice(len(points), n_chosen, replace=False)
    told = select_nearby(points, chosen, reach)
    is_near = cKDTree(points[chosen]).query(points)[0] <= reach
    assert set(np.flatnonzero(is_near)) <= set(told)
    assert (np.diff(told) > 0).all()


def test_of_a_large_cloud_few_points_are_told() -> None:
    points = np.random.default_rng(1).uniform(-2.0, 2.0, (5000, 3))
    assert len(select_nearby(points, np.array([7]), 0.1)) < 50


def test_a_few_points_come_out_as_when_all_are_asked_for() -> None:
    rng = np.random.default_rng(2)
    points = np.column_stack([rng.uniform(1.0, 3.0, 6000), rng.uniform(-1.0, 1.0, (6000, 2))])
    points[:4000, 0] = 2.5 + rng.normal(0.0, 0.01, 4000)
    counts, starts = rng.integers(1, 5, 6000), np.zeros((6000, 3))
    chosen = rng.choice(6000, 200, replace=False)
    everyone = np.arange(6000)
    np.testing.assert_array_equal(
        smooth_points(points, counts, starts, chosen), smooth_points(points, counts, starts, everyone)[chosen]
    )
    np.testing.assert_array_equal(
        measure_spacing(points, starts, chosen), measure_spacing(points, starts, everyone)[chosen]
    )
