"""The store's SQLite file: schema, transactions, and messages for its errors."""

from __future__ import annotations

import sqlite3
import threading
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from functools import cache
from pathlib import Path
from typing import Any

from service.store.errors import DamagedError, DiskError, StoreError
from service.store.folder import PARTIAL
from service.store.seals import LOCAL_COLUMNS, SEAL, compute_seal

VERSION = 3
EARLIER = (1, 2)  # versions that are read; the second is that of release 0.3.0
CHECKPOINT_WRITES, CHECKPOINT_BYTES = 2000, 32 * 2**20  # after which a checkpoint is due; of the write-ahead log
LATEST_CHECKPOINT_PAGES = 50_000  # of 4 KiB, after which a write makes it itself, since nobody else does
_APPLICATION_ID = 0x5C097001
DAMAGED_SEAL = "damaged"  # equals no seal
UNREADABLE_ROW = "a row of the store is damaged on this server's disk; its operator has to restore the store"

# Triggers keep ``totals``, so that limits are checked without counting rows.
_SCHEMA = """
CREATE TABLE plans (
    number INTEGER PRIMARY KEY,
    plan_id TEXT NOT NULL UNIQUE,
    client TEXT NOT NULL,
    request_id TEXT,
    request_sha256 TEXT NOT NULL,
    kind TEXT NOT NULL,
    state TEXT NOT NULL CHECK (state IN ('accepted', 'running', 'finished', 'lost')),
    why_lost TEXT NOT NULL DEFAULT '',
    verdict TEXT NOT NULL DEFAULT '',
    reply BLOB NOT NULL DEFAULT x'',
    plan_sha256 TEXT NOT NULL DEFAULT '',
    certificate_sha256 TEXT NOT NULL DEFAULT '',
    page_sha256 TEXT NOT NULL DEFAULT '',
    archive_sha256 TEXT NOT NULL DEFAULT '',
    archive_bytes INTEGER NOT NULL DEFAULT 0,
    bytes INTEGER NOT NULL DEFAULT 0,
    is_reviewed INTEGER NOT NULL DEFAULT 0,
    created REAL NOT NULL,
    finished REAL,
    request BLOB NOT NULL DEFAULT x'',
    deadline REAL,
    n_resumed INTEGER NOT NULL DEFAULT 0,
    reviews_seal TEXT NOT NULL DEFAULT '',
    seal TEXT NOT NULL DEFAULT '',
    UNIQUE (client, request_id)
) STRICT;
CREATE INDEX plans_by_age ON plans (is_reviewed, number) WHERE state IN ('finished', 'lost');
CREATE INDEX plans_open ON plans (number) WHERE state IN ('accepted', 'running');

CREATE TABLE reviews (
    number INTEGER PRIMARY KEY,
    plan_id TEXT NOT NULL REFERENCES plans (plan_id) ON DELETE CASCADE,
    plan_sha256 TEXT NOT NULL,
    certificate_sha256 TEXT NOT NULL,
    decision TEXT NOT NULL CHECK (decision IN ('ACCEPTED', 'REJECTED')),
    reviewer TEXT NOT NULL,
    comment TEXT NOT NULL,
    time REAL NOT NULL,
    page_sha256 TEXT NOT NULL DEFAULT '',
    approval BLOB NOT NULL DEFAULT x'',
    verdict TEXT NOT NULL DEFAULT '',
    expires REAL NOT NULL DEFAULT 0,
    seal TEXT NOT NULL
) STRICT;
CREATE INDEX reviews_of_plan ON reviews (plan_id, number);
CREATE TRIGGER reviews_stay BEFORE UPDATE ON reviews BEGIN SELECT raise(ABORT, 'a review never changes'); END;

CREATE TABLE scenes (
    scene_id TEXT PRIMARY KEY,
    client TEXT NOT NULL,
    data BLOB NOT NULL,
    created REAL NOT NULL,
    used REAL NOT NULL
) STRICT;
CREATE INDEX scenes_by_use ON scenes (used);

CREATE TABLE totals (what TEXT PRIMARY KEY, n INTEGER NOT NULL, bytes INTEGER NOT NULL) STRICT;
INSERT INTO totals VALUES ('plans', 0, 0), ('scenes', 0, 0);
CREATE TRIGGER plan_in AFTER INSERT ON plans BEGIN
    UPDATE totals SET n = n + 1, bytes = bytes + new.bytes WHERE what = 'plans'; END;
CREATE TRIGGER plan_grows AFTER UPDATE OF bytes ON plans BEGIN
    UPDATE totals SET bytes = bytes + new.bytes - old.bytes WHERE what = 'plans'; END;
CREATE TRIGGER plan_out AFTER DELETE ON plans BEGIN
    UPDATE totals SET n = n - 1, bytes = bytes - old.bytes WHERE what = 'plans'; END;
CREATE TRIGGER scene_in AFTER INSERT ON scenes BEGIN
    UPDATE totals SET n = n + 1, bytes = bytes + length(new.data) WHERE what = 'scenes'; END;
CREATE TRIGGER scene_changes AFTER UPDATE OF data ON scenes BEGIN
    UPDATE totals SET bytes = bytes + length(new.data) - length(old.data) WHERE what = 'scenes'; END;
CREATE TRIGGER scene_out AFTER DELETE ON scenes BEGIN
    UPDATE totals SET n = n - 1, bytes = bytes - length(old.data) WHERE what = 'scenes'; END;
"""


class Database:
    """One connection for all threads, which use it in turn; every write is part of a transaction.

    Raises:
        StoreError: the file is damaged, of another version or application, or cannot be opened.

    Attributes:
        write_error: reason why the last write failed; empty if it succeeded.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.write_error = ""
        self._lock = threading.RLock()
        self._copying = threading.Lock()  # of the log; taken before the other one
        self._n_changes = 0  # rows that were changed before the last checkpoint
        with self._convert_errors():
            if not path.exists():
                self._create()
            elif path.stat().st_size:
                self._migrate()
            self._connection = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
        try:
            with self._convert_errors():
                self._prepare()
        except BaseException:
            self._connection.close()
            raise

    def close(self) -> None:
        """Write everything to the file and close it."""
        with self._lock:
            self._connection.close()

    def probe(self) -> None:
        """Write without a change, and clear ``write_error`` if that succeeds.

        Raises:
            DiskError: the file cannot be written.
        """
        with self.transaction() as db:
            db.execute("UPDATE totals SET n = n")
        self.write_error = ""

    def checkpoint(self) -> None:
        """Copy the write-ahead log into the database if enough has been written; transactions do not wait for it.

        To be called periodically, in a thread: a checkpoint waits for the disk.

        Raises:
            DiskError: the file cannot be written.
        """
        n_changes = self._connection.total_changes
        n_new = n_changes - self._n_changes
        if n_new < CHECKPOINT_WRITES and not (n_new and self._log_bytes() > CHECKPOINT_BYTES):
            return
        with self._copying, self._convert_errors(is_open=True):
            self._copy_log()
        self._n_changes = n_changes

    def _copy_log(self) -> None:
        """Copy the write-ahead log into the database with a connection of its own, for which nobody has to wait."""
        with closing(sqlite3.connect(self.path, isolation_level=None)) as connection:
            connection.execute("PRAGMA synchronous = NORMAL")
            connection.execute("PRAGMA wal_checkpoint(PASSIVE)").fetchall()

    def _empty_log(self) -> None:
        """Copy the write-ahead log into the database and cut it to nothing."""
        with self._copying, self._convert_errors(is_open=True):
            self._copy_log()  # waits for the disk
            with self._lock:
                self._connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()

    def _log_bytes(self) -> int:
        try:
            return self.path.with_name(f"{self.path.name}-wal").stat().st_size
        except OSError:
            return 0

    @contextmanager
    def reading(self) -> Iterator[sqlite3.Connection]:
        """Read; nothing is written meanwhile, since every write has the same lock."""
        with self._lock, self._convert_errors(is_open=True):
            yield self._connection

    @contextmanager
    def transaction(self, *, durable: bool = False) -> Iterator[sqlite3.Connection]:
        """Make changes that happen all or not at all, and survive the process as soon as the body has ended.

        Args:
            durable: wait for the disk, so that they survive a power cut, too. They are then in the database itself,
                whose rows have seals: a damaged write-ahead log would be cut at the damage without a word. If that
                fails, they have been made nevertheless.
        """
        with self._lock, self._convert_errors(is_open=True):
            self._connection.execute("BEGIN IMMEDIATE")
            try:
                yield self._connection
                self._connection.execute("COMMIT")
            except BaseException:
                if self._connection.in_transaction:
                    self._connection.execute("ROLLBACK")
                raise
        if durable:
            self._empty_log()

    def _create(self) -> None:
        """Create the file under another name first, so that a kill leaves no incomplete one."""
        self._make_partial().rename(self.path)

    def _make_partial(self) -> Path:
        """Write an empty database under another name; returns its path."""
        partial = self.path.with_name(f"{PARTIAL}{self.path.name}")
        partial.unlink(missing_ok=True)
        with closing(sqlite3.connect(partial)) as connection:
            marks = f"PRAGMA application_id = {_APPLICATION_ID}; PRAGMA user_version = {VERSION};"
            connection.executescript(f"BEGIN; {_SCHEMA} {marks} COMMIT;")
        return partial

    def _migrate(self) -> None:
        """Copy a database of an earlier version into one of this version, which replaces it as a whole.

        The earlier one is kept under another name, for a return to the version of scopt that wrote it.
        """
        with closing(sqlite3.connect(self.path)) as old:
            marks = [old.execute(f"PRAGMA {name}").fetchone()[0] for name in ("application_id", "user_version")]
            application, version = marks
            if application != _APPLICATION_ID or version not in EARLIER:
                return
            old.execute("PRAGMA journal_mode = DELETE")  # everything is in the one file that is replaced
        partial = self._make_partial()
        with closing(sqlite3.connect(partial, isolation_level=None)) as new:
            new.row_factory = sqlite3.Row
            new.execute("ATTACH ? AS old", (str(self.path),))
            new.execute("BEGIN")
            for table in ("plans", "scenes"):
                names = ", ".join(row["name"] for row in new.execute(f"PRAGMA old.table_info({table})"))
                new.execute(f"INSERT INTO {table} ({names}) SELECT {names} FROM old.{table}")
            for plan in new.execute("SELECT * FROM old.plans").fetchall():
                _migrate_plan(new, dict(plan), has_seals=version > 1)
            new.execute("COMMIT")
        kept = self.path.with_name(f"{self.path.name}.version-{version}")
        kept.unlink(missing_ok=True)
        kept.hardlink_to(self.path)
        partial.rename(self.path)

    def _prepare(self) -> None:
        execute = self._connection.execute
        self._connection.row_factory = sqlite3.Row
        (application,), (version,) = (
            execute(f"PRAGMA {name}").fetchone() for name in ("application_id", "user_version")
        )
        if not self.path.stat().st_size:
            raise StoreError(self._damage("it is empty"))
        if application != _APPLICATION_ID:
            raise StoreError(f"{self.path}: is the database of another application; choose another folder")
        if version != VERSION:
            raise StoreError(
                f"{self.path}: expected version {VERSION}, got {version}; "
                "use the version of scopt that wrote it, or move the folder away to begin with an empty store"
            )
        if execute("PRAGMA journal_mode = WAL").fetchone()[0] != "wal":
            raise StoreError(f"{self.path}: its file system has no shared memory; use a local disk")
        for setting in (
            "synchronous = NORMAL",
            "foreign_keys = ON",
            "journal_size_limit = 8388608",
            f"wal_autocheckpoint = {LATEST_CHECKPOINT_PAGES}",
        ):
            execute(f"PRAGMA {setting}")
        report = execute("PRAGMA quick_check(1)").fetchone()[0]
        if report != "ok":
            raise StoreError(self._damage(report))
        if self._read_schema(self._connection) != _expected_schema():
            raise StoreError(self._damage("its tables are not those that scopt made"))

    @staticmethod
    def _read_schema(connection: sqlite3.Connection) -> list[tuple[str, ...]]:
        rows = connection.execute("SELECT type, name, tbl_name, ifnull(sql, '') FROM sqlite_master ORDER BY type, name")
        return [tuple(row) for row in rows]

    @contextmanager
    def _convert_errors(self, is_open: bool = False) -> Iterator[None]:
        try:
            yield
        except UnicodeDecodeError:  # sqlite3 quotes a damaged schema in its own error
            raise StoreError(self._damage("its schema is no text")) from None
        except sqlite3.DatabaseError as error:
            code = getattr(error, "sqlite_errorcode", 0) & 0xFF
            if code in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB):
                damage = self._damage(str(error))
                raise (DamagedError(UNREADABLE_ROW, damage) if is_open else StoreError(damage)) from None
            if code in (sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR, sqlite3.SQLITE_READONLY, sqlite3.SQLITE_CANTOPEN):
                self.write_error = f"{self.path}: cannot be written ({error}); check its disk"
                raise DiskError(self.write_error) from None
            if isinstance(error, sqlite3.OperationalError) and "decode" in str(error):  # text that is no UTF-8
                raise DamagedError(UNREADABLE_ROW) from None
            raise

    def _damage(self, report: str) -> str:
        text = " ".join(report.split())
        return f"{self.path}: is damaged ({text}); restore it, or move the folder away to begin with an empty store"


def seal_plan(db: sqlite3.Connection, plan_id: str) -> None:
    """Set the seal of a plan's row after a change of it."""
    row = db.execute("SELECT * FROM plans WHERE plan_id = ?", (plan_id,)).fetchone()
    db.execute("UPDATE plans SET seal = ? WHERE plan_id = ?", (compute_seal(dict(row)), plan_id))


def insert_review(db: sqlite3.Connection, review: Mapping[str, Any]) -> None:
    """Add a review (value by column) behind the earlier ones of its plan; ``seal_plan`` has to follow."""
    plan_id = review["plan_id"]
    (previous,) = db.execute("SELECT reviews_seal FROM plans WHERE plan_id = ?", (plan_id,)).fetchone()
    complete = {"page_sha256": "", "approval": b"", "verdict": "", "expires": 0.0, **review}
    values = {**complete, "seal": compute_seal(complete, previous)}
    names = ", ".join(values)
    db.execute(f"INSERT INTO reviews ({names}) VALUES ({', '.join('?' * len(values))})", tuple(values.values()))
    db.execute("UPDATE plans SET is_reviewed = 1, reviews_seal = ? WHERE plan_id = ?", (values["seal"], plan_id))


def _migrate_plan(new: sqlite3.Connection, plan: Mapping[str, Any], *, has_seals: bool) -> None:
    """Copy the reviews of a plan of an earlier version and seal both; a row that was damaged stays damaged.

    Args:
        new: the new database, with the plans copied and the earlier one attached as ``old``.
        plan: row of the earlier database.
        has_seals: whether the earlier version sealed its rows.
    """
    plan_id, is_whole, seal = plan["plan_id"], True, ""
    new.execute("UPDATE plans SET reviews_seal = '' WHERE plan_id = ?", (plan_id,))
    for row in new.execute("SELECT * FROM old.reviews WHERE plan_id = ? ORDER BY number", (plan_id,)).fetchall():
        if has_seals:
            seal = compute_seal(dict(row), seal)
            is_whole = is_whole and seal == row[SEAL]
        insert_review(new, {name: value for name, value in dict(row).items() if name not in LOCAL_COLUMNS})
    if has_seals and not (is_whole and seal == plan["reviews_seal"]):
        new.execute("UPDATE plans SET reviews_seal = ? WHERE plan_id = ?", (DAMAGED_SEAL, plan_id))
    if not has_seals or compute_seal(plan) == plan[SEAL]:
        seal_plan(new, plan_id)


@cache
def _expected_schema() -> list[tuple[str, ...]]:
    with closing(sqlite3.connect(":memory:")) as connection:
        connection.executescript(_SCHEMA)
        return Database._read_schema(connection)
