"""Clients, admission, queue and workers of a server in simulated time, so that shares do not depend on the machine."""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import count
from random import Random

from service.executor import Job, Lane, Place
from service.executor.job import JobRecord
from service.executor.job_queue import FairQueue
from service.server.admission import Admission
from service.trust.rpc import Refusal

KIND = "reach"
IMPATIENCE = 0.5  # of the duration of a plan, after which a client that ignores the delay comes again


@dataclass(frozen=True)
class Client:
    """A client that sends the next request as soon as it has an answer.

    Attributes:
        name: owner of its requests.
        n_calls: number of its calls at a time.
        is_polite: whether it waits as long as a refusal says.
        lane: lane of its requests.
        seconds: mean duration of its plans [s].
        pause_s: from an answer to its next request [s].
    """

    name: str
    n_calls: int
    is_polite: bool
    lane: Lane = Lane.INTERACTIVE
    seconds: float = 0.05
    pause_s: float = 0.003


@dataclass
class Shares:
    """Outcome of a simulation.

    Attributes:
        plans: number of finished plans by client.
        worker_s: worker time by client [s].
        refused: number of refusals by client.
        refused_again: refusals of calls that had waited for their delay, by client.
    """

    plans: Counter[str] = field(default_factory=Counter)
    worker_s: Counter[str] = field(default_factory=Counter)
    refused: Counter[str] = field(default_factory=Counter)
    refused_again: Counter[str] = field(default_factory=Counter)

    def of_time(self, name: str) -> float:
        """Return a client's share of the worker time."""
        return self.worker_s[name] / sum(self.worker_s.values())


class _Server:
    """Admission, queue and workers on the clock of a simulation."""

    def __init__(self, workers: int, queue: int, spread: float, random: Random) -> None:
        self.now = 0.0
        self.shares = Shares()
        self._admission = Admission(workers, queue, clock=lambda: self.now)
        self._queue = FairQueue(lambda: self.now)
        self._events: list[tuple[float, int, Callable[[], None]]] = []
        self._numbers = count(1)
        self._n_idle = workers
        self._spread, self._random = spread, random
        self._after: dict[int, tuple[Client, int]] = {}  # client and admission's ticket by the job's number

    def run(self, until: float) -> None:
        while self._events and self._events[0][0] < until:
            self.now, _, happen = heapq.heappop(self._events)
            happen()

    def send_in(self, seconds: float, client: Client, has_waited: bool = False) -> None:
        self._happen_in(seconds, partial(self._send, client, has_waited))

    def _happen_in(self, seconds: float, happen: Callable[[], None]) -> None:
        heapq.heappush(self._events, (self.now + seconds, next(self._numbers), happen))

    def _send(self, client: Client, has_waited: bool) -> None:
        place = Place(client.name, client.lane)
        try:
            self._admission.check(KIND, None, place)
        except Refusal as refusal:
            self.shares.refused[client.name] += 1
            self.shares.refused_again[client.name] += has_waited
            delay = refusal.retry_after_s or 0.0 if client.is_polite else IMPATIENCE * client.seconds
            self.send_in(delay, client, client.is_polite)
            return
        number = next(self._numbers)
        self._after[number] = client, self._admission.enter(KIND, place)
        self._queue.put(JobRecord(Job(number, None, lambda _: None), b"", None, 3, place=place))
        self._start_jobs()

    def _start_jobs(self) -> None:
        while self._n_idle and (record := self._queue.take()) is not None:
            self._n_idle -= 1
            client, _ = self._after[record.job.number]
            seconds = client.seconds * self._random.lognormvariate(-0.5 * self._spread**2, self._spread)
            self._happen_in(seconds, partial(self._end, record, seconds))

    def _end(self, record: JobRecord, seconds: float) -> None:
        client, ticket = self._after.pop(record.job.number)
        self._queue.note_end(record)
        self._admission.leave(ticket, seconds)
        self.shares.plans[client.name] += 1
        self.shares.worker_s[client.name] += seconds
        self._n_idle += 1
        self._start_jobs()
        self.send_in(client.pause_s, client)


def simulate(
    clients: Sequence[Client],
    workers: int = 2,
    queue: int = 4,
    seconds: float = 30.0,
    spread: float = 0.3,
    seed: int = 0,
) -> Shares:
    """Simulate a server under load.

    Args:
        clients: its clients, each with all its calls from the beginning.
        workers: number of workers.
        queue: number of requests that may wait.
        seconds: simulated time [s].
        spread: standard deviation of the logarithm of durations.
        seed: of the durations.
    """
    server = _Server(workers, queue, spread, Random(seed))
    for client in clients:
        for _ in range(client.n_calls):
            server.send_in(0.0, client)
    server.run(seconds)
    return server.shares
