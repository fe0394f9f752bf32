"""ListPlans and ListScenes: who sees what, which filters are refused, and what open plans are called."""

from __future__ import annotations

import asyncio
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from service.proto.planner.v1 import planner_pb2 as wire
from service.server.operation.lists import ListHandlers
from service.store import Store
from service.trust import LOCAL, Caller, Identity, Role
from service.trust.identity import set_caller
from service.trust.rpc import Refusal

SHA = "a" * 64


@pytest.fixture
def store(tmp_path: Path):
    with Store(tmp_path) as opened:
        yield opened


def call(handlers: ListHandlers, method: str, message: Any, identity: Identity = LOCAL) -> Any:
    async def answer() -> Any:
        set_caller(Caller(identity, identity.name))
        return await getattr(handlers, method)(message, None)

    return asyncio.run(answer())


def begin(store: Store, client: str) -> str:
    return store.plans.begin(client, "", SHA, "valve").plan_id


def test_planners_see_their_own_and_reviewers_everything(store: Store) -> None:
    own, other = begin(store, "ann"), begin(store, "bob")
    store.scenes.put("bob", b"{}")
    handlers = ListHandlers(store, {})  # type: ignore[arg-type]
    seen = {
        role: {plan.plan_id for plan in call(handlers, "list_plans", wire.ListPlansRequest(), who).plans}
        for role in Role
        if (who := Identity("ann", frozenset({role})))
    }
    assert seen[Role.PLAN] == {own}
    assert seen[Role.REVIEW] == seen[Role.ADMIN] == {own, other}
    assert not call(handlers, "list_scenes", wire.ListScenesRequest(), Identity("ann", frozenset({Role.PLAN}))).scenes
    assert len(call(handlers, "list_scenes", wire.ListScenesRequest()).scenes) == 1


def test_open_plans_are_queued_running_or_lost_as_the_server_knows_them(store: Store) -> None:
    lost, queued, running = (begin(store, "ann") for _ in range(3))
    known = {queued: SimpleNamespace(has_begun=False), running: SimpleNamespace(has_begun=True)}
    handlers = ListHandlers(store, known)  # type: ignore[arg-type]
    for state, expected in (("QUEUED", queued), ("RUNNING", running), ("LOST", lost)):
        number = wire.PlanState.Value(f"PLAN_STATE_{state}")
        (plan,) = call(handlers, "list_plans", wire.ListPlansRequest(state=number, page_size=1)).plans
        assert (plan.plan_id, plan.state) == (expected, number)
        assert bool(plan.reason) == (state == "LOST")


def test_pages_follow_each_other_although_the_server_filters(store: Store) -> None:
    ids = [begin(store, "ann") for _ in range(7)]
    known = {plan_id: SimpleNamespace(has_begun=number % 2 == 0) for number, plan_id in enumerate(ids)}
    handlers = ListHandlers(store, known)  # type: ignore[arg-type]
    seen, token = [], ""
    for _ in range(4):
        page = call(handlers, "list_plans", wire.ListPlansRequest(state=2, page_size=1, page_token=token))
        seen += [plan.plan_id for plan in page.plans]
        token = page.next_page_token
    assert (seen, token) == (ids[::2][::-1], "")


@pytest.mark.parametrize(
    ("message", "words"),
    [
        (wire.ListPlansRequest(state=9), "state: 9 is no state of a plan"),  # type: ignore[arg-type]
        (wire.ListPlansRequest(task="vlave"), "task: unknown kind 'vlave'; expected valve"),
        (wire.ListPlansRequest(page_size=501), "page_size: expected at most 500, got 501"),
        (wire.ListPlansRequest(page_token="-1"), "page_token: '-1' is no next_page_token"),
        (wire.ListPlansRequest(since={"seconds": 10**15}), "since: 1000000000000000 s and 0 ns"),  # type: ignore[arg-type]
    ],
)
def test_a_filter_that_makes_no_sense_is_refused(store: Store, message: Any, words: str) -> None:
    with pytest.raises(Refusal, match=words):
        call(ListHandlers(store, {}), "list_plans", message)  # type: ignore[arg-type]
