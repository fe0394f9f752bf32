"""Approvals in the store: bound to the verdict, valid for a time, withdrawn whatever became of the files."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from service.store import DamagedError, Decision, Review, ReviewRefusedError, Store
from service.store.records import PlanRecord
from service.store.seals import compute_seal

DAY_S = 86400.0
HASHES = ("p" * 64, "c" * 64)


class _Clock:
    now = 1e9

    def __call__(self) -> float:
        return self.now


def _finish(store: Store, verdict: str = "CERTIFIED", request_id: str = "r") -> str:
    plan_id = store.plans.begin("ann", request_id, "a" * 64, "goal").plan_id
    store.plans.finish(plan_id, verdict, b"reply", *HASHES)
    return plan_id


def _accept(store: Store, plan_id: str, **more: Any) -> Review:
    return store.reviews.add(plan_id, Decision.ACCEPTED, "rev", *HASHES, **more)


@pytest.mark.parametrize(("more", "days"), [({}, 30.0), ({"valid_s": 2.5 * DAY_S}, 2.5)])
def test_an_approval_ends_with_its_validity(tmp_path: Path, more: dict[str, float], days: float) -> None:
    clock = _Clock()
    with Store(tmp_path, clock=clock) as store:
        plan_id = _finish(store)
        review = _accept(store, plan_id, **more)
        assert (review.verdict, review.expires) == ("CERTIFIED", 1e9 + days * DAY_S)
        clock.now = 1e9 + days * DAY_S - 1.0
        assert store.reviews.is_accepted(plan_id)
        clock.now += 1.0
        assert not store.reviews.is_accepted(plan_id)
        assert store.reviews.find(plan_id) == (review,)


@pytest.mark.parametrize("valid_s", [0.0, -1.0, 367 * DAY_S, float("nan"), float("inf")])
def test_a_validity_out_of_bounds_is_refused(tmp_path: Path, valid_s: float) -> None:
    with Store(tmp_path) as store:
        plan_id = _finish(store)
        with pytest.raises(ReviewRefusedError, match=r"valid_s: .* s; expected more than 0 and at most"):
            _accept(store, plan_id, valid_s=valid_s)


@pytest.mark.parametrize(
    ("stored", "more", "words"),
    [
        ("TIME_LIMIT", {}, "verdict: expected that of the stored plan, TIME_LIMIT, got CERTIFIED; review it again"),
        ("TIME_LIMIT", {"verdict": "TIME_LIMIT"}, r"is TIME_LIMIT, not CERTIFIED; expected TIME_LIMIT .*, got none"),
        ("TIME_LIMIT", {"verdict": "TIME_LIMIT", "despite": "NOT_FOUND"}, r"--despite TIME_LIMIT\), got NOT_FOUND"),
        ("CERTIFIED", {"verdict": "NOT_FOUND", "despite": "NOT_FOUND"}, "verdict: expected that of the stored plan"),
        ("CERTIFIED", {"despite": "NOT_FOUND"}, "despite: the plan is CERTIFIED; leave out NOT_FOUND"),
    ],
)  # fmt: skip
def test_an_approval_is_bound_to_the_verdict(tmp_path: Path, stored: str, more: dict[str, str], words: str) -> None:
    with Store(tmp_path) as store:
        plan_id = _finish(store, stored)
        with pytest.raises(ReviewRefusedError, match=words):
            _accept(store, plan_id, **more)
        assert store.reviews.find(plan_id) == ()


def test_a_plan_without_certificate_is_accepted_by_naming_its_verdict(tmp_path: Path) -> None:
    with Store(tmp_path) as store:
        plan_id = _finish(store, "FEASIBLE_AT_SAMPLES")
        _accept(store, plan_id, verdict="FEASIBLE_AT_SAMPLES", despite="FEASIBLE_AT_SAMPLES")
        assert store.reviews.is_accepted(plan_id)


def test_a_withdrawal_is_signed_and_no_damage_of_the_files_prevents_it(tmp_path: Path) -> None:
    signed: list[tuple[Decision, str]] = []

    def sign(plan: PlanRecord, review: Review) -> bytes:
        signed.append((review.decision, review.verdict))
        return b"signed"

    with Store(tmp_path) as store:
        plan_id = store.plans.begin("ann", "r", "a" * 64, "goal").plan_id
        store.plans.finish(plan_id, "CERTIFIED", b"reply", *HASHES, b"archive", "e" * 64)
        args = ("rev", *HASHES, "", "e" * 64, sign)
        assert store.reviews.add(plan_id, Decision.REJECTED, *args).approval == b""
        store.reviews.add(plan_id, Decision.ACCEPTED, *args)
        (tmp_path / "archives" / plan_id).write_bytes(b"Archive")
        with pytest.raises(DamagedError, match="its files are damaged"):
            store.reviews.add(plan_id, Decision.ACCEPTED, *args)
        assert store.reviews.add(plan_id, Decision.REJECTED, *args).approval == b"signed"
        assert not store.reviews.is_accepted(plan_id)
    assert signed == [(Decision.ACCEPTED, "CERTIFIED"), (Decision.REJECTED, "CERTIFIED")]


def _make_version_2(folder: Path) -> None:
    """Turn a store into one of release 0.3.0, seals included."""
    with closing(sqlite3.connect(folder / "store.sqlite3", isolation_level=None)) as db:
        db.row_factory = sqlite3.Row
        db.execute("DROP TRIGGER reviews_stay")
        for name in ("verdict", "expires"):
            db.execute(f"ALTER TABLE reviews DROP COLUMN {name}")
        for plan in db.execute("SELECT * FROM plans").fetchall():
            seal = ""
            for row in db.execute(
                "SELECT * FROM reviews WHERE plan_id = ? ORDER BY number", (plan["plan_id"],)
            ).fetchall():
                seal = compute_seal(dict(row), seal)
                db.execute("UPDATE reviews SET seal = ? WHERE number = ?", (seal, row["number"]))
            values = {**dict(plan), "reviews_seal": seal}
            db.execute(
                "UPDATE plans SET reviews_seal = ?, seal = ? WHERE plan_id = ?",
                (seal, compute_seal(values), plan["plan_id"]),
            )
        db.execute("PRAGMA user_version = 2")


def test_a_store_of_release_0_3_0_is_read_its_approvals_are_expired_and_its_damage_stays(tmp_path: Path) -> None:
    with Store(tmp_path) as store:
        whole, review_changed, row_changed, rejection_gone = (_finish(store, request_id=f"r{k}") for k in range(4))
        for plan_id in (whole, review_changed, row_changed, rejection_gone):
            _accept(store, plan_id)
        store.reviews.add(rejection_gone, Decision.REJECTED, "rev", *HASHES)
    _make_version_2(tmp_path)
    with closing(sqlite3.connect(tmp_path / "store.sqlite3", isolation_level=None)) as db:
        db.execute("UPDATE reviews SET reviewer = 'eve' WHERE plan_id = ?", (review_changed,))
        db.execute("UPDATE plans SET client = 'eve' WHERE plan_id = ?", (row_changed,))
        db.execute("DELETE FROM reviews WHERE decision = 'REJECTED'")
    with Store(tmp_path) as store:
        (review,) = store.reviews.find(whole)
        assert (review.decision, review.verdict, review.expires) == (Decision.ACCEPTED, "", 0.0)
        assert not store.reviews.is_accepted(whole)
        _accept(store, whole)
        assert store.reviews.is_accepted(whole)
        for plan_id in (review_changed, rejection_gone):
            with pytest.raises(DamagedError, match="its reviews are damaged"):
                store.reviews.find(plan_id)
        with pytest.raises(DamagedError, match="is damaged on this server's disk"):
            store.plans.get(row_changed)
    assert (tmp_path / "store.sqlite3.version-2").is_file()
