"""Warnings about the message of a call, which its handler may add to the reply."""

from __future__ import annotations

from contextvars import ContextVar

_WARNINGS: ContextVar[tuple[str, ...]] = ContextVar("warnings", default=())


def set_warnings(warnings: tuple[str, ...]) -> None:
    """Set the warnings of the call that this task answers."""
    _WARNINGS.set(warnings)


def current_warnings() -> tuple[str, ...]:
    """Return the warnings of the call that this task answers."""
    return _WARNINGS.get()
