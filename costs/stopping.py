"""Cancellation of long work: loops poll, and an ordinary exception ends them where they poll.

Nothing is raised from a signal handler, which could free memory that native threads still use.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar


class Stopped(Exception):  # noqa: N818 - how work ends early, not an error
    """A request to stop the work; raised by ``poll`` alone."""


def never() -> bool:
    """Return False: the work is not to stop."""
    return False


_SHOULD_STOP: ContextVar[Callable[[], bool]] = ContextVar("should_stop", default=never)


@contextmanager
def stops_when(should_stop: Callable[[], bool]) -> Iterator[None]:
    """Make ``poll`` raise in the body once ``should_stop``, or that of a surrounding ``stops_when``, returns True.

    Args:
        should_stop: cheap; called by the thread of the body alone.
    """
    outer = _SHOULD_STOP.get()
    if should_stop is never or outer is never:
        both = outer if should_stop is never else should_stop
    else:
        both = lambda: should_stop() or outer()  # noqa: E731
    token = _SHOULD_STOP.set(both)
    try:
        yield
    finally:
        _SHOULD_STOP.reset(token)


def poll() -> None:
    """Call this in every loop, at least every 100 ms; without ``stops_when`` it does nothing.

    Raises:
        Stopped: the work is to stop.
    """
    if _SHOULD_STOP.get()():
        raise Stopped("stopped on request")


def is_stopped() -> bool:
    """Return whether the next ``poll`` raises, for callers that must clean up first."""
    return _SHOULD_STOP.get()()
