"""Errors of the service, and quoting of values in their messages."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from costs.names import would_do as would_do  # loads no library, so that clients may have it

MAX_PROBLEMS = 10  # most problems in one message
MAX_VALUE_CHARACTERS = 60
_MOST_BITS = 1024  # longer integers are shown in hexadecimals


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


class ResultError(ServiceError):
    """A result folder that cannot be written or read."""


class DamagedResultError(ResultError):
    """A result whose parts contradict each other, or its request: it was changed after it was written."""


class ExecutionError(ServiceError):
    """A plan, a robot or settings that cannot be executed; the message names field, value and reason."""


def shown(value: object) -> str:
    """Quote a value, cut to one short line."""
    text = " ".join(repr(_beginning(value, iter(range(1, MAX_VALUE_CHARACTERS)))).split())
    return text if len(text) <= MAX_VALUE_CHARACTERS else text[: MAX_VALUE_CHARACTERS - 1] + "…"


def _beginning(value: object, entries: Iterator[int]) -> object:
    """Return the part of a value that is shown, since ``repr`` of millions of bytes takes long."""
    if type(value) in (str, bytes):
        return value[: 4 * MAX_VALUE_CHARACTERS]  # type: ignore[index]
    if type(value) in (list, tuple):
        some = [_beginning(entry, entries) for entry, _ in zip(value, entries, strict=False)]  # type: ignore[call-overload]
        return some if type(value) is list else tuple(some)
    if type(value) is dict:
        return {key: _beginning(entry, entries) for (key, entry), _ in zip(value.items(), entries, strict=False)}
    if type(value) is int and value.bit_length() > _MOST_BITS:  # Python refuses to write it in decimals
        return _Hexadecimal(value)
    return value


class _Hexadecimal:
    """An integer too long for decimals."""

    def __init__(self, value: int) -> None:
        self._text = hex(value)

    def __repr__(self) -> str:
        return self._text
