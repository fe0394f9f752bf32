"""When a call is tried again: the server is away, or has said when there will be room."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import grpc

from service.client.errors import PlannerError
from service.errors import RequestError


@dataclass(frozen=True)
class Retry:
    """How often and how long.

    A call is tried again when the server cannot be reached, and when it is overloaded and says how long it will be.

    Attributes:
        attempts: at most, the first included; 1 tries nothing again.
        max_delay_s: a server that asks for a longer one is not asked again.
        first_delay_s: where the server says nothing; doubled each time.
    """

    attempts: int = 3
    max_delay_s: float = 15.0
    first_delay_s: float = 0.3


class Attempts:
    """The attempts at one call, all of which share one deadline.

    Args:
        retry: how often.
        deadline_s: for all of them and the waits between; None without one.
        is_repeatable: whether doing it twice is no different from doing it once.

    Raises:
        RequestError: the deadline is no time.
    """

    def __init__(
        self,
        retry: Retry,
        deadline_s: float | None,
        is_repeatable: bool = True,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        if deadline_s is not None and not 0.0 <= deadline_s < math.inf:
            raise RequestError(f"deadline_s: seconds, or None for as long as it takes, would do, got {deadline_s:g}")
        self._retry = retry
        self._clock = clock
        self.deadline_s = deadline_s
        self._end = None if deadline_s is None else clock() + deadline_s
        self._left = retry.attempts - 1 if is_repeatable else 0
        self._next_delay_s = retry.first_delay_s

    @property
    def timeout_s(self) -> float | None:
        """What is left for the next attempt."""
        return None if self._end is None else max(self._end - self._clock(), 0.0)

    def delay_s(self, error: PlannerError) -> float:
        """How long to wait before the next attempt.

        Raises:
            PlannerError: the same, when there is no point in another.
        """
        if error.code is grpc.StatusCode.UNAVAILABLE:
            delay = self._next_delay_s if error.retry_delay_s is None else error.retry_delay_s
            self._next_delay_s *= 2.0
        elif error.code is grpc.StatusCode.RESOURCE_EXHAUSTED and error.retry_delay_s is not None:
            delay = error.retry_delay_s
        else:
            raise error
        timeout = self.timeout_s
        if self._left <= 0 or delay > self._retry.max_delay_s or (timeout is not None and delay >= timeout):
            raise error
        self._left -= 1
        return delay
