"""How a job ends when its function neither returned nor raised."""

from __future__ import annotations

from concurrent.futures import CancelledError


class ExecutorError(Exception):
    """Base of all errors of executors."""


class PoolClosed(ExecutorError, RuntimeError):  # noqa: N818 - named for what is the case
    """The executor takes no more jobs."""


class JobCancelled(ExecutorError, CancelledError):  # noqa: N818
    """The job was cancelled while it ran: its function raised this, or did not stop and its worker was killed."""


class DeadlineExceeded(ExecutorError):  # noqa: N818
    """The deadline passed before the job began, or while it ran and had no result to hand over."""


class JobFailed(ExecutorError):  # noqa: N818
    """The function raised or returned what cannot be carried between processes; the text says what it was."""


class WorkerDied(ExecutorError):  # noqa: N818
    """Every worker that ran the job died of it, or no worker could be started.

    Attributes:
        how: what ended the last of them: a signal's name, ``exit 3``, ``lost``.
        attempts: how often the job was begun.
        said: the end of what the last one wrote to its standard error.
    """

    def __init__(self, how: str, attempts: int, said: str = "") -> None:
        super().__init__(how, attempts, said)
        self.how, self.attempts, self.said = how, attempts, said

    def __str__(self) -> str:
        begun = f"begun {self.attempts} time{'' if self.attempts == 1 else 's'}"
        said = f"; it said: {self.said}" if self.said else ""
        return f"worker ended ({self.how}), job {begun}{said}"
