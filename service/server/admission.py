"""Admission of requests: a queue bounded in number and time, and refusal of deadlines that cannot be met."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection
from dataclasses import dataclass, field
from statistics import fmean

import grpc

from service.server.refusals import refuse_overload
from service.trust.rpc import Refusal

MAX_DURATIONS = 256  # stored per kind of work
FIRST_GUESS_S = 1.0  # for a kind that has never run
MIN_DURATIONS = 10  # before deadlines are judged: the first run is the slowest, and a refused one is never measured
QUICKEST = 10.0  # percentile of the durations that a deadline must allow
LEAST_S = 1e-6
MEAN_OVER, MAX_MEANS = 8, 1000  # requests per running mean of the relative duration; means that are stored
SLOW = 99.0  # percentile of these means that the queue is planned for
MAX_SLOWNESS = 1.5  # greater relative durations come from harder requests, not from a slower machine


@dataclass
class Durations:
    """Recent durations by kind of work [s]."""

    _seconds: dict[str, deque[float]] = field(default_factory=dict)
    _relative: deque[float] = field(default_factory=lambda: deque(maxlen=MEAN_OVER))  # to the mean of their kind
    _means: deque[float] = field(default_factory=lambda: deque(maxlen=MAX_MEANS))  # of the relative durations
    _slowness: float = 1.0

    def add(self, kind: str, seconds: float) -> None:
        """Add the duration of a finished request."""
        known = self._seconds.setdefault(kind, deque(maxlen=MAX_DURATIONS))
        if len(known) >= MIN_DURATIONS:
            self._relative.append(seconds / max(fmean(known), LEAST_S))
            self._means.append(fmean(self._relative))
            self._slowness = min(max(_percentile(self._means, SLOW), 1.0), MAX_SLOWNESS)
        known.append(seconds)

    @property
    def slowness(self) -> float:
        """Relative duration of consecutive requests in a slow period: 1 to ``MAX_SLOWNESS``."""
        return self._slowness

    def mean(self, kind: str) -> float:
        """Return the expected duration of the next request [s]."""
        known = self._seconds.get(kind)
        return fmean(known) if known else FIRST_GUESS_S

    def quickest(self, kind: str) -> float:
        """Return the ``QUICKEST`` percentile of a kind [s]; 0 with fewer than ``MIN_DURATIONS``."""
        known = self._seconds.get(kind, ())
        return _percentile(known, QUICKEST) if len(known) >= MIN_DURATIONS else 0.0

    def percentile(self, share: float) -> float:
        """Return a percentile over all kinds [s]; 0 without durations."""
        known = [seconds for kind in self._seconds.values() for seconds in kind]
        return _percentile(known, share) if known else 0.0


def _percentile(values: Collection[float], share: float) -> float:
    """Return the value that ``share`` percent do not exceed; twenty times faster than numpy for a few hundred."""
    return sorted(values)[min(int(0.01 * share * len(values)), len(values) - 1)]


@dataclass
class Admission:
    """Count of waiting and running requests, and its bound.

    A waiting request shall begin within the time that ``queue_limit`` usual requests take, also in a slow period: the
    more durations vary, the fewer requests may wait.

    Attributes:
        workers: number of requests that run at a time.
        queue_limit: greatest number of waiting requests.
        durations: recent durations by kind of work.
    """

    workers: int
    queue_limit: int
    durations: Durations = field(default_factory=Durations)
    _open: dict[int, str] = field(default_factory=dict)  # kind by ticket
    _tickets: int = 0

    @property
    def queued(self) -> int:
        """Number of waiting requests."""
        return max(len(self._open) - self.workers, 0)

    @property
    def running(self) -> int:
        """Number of running requests."""
        return min(len(self._open), self.workers)

    def expected_wait_s(self) -> float:
        """Return the time until a worker would begin the next request [s]."""
        if len(self._open) < self.workers:
            return 0.0
        kinds = list(self._open.values())
        # A running request is half done on average.
        work = sum(self.durations.mean(kind) * (0.5 if i < self.workers else 1.0) for i, kind in enumerate(kinds))
        return work / self.workers

    def is_full(self) -> bool:
        """Whether no further request may wait."""
        return len(self._open) >= self.workers + round(self.queue_limit / self.durations.slowness)

    def check(self, kind: str, left_s: float | None) -> None:
        """Refuse a request that exceeds the queue, or cannot be done in the ``left_s`` seconds until its deadline.

        Raises:
            Refusal: RESOURCE_EXHAUSTED with a delay, or DEADLINE_EXCEEDED.
        """
        wait = self.expected_wait_s()
        if self.is_full():
            load = f"requests running: {self.running}, waiting: {self.queued}"
            raise refuse_overload(
                f"{load}, which is about {wait:.1f} s of work; try again in {wait / 2.0:.1f} s", wait / 2.0
            )
        needed = wait + self.durations.quickest(kind)
        if left_s is not None and left_s < needed:
            raise Refusal(
                grpc.StatusCode.DEADLINE_EXCEEDED,
                f"the deadline is in {max(left_s, 0.0):.2f} s and the request would take {needed:.2f} s, "
                f"{wait:.2f} of it waiting; it was not begun",
            )

    def enter(self, kind: str) -> int:
        """Add a request; returns the ticket for ``leave``."""
        self._tickets += 1
        self._open[self._tickets] = kind
        return self._tickets

    def leave(self, ticket: int, seconds: float | None) -> None:
        """Remove a request; ``seconds`` is its duration in a worker, None for a cancelled or refused one."""
        kind = self._open.pop(ticket)
        if seconds is not None:
            self.durations.add(kind, seconds)
