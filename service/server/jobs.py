"""Jobs handed to the executor from the event loop: admission, time budgets, cancellation, and errors as refusals."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from concurrent.futures import CancelledError
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import grpc

from service.executor import (
    NOBODY,
    DeadlineExceeded,
    ExecutorError,
    Job,
    Lane,
    Place,
    Pool,
    PoolClosed,
    WorkerDied,
)
from service.server.admission import Admission
from service.server.refusals import STOPPING
from service.trust.rpc import Refusal

T = TypeVar("T")
OVERTIME_S = 5.0  # beyond the budget, before a job that does not stop by itself is ended


@dataclass(frozen=True)
class JobHandle(Generic[T]):
    """A job that was handed to the executor.

    Attributes:
        job: the executor's job.
        ended: the job's future on the event loop.
    """

    job: Job[T]
    ended: asyncio.Future[T]

    @property
    def waited_s(self) -> float:
        """Time from submission until a worker began; 0 while it waits."""
        return 0.0 if self.job.started is None else self.job.started - self.job.submitted

    def cancel(self) -> None:
        """Stop the job, whether it waits or runs."""
        self.job.cancel()


class JobRunner:
    """Admission and executor together.

    Attributes:
        executor: runs the jobs.
        admission: decides which jobs are accepted.
        is_closed: no further jobs are accepted.
    """

    def __init__(self, executor: Pool, admission: Admission) -> None:
        self.executor = executor
        self.admission = admission
        self._open: dict[int, tuple[str, Job[Any], float]] = {}  # kind, job and budget by ticket
        self._spares: set[Job[Any]] = set()  # jobs that are cancelled when their worker is needed
        self._stop_reasons: dict[int, Refusal] = {}  # by ticket
        self._listeners: set[Callable[[], None]] = set()
        self.is_closed = False

    def start(
        self,
        kind: str,
        fn: Callable[..., T],
        *args: Any,
        deadline: float | None,
        budget_s: float,
        on_event: Callable[[Any], object] | None = None,
        is_typical: Callable[[T], bool] = lambda _: True,
        place: Place = NOBODY,
        is_accepted: bool = False,
    ) -> JobHandle[T]:
        """Hand a job to the executor.

        Args:
            kind: kind of work, for admission.
            fn: top-level function.
            args: picklable arguments.
            deadline: on the clock of ``time.monotonic`` [s]; None without one.
            budget_s: how long it may run [s].
            on_event: called on the event loop with each event that ``fn`` reports.
            is_typical: whether the duration of a result counts for later estimates.
            place: whose job it is and how it waits; light jobs are not counted.
            is_accepted: whether it was accepted before, so that it is not refused now.

        Raises:
            Refusal: the queue is full, the deadline cannot be met, or the server is stopping.
        """
        loop = asyncio.get_running_loop()
        if self.is_closed:
            raise STOPPING
        is_light = place.lane is Lane.LIGHT
        if not is_light and not is_accepted:
            self.admission.check(kind, None if deadline is None else deadline - time.monotonic(), place)

        def forward(event: Any) -> None:
            if on_event is not None:
                _call_in(loop, on_event, event)

        if not is_light:
            self._free_worker()
        try:
            job = self.executor.submit(fn, *args, on_event=forward, deadline=deadline, place=place)
        except PoolClosed:
            raise STOPPING from None
        ticket = -job.number if is_light else self.admission.enter(kind, place)
        self._open[ticket] = (kind, job, budget_s)
        ended: asyncio.Future[T] = loop.create_future()
        job.add_done_callback(lambda _: _call_in(loop, self._end, ticket, job, ended, is_typical))
        return JobHandle(job, ended)

    def start_spare(self, fn: Callable[..., T], *args: Any) -> JobHandle[T] | None:
        """Use an idle worker for a job that is cancelled when the worker is needed; None if no worker is idle."""
        if self.is_closed or self._n_idle <= 0:
            return None
        loop = asyncio.get_running_loop()
        try:
            job = self.executor.submit(fn, *args)
        except PoolClosed:
            return None
        self._spares.add(job)
        ended: asyncio.Future[T] = loop.create_future()
        job.add_done_callback(lambda _: _call_in(loop, self._end_spare, job, ended))
        return JobHandle(job, ended)

    async def run(
        self,
        kind: str,
        fn: Callable[..., T],
        *args: Any,
        deadline: float | None,
        budget_s: float,
        place: Place = NOBODY,
    ) -> T:
        """Run a job to its end; it is stopped when the awaiting task is cancelled.

        Raises:
            Refusal: as ``start`` and ``await_result``.
        """
        handle = self.start(kind, fn, *args, deadline=deadline, budget_s=budget_s, place=place)
        try:
            return await await_result(handle)
        except asyncio.CancelledError:
            handle.cancel()
            raise

    def queue_position(self, handle: JobHandle[Any]) -> int | None:
        """Return the position in the queue, 1 for the next job; None for a job that does not wait."""
        return self.executor.queue_position(handle.job)

    def kind_of_worker(self, pid: int | None) -> str:
        """Return the kind of work that a worker is busy with; empty if none."""
        return next((kind for kind, job, _ in self._open.values() if job.pid == pid and job.started), "")

    def add_listener(self, listener: Callable[[], None]) -> Callable[[], None]:
        """Call ``listener`` whenever a job has ended; returns a function that removes it."""
        self._listeners.add(listener)
        return lambda: self._listeners.discard(listener)

    def stop_overdue(self) -> None:
        """Stop jobs that have exceeded their budget; called periodically."""
        now = time.monotonic()
        for ticket, (kind, job, budget_s) in list(self._open.items()):
            if job.started is not None and not job.done() and now - job.started > budget_s + OVERTIME_S:
                text = f"{kind} may take {budget_s:g} s and had not ended {OVERTIME_S:g} s later; it was stopped"
                self._stop(ticket, job, Refusal(grpc.StatusCode.DEADLINE_EXCEEDED, text))

    def stop_all(self, why: Refusal) -> None:
        """Stop all jobs, since the server stops."""
        for ticket, (_, job, _) in reversed(self._open.copy().items()):  # newest first, so that no waiting job begins
            self._stop(ticket, job, why)

    async def wait_until_empty(self) -> None:
        """Wait until no job is open."""
        empty = asyncio.Event()
        remove = self.add_listener(lambda: empty.set() if not self._open else None)
        try:
            if self._open:
                await empty.wait()
        finally:
            remove()

    @property
    def _n_idle(self) -> int:
        return self.admission.workers - self.admission.running - len(self._spares)

    def _free_worker(self) -> None:
        """Cancel a spare job if no worker is idle."""
        if self._n_idle <= 0 and self._spares:
            self._spares.pop().cancel()

    def _end_spare(self, job: Job[T], ended: asyncio.Future[T]) -> None:
        self._spares.discard(job)
        _settle(job, ended)

    def _stop(self, ticket: int, job: Job[Any], why: Refusal) -> None:
        self._stop_reasons.setdefault(ticket, why)
        job.cancel()

    def _end(self, ticket: int, job: Job[T], ended: asyncio.Future[T], is_typical: Callable[[T], bool]) -> None:
        del self._open[ticket]
        is_answer = not job.cancelled() and job.exception() is None and is_typical(job.result())
        took = None if job.started is None or not is_answer else time.monotonic() - job.started
        if ticket >= 0:
            self.admission.leave(ticket, took)
        for listener in list(self._listeners):
            listener()
        why = self._stop_reasons.pop(ticket, None)
        _settle(job, ended, None if is_answer else why)


def _call_in(loop: asyncio.AbstractEventLoop, fn: Callable[..., object], *args: Any) -> None:
    """Have an event loop call a function soon; in its own thread it need not be woken."""
    try:
        is_own = asyncio.get_running_loop() is loop
    except RuntimeError:  # this thread has none
        is_own = False
    (loop.call_soon if is_own else loop.call_soon_threadsafe)(fn, *args)


def _settle(job: Job[T], ended: asyncio.Future[T], why: Exception | None = None) -> None:
    """Copy a job's end to its future on the event loop; ``why`` it was stopped replaces its own error."""
    if ended.cancelled():  # with the task that awaited it
        return
    error = why or (CancelledError() if job.cancelled() else job.exception())
    if error is not None:
        ended.set_exception(error)
        ended.exception()  # marks it as retrieved: asyncio must not complain if nobody waits any more
    else:
        ended.set_result(job.result())


async def await_result(handle: JobHandle[T]) -> T:
    """Wait for a job's result.

    Raises:
        Refusal: CANCELLED, DEADLINE_EXCEEDED or INTERNAL, if there is none.
    """
    try:
        return await handle.ended
    except CancelledError:  # the job's; cancelling the awaiting task raises asyncio's own class
        raise Refusal(grpc.StatusCode.CANCELLED, "stopped before there was an answer") from None
    except DeadlineExceeded:
        raise Refusal(grpc.StatusCode.DEADLINE_EXCEEDED, "the deadline passed before there was an answer") from None
    except WorkerDied as error:
        raise Refusal(
            grpc.StatusCode.INTERNAL,
            f"{error.attempts} workers ended during this job (the last: {error.cause}); it is not tried again",
        ) from None
    except ExecutorError as error:
        raise Refusal(grpc.StatusCode.INTERNAL, str(error)) from None
