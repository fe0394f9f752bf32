"""Affine rows: the model of a residual over all waypoints."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy import sparse

from scopt import AffineRows


def test_rows_are_evaluated_at_a_step():
    rows = AffineRows(np.array([1.0, -2.0]), sparse.csr_array(np.array([[1.0, 0.0, 2.0], [0.0, 0.0, 3.0]])))
    np.testing.assert_array_equal(rows.at(np.zeros(3)), rows.value)
    np.testing.assert_allclose(rows.at(np.array([1.0, 5.0, -1.0])), [0.0, -5.0])


@given(seed=st.integers(0, 10_000))
def test_blocks_stand_at_the_waypoints_they_touch(seed):
    rng = np.random.default_rng(seed)
    n_waypoints, n, k, m = 6, int(rng.integers(1, 5)), int(rng.integers(1, 4)), int(rng.integers(0, 9))
    first = rng.integers(0, n_waypoints - k + 1, m)
    blocks = rng.normal(size=(m, k, n)) * (rng.random((m, k, n)) < 0.6)
    value = rng.normal(size=m)
    rows = AffineRows.from_blocks(value, first, blocks, n_waypoints)
    expected = np.zeros((m, n_waypoints, n))
    for row in range(m):
        expected[row, first[row] : first[row] + k] = blocks[row]
    np.testing.assert_array_equal(rows.jacobian.toarray(), expected.reshape(m, n_waypoints * n))
    np.testing.assert_array_equal(rows.value, value)
    assert rows.jacobian.nnz == np.count_nonzero(blocks)  # exact zeros take no room in the program
    assert rows.jacobian.has_sorted_indices


def test_no_rows_are_still_rows_of_all_variables():
    empty = AffineRows.empty(12)
    assert empty.at(np.ones(12)).shape == (0,)
    assert empty.jacobian.shape == (0, 12)
    blocks = AffineRows.from_blocks(np.zeros(0), np.zeros(0, dtype=int), np.zeros((0, 2, 4)), 3)
    assert blocks.jacobian.shape == (0, 12)


def test_stacked_rows_keep_their_order():
    rng = np.random.default_rng(1)
    parts = [AffineRows(rng.normal(size=m), sparse.csr_array(rng.normal(size=(m, 4)))) for m in (2, 0, 3)]
    parts.insert(1, AffineRows.empty(4))
    stacked = AffineRows.stack(parts)
    dx = rng.normal(size=4)
    np.testing.assert_allclose(stacked.at(dx), np.concatenate([part.at(dx) for part in parts]))
