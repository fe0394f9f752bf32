"""Sparse arrays of parts that are known to fit: scipy's constructors check them, which takes long for small ones."""

from __future__ import annotations

import copy
from functools import lru_cache
from typing import TypeVar

import numpy as np
from jaxtyping import Float, Int
from scipy import sparse

Compressed = TypeVar("Compressed", sparse.csr_array, sparse.csc_array)
Parts = tuple[Float[np.ndarray, "E"], Int[np.ndarray, "E"], Int[np.ndarray, "L"]]
"""Entries, their indices along the other axis, and where each row (CSR) or column (CSC) begins among them."""


def store_rows(parts: Parts, shape: tuple[int, int]) -> sparse.csr_array:
    """Return the array of these parts, which are not copied."""
    return _fill(_make_empty_rows(*shape), parts)


def store_columns(parts: Parts, shape: tuple[int, int]) -> sparse.csc_array:
    """Return the array of these parts, which are not copied."""
    return _fill(_make_empty_columns(*shape), parts)


def _fill(empty: Compressed, parts: Parts) -> Compressed:
    data, indices, indptr = parts
    if indices.dtype != indptr.dtype:  # scipy's loops need one type
        return type(empty)(parts, shape=empty.shape)
    made = copy.copy(empty)
    made.data, made.indices, made.indptr = data, indices, indptr
    return made


@lru_cache(maxsize=1024)
def _make_empty_rows(n_rows: int, n_columns: int) -> sparse.csr_array:
    return sparse.csr_array((n_rows, n_columns))


@lru_cache(maxsize=1024)
def _make_empty_columns(n_rows: int, n_columns: int) -> sparse.csc_array:
    return sparse.csc_array((n_rows, n_columns))
