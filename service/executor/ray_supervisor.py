"""The thread that looks after a pool's actors on a Ray cluster."""

from __future__ import annotations

import logging
import pickle
import queue
import time
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from typing import Any

import ray

from service.executor.backlog import Backlog, Ending, Task
from service.executor.backoff import Backoff
from service.executor.frames import Kind
from service.executor.interface import WorkerState
from service.executor.overseer import Overseer
from service.executor.ray_worker import N_THREADS, Answer, RayWorker
from service.executor.settings import Settings
from service.executor.worker import WorkerSetup

_LOG = logging.getLogger("service.executor")


class Actor:
    """One worker.

    Attributes:
        handle: what Ray knows it by.
        state: what it is doing.
        pid: on its own machine; None until it has said so.
        task: what it runs.
        run: counts the runs of the pool.
        kill_at: when it is killed unless it stops by itself, on the clock of ``time.monotonic`` [s].
        jobs_done: how many it has answered.
        rss_bytes: its memory after its last job.
        seen: how many events of the run were handed on.
        answer: the run's, while events are still on their way.
        born: when it was asked for [s].
    """

    def __init__(self, handle: Any) -> None:
        self.handle = handle
        self.state = WorkerState.STARTING
        self.pid: int | None = None
        self.task: Task | None = None
        self.run = 0
        self.kill_at: float | None = None
        self.jobs_done = 0
        self.rss_bytes = 0
        self.seen = 0
        self.answer: Answer | None = None
        self.born = time.monotonic()

    @property
    def is_up(self) -> bool:
        """Whether it works or could."""
        return self.state in (WorkerState.IDLE, WorkerState.BUSY)


class RaySupervisor(Overseer):
    """The thread that alone touches actors; Ray's own threads and others leave it messages.

    Attributes:
        actors: all that are not given up.
        restarts: how many died or were killed.
    """

    def __init__(self, target: int, settings: Settings, backlog: Backlog, *, disconnects: bool) -> None:
        super().__init__(backlog, "scopt-ray-pool")
        self.target = target
        self.actors: list[Actor] = []
        self.restarts = 0
        self._settings = settings
        self._disconnects = disconnects
        as_actor = ray.remote(num_cpus=1, max_restarts=0, max_concurrency=N_THREADS)
        self._class = as_actor(RayWorker)
        self._setup = pickle.dumps(WorkerSetup(settings.preload, settings.warm_up, settings.max_bytes))
        self._messages: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._runs = 0
        self._backoff = Backoff()
        self._thread.start()

    # What other threads may call.

    def wake(self) -> bool:
        """Have the thread look after everything now; False when it has ended."""
        self._messages.put(lambda: None)
        return not self._is_over

    def cancel(self, task: Task) -> None:
        """Have a job stopped that runs, or was begun and waits."""
        self._messages.put(lambda: self._stop(task, Ending.CANCELLED))

    @property
    def n_up(self) -> int:
        """How many actors work or could."""
        return sum(actor.is_up for actor in list(self.actors))

    # The thread.

    def _listen(self, wait_s: float | None) -> None:
        with suppress(queue.Empty):
            message = self._messages.get(timeout=wait_s)
            message()

    def _disband(self) -> None:
        self._is_over = True
        for actor in list(self.actors):
            self._give_up(actor)
        if self._disconnects:
            ray.shutdown()

    def _keep_house(self) -> float | None:
        now = time.monotonic()
        for task in self._backlog.take_late(now):
            self._stop(task, Ending.DEADLINE)
        for actor in list(self.actors):
            if actor.kill_at is not None and actor.kill_at <= now:
                self._lose_patience(actor)
            elif actor.state is WorkerState.STARTING and actor.born + self._settings.start_timeout_s <= now:
                self._give_up(actor)
                self._start_failed(
                    f"no actor was ready after {self._settings.start_timeout_s:g} s; has Ray a free CPU?"
                )
        self._keep_number()
        self._dispatch()
        times = [actor.kill_at for actor in self.actors]
        times += [a.born + self._settings.start_timeout_s for a in self.actors if a.state is WorkerState.STARTING]
        times += [self._backlog.next_deadline(), self._backoff.until if self._backoff.is_waiting else None]
        return min((max(0.0, at - time.monotonic()) for at in times if at is not None), default=None)

    def _keep_number(self) -> None:
        limit = self._settings.recycle_after
        idle = [actor for actor in self.actors if actor.state is not WorkerState.BUSY]
        surplus = idle[: max(0, len(self.actors) - self.target)]
        tired = [] if limit is None else [actor for actor in idle if actor.jobs_done >= limit]
        for actor in {id(actor): actor for actor in surplus + tired}.values():
            self._give_up(actor)
        if not self._backoff.is_waiting:
            for _ in range(self.target - len(self.actors)):
                self._start()

    # Actors.

    def _start(self) -> None:
        actor = Actor(self._class.remote(self._setup))
        self.actors.append(actor)
        self._hear(actor.handle.born.remote(), lambda f: self._on_born(actor, f))
        self._hear(actor.handle.hold.remote(), lambda f: self._on_ended(actor, f))

    def _hear(self, reference: Any, then: Callable[[Future[Any]], None]) -> None:
        """Have something done by this thread once a call has come back."""
        reference.future().add_done_callback(lambda future: self._messages.put(lambda: then(future)))

    def _on_born(self, actor: Actor, future: Future[int]) -> None:
        if future.exception() is not None:
            self._on_ended(actor, future)
        elif actor in self.actors:
            self._backoff.succeeded()
            actor.pid, actor.state = future.result(), WorkerState.IDLE
            self._tell_ready()

    def _on_ended(self, actor: Actor, future: Future[Any]) -> None:
        """An actor is no more; several calls to it tell so, and the first one counts."""
        if actor not in self.actors:
            return
        self._give_up(actor)
        said = str(future.exception()).strip()
        if actor.state is WorkerState.STARTING:
            self._start_failed(said)
        else:
            self.restarts += 1
            _LOG.warning("worker (pid %s) ended: %s", actor.pid, said)
        if actor.task is not None:
            self._desk.worker_died(actor.task, "lost", said[-1000:])

    def _give_up(self, actor: Actor) -> None:
        self.actors.remove(actor)
        try:
            ray.kill(actor.handle)
        except Exception as error:  # without a connection it ends with its cluster, or as soon as that misses this pool
            _LOG.warning("worker (pid %s) could not be killed: %s", actor.pid, error)

    def _start_failed(self, reason: str) -> None:
        _LOG.error("a worker could not be started: %s", reason)
        if self._backoff.failed() and self.n_up == 0:
            self._desk.give_up(reason)

    # Jobs.

    def _dispatch(self) -> None:
        for actor in [actor for actor in self.actors if actor.state is WorkerState.IDLE]:
            task = self._desk.next_task()
            if task is None:
                return
            self._runs += 1
            task.begin(actor.pid)
            actor.state, actor.task, actor.run, actor.seen, actor.answer = WorkerState.BUSY, task, self._runs, 0, None
            self._ask_to_run(actor, task)
            if task.on_event is not None:
                self._ask_for_events(actor)

    def _ask_to_run(self, actor: Actor, task: Task) -> None:
        run = actor.run
        reference = actor.handle.run.remote(run, task.payload, task.on_event is not None, time.monotonic())
        self._hear(reference, lambda future: self._on_answer(actor, run, future))

    def _ask_for_events(self, actor: Actor) -> None:
        run = actor.run
        reference = actor.handle.events.remote(run, actor.seen)
        self._hear(reference, lambda future: self._on_events(actor, run, future))

    def _on_events(self, actor: Actor, run: int, future: Future[list[bytes]]) -> None:
        if future.exception() is not None:
            self._on_ended(actor, future)
        elif actor.task is not None and actor.run == run:
            for event in future.result():
                actor.seen += 1
                self._desk.hand_on(actor.task, event)
            if actor.answer is None or actor.seen < actor.answer.n_events:
                self._ask_for_events(actor)
            else:
                self._answer(actor, actor.task, actor.answer)

    def _on_answer(self, actor: Actor, run: int, future: Future[Answer]) -> None:
        if future.exception() is not None:
            self._on_ended(actor, future)
        elif actor.task is not None and actor.run == run:
            answer = future.result()
            if actor.seen < answer.n_events:
                actor.answer = answer  # events that are still on their way come first
            else:
                self._answer(actor, actor.task, answer)

    def _answer(self, actor: Actor, task: Task, answer: Answer) -> None:
        actor.task, actor.kill_at, actor.state, actor.answer = None, None, WorkerState.IDLE, None
        actor.jobs_done, actor.rss_bytes = actor.jobs_done + 1, answer.rss_bytes
        if answer.kind is Kind.RETURNED:
            self._desk.returned(task, answer.payload)
        else:
            self._desk.raised(task, answer.payload)

    def _ask_to_stop(self, task: Task) -> bool:
        actor = next((actor for actor in self.actors if actor.task is task), None)
        if actor is not None:
            actor.kill_at = time.monotonic() + self._settings.grace_s
            actor.handle.stop.remote(actor.run)
        return actor is not None

    def _lose_patience(self, actor: Actor) -> None:
        """Kill the actor of a job that was asked to stop and did not."""
        task, actor.task = actor.task, None
        self.restarts += 1
        self._give_up(actor)
        if task is not None:
            self._desk.killed(task)
