"""How long to wait before starting again what did not start, and when to tell those who wait for it."""

from __future__ import annotations

import time

_FIRST_S, _LONGEST_S = 0.1, 5.0
_HOPELESS = 3  # failures in a row


class Backoff:
    """Failures in a row, and the wait after them, twice as long each time.

    Attributes:
        until: when to try again, on the clock of ``time.monotonic`` [s].
    """

    def __init__(self) -> None:
        self.until = 0.0
        self._failures = 0

    @property
    def is_waiting(self) -> bool:
        """Whether it is too early to try again."""
        return time.monotonic() < self.until

    def failed(self) -> bool:
        """Note a failure, one for each attempt however many it had; whether there is little hope."""
        if self.is_waiting:
            return False
        self.until = time.monotonic() + min(_FIRST_S * 2**self._failures, _LONGEST_S)
        self._failures += 1
        return self._failures >= _HOPELESS

    def succeeded(self) -> None:
        """Begin to count anew."""
        self._failures = 0
