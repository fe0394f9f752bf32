"""Whether there is room to keep what is worked out: a full disk keeps new work out until there is room again."""

from __future__ import annotations

import asyncio
import shutil
from pathlib import Path

import grpc
import structlog

from service.server.health import Health
from service.store import CloudStore, DiskError, Store
from service.trust.rpc import Refusal

_LOG = structlog.get_logger("scopt.server")
LOOK_EVERY_S = 0.5
LEAST_FREE_BYTES = 32 * 2**20  # for the files of what is under way when no more is let in
NO_ROOM = Refusal(
    grpc.StatusCode.UNAVAILABLE,
    "the server's disk takes no more, so that nothing new could be kept; try another server, or later",
)


class Disk:
    """Looks at the disk now and then, and at once where something could not be written.

    Args:
        data: the folder that all is kept in.
        store, clouds: that keep it.
        health: told when nothing new can be taken in, and when that is over.
    """

    def __init__(self, data: Path, store: Store, clouds: CloudStore, health: Health) -> None:
        self._data = data
        self._store = store
        self._clouds = clouds
        self._health = health
        self._problem = ""

    def check(self) -> None:
        """Keep out what could not be kept.

        Raises:
            Refusal: UNAVAILABLE.
        """
        if self._problem or self._store.trouble or self._clouds.trouble:
            raise NO_ROOM

    async def watch(self) -> None:
        """Look until cancelled."""
        while True:
            self._tell(await asyncio.to_thread(self._look))
            await asyncio.sleep(LOOK_EVERY_S)

    def _look(self) -> str:
        """What is wrong; empty where nothing is. Where a write has failed, others are tried."""
        try:
            free = shutil.disk_usage(self._data).free
            if free < LEAST_FREE_BYTES:
                return f"{self._data}: {free / 2**20:.1f} MiB are free; {LEAST_FREE_BYTES / 2**20:g} MiB are needed"
            if self._store.trouble or self._clouds.trouble:
                self._store.probe()
                self._clouds.probe()
        except (DiskError, OSError) as error:
            return str(error)
        return ""

    def _tell(self, problem: str) -> None:
        if problem and not self._problem:
            _LOG.error("no room to keep what is worked out; nothing new is taken in", reason=problem)
        elif self._problem and not problem:
            _LOG.info("there is room again")
        self._problem = problem
        self._health.tell(is_serving=not problem)
