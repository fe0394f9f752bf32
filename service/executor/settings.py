"""What pools are made with."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Settings:
    """What a pool is made with.

    Attributes:
        warm_up: called once in each worker before it takes jobs.
        preload: modules to import before that.
        grace_s: from asking a job to stop to killing its worker [s].
        max_bytes: address space of a worker; None for no limit.
        recycle_after: jobs after which a worker is replaced; None for never.
        start_timeout_s: in which modules are imported, and in which a worker becomes ready [s].
    """

    warm_up: Callable[[], object] | None = None
    preload: tuple[str, ...] = ()
    grace_s: float = 0.25
    max_bytes: int | None = None
    recycle_after: int | None = None
    start_timeout_s: float = 120.0
