"""What is damaged on the disk is refused by name, and never served, used or reviewed."""

from __future__ import annotations

import hashlib
import io
import os
import shutil
import sqlite3
import tarfile
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from service.server.plan_files import _open_members
from service.store import (
    CloudStore,
    DamagedError,
    Decision,
    NotStoredError,
    Store,
    StoreError,
    find_damaged_uploads,
)
from service.store.database import _APPLICATION_ID

PAGE = b"<html>" + b"page" * 500
HASHES = ("p" * 64, "c" * 64)
PAGE_SHA = hashlib.sha256(PAGE).hexdigest()


def _make_archive(page: bytes = PAGE) -> bytes:
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w") as archive:
        for name, data in {"result.json": b"{}" * 300, "viewer.html": page}.items():
            member = tarfile.TarInfo(name)
            member.size = len(data)
            archive.addfile(member, io.BytesIO(data))
    return buffer.getvalue()


def _finish(store: Store, name: str) -> str:
    plan_id = store.plans.begin("ann", name, "a" * 64, "goal").plan_id
    store.plans.finish(plan_id, "CERTIFIED", b"reply" * 400, *HASHES, _make_archive(), PAGE_SHA)
    return plan_id


def _add_review(store: Store, plan_id: str, decision: Decision = Decision.ACCEPTED) -> None:
    store.reviews.add(plan_id, decision, "rev", *HASHES, page_sha256=PAGE_SHA)


def _read_all(store: Store, ids: dict[str, str]) -> dict[str, object]:
    """Everything that is read without an error."""

    def read_archive() -> bytes:
        with store.plans.open_archive(ids["plan"]) as file:
            return file.read()

    reads: dict[str, Callable[[], object]] = {
        "plan": lambda: store.plans.get(ids["plan"]),
        "found": lambda: store.plans.find("ann", "r1"),
        "rejected": lambda: store.reviews.find(ids["rejected"]),
        "reviews": lambda: store.reviews.find(ids["plan"]),
        "archive": read_archive,
        "scene": lambda: store.scenes.get(ids["scene"]),
    }
    answers = {}
    for name, read in reads.items():
        try:
            answers[name] = read()
        except StoreError:
            continue
    return answers


def _flips(folder: Path, n: int) -> Iterator[tuple[Path, int]]:
    generator = np.random.default_rng(5)
    for path in sorted(path for path in folder.rglob("*") if path.is_file() and path.name != "lock"):
        for at in generator.integers(path.stat().st_size, size=n):
            yield path.relative_to(folder), int(at)


def test_no_flipped_byte_of_the_store_is_served_or_approved(tmp_path: Path) -> None:
    sound = tmp_path / "sound"
    with Store(sound) as store:
        ids = {"plan": _finish(store, "r1"), "rejected": _finish(store, "r2")}
        ids["scene"] = store.scenes.put("ann", bytes(range(256)) * 20)
        _add_review(store, ids["plan"], Decision.REJECTED)
        _add_review(store, ids["rejected"])
        _add_review(store, ids["rejected"], Decision.REJECTED)
        expected = _read_all(store, ids)
    n_refused = 0
    for number, (path, at) in enumerate(_flips(sound, 30)):
        folder = tmp_path / str(number)
        shutil.copytree(sound, folder)
        data = bytearray((folder / path).read_bytes())
        data[at] ^= 1 << (number % 8)
        (folder / path).write_bytes(data)
        try:
            with Store(folder) as store:
                answers = _read_all(store, ids)
                wrong = {name for name, value in answers.items() if value != expected[name]}
                # A plan whose rows cannot be found any more is unknown, and has no reviews.
                unknown = {"reviews": "plan" not in answers, "found": answers.get("found", 1) is None}
                assert not {name for name in wrong if not unknown.get(name)}, (path, at)
                n_refused += len(answers) < len(expected)
                try:
                    _add_review(store, ids["plan"])
                except StoreError:
                    continue
                assert {"plan", "archive", "reviews"} <= set(answers), (path, at)
        except StoreError:
            n_refused += 1
        finally:
            shutil.rmtree(folder)
    assert n_refused > 30


def test_an_open_plan_that_was_changed_gets_neither_reply_nor_seal(tmp_path: Path) -> None:
    with Store(tmp_path) as store:
        plan_id = store.plans.begin("ann", "r1", "a" * 64, "goal", b"request").plan_id
        with closing(sqlite3.connect(tmp_path / "store.sqlite3", isolation_level=None)) as db:
            db.execute("UPDATE plans SET client = 'bob' WHERE plan_id = ?", (plan_id,))
        for change in (
            lambda: store.plans.finish(plan_id, "CERTIFIED", b"reply"),
            lambda: store.plans.give_up(plan_id, "why"),
            lambda: store.plans.get(plan_id),
        ):
            with pytest.raises(DamagedError, match=plan_id):
                change()


def test_a_changed_row_and_a_removed_rejection_are_named(tmp_path: Path) -> None:
    with Store(tmp_path) as store:
        plan_id, other = _finish(store, "r1"), _finish(store, "r2")
        for decision in (Decision.ACCEPTED, Decision.REJECTED):
            _add_review(store, other, decision)
    with closing(sqlite3.connect(tmp_path / "store.sqlite3", isolation_level=None)) as db:
        db.execute("UPDATE plans SET reply = ? WHERE plan_id = ?", (b"Reply" * 400, plan_id))
        db.execute("DELETE FROM reviews WHERE decision = 'REJECTED'")
    with Store(tmp_path) as store:
        for read in (
            lambda: store.plans.get(plan_id),
            lambda: store.plans.begin("ann", "r1", "a" * 64, "goal"),
            lambda: _add_review(store, plan_id),
        ):
            with pytest.raises(
                DamagedError, match=f"plan '{plan_id}': is damaged on this server's disk; plan it again"
            ):
                read()
        with pytest.raises(DamagedError, match=f"plan {other}: its reviews are damaged"):
            store.reviews.is_accepted(other)


def test_a_rejection_survives_any_damage_of_the_log_that_a_killed_server_leaves(tmp_path: Path) -> None:
    log = "store.sqlite3-wal"
    with Store(tmp_path / "store") as store:
        plan_id = _finish(store, "r1")
        _add_review(store, plan_id)
        _add_review(store, plan_id, Decision.REJECTED)
        later = _finish(store, "r2")
        shutil.copytree(tmp_path / "store", tmp_path / "left")
    size = (tmp_path / "left" / log).stat().st_size
    assert size > 0
    n_lost = 0
    for place in range(0, size, size // 20):
        folder = shutil.copytree(tmp_path / "left", tmp_path / f"damaged{place}")
        data = bytearray((folder / log).read_bytes())
        data[place] ^= 1
        (folder / log).write_bytes(data)
        with Store(folder) as store:
            assert not store.reviews.is_accepted(plan_id)
            assert len(store.reviews.find(plan_id)) == 2
            try:
                store.plans.get(later)
            except NotStoredError:
                n_lost += 1
    assert n_lost > 0  # the log was damaged


def test_a_changed_page_is_neither_served_nor_approved(tmp_path: Path) -> None:
    with Store(tmp_path) as store:
        plan_id = _finish(store, "r1")
        path = tmp_path / "archives" / plan_id
        path.write_bytes(path.read_bytes().replace(b"page", b"Page", 1))
        for use in (lambda: store.plans.open_archive(plan_id), lambda: _add_review(store, plan_id)):
            with pytest.raises(DamagedError, match="its files are damaged on this server's disk; plan it again"):
                use()


def _put_pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def _put_endless(path: Path) -> None:
    path.unlink()
    path.symlink_to("/dev/zero")


def _put_folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


def _put_link(path: Path) -> None:
    """Move the file, which stays as it was, behind a link."""
    path.rename(path.with_name("elsewhere"))
    path.symlink_to("elsewhere")


@pytest.mark.parametrize(
    "replace", [_put_pipe, _put_endless, _put_folder, _put_link, Path.unlink, lambda path: os.truncate(path, 2**40)]
)
def test_what_has_taken_an_archives_place_is_neither_waited_for_nor_read_without_end(
    tmp_path: Path, replace: Callable[[Path], object]
) -> None:
    with Store(tmp_path) as store:
        plan_id = _finish(store, "r1")
        replace(tmp_path / "archives" / plan_id)
        for use in (lambda: store.plans.open_archive(plan_id), lambda: _add_review(store, plan_id)):
            with pytest.raises(DamagedError, match=f"plan {plan_id}: its files .* on this server's disk"):
                use()


def test_an_archive_that_changes_while_it_is_read_is_refused_at_its_end(tmp_path: Path) -> None:
    with Store(tmp_path) as store:
        plan_id = store.plans.begin("ann", "r1", "a" * 64, "goal").plan_id
        content = _make_archive(PAGE * 100)
        store.plans.finish(plan_id, "CERTIFIED", b"reply", *HASHES, content, PAGE_SHA)
        path = tmp_path / "archives" / plan_id
        with store.plans.open_archive(plan_id) as file:
            assert file.read(100) == content[:100]
            file.finish()
        files = _open_members(store, plan_id)
        assert next(files)[0] == "result.json"
        with path.open("r+b") as other:
            other.seek(150_000)
            other.write(b"?")
        with pytest.raises(DamagedError, match="its files are damaged"):
            list(files)


def test_a_damaged_scene_is_removed_and_can_be_built_again(tmp_path: Path) -> None:
    with Store(tmp_path) as store:
        scene_id = store.scenes.put("ann", b"scene" * 100)
    with closing(sqlite3.connect(tmp_path / "store.sqlite3", isolation_level=None)) as db:
        db.execute("UPDATE scenes SET data = x'00'")
    with Store(tmp_path) as store:
        with pytest.raises(DamagedError, match="is removed; build it again"):
            store.scenes.get(scene_id)
        assert store.scenes.put("ann", b"scene" * 100) == scene_id
        assert store.scenes.get(scene_id) == b"scene" * 100


def test_a_truncated_cloud_is_removed_or_replaced_by_the_next_upload(tmp_path: Path) -> None:
    def upload(store: CloudStore) -> str:
        with store.upload("ann", ".xyz") as upload:
            upload.write(b"0 0 0\n" * 50)
            return upload.finish()

    with CloudStore(tmp_path) as store:
        cloud_id = upload(store)
        file = tmp_path / cloud_id
        assert store.check(cloud_id)
        assert find_damaged_uploads([str(file), "/elsewhere.xyz"]) == ()
        file.write_bytes(file.read_bytes()[:100])
        assert find_damaged_uploads([str(file)]) == (cloud_id,)
        upload(store)  # a client that sends no hash before
        assert store.check(cloud_id)
        file.write_bytes(b"1 0 0\n" * 50)
        assert not store.check(cloud_id)
        assert not store.has(cloud_id)
        assert not file.exists()


def test_a_store_of_the_first_version_is_read_with_its_plans_and_reviews(tmp_path: Path) -> None:
    with Store(tmp_path) as store:
        plan_id = _finish(store, "r1")
        lost = store.plans.begin("ann", "r2", "a" * 64, "goal").plan_id
        _add_review(store, plan_id)
    added = {
        "plans": ("page_sha256", "archive_sha256", "request", "deadline", "n_resumed", "reviews_seal", "seal"),
        "reviews": ("page_sha256", "approval", "seal"),
    }
    with closing(sqlite3.connect(tmp_path / "store.sqlite3", isolation_level=None)) as db:
        db.execute("DROP TRIGGER scene_changes")
        for table, names in added.items():
            for name in names:
                db.execute(f"ALTER TABLE {table} DROP COLUMN {name}")
        db.execute("PRAGMA user_version = 1")
        assert db.execute("PRAGMA application_id").fetchone() == (_APPLICATION_ID,)
    with Store(tmp_path) as store:
        plan = store.plans.get(plan_id)
        assert (plan.reply, plan.page_sha256) == (b"reply" * 400, PAGE_SHA)
        with store.plans.open_archive(plan_id) as file:
            assert file.read() == _make_archive()
        assert store.reviews.is_accepted(plan_id)
        assert "restarted" in store.plans.get(lost).why_lost
        assert store.stats().n_plans == 2
    with closing(sqlite3.connect(tmp_path / "store.sqlite3.version-1")) as kept:
        assert kept.execute("PRAGMA user_version").fetchone() == (1,)
        assert kept.execute("SELECT count(*) FROM plans").fetchone() == (2,)


def test_an_open_plan_with_its_request_is_resumed_at_most_twice_and_not_after_its_deadline(tmp_path: Path) -> None:
    def open_at(now: float) -> Store:
        return Store(tmp_path, clock=lambda: now)

    with open_at(100.0) as store:
        plan_id = store.plans.begin("ann", "r1", "a" * 64, "goal", b"request").plan_id
        late = store.plans.begin("ann", "r2", "a" * 64, "goal", b"request", 110.0).plan_id
    for n_resumed in (1, 2):
        with open_at(120.0) as store:
            (plan,) = store.plans.resumable
            assert (plan.plan_id, plan.request, plan.n_resumed) == (plan_id, b"request", n_resumed)
            assert "deadline passed" in store.plans.get(late).why_lost
    with open_at(120.0) as store:
        assert store.plans.resumable == ()
        assert "restarted 3 times" in store.plans.get(plan_id).why_lost
        with pytest.raises(NotStoredError):
            store.plans.finish(plan_id, "CERTIFIED", b"")
