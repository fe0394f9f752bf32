"""How the work of a job ends when its control says so."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from costs.stopping import Stopped, stops_when
from service.executor import Control
from service.executor.errors import JobCancelled


@contextmanager
def stops_with(control: Control) -> Iterator[None]:
    """Have the body end at its next poll once the job is to stop.

    Raises:
        JobCancelled: it did.
    """
    try:
        with stops_when(control.should_stop):
            yield
    except Stopped:
        raise JobCancelled("stopped as asked") from None
