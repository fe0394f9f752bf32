"""Seals of rows: what they are the hash of, and which rows have different ones."""

from __future__ import annotations

import hashlib
from typing import Any

import pytest

from service.store.seals import compute_seal


def test_a_seal_is_the_hash_of_the_row_before_and_of_names_types_lengths_and_values_in_alphabetical_order() -> None:
    # worked out by hand: stores on disk are read with this rule
    written = b"before\na int 1 7\nb bytes 3 x\ny\nc str 4 'do'\nd NoneType 4 None"
    row = {"c": "do", "b": b"x\ny", "d": None, "a": 7, "number": 5, "seal": "old"}
    assert compute_seal(row, "before") == hashlib.sha256(written).hexdigest()


@pytest.mark.parametrize(
    ("row", "other"),
    [
        ({"a": 1}, {"a": b"1"}),
        ({"a": 1}, {"b": 1}),
        ({"a": None}, {"a": b"None"}),
        ({"a": b"x", "b": b"y"}, {"a": b"x\nb bytes y"}),
        ({"a": b"x", "b": b"y"}, {"a": b"x\nb bytes 1 y"}),
        ({"a": b"", "b": b"x"}, {"a": b"x", "b": b""}),
    ],
)
def test_rows_that_differ_have_different_seals(row: dict[str, Any], other: dict[str, Any]) -> None:
    assert compute_seal(row) != compute_seal(other)


def test_a_seal_ties_a_row_to_the_one_before_and_not_to_its_number() -> None:
    assert compute_seal({"a": 1}, "one") != compute_seal({"a": 1}, "two")
    assert compute_seal({"a": 1, "number": 1}, "one") == compute_seal({"a": 1, "number": 2}, "one")
