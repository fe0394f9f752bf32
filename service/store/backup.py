"""Copy of a server's data folder, also while the server runs."""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from service.store.database import VERSION
from service.store.errors import StoreError
from service.store.folder import LOCK_NAME, PARTIAL
from service.store.seals import hash_file
from service.store.store import ARCHIVES_NAME, DATABASE_NAME

PLANS_NAME = "plans"  # folder of the store in a server's data


@dataclass(frozen=True)
class Backup:
    """What a backup holds.

    Attributes:
        n_plans, n_reviews, n_scenes: rows of the database.
        n_files: archives, clouds and other files.
        n_bytes: of all files.
        damaged: plans whose archive is missing or is not what was stored.
    """

    n_plans: int
    n_reviews: int
    n_scenes: int
    n_files: int
    n_bytes: int
    damaged: tuple[str, ...]


def back_up(data: Path, target: Path) -> Backup:
    """Copy a data folder into a new folder, which a server can use as its own.

    The database is copied as it was at one moment, then the archives of its plans; files that are being written are
    left out.  The new folder has its name only once it is complete.

    Raises:
        StoreError: no store of this version, a target that exists, or a file that cannot be copied; nothing is changed.
    """
    source = require_store(data) / DATABASE_NAME
    if target.exists():
        raise StoreError(f"{target}: exists already; expected the name of a new folder")
    if target.resolve().is_relative_to(data.resolve()):
        raise StoreError(f"{target}: lies in the folder that is copied; expected a place outside of it")
    partial = target.with_name(f"{PARTIAL}{target.name}")
    try:
        shutil.rmtree(partial, ignore_errors=True)
        (partial / PLANS_NAME).mkdir(parents=True, mode=0o700)
        copied = partial / PLANS_NAME / DATABASE_NAME
        _copy_database(source, copied)
        damaged = tuple(_copy_files(data, partial, copied))
        made = _count(partial, copied, damaged)
        partial.rename(target)
        return made
    except (OSError, sqlite3.DatabaseError) as error:
        raise StoreError(f"{data}: cannot be copied to {target} ({error})") from None
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def require_store(data: Path) -> Path:
    """Return the folder of the store in a server's data (StoreError: it has none)."""
    if not (data / PLANS_NAME / DATABASE_NAME).is_file():
        raise StoreError(f"{data}: has no {PLANS_NAME}/{DATABASE_NAME}; expected the folder of scopt serve --data")
    return data / PLANS_NAME


def _copy_database(source: Path, target: Path) -> None:
    """Copy the database as it is now.

    Raises:
        StoreError: it is of another version, or damaged.
    """
    with (
        closing(sqlite3.connect(f"{source.absolute().as_uri()}?mode=ro", uri=True)) as old,
        closing(sqlite3.connect(target)) as new,
    ):
        (version,) = old.execute("PRAGMA user_version").fetchone()
        if version != VERSION:
            raise StoreError(f"{source}: expected version {VERSION}, got {version}; use the scopt that wrote it")
        old.backup(new)
        (report,) = new.execute("PRAGMA quick_check(1)").fetchone()
        if report != "ok":
            raise StoreError(f"{source}: is damaged ({report}); nothing was copied")
        new.execute("PRAGMA journal_mode = DELETE")


def _copy_files(data: Path, partial: Path, database: Path) -> Iterator[str]:
    """Copy archives of the copied plans, and all files outside the store; yield plans whose archive is damaged."""
    archives = partial / PLANS_NAME / ARCHIVES_NAME
    archives.mkdir(mode=0o700)
    with closing(sqlite3.connect(database)) as db:
        rows = db.execute("SELECT plan_id, archive_sha256 FROM plans WHERE archive_bytes > 0").fetchall()
    for plan_id, sha256 in rows:
        source = data / PLANS_NAME / ARCHIVES_NAME / plan_id
        if source.is_file():
            shutil.copy2(source, archives / plan_id)
        if not source.is_file() or (sha256 and hash_file(archives / plan_id) != sha256):
            yield plan_id
    for source in sorted(data.rglob("*")):
        own = source.relative_to(data)
        is_left_out = source.name == LOCK_NAME or source.name.startswith(PARTIAL) or own.parts[0] == PLANS_NAME
        if source.is_file() and not source.is_symlink() and not is_left_out:
            (partial / own).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(source, partial / own)


def _count(partial: Path, database: Path, damaged: tuple[str, ...]) -> Backup:
    with closing(sqlite3.connect(database)) as db:
        rows = [
            int(db.execute(f"SELECT count(*) FROM {table}").fetchone()[0]) for table in ("plans", "reviews", "scenes")
        ]
    files = [path for path in partial.rglob("*") if path.is_file()]
    return Backup(rows[0], rows[1], rows[2], len(files) - 1, sum(path.stat().st_size for path in files), damaged)
