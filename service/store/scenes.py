"""Stored scenes, built once and used by many plans."""

from __future__ import annotations

import hashlib
import sqlite3
import tempfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from service.errors import shown
from service.store.database import Database
from service.store.errors import DamagedError, DiskError, NotStoredError, TooLargeError
from service.store.records import StoreLimits
from service.trust.folders import BUILT


class Scenes:
    """The scenes of a store, each stored once under the hash of its content."""

    def __init__(self, database: Database, limits: StoreLimits, clock: Callable[[], float]) -> None:
        self._database = database
        self._limits = limits
        self._clock = clock

    def put(self, client: str, data: bytes) -> str:
        """Store a scene; returns its id, ``scene:`` and the sha256 of ``data``.

        Raises:
            TooLargeError: it alone exceeds the store's limit.
        """
        scene_id = BUILT + hashlib.sha256(data).hexdigest()
        packed = zlib.compress(data, 3)
        if len(packed) > self._limits.max_scene_bytes:
            raise TooLargeError(
                f"a scene of {len(packed)} bytes; the store keeps {self._limits.max_scene_bytes} at most"
            )
        now = self._clock()
        with self._database.transaction() as db:
            db.execute(
                "INSERT INTO scenes (scene_id, client, data, created, used) VALUES (?, ?, ?, ?, ?) "
                "ON CONFLICT (scene_id) DO UPDATE SET used = excluded.used, data = excluded.data",
                (scene_id, client, packed, now, now),
            )
            self._make_space(db, scene_id)
        return scene_id

    def get(self, scene_id: str) -> bytes:
        """Return a scene's data.

        Raises:
            NotStoredError: no scene has this id.
            DamagedError: it is not what was stored; it is removed.
        """
        with self._database.reading() as db:
            row = db.execute("SELECT data FROM scenes WHERE scene_id = ?", (scene_id,)).fetchone()
        if row is None:
            raise NotStoredError(
                f"unknown scene {shown(scene_id)}; it was removed when the store was full, or never was"
            )
        data = _unpack(row["data"])
        is_sound = data is not None and BUILT + hashlib.sha256(data).hexdigest() == scene_id
        with suppress(DiskError), self._database.transaction() as db:  # a full disk can still be read
            if is_sound:
                db.execute("UPDATE scenes SET used = ? WHERE scene_id = ?", (self._clock(), scene_id))
            else:
                db.execute("DELETE FROM scenes WHERE scene_id = ?", (scene_id,))
        if data is None or not is_sound:
            raise DamagedError(
                f"scene {shown(scene_id)} was damaged on this server's disk and is removed; build it again"
            )
        return data

    def created(self, scene_id: str) -> float:
        """Return when a scene was built first [s since 1970] (NotStoredError: no scene has this id)."""
        with self._database.reading() as db:
            row = db.execute("SELECT created FROM scenes WHERE scene_id = ?", (scene_id,)).fetchone()
        if row is None:
            raise NotStoredError(f"unknown scene {shown(scene_id)}")
        return float(row["created"])

    def has(self, scene_id: str) -> bool:
        """Return whether a scene is stored."""
        with self._database.reading() as db:
            return db.execute("SELECT 1 FROM scenes WHERE scene_id = ?", (scene_id,)).fetchone() is not None

    @contextmanager
    def open_file(self, scene_id: str) -> Iterator[Path]:
        """Yield the path of a scene's file, which exists for the body.

        Raises:
            NotStoredError: no scene has this id.
            DamagedError: it is not what was stored.
        """
        data = self.get(scene_id)
        with tempfile.NamedTemporaryFile(prefix="scopt-", suffix=".json") as file:
            file.write(data)
            file.flush()
            yield Path(file.name)

    def _make_space(self, db: sqlite3.Connection, newest: str) -> None:
        n, size = db.execute("SELECT n, bytes FROM totals WHERE what = 'scenes'").fetchone()
        if n <= self._limits.max_scenes and size <= self._limits.max_scene_bytes:
            return
        deleted = []
        rows = db.execute(
            "SELECT scene_id, length(data) FROM scenes WHERE scene_id != ? ORDER BY used, rowid", (newest,)
        )
        for scene_id, n_bytes in rows:
            if n <= self._limits.max_scenes and size <= self._limits.max_scene_bytes:
                break
            n, size = n - 1, size - n_bytes
            deleted.append((scene_id,))
        db.executemany("DELETE FROM scenes WHERE scene_id = ?", deleted)


def _unpack(packed: bytes) -> bytes | None:
    try:
        return zlib.decompress(packed)
    except zlib.error:
        return None
