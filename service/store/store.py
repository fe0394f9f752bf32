"""The store of plans, reviews and scenes: one SQLite file and one folder of archives."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Self

from service.store.database import Database
from service.store.folder import LockedFolder
from service.store.lists import Lists
from service.store.plans import Plans
from service.store.records import StoreLimits, StoreStats
from service.store.reviews import Reviews
from service.store.scenes import Scenes

DATABASE_NAME = "store.sqlite3"
ARCHIVES_NAME = "archives"


class Store:
    """Plans, reviews and scenes, for use from any thread; every call is one short transaction.

    A finished plan and a review survive the process as soon as the call that stores them has returned. The folder
    belongs to one process at a time.

    Args:
        folder: created if missing.
        limits: limits of the store.
        clock: seconds since 1970.

    Raises:
        StoreError: the folder is in use, damaged, or of another version.
    """

    def __init__(
        self, folder: Path, limits: StoreLimits | None = None, *, clock: Callable[[], float] = time.time
    ) -> None:
        limits = limits or StoreLimits()
        with ExitStack() as stack:
            stack.enter_context(LockedFolder(folder))
            self._archives = archives = stack.enter_context(LockedFolder(folder / ARCHIVES_NAME))
            self._database = Database(folder / DATABASE_NAME)
            stack.callback(self._database.close)
            self.plans = Plans(self._database, archives, limits, clock)
            self.reviews = Reviews(self._database, self.plans, limits, clock)
            self.scenes = Scenes(self._database, limits, clock)
            self.lists = Lists(self._database, self.plans, self.reviews, clock)
            self._resources = stack.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the store and release its folder."""
        self._resources.close()

    @property
    def write_error(self) -> str:
        """Reason why the last write failed; empty if it succeeded."""
        return self._database.write_error or self._archives.write_error

    def probe(self) -> None:
        """Write to the store, and clear ``write_error`` if that succeeds.

        Raises:
            DiskError: it cannot be written.
        """
        self._database.probe()
        self._archives.probe()

    def checkpoint(self) -> None:
        """Move what was written into the database file if it is due; to be called periodically, in a thread.

        Raises:
            DiskError: the file cannot be written.
        """
        self._database.checkpoint()

    def stats(self) -> StoreStats:
        """Return number and size of the stored plans and scenes."""
        with self._database.reading() as db:
            totals = {row["what"]: (row["n"], row["bytes"]) for row in db.execute("SELECT * FROM totals")}
        return StoreStats(*totals["plans"], *totals["scenes"])
