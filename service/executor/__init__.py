"""Executors that run functions in worker processes: jobs can be cancelled, report events and survive dead workers."""

from service.executor.job import (
    NOBODY,
    Control,
    DeadlineExceeded,
    ExecutorError,
    Job,
    JobCancelled,
    JobFailed,
    Lane,
    OnEvent,
    Place,
    PoolClosed,
    WorkerDied,
)
from service.executor.local_pool import LocalPool
from service.executor.pool import Pool, PoolStats, WorkerStats
from service.executor.worker_handle import WorkerState

__all__ = [
    "NOBODY",
    "Control",
    "DeadlineExceeded",
    "ExecutorError",
    "Job",
    "JobCancelled",
    "JobFailed",
    "Lane",
    "LocalPool",
    "OnEvent",
    "Place",
    "Pool",
    "PoolClosed",
    "PoolStats",
    "WorkerDied",
    "WorkerState",
    "WorkerStats",
]
