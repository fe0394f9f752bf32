"""The Hessian of squared rows, part by part and kept from iterate to iterate."""

import numpy as np
from scipy import sparse

from scopt import AffineRows
from scopt.affine import WeightedRows
from scopt.hessian import HessianSum, make_hessian

N = 12


def rows_of(rng, count):
    jacobian = sparse.random_array((count, N), density=0.3, format="csr", rng=rng)
    return AffineRows(rng.normal(size=count), sparse.csr_array(jacobian))


def test_the_sum_is_that_of_all_rows_whichever_parts_stay():
    rng = np.random.default_rng(0)
    is_free = rng.random(N) < 0.7
    hessians = HessianSum(is_free)
    still, often = (WeightedRows(rows_of(rng, 7), rng.uniform(1.0, 3.0, 7)) for _ in range(2))
    # kept, kept beside another part, alone, with another weight, gone
    heavier = WeightedRows(still.rows, 2.0 * still.weight)
    for parts in ((still, often), (still, often), (still,), (still,), (heavier,), (heavier,), (heavier, often), ()):
        moving = WeightedRows(rows_of(rng, 5), np.ones(5))
        for others in ((moving,), ()):
            given = [*parts, *others]
            expected = sum((2.0 * p.rows.jacobian.T @ np.diag(p.weight) @ p.rows.jacobian for p in given), 0.0)
            expected = np.zeros((N, N)) if not given else expected
            found = hessians.of(given)
            np.testing.assert_allclose(found.toarray(), expected[np.ix_(is_free, is_free)], atol=1e-12)
            assert found.has_sorted_indices


def test_the_sum_of_stacked_rows_is_the_same():
    rng = np.random.default_rng(1)
    parts = [WeightedRows(rows_of(rng, 4), rng.uniform(1.0, 2.0, 4)) for _ in range(3)]
    together = make_hessian(WeightedRows.stack(parts, N), np.ones(N, dtype=bool))
    np.testing.assert_allclose(together.toarray(), HessianSum(np.ones(N, dtype=bool)).of(parts).toarray(), atol=1e-12)


def test_hessian_of_some_variables_is_that_part_of_the_whole():
    rng = np.random.default_rng(4)
    rows = AffineRows(np.zeros(20), sparse.csr_array(sparse.random_array((20, N), density=0.2, rng=rng)))
    squared = WeightedRows(rows, rng.uniform(0.5, 2.0, 20))
    is_free = rng.random(N) < 0.6
    J = rows.jacobian.toarray()
    whole = 2.0 * J.T @ (squared.weight[:, None] * J)
    np.testing.assert_allclose(make_hessian(squared, is_free).toarray(), whole[np.ix_(is_free, is_free)], atol=1e-14)
