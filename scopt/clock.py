"""Clocks that time limits are measured with."""

from __future__ import annotations

import time
from collections.abc import Callable

Clock = Callable[[], float]
"""Seconds since some moment; only differences count."""

WALL_SHARE = 0.1  # effort per second of wall time, at least: a process that waits for others ends as well


class EffortClock:
    """Processor time of this process since the clock was made, or a share of the wall time if that is more.

    A limit measured with it does not depend on what else the machine does, unless it slows the process down by more
    than the share.

    Attributes:
        wall_share: 0 to 1.
    """

    def __init__(self, wall_share: float = WALL_SHARE) -> None:
        self.wall_share = wall_share
        self._cpu, self._wall = time.process_time(), time.monotonic()

    def __call__(self) -> float:
        """Return the effort so far [s]."""
        return max(time.process_time() - self._cpu, self.wall_share * (time.monotonic() - self._wall))
