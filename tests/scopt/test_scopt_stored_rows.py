"""Sparse arrays of known parts are scipy's own."""

import numpy as np
import pytest
from scipy import sparse

from scopt.affine import AffineRows, store_columns, store_rows
from scopt.convex_model import _sort_columns


@pytest.mark.parametrize("kind", ["rows", "columns"])
def test_a_stored_array_is_the_one_that_scipy_makes(kind):
    store, make = (store_rows, sparse.csr_array) if kind == "rows" else (store_columns, sparse.csc_array)
    for seed in range(5):
        wanted = make(sparse.random_array((7, 9), density=0.3, rng=np.random.default_rng(seed)))
        parts = wanted.data, wanted.indices, wanted.indptr
        made = store(parts, wanted.shape)
        assert type(made) is type(wanted)
        np.testing.assert_array_equal(made.toarray(), wanted.toarray())
        np.testing.assert_array_equal((made.T @ made).toarray(), (wanted.T @ wanted).toarray())
        np.testing.assert_array_equal(made[2:5].toarray(), wanted[2:5].toarray())
        assert made.nnz == wanted.nnz


def test_arrays_of_one_shape_are_apart():
    first = store_rows((np.ones(1), np.zeros(1, dtype=np.int32), np.array([0, 1, 1], dtype=np.int32)), (2, 3))
    second = store_rows((np.full(1, 2.0), np.ones(1, dtype=np.int32), np.array([0, 0, 1], dtype=np.int32)), (2, 3))
    np.testing.assert_array_equal(first.toarray(), [[1, 0, 0], [0, 0, 0]])
    np.testing.assert_array_equal(second.toarray(), [[0, 0, 0], [0, 2, 0]])
    assert store_rows((np.zeros(0), np.zeros(0, dtype=np.int32), np.zeros(3, dtype=np.int32)), (2, 3)).nnz == 0


def test_parts_with_two_types_of_indices_get_one():
    made = store_columns((np.ones(1), np.zeros(1, dtype=np.int64), np.array([0, 1, 1, 1], dtype=np.int32)), (2, 3))
    assert made.indices.dtype == made.indptr.dtype
    np.testing.assert_array_equal((made @ np.ones(3)), [1.0, 0.0])


def test_a_mask_selects_the_rows_that_scipy_selects():
    for seed in range(5):
        rng = np.random.default_rng(seed)
        jacobian = sparse.csr_array(sparse.random_array((7, 9), density=0.3, rng=rng))
        these = rng.random(7) < 0.5
        chosen = AffineRows(np.arange(7.0), jacobian).select_rows(these)
        np.testing.assert_array_equal(chosen.jacobian.toarray(), jacobian.toarray()[these])
        np.testing.assert_array_equal(chosen.value, np.flatnonzero(these))


def test_columns_are_sorted_and_entries_at_one_place_added():
    row, column = np.array([2, 0, 2, 1]), np.array([1, 3, 1, 1])
    for kept in ([0, 1, 3], [0, 1, 2, 3]):
        made = _sort_columns(np.arange(1.0, 5.0)[kept], row[kept], column[kept], (3, 5))
        wanted = sparse.csc_array((np.arange(1.0, 5.0)[kept], (row[kept], column[kept])), shape=(3, 5))
        np.testing.assert_array_equal(made.toarray(), wanted.toarray())
        assert made.has_sorted_indices


def test_rows_are_scaled_with_their_values():
    jacobian = sparse.csr_array(sparse.random_array((4, 9), density=0.5, rng=np.random.default_rng(1)))
    factors = np.array([0.0, -1.0, 2.0, 0.5])
    scaled = AffineRows(np.arange(4.0), jacobian).scale_rows(factors)
    np.testing.assert_array_equal(scaled.value, [0.0, -1.0, 4.0, 1.5])
    np.testing.assert_array_equal(scaled.jacobian.toarray(), factors[:, None] * jacobian.toarray())
