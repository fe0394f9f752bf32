"""The thread behind a pool, wherever its workers are: what must be done, in turn with what is heard, to the end."""

from __future__ import annotations

import logging
import threading
from abc import ABC, abstractmethod

from service.executor.backlog import Backlog, Ending, Task
from service.executor.desk import Desk
from service.executor.errors import ExecutorError

_LOG = logging.getLogger("service.executor")


class Overseer(ABC):
    """One thread, which alone touches workers; others leave wishes and read figures.

    Attributes:
        target: how many workers there shall be.
    """

    target: int

    def __init__(self, backlog: Backlog, name: str) -> None:
        self._backlog = backlog
        self._desk = Desk(backlog)
        self._is_closing = self._is_over = False
        self._ready = threading.Condition()
        self._thread = threading.Thread(target=self._work, name=name, daemon=True)

    # What other threads may call.

    @property
    @abstractmethod
    def n_up(self) -> int:
        """How many workers are up."""

    @abstractmethod
    def wake(self) -> bool:
        """Have the thread look after everything now; False when it has ended."""

    def close(self, wait: bool) -> None:
        """End once all jobs are answered."""
        self._is_closing = True
        self.wake()
        if wait:
            self._thread.join()

    def wait_ready(self, timeout: float | None) -> bool:
        """Wait until all workers are up; whether they are."""
        with self._ready:
            self._ready.wait_for(lambda: self._is_over or self.n_up >= self.target, timeout)
            return not self._is_over and self.n_up >= self.target

    # The thread.

    @abstractmethod
    def _keep_house(self) -> float | None:
        """Do all that is due; how long there is nothing to do then [s]."""

    @abstractmethod
    def _listen(self, wait_s: float | None) -> None:
        """Hear what workers and other threads say, or that nobody does for so long."""

    @abstractmethod
    def _disband(self) -> None:
        """End the workers; whoever wants to wake the thread is told from now on that it has ended."""

    @abstractmethod
    def _ask_to_stop(self, task: Task) -> bool:
        """Ask the worker of a task to stop; whether there is one."""

    def _work(self) -> None:
        try:
            while not (self._is_closing and not self._backlog.open):
                self._listen(self._keep_house())
        except BaseException:
            _LOG.critical("the pool's supervisor failed", exc_info=True)
        finally:
            self._disband()
            for task in self._backlog.all_open():  # none, unless this thread failed
                self._desk.fail(task, ExecutorError("the pool failed; its log says why"))
            self._tell_ready()

    def _tell_ready(self) -> None:
        """Have those who wait for workers look."""
        with self._ready:
            self._ready.notify_all()

    def _stop(self, task: Task, ending: Ending) -> None:
        """Ask a job to stop, or let it never begin."""
        if not self._desk.drop(task, ending) and task.ending is None and self._ask_to_stop(task):
            task.ending = ending
