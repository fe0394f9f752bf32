"""Stopping long work: loops poll whether to go on, and an ordinary exception ends them where they poll.

Nothing is ever raised from a signal handler, which could leave native threads with memory that is freed under them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar


class Stopped(Exception):  # noqa: N818 - how work ends early, not an error
    """The work was asked to stop; raised by ``poll`` alone."""


def never() -> bool:
    """Nobody asks to stop."""
    return False


_SHOULD_STOP: ContextVar[Callable[[], bool]] = ContextVar("should_stop", default=never)


@contextmanager
def stops_when(should_stop: Callable[[], bool]) -> Iterator[None]:
    """Have ``poll`` raise in the body once ``should_stop`` is true, or what surrounds the body asks to stop.

    Args:
        should_stop: cheap; asked by the thread of the body alone.
    """
    outer = _SHOULD_STOP.get()
    token = _SHOULD_STOP.set(should_stop if outer is never else lambda: should_stop() or outer())
    try:
        yield
    finally:
        _SHOULD_STOP.reset(token)


def poll() -> None:
    """Call this in every loop, at least every 100 ms; without ``stops_when`` it does nothing.

    Raises:
        Stopped: the work was asked to stop.
    """
    if _SHOULD_STOP.get()():
        raise Stopped("stopped as asked")


def is_stopped() -> bool:
    """Whether the next ``poll`` raises, for those who have something to end first."""
    return _SHOULD_STOP.get()()
