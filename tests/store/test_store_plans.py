"""The store keeps plans once each, within its bounds, and finds them again."""

from __future__ import annotations

import hashlib
import itertools
import threading
from pathlib import Path

import pytest

from service.store import (
    Decision,
    NotStoredError,
    PlanState,
    ReviewRefusedError,
    Store,
    StoreLimits,
    TooLargeError,
    database,
)
from service.store.seals import compute_seal

SHA = "a" * 64


def _finished(store: Store, request_id: str, reply: bytes = b"reply", client: str = "ann") -> str:
    plan_id = store.plans.begin(client, request_id, SHA, "valve").plan_id
    store.plans.finish(plan_id, "CERTIFIED", reply, "p" * 64, "c" * 64)
    return plan_id


def _archive(store: Store, plan_id: str) -> bytes:
    with store.plans.open_archive(plan_id) as file:
        return file.read()


def _is_there(store: Store, plan_id: str) -> bool:
    try:
        store.plans.get(plan_id)
    except NotStoredError:
        return False
    return True


def test_a_finished_plan_is_found_by_its_id_with_all_that_was_said(tmp_path: Path) -> None:
    ticks = itertools.count(100.0)
    with Store(tmp_path, clock=lambda: next(ticks)) as store:
        plan_id = _finished(store, "r1", b"\x00\xffreply")
        plan = store.plans.get(plan_id)
    assert (plan.client, plan.request_id, plan.request_sha256, plan.kind) == ("ann", "r1", SHA, "valve")
    assert (plan.state, plan.verdict, plan.reply) == (PlanState.FINISHED, "CERTIFIED", b"\x00\xffreply")
    assert (plan.plan_sha256, plan.certificate_sha256) == ("p" * 64, "c" * 64)
    assert (plan.created, plan.finished) == (100.0, 101.0)


def test_a_request_that_is_sent_again_gets_the_same_plan(tmp_path: Path) -> None:
    with Store(tmp_path) as store:
        first = store.plans.begin("ann", "r1", SHA, "valve")
        assert first.state is PlanState.ACCEPTED
        assert store.plans.begin("ann", "r1", SHA, "valve") == first
        store.plans.finish(first.plan_id, "CERTIFIED", b"reply")
        again = store.plans.begin("ann", "r1", SHA, "valve")
        assert (again.plan_id, again.state, again.reply) == (first.plan_id, PlanState.FINISHED, b"reply")


def test_another_request_under_a_used_request_id_changes_nothing(tmp_path: Path) -> None:
    with Store(tmp_path) as store:
        plan_id = _finished(store, "r1")
        other = store.plans.begin("ann", "r1", "b" * 64, "valve")
        assert (other.plan_id, other.request_sha256) == (plan_id, SHA)
        assert store.plans.get(plan_id).request_sha256 == SHA


def test_clients_do_not_meet_in_their_request_ids_and_an_empty_one_is_always_new(tmp_path: Path) -> None:
    with Store(tmp_path) as store:
        ids = {store.plans.begin(*key, SHA, "goal").plan_id for key in [("ann", "1"), ("bob", "1")]}
        ids |= {store.plans.begin("ann", "", SHA, "goal").plan_id for _ in range(2)}
    assert len(ids) == 4


def test_of_many_threads_with_one_request_id_only_one_begins_it(tmp_path: Path) -> None:
    with Store(tmp_path) as store:
        ids: list[str] = []
        threads = [
            threading.Thread(target=lambda: ids.append(store.plans.begin("ann", "r", SHA, "goal").plan_id))
            for _ in range(8)
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert store.stats().n_plans == 1
    assert ids == [ids[0]] * 8


def test_after_a_restart_unfinished_plans_are_lost_and_their_requests_run_again(tmp_path: Path) -> None:
    with Store(tmp_path) as store:
        first = store.plans.begin("ann", "r1", SHA, "goal").plan_id
        second = store.plans.begin("ann", "r2", SHA, "goal").plan_id
        done = _finished(store, "r3")
    with Store(tmp_path) as store:
        assert [store.plans.get(plan_id).state for plan_id in (first, second, done)] == ["lost", "lost", "finished"]
        assert "restarted" in store.plans.get(second).why_lost
        again = store.plans.begin("ann", "r2", SHA, "goal")
        assert (again.plan_id, again.state, again.why_lost) == (second, PlanState.ACCEPTED, "")
        assert store.plans.begin("ann", "r1", "b" * 64, "goal").state is PlanState.LOST


def test_after_a_restart_plans_with_time_left_are_begun_again_and_late_ones_are_lost(tmp_path: Path) -> None:
    with Store(tmp_path) as store:
        late, early = (store.plans.begin("ann", "", SHA, "goal", b"request", when) for when in (100.0, 100.5))
    with Store(tmp_path, clock=lambda: 100.0) as store:
        assert [plan.plan_id for plan in store.plans.resumable] == [early.plan_id]
        assert "deadline" in store.plans.get(late.plan_id).why_lost


def test_a_plan_that_was_given_up_may_run_again(tmp_path: Path) -> None:
    with Store(tmp_path) as store:
        plan_id = store.plans.begin("ann", "r1", SHA, "goal").plan_id
        store.plans.give_up(plan_id, "cancelled by the client")
        assert store.plans.get(plan_id).why_lost == "cancelled by the client"
        assert store.plans.begin("ann", "r1", SHA, "goal").state is PlanState.ACCEPTED


def test_a_plan_is_answered_once(tmp_path: Path) -> None:
    with Store(tmp_path) as store:
        plan_id = store.plans.begin("ann", "r1", SHA, "goal").plan_id
        store.plans.finish(plan_id, "CERTIFIED", b"first", archive=b"first")
        for late in (
            lambda: store.plans.finish(plan_id, "NOT_FOUND", b"second", archive=b"second"),
            lambda: store.plans.give_up(plan_id, "late"),
        ):
            with pytest.raises(NotStoredError, match="it has its reply"):
                late()
        assert store.plans.get(plan_id).reply == b"first"
        assert _archive(store, plan_id) == b"first"


def test_an_unknown_plan_is_named(tmp_path: Path) -> None:
    with Store(tmp_path) as store, pytest.raises(NotStoredError, match="unknown plan 'nobody'"):
        store.plans.get("nobody")


def test_the_oldest_plans_go_first_reviewed_ones_last_and_open_ones_never(tmp_path: Path) -> None:
    with Store(tmp_path, StoreLimits(max_plans=4)) as store:
        open_one = store.plans.begin("ann", "open", SHA, "goal").plan_id
        reviewed = _finished(store, "reviewed")
        store.reviews.add(reviewed, Decision.ACCEPTED, "rev", "p" * 64, "c" * 64)
        old, new = _finished(store, "old"), _finished(store, "new")
        newest = _finished(store, "newest")
        assert [_is_there(store, one) for one in (open_one, reviewed, old, new, newest)] == [1, 1, 0, 1, 1]
        _finished(store, "a"), _finished(store, "b")
        assert [_is_there(store, one) for one in (open_one, reviewed, new, newest)] == [1, 1, 0, 0]
        assert store.stats().n_plans == 4


def test_replies_and_archives_stay_within_the_bytes_and_the_newest_is_always_there(tmp_path: Path) -> None:
    with Store(tmp_path, StoreLimits(max_bytes=3000)) as store:
        plans = []
        for number in range(5):
            plan_id = store.plans.begin("ann", str(number), SHA, "goal").plan_id
            store.plans.finish(plan_id, "CERTIFIED", b"r" * 500, archive=b"a" * 500)
            plans.append(plan_id)
        assert [_is_there(store, one) for one in plans] == [0, 0, 1, 1, 1]
        assert store.stats().plan_bytes == 3000
        assert sorted(path.name for path in (tmp_path / "archives").iterdir()) == sorted([*plans[2:], "lock"])
        plan_id = store.plans.begin("ann", "huge", SHA, "goal").plan_id
        with pytest.raises(TooLargeError, match="3001 bytes; the store keeps 3000 at most"):
            store.plans.finish(plan_id, "CERTIFIED", b"r" * 3001)


def test_the_last_reviewed_plan_gives_way_to_a_new_one_only(tmp_path: Path) -> None:
    with Store(tmp_path, StoreLimits(max_plans=1)) as store:
        reviewed = _finished(store, "reviewed")
        store.reviews.add(reviewed, Decision.REJECTED, "rev", "p" * 64, "c" * 64)
        new = _finished(store, "new")
        assert (_is_there(store, reviewed), _is_there(store, new)) == (False, True)
        assert store.reviews.find(reviewed) == ()


def test_a_reply_that_was_just_stored_stays_even_beside_reviewed_ones(tmp_path: Path) -> None:
    with Store(tmp_path, StoreLimits(max_bytes=1000)) as store:
        reviewed = _finished(store, "reviewed", b"r" * 600)
        store.reviews.add(reviewed, Decision.ACCEPTED, "rev", "p" * 64, "c" * 64)
        new = _finished(store, "new", b"r" * 600)
        assert (_is_there(store, reviewed), _is_there(store, new)) == (False, True)


def test_archives_without_a_plan_are_removed_at_start_and_others_stay(tmp_path: Path) -> None:
    with Store(tmp_path) as store:
        plan_id = store.plans.begin("ann", "r", SHA, "goal").plan_id
        store.plans.finish(plan_id, "CERTIFIED", b"", archive=b"archive")
    (tmp_path / "archives" / ("f" * 32)).write_bytes(b"of a plan that never finished")
    (tmp_path / "archives" / ".partial-x").write_bytes(b"half")
    with Store(tmp_path) as store:
        assert {path.name for path in (tmp_path / "archives").iterdir()} == {plan_id, "lock"}
        assert _archive(store, plan_id) == b"archive"


def test_an_archive_that_is_not_there_is_told(tmp_path: Path) -> None:
    with Store(tmp_path) as store:
        plan_id = _finished(store, "r")
        with pytest.raises(NotStoredError, match="was planned without files; plan it again with files"):
            store.plans.open_archive(plan_id)
        plan_id = store.plans.begin("ann", "s", SHA, "goal").plan_id
        with pytest.raises(NotStoredError, match="has not finished; there are no files yet"):
            store.plans.open_archive(plan_id)


def test_an_accepted_review_is_bound_to_the_plan_and_the_certificate_that_were_looked_at(tmp_path: Path) -> None:
    with Store(tmp_path) as store:
        plan_id = _finished(store, "r1")
        for plan_sha, certificate_sha in (("x" * 64, "c" * 64), ("p" * 64, "x" * 64), ("p" * 64, "")):
            with pytest.raises(ReviewRefusedError, match="expected that of the stored plan"):
                store.reviews.add(plan_id, Decision.ACCEPTED, "rev", plan_sha, certificate_sha)
        assert not store.reviews.is_accepted(plan_id)
        review = store.reviews.add(plan_id, Decision.ACCEPTED, "rev", "p" * 64, "c" * 64, "looks right")
        assert store.reviews.find(plan_id) == (review,)
        assert store.reviews.is_accepted(plan_id)


def test_the_last_word_counts_and_every_word_stays(tmp_path: Path) -> None:
    with Store(tmp_path) as store:
        plan_id = _finished(store, "r1")
        for decision in (Decision.ACCEPTED, Decision.REJECTED):
            store.reviews.add(plan_id, decision, "rev", "p" * 64, "c" * 64)
        assert [review.decision for review in store.reviews.find(plan_id)] == [Decision.ACCEPTED, Decision.REJECTED]
        assert not store.reviews.is_accepted(plan_id)


def test_nothing_unfinished_unproven_or_unknown_is_accepted(tmp_path: Path) -> None:
    with Store(tmp_path) as store:
        plan_id = store.plans.begin("ann", "r1", SHA, "goal").plan_id
        with pytest.raises(ReviewRefusedError, match="only a finished plan"):
            store.reviews.add(plan_id, Decision.ACCEPTED, "rev", "", "")
        store.plans.finish(plan_id, "NOT_FOUND", b"", "p" * 64, "")
        with pytest.raises(ReviewRefusedError, match="has no certificate"):
            store.reviews.add(plan_id, Decision.ACCEPTED, "rev", "p" * 64, "")
        store.reviews.add(plan_id, Decision.REJECTED, "rev", "p" * 64, "")
        with pytest.raises(NotStoredError, match="unknown plan 'other'"):
            store.reviews.add("other", Decision.ACCEPTED, "rev", "p" * 64, "c" * 64)


def test_reviews_are_bounded(tmp_path: Path) -> None:
    with Store(tmp_path, StoreLimits(max_reviews=2)) as store:
        plan_id = _finished(store, "r1")
        with pytest.raises(ReviewRefusedError, match="expected at most 4000"):
            store.reviews.add(plan_id, Decision.REJECTED, "rev", "p" * 64, "c" * 64, "x" * 4001)
        for _ in range(2):
            store.reviews.add(plan_id, Decision.REJECTED, "rev", "p" * 64, "c" * 64)
        with pytest.raises(ReviewRefusedError, match="2 reviews already"):
            store.reviews.add(plan_id, Decision.REJECTED, "rev", "p" * 64, "c" * 64)


def test_there_is_always_room_to_take_an_approval_back(tmp_path: Path) -> None:
    with Store(tmp_path, StoreLimits(max_reviews=2)) as store:
        plan_id = _finished(store, "r1")
        for _ in range(2):
            store.reviews.add(plan_id, Decision.ACCEPTED, "rev", "p" * 64, "c" * 64)
        store.reviews.add(plan_id, Decision.REJECTED, "rev", "p" * 64, "c" * 64)
        assert not store.reviews.is_accepted(plan_id)
        for decision in Decision:
            with pytest.raises(ReviewRefusedError, match="3 reviews already"):
                store.reviews.add(plan_id, decision, "rev", "p" * 64, "c" * 64)


def test_a_scene_is_kept_once_and_comes_back_as_it_was(tmp_path: Path) -> None:
    with Store(tmp_path) as store:
        scene_id = store.scenes.put("ann", b"scene" * 100)
        assert store.scenes.put("bob", b"scene" * 100) == scene_id
        assert store.stats().n_scenes == 1
    with Store(tmp_path) as store:
        assert store.scenes.get(scene_id) == b"scene" * 100
        with pytest.raises(NotStoredError, match="unknown scene 'scene:0'"):
            store.scenes.get("scene:0")


def test_scenes_not_used_for_longest_go_first(tmp_path: Path) -> None:
    ticks = itertools.count()
    with Store(tmp_path, StoreLimits(max_scenes=2), clock=lambda: float(next(ticks))) as store:
        first, second = store.scenes.put("ann", b"1"), store.scenes.put("ann", b"2")
        store.scenes.get(first)
        store.scenes.put("ann", b"3")
        assert store.scenes.get(first) == b"1"
        with pytest.raises(NotStoredError):
            store.scenes.get(second)
        assert store.stats().n_scenes == 2


def test_scenes_stay_within_their_bytes(tmp_path: Path) -> None:
    with Store(tmp_path, StoreLimits(max_scene_bytes=40)) as store:
        for number in range(5):
            newest = store.scenes.put("ann", bytes(range(number, number + 16)))
        assert store.scenes.get(newest)
        assert 0 < store.stats().scene_bytes <= 40
        with pytest.raises(TooLargeError, match="40 at most"):
            store.scenes.put("ann", bytes(range(100)))


def test_a_checkpoint_is_made_when_enough_was_written_and_delays_no_transaction(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(database, "CHECKPOINT_WRITES", 8)
    file = tmp_path / "store.sqlite3"
    with Store(tmp_path) as store:
        empty = file.stat().st_size
        _finished(store, "r0", bytes(200_000))
        store.checkpoint()
        assert file.stat().st_size == empty  # too little was written
        ids = [_finished(store, f"r{number}", bytes(200_000)) for number in range(1, 6)]
        assert file.stat().st_size == empty  # and no write copies it meanwhile
        with store._database.transaction():  # a checkpoint does not need its lock
            thread = threading.Thread(target=store.checkpoint)
            thread.start()
            thread.join(60.0)
            assert not thread.is_alive()
            size = file.stat().st_size
        assert size > empty + 1_000_000
        store.checkpoint()
        assert file.stat().st_size == size
        assert all(store.plans.get(plan_id).reply == bytes(200_000) for plan_id in ids)


def test_a_seal_is_the_hash_of_names_types_sizes_and_values_in_order() -> None:
    row = {"number": 7, "b": b"\x00\xff", "a": None, "c": "x", "d": 1.5, "seal": "old"}
    text = b"before\na NoneType 4 None\nb bytes 2 \x00\xff\nc str 3 'x'\nd float 3 1.5"
    assert compute_seal(row, "before") == hashlib.sha256(text).hexdigest()
