"""Settings of a server."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from service.request.tasks.kind import TaskSection
from service.request.tasks.registry import KINDS as TASK_KINDS
from service.store import CloudLimits, StoreLimits

KINDS = ("default", *(name for kind in TASK_KINDS for name in kind.counted_as), "scene", "detect", "verify", "simulate")
BUDGETS_S = {
    "default": TaskSection.effort_s,
    **{
        name: kind.section.effort_s
        for kind in TASK_KINDS
        for name in kind.counted_as
        if kind.section.effort_s != TaskSection.effort_s
    },
}
WORKER_BYTES = 8 * 2**30  # of address space, of which libraries and threads reserve far more than they use
MESSAGE_BYTES = 4 * 2**20
SMALL_BYTES = 64 * 2**10  # larger messages are read in a thread beside the event loop
MAX_STREAMS = 256  # open calls of one connection


@dataclass(frozen=True)
class ServerSettings:
    """Settings of a server apart from its endpoint.

    Attributes:
        data: folder of plans, scenes, reviews and clouds.
        workers: worker processes.
        spread: workers that one plan may use while they are otherwise idle.
        queue: waiting requests per worker.
        budgets_s: greatest time limit by kind of request (``default`` for the others).
        allowed: folders whose files requests may name.
        robots: folder of further robots, a subfolder each.
        drain_s: time for open requests after a signal to stop.
        message_bytes: greatest size of one message.
        worker_bytes: address space per worker; None for no limit.
    """

    data: Path
    workers: int = field(default_factory=lambda: max(1, (os.cpu_count() or 2)))
    spread: int = 1
    queue: int = 4
    budgets_s: Mapping[str, float] = field(default_factory=lambda: dict(BUDGETS_S))
    allowed: tuple[Path, ...] = ()
    robots: Path | None = None
    drain_s: float = 30.0
    worker_bytes: int | None = WORKER_BYTES
    message_bytes: int = MESSAGE_BYTES
    store_limits: StoreLimits = field(default_factory=StoreLimits)
    cloud_limits: CloudLimits = field(default_factory=CloudLimits)

    @property
    def queue_limit(self) -> int:
        """Greatest number of waiting requests."""
        return self.queue * self.workers

    def budget_s(self, kind: str) -> float:
        """Return the time that a kind of request may take [s]."""
        return self.budgets_s.get(kind, self.budgets_s["default"])
