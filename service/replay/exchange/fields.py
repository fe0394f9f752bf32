"""Fields of messages and files: what is taken from them, and the names of those that nobody took."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from service.errors import RequestError, shown

LISTED = 8  # names in a note
MAX_DEPTH = 12
LARGEST = 1e6  # of coordinates and their rates [m, rad; per s]


class TakenFields:
    """A mapping that remembers what was taken from it."""

    def __init__(self, body: Mapping[str, Any]) -> None:
        self._body = body
        self._taken: set[str] = set()

    def take(self, *keys: str) -> Any:
        """Return the value of the first of several keys that holds something; None if none does."""
        for key in keys:
            value = self._body.get(key)
            if not is_empty(value):
                self._taken.add(key)
                return value
        return None

    def skip(self, *keys: str) -> None:
        """Pass over keys that have no meaning here."""
        self._taken.update(keys)

    def list_rest(self) -> list[str]:
        """Return the keys that nobody took and that hold something other than zeros."""
        return [str(key) for key, value in self._body.items() if key not in self._taken and not is_blank(value)]


def is_empty(value: object) -> bool:
    """Return whether a value holds nothing: None, or a list without entries."""
    return value is None or (isinstance(value, list | tuple | np.ndarray) and len(value) == 0 and np.ndim(value) > 0)


def is_blank(value: object, depth: int = 0) -> bool:
    """Return whether a value says nothing: empty, zero, false, or only made of such values, as in an unused message."""
    if depth > MAX_DEPTH:
        return False
    if isinstance(value, Mapping):
        return all(is_blank(inner, depth + 1) for inner in value.values())
    if isinstance(value, np.ndarray):
        return not value.size or (value.dtype.kind in "biuf" and not np.any(value))
    if isinstance(value, list | tuple):
        return all(is_blank(inner, depth + 1) for inner in value)
    return value is None or value is False or value == "" or (isinstance(value, int | float) and value == 0)


def note_rest(names: Sequence[str]) -> Iterator[str]:
    """Yield a note on fields that are read past."""
    rest = list(dict.fromkeys(names))
    if rest:
        more = f" and {len(rest) - LISTED} more" if len(rest) > LISTED else ""
        yield f"not read: {', '.join(shown(name) for name in rest[:LISTED])}{more}"


def stack_rows(rows: list[Any], width: int, field: str, source: str) -> np.ndarray | None:
    """Return rows of numbers as an array; None where no row holds anything.

    Raises:
        RequestError: a row is missing, has another length, or holds something else.
    """
    if all(row is None for row in rows):
        return None
    for index, row in enumerate(rows):
        if isinstance(row, np.ndarray):
            row = rows[index] = row.tolist() if row.ndim == 1 else row
        if not isinstance(row, list | tuple) or len(row) != width:
            held = f"{len(row)} numbers" if isinstance(row, list | tuple) else "none" if row is None else shown(row)
            raise RequestError(f"{source}: point {index} has {held} as {field}; expected {width}, one per joint")
    return np.array([[to_number(value, field, source) for value in row] for row in rows], dtype=float)


def to_number(value: object, field: str, source: str) -> float:
    """Return a number (RequestError where it is none)."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise RequestError(f"{source}: {field} holds {shown(value)}; a number is needed")
    try:
        return float(value)
    except OverflowError:
        raise RequestError(f"{source}: {field} holds a number beyond all limits") from None


def to_coordinate(value: object, field: str, source: str) -> float:
    """Return a finite number of a plausible size for a place, an angle or a speed (RequestError where it is none)."""
    number = to_number(value, field, source)
    if not abs(number) <= LARGEST:
        raise RequestError(f"{source}: {field} is {number:g}; expected at most {LARGEST:g}")
    return number


def to_list(value: object, field: str, source: str) -> list[Any]:
    """Return a list or an array as a list, empty for None (RequestError where it is neither)."""
    if not isinstance(value, list | tuple | np.ndarray | None):
        raise RequestError(f"{source}: {field} is {shown(value)}; expected a list")
    return [] if value is None else list(value)


def read_stamps(stamps: list[Any], source: str) -> np.ndarray | None:
    """Return times in seconds: numbers, or seconds and nanoseconds as ROS 1 and ROS 2 name them."""
    if all(stamp is None for stamp in stamps):
        return None
    return np.array([_read_stamp(stamp, row, source) for row, stamp in enumerate(stamps)], dtype=float)


def _read_stamp(stamp: Any, row: int, source: str) -> float:
    if isinstance(stamp, Mapping):
        whole = stamp.get("sec", stamp.get("secs"))
        part = stamp.get("nanosec", stamp.get("nsecs", 0))
        if whole is not None:
            return to_number(whole, "time_from_start", source) + 1e-9 * to_number(part, "time_from_start", source)
    if stamp is None or isinstance(stamp, Mapping):
        raise RequestError(f"{source}: point {row} has no time; expected seconds, or sec and nanosec")
    return to_number(stamp, "time", source)
