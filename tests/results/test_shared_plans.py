"""Plans of the tests themselves: made once per run, handed out as copies."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shared_plans
from shared_plans import plan_once, write_once
from small_plan import small_plan

from service.request.file import parse_request
from service.request.schema import PlanRequest
from service.result.folder import read_result
from service.result.result import PlanResult, Verdict


@pytest.fixture
def made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[PlanRequest]:
    """Requests that a stand-in of the planner was asked for."""
    asked: list[PlanRequest] = []
    answer = small_plan()

    def plan(request: PlanRequest) -> PlanResult:
        asked.append(request)
        is_known = request == answer.request
        return replace(answer, verdict=Verdict.CERTIFIED if is_known else Verdict.NOT_FOUND)

    monkeypatch.setattr(shared_plans, "plan", plan)
    monkeypatch.setenv("SCOPT_TEST_RUN", str(tmp_path))
    return asked


def test_a_plan_is_made_once_and_a_change_of_it_is_seen_by_nobody_else(made: list[PlanRequest]) -> None:
    request = small_plan().request
    with ThreadPoolExecutor(4) as threads:
        first, *others = threads.map(plan_once, [request] * 4)
    assert len(made) == 1
    first.start[:] = 7.0
    assert all((other.start != 7.0).all() for other in (*others, plan_once(request)))
    np.testing.assert_array_equal(read_result(write_once(request))["trajectory"]["times"][0], 0.0)
    assert write_once(request) == write_once(request)
    assert len(made) == 1


def test_what_is_not_certified_is_an_error_and_is_not_kept(made: list[PlanRequest], tmp_path: Path) -> None:
    request = parse_request({"robot": {"name": "atlas"}, "goal": {"joints": {"l_arm_elx": 1.5}}})
    for count in (1, 2):
        with pytest.raises(RuntimeError, match="NOT_FOUND"):
            plan_once(request)
        assert len(made) == count
    assert not list((tmp_path / "plans").glob("*.pickle"))
