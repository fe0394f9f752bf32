"""Where jobs get their answers, each exactly once, whoever ran them."""

from __future__ import annotations

import logging
import pickle
import time
from collections.abc import Callable

from service.executor.backlog import Backlog, Ending, Task
from service.executor.errors import DeadlineExceeded, ExecutorError, JobCancelled, JobFailed, WorkerDied

_LOG = logging.getLogger("service.executor")

_KILLED: dict[Ending, Callable[[], ExecutorError]] = {
    Ending.CANCELLED: lambda: JobCancelled("cancelled; it did not stop by itself and was ended"),
    Ending.DEADLINE: lambda: DeadlineExceeded("the deadline passed; it did not stop by itself and was ended"),
}

_STOPPED: dict[Ending, Callable[[], ExecutorError]] = {
    Ending.CANCELLED: lambda: JobCancelled("cancelled; it stopped by itself"),
    Ending.DEADLINE: lambda: DeadlineExceeded("the deadline passed; it stopped by itself"),
}


class Desk:
    """Answers a backlog's tasks; of one thread, but for callers that cancel what has not begun."""

    def __init__(self, backlog: Backlog) -> None:
        self._backlog = backlog

    def next_task(self) -> Task | None:
        """The next task that is still wanted and not too late."""
        while (task := self._backlog.take()) is not None:
            if not self._begins(task):
                continue
            if task.job.deadline is None or task.job.deadline > time.monotonic():
                return task
            self.fail(task, _unbegun(task, Ending.DEADLINE))
        return None

    def drop(self, task: Task, ending: Ending) -> bool:
        """End a task that waits; False when it does not."""
        if not self._backlog.withdraw(task):
            return False
        if self._begins(task):
            self.fail(task, _unbegun(task, ending))
        return True

    def give_up(self, reason: str) -> None:
        """End all tasks that wait, since nobody is there to run them."""
        for task in self._backlog.all_queued():
            if self._backlog.withdraw(task) and self._begins(task):
                self.fail(task, WorkerDied("none could be started", task.job.attempts, reason[-1000:]))

    def returned(self, task: Task, payload: bytes | bytearray) -> None:
        """Answer with a pickled result."""
        try:
            result = pickle.loads(payload)
        except Exception as error:
            self.fail(task, _unreadable(error))
            return
        task.job.set_result(result)
        self._backlog.answered(task)

    def raised(self, task: Task, payload: bytes | bytearray) -> None:
        """Answer with an exception as ``worker.carried`` writes it."""
        try:
            error, said, trace = pickle.loads(payload)
        except Exception as unread:
            self.fail(task, _unreadable(unread))
            return
        if isinstance(error, JobCancelled):
            error = None if task.ending is None else _STOPPED[task.ending]()
        raised: Exception = JobFailed(said) if error is None else error
        raised.__cause__ = RemoteTraceback(trace)
        self.fail(task, raised)

    def killed(self, task: Task) -> None:
        """Answer a task whose worker was killed because it did not stop."""
        if task.ending is None:  # a worker's word alone ends no job without an answer
            self.fail(task, ExecutorError("ended although it was not asked to stop"))
        else:
            self.fail(task, _KILLED[task.ending]())

    def worker_died(self, task: Task, how: str, said: str) -> None:
        """Have a task begun again before all others, if it may be."""
        if task.ending is not None:
            self.killed(task)
        elif task.job.attempts >= task.max_attempts:
            self.fail(task, WorkerDied(how, task.job.attempts, said))
        else:
            self._backlog.put_back(task)

    def fail(self, task: Task, error: Exception) -> None:
        """Answer with an exception, unless there is an answer."""
        if not task.job.done():
            task.job.set_exception(error)
        self._backlog.answered(task)

    def hand_on(self, task: Task, payload: bytes | bytearray) -> None:
        """Give the caller an event; what is wrong with that is logged, since the job goes on."""
        if task.on_event is None:
            return
        try:
            task.on_event(pickle.loads(payload))
        except Exception:
            _LOG.exception("an event of job %d could not be handed on", task.job.number)

    def _begins(self, task: Task) -> bool:
        """Whether a task that waited is still wanted; it cannot be cancelled on the quiet from now on."""
        if task.job.attempts or task.job.set_running_or_notify_cancel():
            return True
        self._backlog.answered(task)
        return False


class RemoteTraceback(Exception):  # noqa: N818
    """The traceback of an exception that was raised in a worker."""

    def __init__(self, trace: str) -> None:
        super().__init__(trace)
        self.trace = trace

    def __str__(self) -> str:
        return f"\n{self.trace}"


def _unreadable(error: Exception) -> JobFailed:
    return JobFailed(f"its answer cannot be read here: {type(error).__name__}: {error}")


def _unbegun(task: Task, ending: Ending) -> ExecutorError:
    if ending is Ending.CANCELLED:
        return JobCancelled("cancelled while it waited for another worker")
    return DeadlineExceeded(f"the deadline passed while it waited, begun {task.job.attempts} times")
