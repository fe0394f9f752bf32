"""Further attempts at a call, after a server was unreachable or overloaded."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import grpc

from service.client.errors import PlannerError
from service.errors import RequestError


@dataclass(frozen=True)
class Retry:
    """Number of attempts and delays between them.

    A call is tried again if the server cannot be reached, or if it is overloaded and names a delay.

    Attributes:
        attempts: largest number of attempts, the first included.
        max_delay_s: longest delay [s]; a server that names a longer one gets no other attempt.
        first_delay_s: delay [s] if the server names none; doubled each time.
    """

    attempts: int = 3
    max_delay_s: float = 15.0
    first_delay_s: float = 0.3


class Attempts:
    """Attempts at one call, which share one deadline.

    Args:
        retry: number and delays.
        deadline_s: time limit [s] of all attempts and delays; None for no limit.
        is_repeatable: whether the call may be made twice.

    Raises:
        RequestError: the deadline is negative or not finite.
    """

    def __init__(self, retry: Retry, deadline_s: float | None, is_repeatable: bool = True) -> None:
        if deadline_s is not None:
            check_seconds("deadline_s", deadline_s)
        self._retry = retry
        self.deadline_s = deadline_s
        self._end = None if deadline_s is None else time.monotonic() + deadline_s
        self._left = retry.attempts - 1 if is_repeatable else 0
        self._next_delay_s = retry.first_delay_s

    @property
    def timeout_s(self) -> float | None:
        """Time left [s], 0 after the deadline; None for no limit."""
        return None if self._end is None else max(self._end - time.monotonic(), 0.0)

    def start(self) -> float | None:
        """Return the time left for the next attempt [s]; None for no limit.

        Raises:
            PlannerError: the deadline has passed.
        """
        timeout_s = self.timeout_s
        if timeout_s is not None and timeout_s <= 0.0:
            raise PlannerError(grpc.StatusCode.DEADLINE_EXCEEDED, "no time is left")
        return timeout_s

    def use(self, error: PlannerError) -> float:
        """Use up an attempt after an error, and return the delay before it [s].

        Raises:
            PlannerError: ``error`` itself, if no attempt is left.
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


def check_seconds(field: str, seconds: float) -> None:
    """
    Raises:
        TypeError: ``seconds`` is no number.
        RequestError: it is negative or not finite.
    """
    if not 0.0 <= seconds < math.inf:
        raise RequestError(f"{field}: {seconds:g} is no duration; expected seconds, 0 or more")
