"""Clocks that tests control."""

from __future__ import annotations


class CountingClock:
    """Clock that every reading advances by the same step: equal computations take equal times on it."""

    def __init__(self, step_s: float) -> None:
        self._step_s = step_s
        self.now = 0.0

    def __call__(self) -> float:
        """Return the time after one more step [s]."""
        self.now += self._step_s
        return self.now
