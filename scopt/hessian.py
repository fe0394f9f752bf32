"""Hessian of the squared rows, of which the part whose Jacobian stays the same is summed once in a solve."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from jaxtyping import Bool
from scipy import sparse

from scopt.affine import WeightedRows, store_columns, store_rows

_KEPT = 16  # products: of some shapes of solves


@dataclass
class HessianSum:
    """Sum of ``2 J^T W J`` over squared terms, in the free step variables of one solve.

    Terms of joint positions have one Jacobian for the whole solve: what they add is kept from iterate to iterate.

    Attributes:
        is_free: (N,) which step variables are in the program.
    """

    is_free: Bool[np.ndarray, "N"]
    _kept: list[WeightedRows] = field(default_factory=list)
    _sum_of_kept: sparse.csc_array = field(default_factory=lambda: sparse.csc_array((0, 0)))
    _last: list[WeightedRows] = field(default_factory=list)

    def of(self, parts: Sequence[WeightedRows]) -> sparse.csc_array:
        """Return the sum for the terms at one iterate, with sorted indices."""
        same = [part for part in parts if _is_among(part, self._last)]
        others = [part for part in parts if not _is_among(part, self._last)]
        self._last = list(parts)
        if not same:
            return self._make(others)
        if len(same) != len(self._kept) or not all(_is_among(part, self._kept) for part in same):
            self._kept, self._sum_of_kept = same, self._make(same)
        return self._sum_of_kept if not others else sparse.csc_array(self._sum_of_kept + self._make(others))

    def _make(self, parts: Sequence[WeightedRows]) -> sparse.csc_array:
        return make_hessian(WeightedRows.stack(parts, len(self.is_free)), self.is_free)


def make_hessian(squared: WeightedRows, is_free: Bool[np.ndarray, "N"]) -> sparse.csc_array:
    """Return ``2 J^T W J`` of squared rows in the free variables, with sorted indices."""
    jacobian = squared.rows.jacobian
    counts, stays = np.diff(jacobian.indptr), is_free[jacobian.indices]
    column = np.cumsum(is_free, dtype=np.int32) - 1
    of_row = np.repeat(np.arange(len(counts), dtype=np.int32), counts)[stays]
    indptr = np.searchsorted(of_row, np.arange(len(counts) + 1)).astype(np.int32)
    parts = jacobian.data[stays], column[jacobian.indices[stays]].astype(np.int32), indptr
    weight = 2.0 * squared.weight[of_row] * parts[0]
    return _square(int(np.count_nonzero(is_free)), *(part.tobytes() for part in (weight, *parts)))


@lru_cache(maxsize=_KEPT)
def _square(n_columns: int, weighted: bytes, data: bytes, indices: bytes, indptr: bytes) -> sparse.csc_array:
    """Return ``J^T (W J)``, read-only, of the entries of J and of W J, which stand at the same places of rows.

    The terms of joint positions are the same in all solves of a shape: equal entries give the same object.
    """
    at = np.frombuffer(indices, dtype=np.int32), np.frombuffer(indptr, dtype=np.int32)
    n_rows = len(at[1]) - 1
    transposed = store_columns((np.frombuffer(data), *at), (n_columns, n_rows))
    product = sparse.csc_array(transposed @ store_rows((np.frombuffer(weighted), *at), (n_rows, n_columns)))
    product.sort_indices()
    for part in (product.data, product.indices, product.indptr):
        part.flags.writeable = False
    return product


def _is_among(part: WeightedRows, others: Sequence[WeightedRows]) -> bool:
    """Return whether another part has the same Jacobian and weights, so that it adds the same."""
    return any(
        other.rows.jacobian is part.rows.jacobian and np.array_equal(other.weight, part.weight) for other in others
    )
