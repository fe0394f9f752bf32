"""Plans that have not ended, each awaited by any number of calls."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

from service.proto.planner.v1.planner_pb2 import PlanQueued, PlanResponse
from service.server.jobs import JobHandle, JobRunner
from service.trust.rpc import Refusal


class RunningPlan:
    """One plan from its acceptance to its end.

    A watcher gets the newest state, not every state: a slow reader misses steps and delays nobody. The plan is stopped
    when the last watcher leaves before the end. States are serialized ``PlanResponse``s, which the server passes on.

    Args:
        jobs: runner of its jobs.

    Attributes:
        plan_id: id in the store; empty until the plan is written there.
    """

    def __init__(self, jobs: JobRunner) -> None:
        self.plan_id = ""
        self._jobs = jobs
        self._handle: JobHandle[Any] | None = None
        self._latest = b""
        self._version = 0
        self._changed = asyncio.Event()
        self._deadlines: list[float] = []  # of the watchers
        self._was_watched = self._is_stopping = False
        self._left = asyncio.Event()  # no watcher is there
        self._end: bytes | Refusal | None = None
        self._end_callbacks: list[Callable[[], object]] = [jobs.add_listener(self._report_position)]

    @property
    def is_stopping(self) -> bool:
        """Whether the plan was stopped because its last watcher left, and has not ended yet."""
        return self._is_stopping

    @property
    def has_begun(self) -> bool:
        """Whether a worker has begun."""
        return self._handle is not None and self._handle.job.started is not None

    def set_job(self, handle: JobHandle[Any]) -> None:
        """Set the job that works on the plan."""
        self._handle = handle
        if self._is_stopping:  # the last watcher has left meanwhile
            handle.cancel()
        self._report_position()

    def report(self, response: bytes) -> None:
        """Set the newest state."""
        self._latest = response
        self._version += 1
        self._wake()

    def end(self, end: bytes | Refusal) -> None:
        """End the plan with its result, or with a refusal if there is none."""
        self._end = end
        self.discard()
        self._wake()

    def discard(self) -> None:
        """Run the end callbacks; alone for a plan that never began."""
        for callback in self._end_callbacks:
            callback()

    @property
    def latest_deadline(self) -> float | None:
        """Latest deadline of the watchers, on the clock of ``time.monotonic`` [s]; None if one has none."""
        latest = max(self._deadlines, default=0.0)
        return None if latest == math.inf else latest

    def is_awaited_beyond(self, deadline: float | None) -> bool:
        """Whether a watcher's deadline is later than the given one."""
        return deadline is not None and max(self._deadlines, default=0.0) > deadline

    @contextmanager
    def watch(self, deadline: float | None) -> Iterator[bool]:
        """Count a watcher for the body; yields whether it is the first."""
        is_first, self._was_watched = not self._was_watched, True
        own = math.inf if deadline is None else deadline
        self._deadlines.append(own)
        self._left.clear()
        try:
            yield is_first
        finally:
            self._deadlines.remove(own)
            if not self._deadlines:
                self._left.set()
            if not self._deadlines and self._end is None:
                self._is_stopping = True
                if self._handle is not None:
                    self._handle.cancel()

    async def events(self) -> AsyncIterator[bytes]:
        """Yield the states from now on, up to the end.

        Raises:
            Refusal: the plan ended without a result.
        """
        seen = 0
        while self._end is None:
            if self._version > seen:
                seen = self._version
                yield self._latest
            else:
                await self._changed.wait()
        if isinstance(self._end, Refusal):
            raise self._end
        yield self._end

    def add_end_callback(self, callback: Callable[[], object]) -> None:
        """Call ``callback`` at the end, before the watchers learn of it."""
        self._end_callbacks.append(callback)

    async def wait_for_end(self) -> None:
        """Wait for the end."""
        while self._end is None:
            await self._changed.wait()

    async def wait_until_left(self, timeout_s: float) -> None:
        """Wait until no watcher is there, at most ``timeout_s``."""
        if self._deadlines:
            with suppress(TimeoutError):
                async with asyncio.timeout(timeout_s):
                    await self._left.wait()

    def _report_position(self) -> None:
        if not self._jobs.admission.queued:
            return
        position = None if self._handle is None else self._jobs.queue_position(self._handle)
        if position is not None:
            wait = self._jobs.admission.wait_at(position)
            queued = PlanQueued(place=position, expected_wait_s=wait)
            self.report(PlanResponse(queued=queued).SerializeToString())

    def _wake(self) -> None:
        # All current waiters hold this event; later waiters get the new one.
        self._changed.set()
        self._changed = asyncio.Event()


class RunningPlans:
    """The plans that have not ended, by id."""

    def __init__(self) -> None:
        self._plans: dict[str, RunningPlan] = {}

    def __len__(self) -> int:
        return len(self._plans)

    def get(self, plan_id: str) -> RunningPlan | None:
        """Return a plan; None if it has ended."""
        return self._plans.get(plan_id)

    def add(self, plan: RunningPlan) -> None:
        """Add a plan until its end.

        It is removed before its watchers learn of the end, so that they can plan again under the same request id.
        """
        self._plans[plan.plan_id] = plan
        plan.add_end_callback(lambda: self._plans.pop(plan.plan_id, None))
