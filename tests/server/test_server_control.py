"""Control of the robot and the checks before it moves: leases, revisions, approvals, scans. No server process."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.server.operation.checks import (
    check_approval,
    check_plan,
    check_releases,
    check_scan_age,
    find_scan_age_s,
)
from service.server.operation.control import Lease, RobotControl
from service.store import Decision, PlanState, Review, Store
from service.trust.rpc import Refusal

NOW = 1e6
REVIEW = Review("p", "t", "c", Decision.ACCEPTED, "rev", "", NOW - 10, approval=b"signed", expires=NOW + 10)


class Alone:
    """A control, and who has left it."""

    def __init__(self) -> None:
        self.left: list[Lease] = []
        self.control = RobotControl(lambda: None, self.left.append)


def test_one_operator_has_control_until_another_takes_it_over_explicitly() -> None:
    control = Alone().control
    first = control.take("ann", "console", takes_over=False)
    with pytest.raises(Refusal, match=r"ann \(console\) has control since .* take it over explicitly"):
        control.take("bob", "", takes_over=False)
    seen = control.revision
    second = control.take("bob", "", takes_over=True)
    assert control.require(second.token).name == "bob"
    with pytest.raises(Refusal, match="bob has control; the one you name has ended"):
        control.require(first.token)
    with pytest.raises(Refusal, match="bob has control, and the order names none"):
        control.require("")
    with pytest.raises(Refusal, match=r"now bob took control over from ann \(console\); look again"):
        control.require_revision(seen)
    control.release(second.token)
    with pytest.raises(Refusal, match="nobody has control of the robot; take it first"):
        control.require(second.token)


def test_an_operator_is_alone_once_the_last_of_its_calls_has_ended() -> None:
    alone = Alone()
    lease = alone.control.take("ann", "", takes_over=False)
    with alone.control.attend(lease.token):
        with alone.control.attend(lease.token):
            pass
        assert alone.control.is_present
        assert alone.left == []
    assert alone.left == [lease]


def test_who_was_taken_over_leaves_nobody_alone() -> None:
    alone = Alone()
    first = alone.control.take("ann", "", takes_over=False)
    with alone.control.attend(first.token):
        second = alone.control.take("bob", "", takes_over=True)
        assert not alone.control.is_present
        watched = alone.control.attend(second.token)
        watched.__enter__()
    assert alone.left == []
    assert alone.control.is_present
    watched.__exit__(None, None, None)
    assert alone.left == [second]


@given(st.lists(st.sampled_from(["take", "over", "release", "change"]), max_size=20))
def test_every_change_makes_a_revision_of_its_own_and_at_most_one_lease_is_valid(steps: list[str]) -> None:
    control, tokens, revisions = Alone().control, [""], []
    for step in steps:
        try:
            if step == "release":
                control.release(tokens[-1])
            elif step == "change":
                control.raise_revision("the robot moves")
            else:
                tokens.append(control.take("ann", "", takes_over=step == "over").token)
        except Refusal:
            continue
        revisions.append(control.revision)
    assert revisions == sorted(set(revisions))
    valid = [token for token in tokens if control.lease is not None and control.lease.token == token]
    assert len(valid) == (control.lease is not None)


@pytest.mark.parametrize(
    ("reviews", "given_statement", "words"),
    [
        ([], b"", "plan p has no review; accept it first"),
        ([replace(REVIEW, decision=Decision.REJECTED)], b"", "rev rejected the plan at 1970-01-12"),
        ([REVIEW, replace(REVIEW, decision=Decision.REJECTED)], b"", "rev revoked the approval at 1970-01-12"),
        ([replace(REVIEW, expires=NOW)], b"", "that of rev expired at 1970-01-12 13:46:40 UTC"),
        ([REVIEW], b"another", "newest one is that of rev .* not the one that was named"),
    ],
)
def test_an_approval_that_is_missing_void_or_another_is_refused(
    reviews: list[Review], given_statement: bytes, words: str
) -> None:
    with pytest.raises(Refusal, match=words):
        check_approval("p", reviews, given_statement, is_required=True, now=NOW)


def test_an_approval_counts_where_it_is_required_or_named() -> None:
    check_approval("p", [REVIEW], b"signed", is_required=True, now=NOW)
    check_approval("p", [], b"", is_required=False, now=NOW)
    with pytest.raises(Refusal, match="has no review"):
        check_approval("p", [], b"signed", is_required=False, now=NOW)


def test_a_nudge_that_nobody_accepted_is_refused_with_what_allows_it() -> None:
    with pytest.raises(Refusal, match=r"direct move has no review; scopt serve --no-require-approval allows them"):
        check_approval("p", [], b"", is_required=True, now=NOW, is_direct=True)
    check_approval("p", [REVIEW], b"signed", is_required=True, now=NOW, is_direct=True)


def test_only_the_certified_plan_that_was_looked_at_is_carried_out(tmp_path: Path) -> None:
    with Store(tmp_path) as store:
        plan_id = store.plans.begin("ann", "", "a" * 64, "valve").plan_id
        with pytest.raises(Refusal, match="is accepted; expected a finished plan"):
            check_plan(store.plans.get(plan_id), "t" * 64)
        store.plans.finish(plan_id, "CERTIFIED", b"reply", "t" * 64, "c" * 64)
        record = store.plans.get(plan_id)
    with pytest.raises(Refusal, match="planned without files"):
        check_plan(record, "t" * 64)
    record = replace(record, archive_bytes=1)
    check_plan(record, "t" * 64)
    with pytest.raises(Refusal, match=r"has 'tttttttttttt', the order is about 'uuuuuuuuuuuu'; it is not the plan"):
        check_plan(record, "u" * 64)
    with pytest.raises(Refusal, match="is NOT_FOUND; only CERTIFIED plans"):
        check_plan(replace(record, verdict="NOT_FOUND"), "t" * 64)
    with pytest.raises(Refusal, match="is lost; expected a finished plan"):
        check_plan(replace(record, state=PlanState.LOST), "t" * 64)


def test_a_scan_is_as_old_as_its_scene_and_at_least_as_the_plan(tmp_path: Path) -> None:
    times = iter([1000.0, 1500.0, 1600.0])
    with Store(tmp_path, clock=lambda: next(times)) as store:
        scene_id = store.scenes.put("ann", b"{}")
        record = store.plans.get(store.plans.begin("ann", "", "a" * 64, "valve").plan_id)

        def age(**scene: object) -> float | None:
            return find_scan_age_s({"request": {"scene": scene}}, record, store, now=2000.0)

        assert age(obstacles=[]) is None
        assert age(file=scene_id) == 1000.0
        assert age(file="room.json") == 500.0
        assert age(cloud=[{"file": "sha256:1.pcd"}]) == 500.0


def test_an_old_scan_is_refused_unless_the_operator_accepts_its_age() -> None:
    check_scan_age(None, 0.0, None)
    check_scan_age(3600.0, 3600.0, None)
    with pytest.raises(Refusal, match=r"scan is 2.5 h old; expected at most 60 min: scan again"):
        check_scan_age(9000.0, 3600.0, None)
    check_scan_age(9000.0, 3600.0, 10000.0)
    with pytest.raises(Refusal, match="expected at most 10 s"):
        check_scan_age(60.0, 3600.0, 10.0)


def test_a_plan_that_lets_go_of_something_needs_its_own_confirmation() -> None:
    carriers = [[{"object": "drill", "link": "r_hand"}], [{"object": "drill", "link": None}]]
    phases = [{"name": name, "carriers": own} for name, own in zip(("hold", "put down"), carriers, strict=True)]
    for confirmed in ([], ["cup"]):
        with pytest.raises(Refusal, match="lets go of 'drill' in phase 'put down'; name what may be let go"):
            check_releases({"phases": phases}, confirmed)
    check_releases({"phases": phases}, ["drill"])
    check_releases({"phases": phases[:1]}, [], held=["drill"])
    with pytest.raises(Refusal, match="the robot holds 'drill', and the plan does not begin with that in a hand"):
        check_releases({"phases": phases[1:]}, [], held=["drill"])
    check_releases({"phases": phases[1:]}, ["drill"], held=["drill"])
