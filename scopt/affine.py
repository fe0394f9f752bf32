"""Affine rows over all waypoints, the first-order model of a residual."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeVar

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import sparse

Compressed = TypeVar("Compressed", sparse.csr_array, sparse.csc_array)
Made = TypeVar("Made", sparse.csr_array, sparse.csc_array, sparse.csc_matrix)
Parts = tuple[Float[np.ndarray, "E"], Int[np.ndarray, "E"], Int[np.ndarray, "L"]]
"""Entries, their indices along the other axis, and where each row (CSR) or column (CSC) begins among them."""


@dataclass(frozen=True)
class AffineRows:
    """``value + jacobian @ dx``, the first-order model of a residual around one iterate.

    Attributes:
        value: (m,) residual at the iterate.
        jacobian: (m, N) sparse, ``N = T * n`` variables in waypoint order.
    """

    value: Float[np.ndarray, "m"]
    jacobian: sparse.csr_array

    def at(self, dx: Float[np.ndarray, "N"]) -> Float[np.ndarray, "m"]:
        """Return the model's value after a step ``dx``."""
        return np.asarray(self.value + self.jacobian @ dx)

    def slice_rows(self, start: int, stop: int) -> AffineRows:
        """Return the rows ``start`` to ``stop - 1``."""
        jacobian = self.jacobian
        first, last = int(jacobian.indptr[start]), int(jacobian.indptr[stop])
        stored = jacobian.data[first:last], jacobian.indices[first:last], jacobian.indptr[start : stop + 1] - first
        return AffineRows(self.value[start:stop], store_rows(stored, (stop - start, jacobian.shape[1])))

    def select_rows(self, these: Bool[np.ndarray, "m"]) -> AffineRows:
        """Return the rows that a mask chooses, in their order."""
        jacobian, counts = self.jacobian, np.diff(self.jacobian.indptr)
        indptr = np.zeros(int(np.count_nonzero(these)) + 1, dtype=jacobian.indptr.dtype)
        np.cumsum(counts[these], out=indptr[1:])
        stored = np.repeat(these, counts)
        parts = jacobian.data[stored], jacobian.indices[stored], indptr
        return AffineRows(self.value[these], store_rows(parts, (len(indptr) - 1, jacobian.shape[1])))

    def scale_rows(self, factors: Float[np.ndarray, "m"]) -> AffineRows:
        """Return each row times its factor."""
        jacobian = self.jacobian
        parts = jacobian.data * np.repeat(factors, np.diff(jacobian.indptr)), jacobian.indices, jacobian.indptr
        return AffineRows(self.value * factors, store_rows(parts, jacobian.shape))

    @staticmethod
    def empty(n_variables: int) -> AffineRows:
        """Return no rows."""
        return AffineRows(np.zeros(0), _make_empty_rows(0, n_variables))

    @staticmethod
    def stack(parts: Sequence[AffineRows]) -> AffineRows:
        """Return the rows of all parts in their order."""
        if len(parts) == 1:
            return parts[0]
        jacobians = [part.jacobian for part in parts]
        stored = np.cumsum([0, *(jacobian.nnz for jacobian in jacobians)])
        ends = [j.indptr[1:] + offset for j, offset in zip(jacobians, stored[:-1].tolist(), strict=True)]
        indptr = np.concatenate([jacobians[0].indptr[:1], *ends])
        indices = np.concatenate([jacobian.indices for jacobian in jacobians])
        data = np.concatenate([jacobian.data for jacobian in jacobians])
        shape = (len(indptr) - 1, jacobians[0].shape[1])
        value = np.concatenate([part.value for part in parts])
        return AffineRows(value, store_rows((data, indices, indptr), shape))

    @staticmethod
    def from_blocks(
        value: Float[np.ndarray, "m"],
        first: Int[np.ndarray, "m"],
        blocks: Float[np.ndarray, "m k n"],
        n_waypoints: int,
    ) -> AffineRows:
        """Make rows that each touch ``k`` consecutive waypoints; exact zeros are not stored.

        Args:
            value: (m,) residual.
            first: (m,) index of the first waypoint a row touches.
            blocks: (m, k, n) derivative with respect to those waypoints.
            n_waypoints: T.
        """
        m, k, n = blocks.shape
        dense = blocks.reshape(m, k * n)
        is_stored = dense != 0.0
        counts = is_stored.sum(axis=1)
        indptr = np.zeros(m + 1, dtype=np.int32)
        np.cumsum(counts, out=indptr[1:])
        at = np.flatnonzero(is_stored)
        # An entry at column c of row r stands at k n r + c here, and in column n first + c of the Jacobian.
        indices = (at + np.repeat(n * np.asarray(first) - k * n * np.arange(m), counts)).astype(np.int32)
        jacobian = store_rows((dense.ravel()[at], indices, indptr), (m, n_waypoints * n))
        return AffineRows(np.asarray(value, dtype=float), jacobian)


@dataclass(frozen=True)
class WeightedRows:
    """Affine rows, each with its weight in the merit."""

    rows: AffineRows
    weight: Float[np.ndarray, "m"]

    @staticmethod
    def stack(parts: Sequence[WeightedRows], n_variables: int) -> WeightedRows:
        """Return the rows of all parts in their order."""
        nonempty = [part for part in parts if len(part.weight)]
        if not nonempty:
            return WeightedRows(AffineRows.empty(n_variables), np.zeros(0))
        if len(nonempty) == 1:
            return nonempty[0]
        return WeightedRows(AffineRows.stack([p.rows for p in nonempty]), np.concatenate([p.weight for p in nonempty]))


def store_rows(parts: Parts, shape: tuple[int, int]) -> sparse.csr_array:
    """Return the array of parts that are known to fit, which are not copied.

    scipy's own constructors check them, which takes longer than the use of most arrays here.
    """
    return _fill(_make_empty_rows(*shape), parts)


def store_columns(parts: Parts, shape: tuple[int, int]) -> sparse.csc_array:
    """Return the same, column by column."""
    return _fill(_make_empty_columns(*shape), parts)


def store_matrix(columns: sparse.csc_array) -> sparse.csc_matrix:
    """Return the same entries, not copied, as the type that some solvers expect."""
    made = _copy(_make_empty_matrix(*columns.shape))
    made.data, made.indices, made.indptr = columns.data, columns.indices, columns.indptr
    return made


def _fill(empty: Compressed, parts: Parts) -> Compressed:
    data, indices, indptr = parts
    if indices.dtype != indptr.dtype:  # scipy's loops need one type
        return type(empty)(parts, shape=empty.shape)
    made = _copy(empty)
    made.data, made.indices, made.indptr = data, indices, indptr
    return made


def _copy(empty: Made) -> Made:
    """Return ``copy.copy`` of an array without entries, in a tenth of its time."""
    made = object.__new__(type(empty))
    made.__dict__.update(empty.__dict__)
    return made


@lru_cache(maxsize=1024)
def _make_empty_rows(n_rows: int, n_columns: int) -> sparse.csr_array:
    return sparse.csr_array((n_rows, n_columns))


@lru_cache(maxsize=1024)
def _make_empty_columns(n_rows: int, n_columns: int) -> sparse.csc_array:
    return sparse.csc_array((n_rows, n_columns))


@lru_cache(maxsize=1024)
def _make_empty_matrix(n_rows: int, n_columns: int) -> sparse.csc_matrix:
    return sparse.csc_matrix((n_rows, n_columns))
