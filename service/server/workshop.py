"""Work handed to the executor from the event loop: admitted, timed, stopped, its end told as a client shall hear it."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from concurrent.futures import CancelledError
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import grpc

from service.executor import CancellableExecutor, DeadlineExceeded, ExecutorError, Job, PoolClosed, WorkerDied
from service.server.admission import Admission
from service.server.farewell import STOPPING
from service.trust.rpc import Refusal

T = TypeVar("T")
OVERTIME_S = 5.0  # beyond its budget, before a worker that does not stop by itself is killed

OVERTIME = "{kind} is allowed {budget:g} s and was not done {over:g} s after them; it was ended"


@dataclass(frozen=True)
class Piece(Generic[T]):
    """Work that was handed over.

    Attributes:
        job: of the executor.
        ended: the job's future on the event loop.
    """

    job: Job[T]
    ended: asyncio.Future[T]

    @property
    def waited_s(self) -> float:
        """From its submission until a worker had time for it; 0 while none has."""
        return 0.0 if self.job.started is None else self.job.started - self.job.submitted

    def cancel(self) -> None:
        """Stop it, whether it waits or runs."""
        self.job.cancel()


class Workshop:
    """Admission and executor together.

    Args:
        executor: what runs the work.
        admission: who is let in.
    """

    def __init__(self, executor: CancellableExecutor, admission: Admission) -> None:
        self.executor = executor
        self.admission = admission
        self._running: dict[int, tuple[str, Job[Any], float]] = {}  # kind, job and budget by ticket
        self._spares: set[Job[Any]] = set()  # of what helps, which gives way
        self._ended_by_us: dict[int, Refusal] = {}  # why, by ticket
        self._listeners: set[Callable[[], None]] = set()
        self.is_closed = False  # takes nothing more in

    def start(
        self,
        kind: str,
        fn: Callable[..., T],
        *args: Any,
        deadline: float | None,
        budget_s: float,
        on_event: Callable[[Any], object] | None = None,
        is_typical: Callable[[T], bool] = lambda _: True,
    ) -> Piece[T]:
        """Hand work over.

        Args:
            kind: of work, for admission.
            fn: top-level function; args: picklable.
            deadline: on the clock of ``time.monotonic`` [s]; None without one.
            budget_s: how long a worker may be at it.
            on_event: told on the event loop what ``fn`` reports.
            is_typical: whether how long a result took says something of the next.

        Raises:
            Refusal: the queue is full, the deadline cannot be met, or the server is about to stop.
        """
        loop = asyncio.get_running_loop()
        if self.is_closed:
            raise STOPPING
        self.admission.check(kind, None if deadline is None else deadline - time.monotonic())

        def tell(event: Any) -> None:
            if on_event is not None:
                loop.call_soon_threadsafe(on_event, event)

        self._give_way()
        try:
            job = self.executor.submit(fn, *args, on_event=tell, deadline=deadline)
        except PoolClosed:
            raise STOPPING from None
        ticket = self.admission.enter(kind)
        self._running[ticket] = (kind, job, budget_s)
        ended: asyncio.Future[T] = loop.create_future()
        job.add_done_callback(lambda _: loop.call_soon_threadsafe(self._end, ticket, job, ended, is_typical))
        return Piece(job, ended)

    def spare(self, fn: Callable[..., T], *args: Any) -> Piece[T] | None:
        """Hand over what would help other work, until a worker is needed for more; None where none is idle."""
        if self.is_closed or self._idle <= 0:
            return None
        loop = asyncio.get_running_loop()
        try:
            job = self.executor.submit(fn, *args)
        except PoolClosed:
            return None
        self._spares.add(job)
        ended: asyncio.Future[T] = loop.create_future()
        job.add_done_callback(lambda _: loop.call_soon_threadsafe(self._end_spare, job, ended))
        return Piece(job, ended)

    async def run(self, kind: str, fn: Callable[..., T], *args: Any, deadline: float | None, budget_s: float) -> T:
        """Hand work over and wait for it; stopped when whoever waits is cancelled.

        Raises:
            Refusal: as ``start`` and ``outcome``.
        """
        piece = self.start(kind, fn, *args, deadline=deadline, budget_s=budget_s)
        try:
            return await outcome(piece)
        except asyncio.CancelledError:
            piece.cancel()
            raise

    def place(self, piece: Piece[Any]) -> int | None:
        """1 for what is next; None for what does not wait."""
        return self.executor.queue_position(piece.job)

    def kind_at(self, pid: int | None) -> str:
        """What a worker is at."""
        return next((kind for kind, job, _ in self._running.values() if job.pid == pid and job.started), "")

    def on_change(self, listener: Callable[[], None]) -> Callable[[], None]:
        """Have ``listener`` called whenever something has ended; returns what ends that."""
        self._listeners.add(listener)
        return lambda: self._listeners.discard(listener)

    def stop_overtime(self) -> None:
        """Stop what has been running beyond its budget, and say so; to be called now and then."""
        now = time.monotonic()
        for ticket, (kind, job, budget_s) in list(self._running.items()):
            if job.started is not None and not job.done() and now - job.started > budget_s + OVERTIME_S:
                text = OVERTIME.format(kind=kind, budget=budget_s, over=OVERTIME_S)
                self._stop(ticket, job, Refusal(grpc.StatusCode.DEADLINE_EXCEEDED, text))

    def stop_all(self, why: Refusal = STOPPING) -> None:
        """Stop everything, since the server stops."""
        for ticket, (_, job, _) in reversed(self._running.copy().items()):  # else what waits would begin
            self._stop(ticket, job, why)

    async def emptied(self) -> None:
        """Wait until nothing is under way."""
        empty = asyncio.Event()
        forget = self.on_change(lambda: empty.set() if not self._running else None)
        try:
            if self._running:
                await empty.wait()
        finally:
            forget()

    @property
    def _idle(self) -> int:
        """Workers that nothing is at."""
        return self.admission.workers - self.admission.running - len(self._spares)

    def _give_way(self) -> None:
        """Have a worker freed where all are taken and some of them only help."""
        if self._idle <= 0 and self._spares:
            self._spares.pop().cancel()

    def _end_spare(self, job: Job[T], ended: asyncio.Future[T]) -> None:
        self._spares.discard(job)
        _settle(job, ended)

    def _stop(self, ticket: int, job: Job[Any], why: Refusal) -> None:
        self._ended_by_us.setdefault(ticket, why)
        job.cancel()

    def _end(self, ticket: int, job: Job[T], ended: asyncio.Future[T], is_typical: Callable[[T], bool]) -> None:
        del self._running[ticket]
        is_answer = not job.cancelled() and job.exception() is None and is_typical(job.result())
        took = None if job.started is None or not is_answer else time.monotonic() - job.started
        self.admission.leave(ticket, took)
        for listener in list(self._listeners):
            listener()
        why = self._ended_by_us.pop(ticket, None)
        _settle(job, ended, None if is_answer else why)


def _settle(job: Job[T], ended: asyncio.Future[T], why: Exception | None = None) -> None:
    """Tell the event loop how a job has ended; ``why`` it was ended comes before what it says itself."""
    error = why or (CancelledError() if job.cancelled() else job.exception())
    if error is not None:
        ended.set_exception(error)
        ended.exception()  # looked at: nobody may be waiting any more, which is no reason to complain
    else:
        ended.set_result(job.result())


async def outcome(piece: Piece[T]) -> T:
    """What work came to.

    Raises:
        Refusal: CANCELLED, DEADLINE_EXCEEDED or INTERNAL, where it came to nothing.
    """
    try:
        return await asyncio.shield(piece.ended)
    except CancelledError:  # the job's; asyncio has a class of its own for that of whoever waits
        raise Refusal(grpc.StatusCode.CANCELLED, "stopped before there was an answer") from None
    except DeadlineExceeded:
        raise Refusal(grpc.StatusCode.DEADLINE_EXCEEDED, "the deadline passed before there was an answer") from None
    except WorkerDied as error:
        raise Refusal(
            grpc.StatusCode.INTERNAL,
            f"{error.attempts} workers ended while they were at it (the last: {error.cause}); it is not tried again",
        ) from None
    except ExecutorError as error:
        raise Refusal(grpc.StatusCode.INTERNAL, str(error)) from None
