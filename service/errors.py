"""Errors of the service: what is wrong with what a user asked."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from costs.names import would_do as would_do  # loads no library, so that clients may have it

MAX_PROBLEMS = 10  # a file of garbage need not be listed to its end
MAX_VALUE_CHARACTERS = 60
_MOST_BITS = 1024  # an integer of more is shown in hexadecimals


class ServiceError(Exception):
    """Base of all errors raised by ``service``."""


class RequestError(ServiceError):
    """A request, or a file it names, that cannot be used.

    Attributes:
        problems: one line each, naming the field, the value and what is expected.
    """

    def __init__(self, problems: str | Sequence[str]) -> None:
        lines = (problems,) if isinstance(problems, str) else tuple(problems)
        self.problems = tuple(" ".join(line.split()) for line in lines)
        more = len(self.problems) - MAX_PROBLEMS
        super().__init__("\n".join([*self.problems[:MAX_PROBLEMS], *([f"and {more} more"] if more > 0 else [])]))


class UnplannedTaskError(RequestError):
    """A request for a task that is understood, and that nothing here can plan yet."""


class ResultError(ServiceError):
    """A result folder that cannot be written or read."""


def shown(value: object) -> str:
    """``value`` as a person would quote it, cut to one short line."""
    text = " ".join(repr(_beginning(value, iter(range(1, MAX_VALUE_CHARACTERS)))).split())
    return text if len(text) <= MAX_VALUE_CHARACTERS else text[: MAX_VALUE_CHARACTERS - 1] + "…"


def _beginning(value: object, entries: Iterator[int]) -> object:
    """As much of a value as is shown: all of a message's millions of bytes would be read for one line."""
    if type(value) in (str, bytes):
        return value[: 4 * MAX_VALUE_CHARACTERS]  # type: ignore[index]
    if type(value) in (list, tuple):
        some = [_beginning(one, entries) for one, _ in zip(value, entries, strict=False)]  # type: ignore[call-overload]
        return some if type(value) is list else tuple(some)
    if type(value) is dict:
        return {key: _beginning(one, entries) for (key, one), _ in zip(value.items(), entries, strict=False)}
    if type(value) is int and value.bit_length() > _MOST_BITS:  # Python refuses to write it in decimals
        return _Hexadecimal(value)
    return value


class _Hexadecimal:
    """An integer too long for decimals."""

    def __init__(self, value: int) -> None:
        self._text = hex(value)

    def __repr__(self) -> str:
        return self._text
