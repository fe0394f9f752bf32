"""Stopwatch for the steps of a computation."""

from __future__ import annotations

import time


class Clock:
    """Time per step [s]; a step ends when the next begins."""

    def __init__(self) -> None:
        self.timings: dict[str, float] = {}
        self._since = time.perf_counter()

    def lap(self, step: str) -> None:
        """Add the time since the previous lap to the step's total [s]."""
        now = time.perf_counter()
        self.timings[step] = self.timings.get(step, 0.0) + now - self._since
        self._since = now
