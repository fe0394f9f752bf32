"""Jobs without a result, and the order of those that wait: lanes first, then equal shares of worker time.

Start-time fair queueing (Goyal, Vin and Cheng, SIGCOMM 1996) without known durations: the owner whose jobs have used
the least worker time gets the next worker.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

from service.executor.job import Job, JobRecord, Lane

BATCH_AFTER = 4  # consecutive interactive jobs after which a waiting batch job is next


@dataclass
class _Owner:
    """Waiting and running jobs of one owner.

    Attributes:
        waiting: by lane, in order of submission.
        used_s: worker time that is compared with other owners' [s].
        running: start of each running job by its number [s].
    """

    used_s: float
    waiting: dict[Lane, deque[JobRecord]] = field(default_factory=lambda: {lane: deque() for lane in Lane})
    running: dict[int, float] = field(default_factory=dict)

    @property
    def is_active(self) -> bool:
        return bool(self.running) or any(self.waiting.values())

    def cost_s(self, now: float) -> float:
        return self.used_s + sum(now - start for start in self.running.values())


class FairQueue:
    """Waiting jobs; not safe for several threads."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._again: deque[JobRecord] = deque()  # jobs whose worker died, before all others
        self._owners: dict[str, _Owner] = {}
        self._floor_s = 0.0  # least cost among owners with jobs; a new owner begins there
        self._n_interactive = 0  # consecutive ones while batch jobs waited
        self._n = 0

    def __len__(self) -> int:
        return self._n

    def __iter__(self) -> Iterator[JobRecord]:
        """Iterate over the waiting jobs in order of submission."""
        lanes = (queue for owner in self._owners.values() for queue in owner.waiting.values())
        jobs = [*self._again, *(record for queue in lanes for record in queue)]
        return iter(sorted(jobs, key=lambda record: record.job.number))

    def put(self, record: JobRecord) -> None:
        """Add a new job behind the owner's other jobs of its lane."""
        owner = self._owners.setdefault(record.place.owner, _Owner(self._floor_s))
        if not owner.is_active:
            owner.used_s = max(owner.used_s, self._floor_s)
        owner.waiting[record.place.lane].append(record)
        self._n += 1

    def put_back(self, record: JobRecord) -> None:
        """Add a job that was started before, in front of all others."""
        self.note_end(record)
        self._again.appendleft(record)
        self._n += 1

    def take(self, only_light: bool = False) -> JobRecord | None:
        """Remove and return the next job, which is running from now on; None if there is none."""
        record = self._take_again(only_light) or self._take_waiting(only_light)
        if record is not None:
            self._n -= 1
            owner = self._owners.setdefault(record.place.owner, _Owner(self._floor_s))
            owner.running[record.job.number] = self._clock()
        return record

    def remove(self, record: JobRecord) -> bool:
        """Remove a waiting job; return whether it was there."""
        owner = self._owners.get(record.place.owner)
        for queue in (self._again, *([] if owner is None else [owner.waiting[record.place.lane]])):
            if record in queue:
                queue.remove(record)
                self._n -= 1
                self._forget_idle()
                return True
        return False

    def note_end(self, record: JobRecord) -> None:
        """Count the worker time of a job that no longer runs."""
        owner = self._owners.get(record.place.owner)
        start = None if owner is None else owner.running.pop(record.job.number, None)
        if owner is not None and start is not None:
            owner.used_s += self._clock() - start
            self._forget_idle()

    def position(self, record: JobRecord) -> int | None:
        """Return the expected place of a waiting job, 1 for the next one; None for a job that does not wait."""
        if record in self._again:
            return self._again.index(record) + 1
        own = self._owners.get(record.place.owner)
        lane = record.place.lane
        if own is None or record not in own.waiting[lane]:
            return None
        index, now = own.waiting[lane].index(record), self._clock()
        ahead = len(self._again) + index
        for owner in self._owners.values():
            ahead += sum(len(queue) for other, queue in owner.waiting.items() if other < lane)
            if owner is not own:
                turns = index + (owner.cost_s(now) <= own.cost_s(now))
                ahead += min(len(owner.waiting[lane]), turns)
        return ahead + 1

    def _take_again(self, only_light: bool) -> JobRecord | None:
        for record in self._again:
            if not only_light or record.place.lane is Lane.LIGHT:
                self._again.remove(record)
                return record
        return None

    def _take_waiting(self, only_light: bool) -> JobRecord | None:
        lanes = [lane for lane in Lane if any(owner.waiting[lane] for owner in self._owners.values())]
        if only_light:
            lanes = [lane for lane in lanes if lane is Lane.LIGHT]
        if not lanes:
            return None
        lane = lanes[0]
        if lane is Lane.INTERACTIVE:
            is_batch_next = self._n_interactive >= BATCH_AFTER and Lane.BATCH in lanes
            self._n_interactive = 0 if is_batch_next or Lane.BATCH not in lanes else self._n_interactive + 1
            lane = Lane.BATCH if is_batch_next else lane
        now = self._clock()
        owner = min(
            (owner for owner in self._owners.values() if owner.waiting[lane]),
            key=lambda owner: (owner.cost_s(now), len(owner.running), owner.waiting[lane][0].job.number),
        )
        self._floor_s = max(self._floor_s, min(o.cost_s(now) for o in self._owners.values() if o.is_active))
        return owner.waiting[lane].popleft()

    def _forget_idle(self) -> None:
        """Forget owners without jobs that would begin at the floor anyway."""
        for name in [n for n, owner in self._owners.items() if not owner.is_active and owner.used_s <= self._floor_s]:
            del self._owners[name]
        if not any(owner.is_active for owner in self._owners.values()):
            self._owners.clear()  # nobody has waited for anybody
            self._floor_s = 0.0


class JobQueue:
    """The pool's jobs without a result, of which some wait; safe to use from several threads.

    Attributes:
        n_done: number of jobs that have ended.
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._waiting = FairQueue()
        self._open: dict[int, JobRecord] = {}  # by the job's number: waiting or running
        self.n_done = 0

    @property
    def n_queued(self) -> int:
        """Number of waiting jobs."""
        return len(self._waiting)

    @property
    def n_open(self) -> int:
        """Number of jobs without a result."""
        return len(self._open)

    def put(self, record: JobRecord) -> None:
        """Add a new job, which is forgotten when it ends."""
        with self._changed:
            self._open[record.job.number] = record
            self._waiting.put(record)
        record.job.add_done_callback(lambda _: self._forget(record))

    def put_back(self, record: JobRecord) -> None:
        """Add a job that was started before, in front of all others."""
        with self._changed:
            record.job.pid = None
            self._waiting.put_back(record)

    def take(self, only_light: bool = False) -> JobRecord | None:
        """Remove and return the next waiting job, of any lane or only of the light one."""
        with self._changed:
            return self._waiting.take(only_light)

    def withdraw(self, record: JobRecord) -> bool:
        """Remove a job from those that wait; return whether it was there."""
        with self._changed:
            return self._waiting.remove(record)

    def find(self, number: int) -> JobRecord | None:
        """Return the record of a job that has not ended."""
        return self._open.get(number)

    def position(self, job: Job[Any]) -> int | None:
        """Return 1 for the job that is next, None for a job that does not wait."""
        with self._changed:
            record = self._open.get(job.number)
            return None if record is None else self._waiting.position(record)

    def list_open(self, only_queued: bool = False) -> list[JobRecord]:
        """Return the jobs without a result, or only those that wait, in order of submission."""
        with self._changed:
            return list(self._waiting if only_queued else self._open.values())

    def wait_empty(self, timeout_s: float | None) -> bool:
        """Wait until all jobs have ended; return whether they have."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._open, timeout_s)

    def _forget(self, record: JobRecord) -> None:
        with self._changed:
            is_withdrawn = record.job.cancelled() and self._waiting.remove(record)  # else the supervisor is taking it
            self._waiting.note_end(record)
            del self._open[record.job.number]
            self.n_done += 1
            self._changed.notify_all()
        if is_withdrawn:
            record.job.set_running_or_notify_cancel()  # `concurrent.futures.wait` looks for this
