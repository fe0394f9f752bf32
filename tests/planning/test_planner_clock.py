"""What a plan's time limit counts: wall time where the request states one, else effort."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from clocks import CountingClock
from planar_arm import write_planar_arm

from scopt import EffortClock
from service.body.monitor import Monitor
from service.planner import plan
from service.request.file import parse_request, to_json
from service.request.schema import PlanRequest
from service.request.tasks.egress import EgressRequest
from service.request.tasks.kind import TaskSection
from service.result.result import Verdict
from service.work.plan import _limit_time


@pytest.fixture
def request_of(tmp_path: Path) -> PlanRequest:
    """A planar arm that turns."""
    urdf = write_planar_arm(tmp_path, 3, 0.4, 0.05, 3.0)
    data = {"robot": {"urdf": str(urdf)}, "start": {"joints": {"j0": -1.0, "j1": 0.4}}, "goal": {"joints": {"j0": 1.0}}}
    return parse_request(data)


def state_limit(request: PlanRequest, seconds: float) -> PlanRequest:
    return replace(request, options=replace(request.options, time_limit_s=seconds))


def test_a_busy_machine_ends_a_plan_whose_request_states_a_limit_and_no_other(
    request_of: PlanRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    slow = CountingClock(0.1)  # this much passes between two looks at the clock
    monkeypatch.setattr("time.monotonic", slow)
    late = plan(state_limit(request_of, 5.0))
    assert late.verdict is Verdict.TIME_LIMIT
    assert late.explanation[0].startswith("the time limit of 5 s was reached during")
    result = plan(request_of)
    assert result.verdict is Verdict.CERTIFIED
    assert slow.now > 12.0, "the second plan looked at the clock as often as the first"


def test_the_default_limit_says_that_it_is_processor_time(request_of: PlanRequest) -> None:
    late = plan(request_of, clock=CountingClock(TaskSection.effort_s))
    assert late.verdict is Verdict.TIME_LIMIT
    assert late.explanation[0].startswith("the default limit of 60 s of processor time was reached during")


def test_a_limit_ends_a_plan_at_the_same_step_on_an_equal_clock(request_of: PlanRequest) -> None:
    first, second = (plan(state_limit(request_of, 0.2), clock=CountingClock(0.01)) for _ in range(2))
    assert first.verdict is second.verdict is Verdict.TIME_LIMIT
    assert first.explanation == second.explanation


def test_a_plan_that_ends_early_says_what_its_best_attempt_missed(request_of: PlanRequest) -> None:
    wall = {"name": "wall", "type": "box", "size": [0.6, 0.1, 0.4], "position": [0.8, 0.0, 0.0]}
    closed = replace(request_of, scene=parse_request({**to_json(request_of), "scene": {"obstacles": [wall]}}).scene)
    late = plan(state_limit(closed, 3.0), clock=CountingClock(0.005))
    assert late.verdict is Verdict.TIME_LIMIT
    assert len(late.explanation) > 1
    assert any("wall" in line for line in late.explanation[1:])


def test_an_egress_has_more_effort_by_default_and_a_stated_limit_is_what_it_says(request_of: PlanRequest) -> None:
    assert request_of.limit_s == TaskSection.effort_s
    assert to_json(request_of)["options"]["time_limit_s"] is None
    assert state_limit(request_of, 7.0).limit_s == 7.0
    car = {"robot": {"name": "atlas"}, "task": {"egress": {"surfaces": {"seat": {"piece": "seat"}}, "phases": [
        {"name": name, "contacts": {"pelvis": {"surface": "seat", "at": [0.0, 0.0, 0.0]}}} for name in ("sit", "stand")
    ]}}}  # fmt: skip
    assert parse_request(car).limit_s == EgressRequest.effort_s


def test_a_monitor_counts_from_when_it_was_made() -> None:
    times = [100.0]
    monitor = Monitor(5.0, clock=lambda: times[0])
    times[0] = 103.0
    assert (monitor.elapsed_s(), monitor.remaining_s(), monitor.is_over()) == (3.0, 2.0, False)
    times[0] = 105.0
    assert monitor.is_over()


@pytest.mark.parametrize(("stated", "left", "limit"), [(10.0, 100.0, 10.0), (10.0, 6.0, 4.5), (None, 20.0, 18.0)])
def test_a_deadline_shortens_a_limit_that_is_longer(
    request_of: PlanRequest, stated: float | None, left: float, limit: float
) -> None:
    request = request_of if stated is None else state_limit(request_of, stated)
    limited, clock = _limit_time(request, left)
    assert limited.options.time_limit_s == pytest.approx(limit)
    assert clock is None


def test_a_deadline_beyond_the_default_limit_ends_a_plan_that_waits(request_of: PlanRequest) -> None:
    limited, clock = _limit_time(request_of, 122.0)
    assert limited == request_of
    assert isinstance(clock, EffortClock)
    assert clock.wall_share == pytest.approx(TaskSection.effort_s / 120.0)
    _, late = _limit_time(request_of, 3000.0)
    assert isinstance(late, EffortClock)
    assert late.wall_share == EffortClock().wall_share
