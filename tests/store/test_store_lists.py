"""Lists of stored plans and scenes: newest first, filtered, in pages without gaps or repetitions."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from service.store import DIRECT, Decision, PlanFilter, PlanState, Store
from service.store.reviews import DAY_S

SHA, P, C = "a" * 64, "p" * 64, "c" * 64


class Clock:
    now = 1000.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def store(tmp_path: Path, clock: Clock):
    with Store(tmp_path, clock=clock) as opened:
        yield opened


def _plan(store: Store, kind: str = "valve", client: str = "ann", trajectory: str = P) -> str:
    plan_id = store.plans.begin(client, "", SHA, kind).plan_id
    store.plans.finish(
        plan_id, "CERTIFIED" if trajectory else "NOT_FOUND", b"reply", trajectory, C if trajectory else ""
    )
    return plan_id


def _ids(store: Store, wanted: PlanFilter | None = None) -> list[str]:
    return [listed.plan_id for listed in store.lists.find_plans(wanted or PlanFilter(), 100)]


def _review(store: Store, plan_id: str, decision: Decision = Decision.ACCEPTED, **more: float) -> None:
    store.reviews.add(plan_id, decision, "rev", P, C, **more)


def test_each_filter_leaves_what_it_says(store: Store, clock: Clock) -> None:
    valve = _plan(store)
    clock.now = 2000.0
    door = _plan(store, "door", "bob")
    lost = store.plans.begin("ann", "", SHA, "reach").plan_id
    store.plans.give_up(lost, "refused")
    waiting = store.plans.begin("ann", "", SHA, "reach").plan_id
    assert _ids(store) == [waiting, lost, door, valve]
    assert _ids(store, PlanFilter(client="bob")) == [door]
    assert _ids(store, PlanFilter(kind="reach")) == [waiting, lost]
    assert _ids(store, PlanFilter(since=2000.0)) == [waiting, lost, door]
    assert _ids(store, PlanFilter(states=(PlanState.LOST,))) == [lost]
    assert _ids(store, PlanFilter(states=(PlanState.ACCEPTED, PlanState.FINISHED), client="ann")) == [waiting, valve]


def test_direct_moves_wait_for_no_decision_and_are_listed_by_their_kind_alone(store: Store) -> None:
    nudge, valve = _plan(store, DIRECT), _plan(store)
    assert _ids(store) == _ids(store, PlanFilter(needs_review=True)) == [valve]
    assert _ids(store, PlanFilter(kind=DIRECT)) == [nudge]
    assert not store.lists.needs_review(nudge)
    assert store.lists.needs_review(valve)


def test_a_plan_waits_for_a_decision_until_there_is_one_and_again_when_the_acceptance_has_expired(
    store: Store, clock: Clock
) -> None:
    accepted, rejected, fresh, without_motion = _plan(store), _plan(store), _plan(store), _plan(store, trajectory="")
    _review(store, accepted, valid_s=DAY_S)
    _review(store, rejected, Decision.REJECTED)
    wanted = PlanFilter(needs_review=True)
    assert _ids(store, wanted) == [fresh]
    clock.now += 2 * DAY_S
    assert _ids(store, wanted) == [fresh, accepted]
    needs = {listed.plan_id for listed in store.lists.find_plans(PlanFilter(), 100) if listed.needs_review}
    assert needs == {fresh, accepted}
    assert without_motion not in needs
    _review(store, accepted, Decision.REJECTED)
    assert _ids(store, wanted) == [fresh]


@settings(max_examples=12)
@given(n_plans=st.integers(0, 9), size=st.integers(1, 5))
def test_pages_have_every_plan_once(tmp_path_factory: pytest.TempPathFactory, n_plans: int, size: int) -> None:
    with Store(tmp_path_factory.mktemp("store")) as store:
        made = [store.plans.begin("ann", "", SHA, "valve").plan_id for _ in range(n_plans)]
        seen: list[str] = []
        below = None
        while page := store.lists.find_plans(PlanFilter(), size, below):
            assert len(page) <= size
            seen += [listed.plan_id for listed in page]
            below = page[-1].number
        assert seen == made[::-1]


def test_a_damaged_plan_is_listed_with_its_damage(tmp_path: Path) -> None:
    with Store(tmp_path) as store:
        sound, damaged = _plan(store), _plan(store)
    with sqlite3.connect(tmp_path / "store.sqlite3") as db:
        db.execute("UPDATE plans SET verdict = 'NOT_FOUND' WHERE plan_id = ?", (damaged,))
    with Store(tmp_path) as store:
        first, second = store.lists.find_plans(PlanFilter(), 10)
        assert (first.plan_id, first.plan) == (damaged, None)
        assert "damaged" in first.damage
        assert not first.needs_review
        assert second.plan is not None
        assert second.plan_id == sound


def test_scenes_are_listed_newest_first_with_who_built_them(store: Store, clock: Clock) -> None:
    ids = []
    for number, client in enumerate(("ann", "bob", "ann")):
        clock.now = 1000.0 + number
        ids.append(store.scenes.put(client, b'{"scene": %d}' % number))
    found = store.lists.find_scenes()
    assert [scene.scene_id for scene in found] == ids[::-1]
    assert [scene.client for scene in found] == ["ann", "bob", "ann"]
    assert all(scene.n_bytes > 0 for scene in found)
    assert [scene.scene_id for scene in store.lists.find_scenes("ann")] == [ids[2], ids[0]]
    assert [scene.scene_id for scene in store.lists.find_scenes(since=1001.0)] == [ids[2], ids[1]]
    (last,) = store.lists.find_scenes(n_scenes=1)
    assert [scene.scene_id for scene in store.lists.find_scenes(below=last.number)] == [ids[1], ids[0]]
