"""What the console says of a plan: the worst of each risk, and every check in one group."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from planner_stand_in import make_result

from service.cli.console.judging import WHOLE, find_phase, find_standing, group_checks, judge_plan, list_risks
from service.client import PlannerError
from service.proto.planner.v1.planner_pb2 import PlanRecord


def check(name: str, value: float | None = 0.5, limit: float | None = 1.0, **more: Any) -> dict[str, Any]:
    figures = {"value": value, "limit": limit, "unit": "1"}
    data = {"name": name, "ok": True, "text": name, "basis": "proof", **figures, **more}
    return {**data, "standing": find_standing(data)}


def test_a_phase_with_dots_in_its_name_is_the_longest_that_fits() -> None:
    phases = ["turn", "turn.1", "let go"]
    assert find_phase("torque.turn", phases) == "turn"
    assert find_phase("planted.turn.1.l_foot", phases) == "turn.1"
    assert find_phase("planted.turn.10", phases) == "turn"
    assert find_phase("balance.let go", phases) == "let go"
    assert find_phase("limits.position", phases) == WHOLE
    assert find_phase("turn", phases) == WHOLE


PARTS = ["turn", "turn.1", "reach", "a", "l_foot", "limits"]
names = st.lists(st.sampled_from(PARTS), min_size=1, max_size=4).map(".".join)


@given(
    checks=st.lists(st.tuples(names, st.booleans(), st.sampled_from(["proof", "samples", "unproven"])), max_size=20),
    phases=st.lists(st.sampled_from(["turn", "turn.1", "reach", "a"]), unique=True),
)
def test_every_check_is_in_one_group_and_open_only_if_it_does_not_hold(
    checks: list[tuple[str, bool, str]], phases: list[str]
) -> None:
    made = [check(name, ok=ok, basis=basis) for name, ok, basis in checks]
    groups = group_checks(made, phases)
    shown = [index for group in groups for index in (*group["open"], *group["passed"])]
    assert sorted(shown) == list(range(len(made)))
    for group in groups:
        assert all(made[index]["standing"] in ("refuted", "unproven") for index in group["open"])
        assert all(made[index]["standing"] in ("proven", "at samples") for index in group["passed"])


def test_the_worst_of_a_risk_has_the_weakest_standing_and_then_least_to_spare() -> None:
    checks = [
        check("torque.reach", 0.9),
        check("torque.turn", 0.95),
        check("balance.reach", 0.12, 0.02),
        check("balance.turn", 0.03, 0.02),
        check("zmp.turn", 0.5, 0.0, basis="samples"),
        check("hand_contact.turn.wheel", -0.1, 0.0, ok=False),
        check("equilibrium.turn", 0.0, 0.01),
        check("planted.turn.l_foot", 9.0),
    ]
    risks = {risk["title"]: checks[risk["check"]]["name"] for risk in list_risks(checks, {})}
    assert risks == {
        "Largest torque": "torque.turn",
        "Hand forces against their contacts": "hand_contact.turn.wheel",
        "Balance": "zmp.turn",
    }
    checks[4] = check("zmp.turn", 0.5, 0.0)
    (balance,) = (risk for risk in list_risks(checks, {}) if risk["title"] == "Balance")
    assert checks[balance["check"]]["name"] == "balance.turn"


def test_a_check_without_value_is_worse_than_any_with_one() -> None:
    checks = [check("torque.a", 0.99), check("torque.b", None)]
    assert list_risks(checks, {})[0]["check"] == 1


def test_the_closest_pair_is_named_as_the_certificate_proves_it() -> None:
    checks = [check("clearance", 0.02, 0.0, text="far")]
    certificate = {"min_clearance_m": 0.0149, "min_clearance_pair": ["l_hand", "rim"]}
    (risk,) = list_risks(checks, certificate)
    assert (risk["value"], risk["text"]) == (0.0149, "l_hand and rim")
    refuted = [check("clearance", -0.01, 0.0, text="deep", ok=False)]
    (risk,) = list_risks(refuted, certificate)
    assert (risk["value"], risk["text"], risk["standing"]) == (-0.01, "deep", "refuted")


def test_a_plan_is_judged_by_the_certificate_whose_hash_a_review_has() -> None:
    judged = judge_plan(PlanRecord(plan_id="a", result=make_result()))
    assert [one["name"] for one in judged["checks"]] == ["clearance", "start.l_hand"]
    assert judged["risks"][0]["text"] == "crate and l_hand"
    assert judged["assumed"] == ["made by a stand-in"]
    assert json.dumps(judged)


@pytest.mark.parametrize("text", [b"{", b"[]", b"3", b"[" * 100_000])
def test_a_certificate_that_is_none_is_refused_in_a_sentence(text: bytes) -> None:
    result = make_result()
    result.certificate.json = text
    with pytest.raises(PlannerError, match="no JSON object"):
        judge_plan(PlanRecord(plan_id="a", result=result))
