"""The store of a server: what must outlive it, in one SQLite file and one folder of archives."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Self

from service.store.database import Database
from service.store.folder import HeldFolder
from service.store.plans import Plans
from service.store.records import StoreLimits, StoreStats
from service.store.reviews import Reviews
from service.store.scenes import Scenes

DATABASE_NAME = "store.sqlite3"
ARCHIVES_NAME = "archives"


class Store:
    """Plans, reviews and scenes; used from any thread, every call is one short transaction.

    A plan that has finished and a review survive the process from the moment the call has returned, whatever happens
    to it.  Opening takes the folder for this process alone.

    Args:
        folder: made when it is not there.
        limits: how much is kept.
        clock: seconds since 1970.

    Raises:
        StoreError: the folder is in use, damaged, or of another version.
    """

    def __init__(
        self, folder: Path, limits: StoreLimits | None = None, *, clock: Callable[[], float] = time.time
    ) -> None:
        limits = limits or StoreLimits()
        with ExitStack() as opened:
            opened.enter_context(HeldFolder(folder))
            self._archives = archives = opened.enter_context(HeldFolder(folder / ARCHIVES_NAME))
            self._database = Database(folder / DATABASE_NAME)
            opened.callback(self._database.close)
            self.plans = Plans(self._database, archives, limits, clock)
            self.reviews = Reviews(self._database, limits, clock)
            self.scenes = Scenes(self._database, limits, clock)
            self._opened = opened.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Let the folder go; the store cannot be used any more."""
        self._opened.close()

    @property
    def trouble(self) -> str:
        """Why something could not be written the last time; empty where it could."""
        return self._database.trouble or self._archives.trouble

    def probe(self) -> None:
        """Find out whether it can be written again.

        Raises:
            DiskError: it still cannot.
        """
        self._database.probe()
        self._archives.probe()

    def stats(self) -> StoreStats:
        """How full it is."""
        with self._database.transaction() as db:
            totals = {row["what"]: (row["n"], row["bytes"]) for row in db.execute("SELECT * FROM totals")}
        return StoreStats(*totals["plans"], *totals["scenes"])
