"""How a value is quoted in an error: its beginning, however much of it there is."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import pytest

from service.errors import shown


class _Unread:
    """What nobody looks at."""

    def __repr__(self) -> str:
        raise AssertionError("it was read")


def _as_dict(values: Sequence[object]) -> object:
    return dict(enumerate(values))


def _within(values: Sequence[object]) -> object:
    return [1, list(values)]


@pytest.mark.parametrize("made", [list, tuple, _as_dict, _within])
def test_of_a_long_value_only_the_beginning_is_read(made: Callable[[Sequence[object]], object]) -> None:
    assert shown(made([0] * 100 + [_Unread()])) == f"{made([0] * 100)!r:.59}…"


def test_what_is_short_is_shown_whole() -> None:
    for value in ("a b", [1, (2, "x")], {"k": [None, True]}, b"q", 1.5, ()):
        assert shown(value) == repr(value)
