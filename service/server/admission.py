"""Admission of requests: a queue bounded in number and time and shared by clients; deadlines that cannot be met."""

from __future__ import annotations

import math
import time
from bisect import bisect_left, insort
from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from statistics import fmean

import grpc

from service.executor import NOBODY, Lane, Place
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

SHORTEST_DELAY_S = 0.05  # before another try
EARLY_S = 0.02  # by which a client may come before its reservation
RESERVED_S = 2.0  # beyond its delay, for which a place is reserved
MAX_RESERVATIONS = 1000
REMEMBERED_S = 2.0  # for which a client's requests count for the shares of others after they have ended


@dataclass
class Durations:
    """Recent durations by kind of work [s]."""

    _seconds: dict[str, deque[float]] = field(default_factory=dict)
    _relative: deque[float] = field(default_factory=lambda: deque(maxlen=MEAN_OVER))  # to the mean of their kind
    _means: deque[float] = field(default_factory=deque)  # of the relative durations
    _sorted_means: list[float] = field(default_factory=list)

    def add(self, kind: str, seconds: float) -> None:
        """Add the duration of a finished request."""
        known = self._seconds.setdefault(kind, deque(maxlen=MAX_DURATIONS))
        if len(known) >= MIN_DURATIONS:
            self._relative.append(seconds / max(fmean(known), LEAST_S))
            self._add_mean(fmean(self._relative))
        known.append(seconds)

    @property
    def slowness(self) -> float:
        """Relative duration of consecutive requests in a slow period: 1 to ``MAX_SLOWNESS``."""
        slow = _percentile(self._sorted_means, SLOW) if self._sorted_means else 1.0
        return min(max(slow, 1.0), MAX_SLOWNESS)

    def mean(self, kind: str) -> float:
        """Return the expected duration of the next request [s]."""
        known = self._seconds.get(kind)
        return fmean(known) if known else FIRST_GUESS_S

    def quickest(self, kind: str) -> float:
        """Return the ``QUICKEST`` percentile of a kind [s]; 0 with fewer than ``MIN_DURATIONS``."""
        known = self._seconds.get(kind, ())
        return _percentile(sorted(known), QUICKEST) if len(known) >= MIN_DURATIONS else 0.0

    def _add_mean(self, mean: float) -> None:
        self._means.append(mean)
        insort(self._sorted_means, mean)
        if len(self._means) > MAX_MEANS:
            del self._sorted_means[bisect_left(self._sorted_means, self._means.popleft())]


def _percentile(values: Sequence[float], share: float) -> float:
    """Return the value of a sorted list that ``share`` percent do not exceed."""
    return values[min(int(0.01 * share * len(values)), len(values) - 1)]


@dataclass(frozen=True)
class _Request:
    """A request that waits or runs."""

    kind: str
    place: Place


@dataclass(frozen=True)
class _Reservation:
    """A place in the queue that is kept for a refused client which comes back in time.

    Attributes:
        place: whose it is.
        due: from when on [s].
        until: to when [s].
    """

    place: Place
    due: float
    until: float


@dataclass(frozen=True)
class _Need:
    """Recent requests of a client.

    Attributes:
        last_seen: when it last had an open request [s].
        most: greatest number of requests that were open at a time.
        most_at: when that was [s].
    """

    last_seen: float
    most: int
    most_at: float


@dataclass
class Admission:
    """Count of waiting and running requests by client, and its bound.

    A waiting request shall begin within the time that ``queue_limit`` usual requests take, also in a slow period: the
    more durations vary, the fewer requests may wait. Clients share the places: each may have its equal share, and
    beyond that only idle workers, and places that the others have not needed recently. Batch requests leave a quarter
    to interactive ones. A refused client is told when to come back, and a place is reserved for it then: one for each
    refused request up to its share of the places. Reservations are served in turns, the first of each client before
    the second of any.

    Attributes:
        workers: number of requests that run at a time.
        queue_limit: greatest number of waiting requests.
        durations: recent durations by kind of work.
        clock: monotonic [s].
    """

    workers: int
    queue_limit: int
    durations: Durations = field(default_factory=Durations)
    clock: Callable[[], float] = time.monotonic
    _open: dict[int, _Request] = field(default_factory=dict)  # by ticket
    _reserved: list[_Reservation] = field(default_factory=list)  # in order of the refusals
    _needs: dict[str, _Need] = field(default_factory=dict)  # by client
    _tickets: int = 0

    @property
    def queued(self) -> int:
        """Number of waiting requests."""
        return max(len(self._open) - self.workers, 0)

    @property
    def running(self) -> int:
        """Number of running requests."""
        return min(len(self._open), self.workers)

    def expected_wait_s(self, place: Place = NOBODY) -> float:
        """Return the time until a worker would begin the next request of a client [s]."""
        requests = list(self._open.values())
        if len(requests) < self.workers:
            return 0.0
        # A running request is half done on average.
        work = sum(0.5 * self.durations.mean(request.kind) for request in requests[: self.workers])
        waiting = requests[self.workers :]
        n_own = sum(_is_ahead(request, place, same=True) for request in waiting)
        turns = Counter[str]()
        for request in waiting:
            is_own = request.place.owner == place.owner
            if _is_ahead(request, place, same=is_own) and (is_own or turns[request.place.owner] <= n_own):
                turns[request.place.owner] += 1
                work += self.durations.mean(request.kind)
        return work / self.workers

    def wait_at(self, position: int) -> float:
        """Return the time until a worker begins the request at a position of the queue, 1 for the next one [s]."""
        return (position - 0.5) * self._place_every_s

    def is_full(self) -> bool:
        """Whether no further request may wait."""
        return self._n_free <= 0

    def check(self, kind: str, left_s: float | None, place: Place = NOBODY) -> None:
        """Refuse a request that exceeds the queue, or cannot be done in the ``left_s`` seconds until its deadline.

        Raises:
            Refusal: RESOURCE_EXHAUSTED with a delay, or DEADLINE_EXCEEDED.
        """
        self._drop_expired()
        client, n_places = place.owner, self._n_places
        n_own = self._n_open(client)
        owners = {r.place.owner for r in self._open.values()} | {r.place.owner for r in self._reserved}
        others = (owners | set(self._needs)) - {client}
        share = math.ceil(n_places / (len(others) + 1))
        n_needed = sum(min(self._n_needed(other), share) for other in others)
        if n_own >= max(share, n_places - n_needed) and len(self._open) >= self.workers:
            delay = self._place_every_s * (len(others) + 1)
            raise refuse_overload(
                f"{n_own} requests of this client run or wait, which is its share beside {len(others)} other "
                f"client{'s' if len(others) > 1 else ''}; try again in {delay:.1f} s",
                delay,
            )
        due = self._find_due(client)
        n_held = min(self._n_ahead(client, due), max(1, n_places // 2))
        if self._n_free - n_held < 1 or self._is_full_for(place.lane):
            raise self._refuse(place, due, max(share - n_own, 1))
        wait = self.expected_wait_s(place)
        needed = wait + self.durations.quickest(kind)
        if left_s is not None and left_s < needed:
            raise Refusal(
                grpc.StatusCode.DEADLINE_EXCEEDED,
                f"the deadline is in {max(left_s, 0.0):.2f} s and the request would take {needed:.2f} s, "
                f"{wait:.2f} of it waiting; it was not begun",
            )

    def enter(self, kind: str, place: Place = NOBODY) -> int:
        """Add a request, which uses its client's reservation; returns the ticket for ``leave``."""
        self._tickets += 1
        self._open[self._tickets] = _Request(kind, place)
        self._note_need(place.owner)
        used = self._find_due(place.owner) or next((r for r in self._reserved if r.place.owner == place.owner), None)
        self._reserved = [reservation for reservation in self._reserved if reservation is not used]
        return self._tickets

    def leave(self, ticket: int, seconds: float | None) -> None:
        """Remove a request; ``seconds`` is its duration in a worker, None for a cancelled or refused one."""
        self._note_need(self._open[ticket].place.owner)
        request = self._open.pop(ticket)
        if seconds is not None:
            self.durations.add(request.kind, seconds)

    def _n_open(self, client: str) -> int:
        return sum(request.place.owner == client for request in self._open.values())

    def _n_needed(self, client: str) -> int:
        """Return how many places a client has needed recently, those included that it was refused."""
        n_refused = sum(reservation.place.owner == client for reservation in self._reserved)
        need = self._needs.get(client)
        return max(self._n_open(client) + n_refused, 0 if need is None else need.most)

    def _note_need(self, client: str) -> None:
        now, n_open, need = self.clock(), self._n_open(client), self._needs.get(client)
        if need is None or n_open >= need.most or now - need.most_at > REMEMBERED_S:
            self._needs[client] = _Need(now, n_open, now)
        else:
            self._needs[client] = replace(need, last_seen=now)

    @property
    def _n_places(self) -> int:
        return self.workers + round(self.queue_limit / self.durations.slowness)

    @property
    def _n_free(self) -> int:
        return self._n_places - len(self._open)

    @property
    def _place_every_s(self) -> float:
        """Expected time between two requests that end [s]."""
        requests = list(self._open.values())[: self.workers]
        return fmean([self.durations.mean(request.kind) for request in requests] or [FIRST_GUESS_S]) / self.workers

    def _find_due(self, client: str) -> _Reservation | None:
        """Return the client's first reservation whose time has come."""
        now = self.clock() + EARLY_S
        return next((r for r in self._reserved if r.place.owner == client and r.due <= now), None)

    def _n_ahead(self, client: str, own: _Reservation | None) -> int:
        """Return how many reservations of others go before one of a client, None for one that it would get now."""
        turns = Counter[str]()
        before: list[int] = []  # turns of the others' reservations
        after: list[int] = []
        turn: int | None = None
        for reservation in self._reserved:
            owner = reservation.place.owner
            turns[owner] += 1
            if reservation is own:
                turn = turns[client]
            elif owner != client and not self._is_full_for(reservation.place.lane):
                (before if turn is None else after).append(turns[owner])
        turn = turns[client] + 1 if turn is None else turn
        return sum(other <= turn for other in before) + sum(other < turn for other in after)

    def _is_full_for(self, lane: Lane) -> bool:
        """Whether requests of a lane have all places that they may have."""
        if lane is not Lane.BATCH:
            return False  # they may have all
        n_batch = sum(request.place.lane is Lane.BATCH for request in self._open.values())
        return n_batch >= self._n_places - self._n_places // 4

    def _refuse(self, place: Place, due: _Reservation | None, most: int) -> Refusal:
        """Make the refusal of a full queue; the client gets a reservation, or its ``due`` one a later time.

        Args:
            place: whose request is refused.
            due: its client's reservation that could not be used.
            most: greatest number of its reservations.
        """
        now = self.clock()
        own = [reservation for reservation in self._reserved if reservation.place.owner == place.owner]
        if due is None and own and (len(own) >= most or len(self._reserved) >= MAX_RESERVATIONS):
            reservation = own[-1]
        else:
            n_ahead = self._n_ahead(place.owner, due) + (len(own) if due is None else own.index(due))
            delay = max((n_ahead + 0.5) * self._place_every_s, SHORTEST_DELAY_S)
            reservation = _Reservation(place, now + delay, now + 2.0 * delay + RESERVED_S)
            if due is not None:  # keeps its turn
                self._reserved = [reservation if other is due else other for other in self._reserved]
            elif len(self._reserved) < MAX_RESERVATIONS:
                self._reserved.append(reservation)
        delay = max(reservation.due - now, SHORTEST_DELAY_S)
        load = f"requests running: {self.running}, waiting: {self.queued}"
        work = self.expected_wait_s()
        return refuse_overload(
            f"{load}, which is about {work:.1f} s of work; try again in {delay:.1f} s, a place is reserved then", delay
        )

    def _drop_expired(self) -> None:
        now = self.clock()
        self._reserved = [reservation for reservation in self._reserved if reservation.until > now]
        self._needs = {name: need for name, need in self._needs.items() if now - need.last_seen < REMEMBERED_S}


def _is_ahead(request: _Request, place: Place, same: bool) -> bool:
    """Whether a waiting request may go before a new one of a client (``same``: only the client's own count)."""
    return request.place.lane <= place.lane and (not same or request.place.owner == place.owner)
