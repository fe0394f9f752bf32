"""Executors that run functions in worker processes: jobs can be cancelled, report events and survive dead workers."""

from service.executor.errors import (
    DeadlineExceeded,
    ExecutorError,
    JobCancelled,
    JobFailed,
    PoolClosed,
    WorkerDied,
)
from service.executor.interface import (
    CancellableExecutor,
    Control,
    Job,
    OnEvent,
    PoolStats,
    WorkerState,
    WorkerStats,
)
from service.executor.local_pool import LocalPool

__all__ = [
    "CancellableExecutor",
    "Control",
    "DeadlineExceeded",
    "ExecutorError",
    "Job",
    "JobCancelled",
    "JobFailed",
    "LocalPool",
    "OnEvent",
    "PoolClosed",
    "PoolStats",
    "WorkerDied",
    "WorkerState",
    "WorkerStats",
]
