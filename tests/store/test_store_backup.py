"""Backups of a store that is in use, and retention: nothing that was confirmed is missing or kept too long."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
from earlier_results import unpack

from service.store import Store, StoreError
from service.store.backup import back_up


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """The data folder of a server, of this version, with a plan that was accepted and one without files."""
    folder = unpack("0.3.0", "store", tmp_path / "data")
    Store(folder / "plans").close()  # which brings it to this version
    return folder


def _list(folder: Path) -> list[tuple[str, str, int]]:
    with closing(sqlite3.connect(folder / "plans" / "store.sqlite3")) as db:
        return db.execute("SELECT plan_id, seal, archive_bytes FROM plans ORDER BY number").fetchall()


def _list_names(folder: Path) -> list[str]:
    """Names of all files and folders, without those that SQLite has beside a database that is read."""
    return sorted(path.name for path in folder.rglob("*") if not path.name.endswith(("-shm", "-wal")))


def test_a_backup_of_a_store_in_use_has_every_plan_with_its_files(data: Path, tmp_path: Path) -> None:
    with Store(data / "plans"):
        made = back_up(data, tmp_path / "copy")
    assert (made.n_plans, made.n_reviews, made.damaged) == (2, 1, ())
    assert _list(tmp_path / "copy") == _list(data)
    with Store(tmp_path / "copy" / "plans") as store:
        for plan_id, _, archive_bytes in _list(data):
            record = store.plans.get(plan_id)
            assert len(store.reviews.find(plan_id)) == bool(archive_bytes)
            if archive_bytes:
                store.plans.check_archive(record)


def test_files_beside_the_store_are_copied_but_for_locks_and_what_is_being_written(data: Path, tmp_path: Path) -> None:
    (data / "scans").mkdir()
    for name in ("scan.npz", "lock", ".partial-1"):
        (data / "scans" / name).write_bytes(b"points")
    back_up(data, tmp_path / "copy")
    assert [path.name for path in (tmp_path / "copy" / "scans").iterdir()] == ["scan.npz"]


def test_a_backup_names_plans_whose_files_are_not_what_was_stored(data: Path, tmp_path: Path) -> None:
    (damaged,) = [plan_id for plan_id, _, archive_bytes in _list(data) if archive_bytes]
    archive = data / "plans" / "archives" / damaged
    archive.write_bytes(archive.read_bytes()[:-1] + b"x")
    assert back_up(data, tmp_path / "copy").damaged == (damaged,)
    archive.unlink()
    assert back_up(data, tmp_path / "again").damaged == (damaged,)


def test_a_backup_that_cannot_be_made_changes_nothing(data: Path, tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    with pytest.raises(StoreError, match="exists already"):
        back_up(data, tmp_path / "there")
    with pytest.raises(StoreError, match="outside of it"):
        back_up(data, data / "inside")
    with pytest.raises(StoreError, match="has no plans/store"):
        back_up(tmp_path / "nothing", tmp_path / "copy")
    with closing(sqlite3.connect(data / "plans" / "store.sqlite3")) as db:
        db.execute("PRAGMA user_version = 99")
    before = _list_names(tmp_path)
    with pytest.raises(StoreError, match="expected version 3, got 99"):
        back_up(data, tmp_path / "copy")
    assert _list_names(tmp_path) == before


def test_old_plans_are_deleted_with_their_files_and_reviewed_ones_only_on_demand(data: Path) -> None:
    reviewed, plain = sorted(_list(data), key=lambda row: -row[2])
    with Store(data / "plans") as store:
        assert store.plans.delete_older(1.0, with_reviewed=True) == 0  # none is from 1970
        assert store.plans.delete_older(9e9, with_reviewed=False) == 1
        assert [row[0] for row in _list(data)] == [reviewed[0]] != [plain[0]]
        assert store.plans.delete_older(9e9, with_reviewed=True) == 1
        assert store.stats().n_plans == 0
    assert list((data / "plans" / "archives").glob(reviewed[0])) == []
