"""What a server is told when it starts."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from service.store import CloudLimits, StoreLimits

KINDS = (
    "default", "valve", "door", "egress", "trajopt", "joint_goal", "pose_goal", "posture", "scene", "detect", "verify",
)  # fmt: skip
BUDGETS_S = {"default": 60.0, "egress": 300.0}
WORKER_BYTES = 8 * 2**30  # of address space: libraries and threads reserve far more than they use
MESSAGE_BYTES = 4 * 2**20
SMALL_BYTES = 64 * 2**10  # larger messages are read off the event loop
MOST_STREAMS = 256  # calls at a time over one connection


@dataclass(frozen=True)
class ServerSettings:
    """Everything but the transport's secrets.

    Attributes:
        data: folder for plans, scenes, reviews and clouds.
        workers: processes that plan.
        spread: workers that may be at one plan, while nobody else needs them.
        queue: requests that may wait for each of them.
        budgets_s: greatest ``options.time_limit_s`` by kind of request (``default`` for the others).
        allowed: folders from which requests may name files.
        robots: folder of further robots, a subfolder each.
        drain_s: after a signal to stop, for what is under way.
        message_bytes: of one message; larger ones never reach the service.
        worker_bytes: of address space each worker may have; None for no limit.
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
        """Requests that may wait in all."""
        return self.queue * self.workers

    def budget_s(self, kind: str) -> float:
        """Seconds that a kind of request may take."""
        return self.budgets_s.get(kind, self.budgets_s["default"])
