"""A limit for the time of a command: what is at work when it is over is interrupted."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from service.errors import ServiceError


class TimeOver(BaseException):
    """The time is over; raised wherever the main thread is at work, and no error, which a library might catch."""


class OutOfTimeError(ServiceError):
    """A command whose time was over before it had anything to show."""


@contextmanager
def at_most(seconds: float | None) -> Iterator[None]:
    """Raise ``TimeOver`` in the body once so much time has gone; None: as long as it takes.

    Only in the main thread, where alone a signal can interrupt what is at work.
    """
    if seconds is None or threading.current_thread() is not threading.main_thread():
        yield
        return

    def end(signum: int, frame: FrameType | None) -> None:
        raise TimeOver

    earlier = signal.signal(signal.SIGALRM, end)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, earlier)
