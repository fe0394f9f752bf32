"""Progress of long work: steps say how much of them is done, and the caller is told with the time left."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

# A step that takes less says only its name [s]; longer ones tell every further tenth, or so often [s].
_LONG_S = 1.0
_OFTEN_S = 5.0
_FURTHER = 0.1


class _Teller:
    """Current step, when it began, and what was last said of it."""

    def __init__(self, on_step: Callable[[str], None], clock: Callable[[], float]) -> None:
        self._on_step, self._clock = on_step, clock
        self._step, self._began, self._said, self._said_at = "", 0.0, 0.0, 0.0

    def tell(self, step: str, share: float) -> None:
        now = self._clock()
        if step != self._step or share < self._said:
            is_new = step != self._step
            self._step, self._began, self._said, self._said_at = step, now, 0.0, now
            if is_new:
                self._on_step(step)
            return
        spent = now - self._began
        is_due = share >= self._said + _FURTHER or now >= self._said_at + _OFTEN_S
        if spent < _LONG_S or not is_due or share <= 0.0:
            return
        self._said, self._said_at = share, now
        left = spent * (1.0 - share) / share
        self._on_step(f"{step} {100.0 * share:.0f} %, about {max(left, 1.0):.0f} s left")


_TELLER: ContextVar[_Teller | None] = ContextVar("teller", default=None)


@contextmanager
def tells_progress(on_step: Callable[[str], None], clock: Callable[[], float] = time.monotonic) -> Iterator[None]:
    """Tell ``on_step`` the steps of the body: the name of each, and of longer ones their share and the time left.

    Args:
        clock: seconds; for tests.
    """
    token = _TELLER.set(_Teller(on_step, clock))
    try:
        yield
    finally:
        _TELLER.reset(token)


def tell(step: str, share: float = 0.0) -> None:
    """Say that a step has begun, or that a share of it is done; without ``tells_progress`` it does nothing."""
    teller = _TELLER.get()
    if teller is not None:
        teller.tell(step, share)
