"""Watch on the disk of the data folder: new work is refused while results cannot be stored."""

from __future__ import annotations

import asyncio
import shutil
from pathlib import Path

import structlog

from service.server.lifecycle import Health
from service.server.refusals import DISK_FULL
from service.store import CloudStore, DiskError, Store

_LOG = structlog.get_logger("scopt.server")
CHECK_EVERY_S = 0.5
LEAST_FREE_BYTES = 32 * 2**20  # for the files of running plans once no more are accepted


class DiskWatch:
    """Periodic check of free space, and of stores whose last write failed; checkpoints of the store.

    Args:
        data: folder of the stores.
        store: store of plans and scenes.
        clouds: store of uploads.
        health: set to NOT_SERVING while nothing can be stored.
    """

    def __init__(self, data: Path, store: Store, clouds: CloudStore, health: Health) -> None:
        self._data = data
        self._store = store
        self._clouds = clouds
        self._health = health
        self._problem = ""

    def require_space(self) -> None:
        """Refuse work whose result could not be stored.

        Raises:
            Refusal: UNAVAILABLE.
        """
        if self._problem or self._store.write_error or self._clouds.write_error:
            raise DISK_FULL

    async def watch(self) -> None:
        """Check periodically until cancelled."""
        while True:
            self._report(await asyncio.to_thread(self._find_problem))
            await asyncio.sleep(CHECK_EVERY_S)

    def _find_problem(self) -> str:
        """Return what is wrong, or an empty text; a store whose last write failed is tried again."""
        try:
            free = shutil.disk_usage(self._data).free
            if free < LEAST_FREE_BYTES:
                return f"{self._data}: {free / 2**20:.1f} MiB are free; {LEAST_FREE_BYTES / 2**20:g} MiB are needed"
            self._store.checkpoint()
            if self._store.write_error or self._clouds.write_error:
                self._store.probe()
                self._clouds.probe()
        except (DiskError, OSError) as error:
            return str(error)
        return ""

    def _report(self, problem: str) -> None:
        if problem and not self._problem:
            _LOG.error("results cannot be stored; new work is refused", reason=problem)
        elif self._problem and not problem:
            _LOG.info("results can be stored again")
        self._problem = problem
        self._health.set_ready("disk", not problem)
