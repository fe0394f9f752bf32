"""Extents along fixed directions: exact for every set, and apart only where the sets are."""

import numpy as np
from convex_distance import signed_distance
from hypothesis import given, settings
from hypothesis import strategies as st

from costs.collision.slabs import DIRECTIONS, find_slabs, find_slabs_of_sets


def test_directions_are_unit_vectors_and_none_is_another_s():
    np.testing.assert_allclose(np.linalg.norm(DIRECTIONS, axis=1), 1.0, atol=1e-15)
    products = np.abs(DIRECTIONS @ DIRECTIONS.T) - np.eye(len(DIRECTIONS))
    assert products.max() < 0.9


def test_a_cube_reaches_its_half_diagonals():
    cube = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
    low, high = find_slabs(cube)
    np.testing.assert_allclose(high, [np.sqrt(2.0)] * 6 + [np.sqrt(3.0)] * 4)
    np.testing.assert_allclose(low, -high)


def test_sets_of_different_sizes_have_their_own_extents():
    rng = np.random.default_rng(0)
    sets = [rng.normal(size=(count, 3)) for count in (1, 8, 3)]
    low, high = find_slabs_of_sets(sets)
    for row, points in enumerate(sets):
        np.testing.assert_allclose(low[row], (points @ DIRECTIONS.T).min(axis=0), atol=1e-14)
        np.testing.assert_allclose(high[row], (points @ DIRECTIONS.T).max(axis=0), atol=1e-14)
    assert find_slabs_of_sets([])[0].shape == (0, len(DIRECTIONS))


@settings(max_examples=30)
@given(seed=st.integers(0, 100_000))
def test_the_gap_of_extents_is_at_most_the_distance(seed):
    rng = np.random.default_rng(seed)
    sets = [rng.normal(size=(8, 3)), rng.normal(size=(8, 3)) + rng.uniform(-4.0, 4.0, 3)]
    low, high = find_slabs_of_sets(sets)
    gap = float(np.maximum(low[0] - high[1], low[1] - high[0]).max())
    assert gap <= signed_distance(*sets) + 1e-6
