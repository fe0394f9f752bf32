"""What a worker tells on the way, and how it keeps to the time there is."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from perception import Cloud, Perceived, memory, perceive
from service.proto.planner.v1.planner_pb2 import PlanProgress, PlanResponse
from service.proto.planner.v1.result_pb2 import VERDICT_CERTIFIED, MotionResult
from service.request.file import parse_request
from service.work.plan import PlanAnswer, PlanTask, Refused, run_plan

QUICK: dict[str, Any] = {
    "robot": {"name": "atlas"},
    "start": {"posture": "stand"},
    "goal": {"poses": [{"link": "l_hand", "position": [0.35, 0.45, 1.1]}]},
}

NOW = 1e6  # on the clock of whoever asks [s]


class _Control:
    def __init__(self, stop: bool = False) -> None:
        self.told: list[PlanProgress] = []
        self.stop = stop

    def should_stop(self) -> bool:
        return self.stop

    def now(self) -> float:
        return NOW

    def report(self, event: bytes) -> None:
        self.told.append(PlanResponse.FromString(event).progress)


def test_progress_tells_iterations_with_merit_penalty_and_violations() -> None:
    control = _Control()
    answer = run_plan(PlanTask(parse_request(QUICK), with_waypoints=True), control)
    assert isinstance(answer, PlanAnswer)
    assert answer.verdict == "CERTIFIED"
    assert MotionResult.FromString(answer.reply).verdict == VERDICT_CERTIFIED
    iterations = [one.iteration for one in control.told if one.HasField("iteration")]
    assert iterations
    assert all(one.mu > 0.0 and one.trust_radius > 0.0 for one in iterations)
    assert all("planted feet" in one.violations or one.violations for one in iterations)
    assert all(len(one.waypoints) % len(one.joint_names) == 0 for one in iterations)
    fractions = [one.fraction for one in control.told]
    assert fractions == sorted(fractions)


def test_the_hash_of_the_request_is_left_to_the_server_which_knows_what_the_client_said() -> None:
    placed = parse_request({**QUICK, "options": {"seed": 0}}, folder="/somewhere")
    answer = run_plan(PlanTask(placed, until=NOW + 30.0, original=parse_request(QUICK)), _Control())
    assert isinstance(answer, PlanAnswer)
    assert not MotionResult.FromString(answer.reply).request_sha256


def test_time_that_is_up_ends_the_plan_whatever_the_request_allows() -> None:
    answer = run_plan(PlanTask(parse_request(QUICK), until=NOW - 1.0), _Control())
    assert isinstance(answer, PlanAnswer)
    assert answer.verdict == "TIME_LIMIT"


def test_stop_ends_the_plan() -> None:
    answer = run_plan(PlanTask(parse_request(QUICK)), _Control(stop=True))
    assert isinstance(answer, PlanAnswer)
    assert answer.verdict == "CANCELLED"


def test_request_that_cannot_be_used_is_an_answer_too() -> None:
    unknown = parse_request({**QUICK, "goal": {"joints": {"nose": 1.0}}})
    refused = run_plan(PlanTask(unknown), _Control())
    assert isinstance(refused, Refused)
    assert "nose" in refused.problems[0]


def test_scan_that_was_planned_in_before_is_not_looked_at_again(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []

    def counted(cloud: Cloud, **settings: Any) -> Perceived:
        seen.append(cloud)
        return perceive(cloud, **settings)

    monkeypatch.setattr(memory, "perceive", counted)
    data = Path(__file__).parents[2] / "examples" / "data"
    asked = {"robot": {"name": "atlas"}, "start": {"posture": "reach_ready"}, "scene": {"cloud": "valve_scan.pcd"}}
    for goal in ({"posture": "reach_ready"}, {"joints": {"neck_ry": 0.2}}):
        answer = run_plan(PlanTask(parse_request({**asked, "goal": goal}, data)), _Control())
        assert isinstance(answer, PlanAnswer), answer
    assert len(seen) == 1
