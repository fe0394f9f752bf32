"""Errors of an executor: how a job ends whose function neither returned nor raised."""

from __future__ import annotations

from concurrent.futures import CancelledError


class ExecutorError(Exception):
    """Base of all errors of executors."""


class PoolClosed(ExecutorError, RuntimeError):  # noqa: N818 - named for the state
    """The executor takes no more jobs."""


class JobCancelled(ExecutorError, CancelledError):  # noqa: N818
    """The job was cancelled while it ran: its function raised this, or its worker was killed."""


class DeadlineExceeded(ExecutorError):  # noqa: N818
    """The deadline passed before the job started, or while it ran and it returned no result."""


class JobFailed(ExecutorError):  # noqa: N818
    """The function raised or returned something that cannot be pickled; the text describes it."""


class WorkerDied(ExecutorError):  # noqa: N818
    """Each worker that ran the job died, or no worker could be started.

    Attributes:
        cause: what ended the last worker: a signal's name, ``exit 3``, ``lost``.
        attempts: how often the job was started.
        last_output: the end of the last worker's standard error.
    """

    def __init__(self, cause: str, attempts: int, last_output: str = "") -> None:
        super().__init__(cause, attempts, last_output)
        self.cause, self.attempts, self.last_output = cause, attempts, last_output

    def __str__(self) -> str:
        times = f"{self.attempts} time{'' if self.attempts == 1 else 's'}"
        output = f"; its last output: {self.last_output}" if self.last_output else ""
        return f"worker ended ({self.cause}), job started {times}{output}"
