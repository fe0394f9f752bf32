"""Who is let in: a queue bounded in number and in time, and no deadline that cannot be met."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection
from dataclasses import dataclass, field
from statistics import fmean

import grpc

from service.server.refusal import overloaded
from service.trust.rpc import Refusal

REMEMBERED = 256  # durations by kind of work
FIRST_GUESS_S = 1.0  # of a kind that has never run
FEWEST = 10  # done before a deadline is held against it: the first is the slowest, and a refusal teaches nothing
QUICKEST = 10.0  # percentile of durations below which no deadline is believed to be kept
LEAST_S = 1e-6
IN_A_ROW, SPELLS = 8, 1000  # requests whose mean tells how fast work goes for a while; such means that are remembered
SLOW = 99.0  # percentile of these means that is expected: promises of a service are kept by 99 of 100
MOST_SLOW = 1.5  # times the usual; what is slower than that are harder requests, not a slower machine


@dataclass
class Durations:
    """How long work of each kind has taken lately [s]."""

    _seconds: dict[str, deque[float]] = field(default_factory=dict)
    _latest: deque[float] = field(default_factory=lambda: deque(maxlen=IN_A_ROW))  # each against the usual of its kind
    _spells: deque[float] = field(default_factory=lambda: deque(maxlen=SPELLS))  # their means
    _slowness: float = 1.0

    def add(self, kind: str, seconds: float) -> None:
        """Something of a kind is done."""
        known = self._seconds.setdefault(kind, deque(maxlen=REMEMBERED))
        if len(known) >= FEWEST:
            self._latest.append(seconds / max(fmean(known), LEAST_S))
            self._spells.append(fmean(self._latest))
            self._slowness = min(max(_percentile(self._spells, SLOW), 1.0), MOST_SLOW)
        known.append(seconds)

    @property
    def slowness(self) -> float:
        """How much longer than usual some work in a row takes in a slow spell: 1 to ``MOST_SLOW``."""
        return self._slowness

    def mean(self, kind: str) -> float:
        """Expected of the next."""
        known = self._seconds.get(kind)
        return fmean(known) if known else FIRST_GUESS_S

    def quickest(self, kind: str) -> float:
        """What hardly any takes less than; 0 where too little is known."""
        known = self._seconds.get(kind, ())
        return _percentile(known, QUICKEST) if len(known) >= FEWEST else 0.0

    def percentile(self, share: float) -> float:
        """Over all kinds; 0 where nothing is known."""
        known = [seconds for kind in self._seconds.values() for seconds in kind]
        return _percentile(known, share) if known else 0.0


def _percentile(values: Collection[float], share: float) -> float:
    """The value that ``share`` percent do not exceed; for a few hundred, numpy takes twenty times as long."""
    return sorted(values)[min(int(0.01 * share * len(values)), len(values) - 1)]


@dataclass
class Admission:
    """The count of what waits and runs, and the rule that keeps it bounded.

    What waits is to be begun within the time that ``queue_limit`` of the usual requests take, in a slow spell too: the
    more unevenly work goes, the fewer may wait.

    Attributes:
        workers: how many run at a time.
        queue_limit: how many may wait at most.
        durations: by kind of work.
    """

    workers: int
    queue_limit: int
    durations: Durations = field(default_factory=Durations)
    _open: dict[int, str] = field(default_factory=dict)  # kind by ticket
    _tickets: int = 0

    @property
    def queued(self) -> int:
        """How many wait."""
        return max(len(self._open) - self.workers, 0)

    @property
    def running(self) -> int:
        """How many are worked on."""
        return min(len(self._open), self.workers)

    def expected_wait_s(self) -> float:
        """Until a worker would begin with another one."""
        if len(self._open) < self.workers:
            return 0.0
        # Of those that run, half is done on average.
        ahead = list(self._open.values())
        work = sum(self.durations.mean(kind) * (0.5 if i < self.workers else 1.0) for i, kind in enumerate(ahead))
        return work / self.workers

    def is_full(self) -> bool:
        """Whether nothing more may wait."""
        return len(self._open) >= self.workers + round(self.queue_limit / self.durations.slowness)

    def check(self, kind: str, left_s: float | None) -> None:
        """Refuse what would not fit the queue, or could not be done in the ``left_s`` seconds it has.

        Raises:
            Refusal: RESOURCE_EXHAUSTED with a delay, or DEADLINE_EXCEEDED.
        """
        wait = self.expected_wait_s()
        if self.is_full():
            load = f"requests being worked on: {self.running}, waiting: {self.queued}"
            raise overloaded(
                f"{load}, which is about {wait:.1f} s of work; try again in {wait / 2.0:.1f} s", wait / 2.0
            )
        needed = wait + self.durations.quickest(kind)
        if left_s is not None and left_s < needed:
            raise Refusal(
                grpc.StatusCode.DEADLINE_EXCEEDED,
                f"the deadline is in {max(left_s, 0.0):.2f} s and work would take {needed:.2f} s, "
                f"{wait:.2f} of it waiting; it was not begun",
            )

    def enter(self, kind: str) -> int:
        """One more; returns the ticket to leave with."""
        self._tickets += 1
        self._open[self._tickets] = kind
        return self._tickets

    def leave(self, ticket: int, seconds: float | None) -> None:
        """One less; ``seconds`` are what it took a worker, None where that says nothing (cancelled, refused)."""
        kind = self._open.pop(ticket)
        if seconds is not None:
            self.durations.add(kind, seconds)
