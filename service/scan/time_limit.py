"""A limit for the time of a command: what is at work when it is over ends at its next poll."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

from costs.stopping import Stopped, poll, stops_when
from service.errors import ServiceError


class TimeOver(Exception):  # noqa: N818 - how a command ends early, not an error
    """The time is over; raised by ``limit_time`` once the work in its body has stopped."""


class OutOfTimeError(ServiceError):
    """A command whose time was over before it had anything to show."""


@contextmanager
def limit_time(seconds: float | None) -> Iterator[None]:
    """Stop the body at its next poll once so much time has gone; None: as long as it takes.

    Raises:
        TimeOver: the time was over.
        Stopped: whatever surrounds the body asks to stop, too.
    """
    if seconds is None:
        yield
        return
    end = time.monotonic() + seconds
    try:
        with stops_when(lambda: time.monotonic() >= end):
            yield
    except Stopped:
        poll()
        raise TimeOver from None
