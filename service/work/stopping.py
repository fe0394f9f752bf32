"""Cancellation of a job's work by its ``Control``."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from costs.stopping import Stopped, stops_when
from service.executor import Control
from service.executor.errors import JobCancelled


@contextmanager
def stops_with(control: Control) -> Iterator[None]:
    """Stop the body at its next poll once the job is cancelled.

    Raises:
        JobCancelled: the body was stopped.
    """
    try:
        with stops_when(control.should_stop):
            yield
    except Stopped:
        raise JobCancelled("stopped on request") from None
