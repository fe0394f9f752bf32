"""One plan from several workers: the first certificate wins, and who only helps gives way."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import grpc
import pytest
from executor_jobs import nap, wait_for_file
from planner_calls import QUICK, finished, plan_request
from planner_server import planner_server

from service.executor.local_pool import LocalPool
from service.proto.planner.v1 import planner_pb2 as wire
from service.proto.planner.v1.planner_pb2_grpc import PlannerServiceStub
from service.proto.planner.v1.result_pb2 import VERDICT_CERTIFIED, MotionResult
from service.request.file import parse_request, request_hash
from service.result.result import Verdict
from service.server.admission import Admission
from service.server.jobs import JobHandle, JobRunner
from service.server.spread import await_certified, with_other_seed
from service.trust.rpc import Refusal
from service.wire.results import add_request_hash
from service.work.plan import PlanAnswer, PlanTask, Refused, run_plan


class _Job:
    """Of which only is known whether it was stopped."""

    is_stopped = False

    def cancel(self) -> None:
        self.is_stopped = True


class _Stays:
    """A control that never stops a plan."""

    def should_stop(self) -> bool:
        return False

    def now(self) -> float:
        return 0.0

    def report(self, event: Any) -> None:
        pass


def _answer(verdict: Verdict, name: str = "") -> PlanAnswer:
    return PlanAnswer(verdict.value, name.encode(), "", "", b"", "", {})


def _raced(*ends: tuple[float, PlanAnswer | Refused | Exception]) -> tuple[PlanAnswer | Refused, list[bool]]:
    """What comes of handles that end after so many seconds, the plan's own first, and which were stopped."""

    async def race() -> tuple[PlanAnswer | Refused, list[bool]]:
        loop = asyncio.get_running_loop()
        handles: list[JobHandle[Any]] = []
        for seconds, end in ends:
            ended = loop.create_future()
            settle = ended.set_exception if isinstance(end, Exception) else ended.set_result
            loop.call_later(seconds, settle, end)
            handles.append(JobHandle(_Job(), ended))  # type: ignore[arg-type]
        answer = await await_certified(handles[0], handles[1:])
        return answer, [handle.job.is_stopped for handle in handles]  # type: ignore[attr-defined]

    return asyncio.run(race())


def test_first_certificate_wins_and_the_others_are_stopped() -> None:
    late, early = _answer(Verdict.CERTIFIED, "own"), _answer(Verdict.CERTIFIED, "helper")
    answer, stopped = _raced((30.0, late), (0.01, early))
    assert answer is early
    assert stopped[0]
    assert _raced((0.01, late), (30.0, early)) == (late, [True, True])


def test_plan_that_falls_short_waits_for_those_that_help() -> None:
    found = _answer(Verdict.CERTIFIED)
    answer, _ = _raced((0.0, _answer(Verdict.NOT_FOUND)), (0.01, _answer(Verdict.TIME_LIMIT)), (0.02, found))
    assert answer is found


@pytest.mark.parametrize("verdict", [Verdict.INFEASIBLE, Verdict.CANCELLED])
def test_what_no_start_can_change_is_the_answer(verdict: Verdict) -> None:
    answer, stopped = _raced((0.0, _answer(verdict)), (30.0, _answer(Verdict.CERTIFIED)))
    assert isinstance(answer, PlanAnswer)
    assert answer.verdict == verdict.value
    assert stopped[1]


def test_where_nobody_finds_a_way_the_plan_s_own_answer_is_told() -> None:
    own = _answer(Verdict.NOT_FOUND, "own")
    failure = Refusal(grpc.StatusCode.INTERNAL, "it died")
    assert _raced((0.02, own), (0.0, _answer(Verdict.NOT_FOUND)), (0.01, failure))[0] is own


def test_failure_of_the_plan_s_own_worker_is_told() -> None:
    with pytest.raises(Refusal, match="it died"):
        _raced((0.0, Refusal(grpc.StatusCode.INTERNAL, "it died")), (30.0, _answer(Verdict.CERTIFIED)))


def test_other_starts_answer_the_same_request_and_say_which_they_were() -> None:
    request = parse_request({**QUICK, "options": {"seed": 2**32 - 1}})
    task = with_other_seed(PlanTask(request), 2)
    assert task.request.options.seed == 1999
    answer = run_plan(task, _Stays())
    assert isinstance(answer, PlanAnswer)
    result = MotionResult.FromString(add_request_hash(answer.reply, request_hash(request)))
    assert result.request_sha256 == request_hash(request)
    assert "found with options.seed 1999, tried besides 4294967295" in result.notes


@pytest.fixture(scope="module")
def pool() -> Iterator[LocalPool]:
    with LocalPool(2, grace_s=0.05) as made:
        yield made


def test_who_helps_gives_way_to_who_asks(pool: LocalPool, tmp_path: Path) -> None:
    async def helped() -> tuple[bool, float]:
        runner = JobRunner(pool, Admission(2, 4))
        first = runner.start("scene", wait_for_file, tmp_path / "go", deadline=None, budget_s=600.0)
        spare = runner.start_spare(nap, 600.0)
        assert spare is not None
        assert runner.start_spare(nap, 600.0) is None  # nobody is idle
        second = runner.start("scene", nap, 0.01, deadline=None, budget_s=60.0)
        await second.ended
        is_still_at_it = not first.ended.done()
        (tmp_path / "go").touch()
        await first.ended
        return is_still_at_it, spare.waited_s

    assert asyncio.run(helped())[0]


def test_server_that_spreads_plans_answers_as_one_that_does_not(tmp_path: Path) -> None:
    with (
        planner_server(tmp_path / "data", "--spread", "2", workers=2) as server,
        grpc.insecure_channel(server.address) as channel,
    ):
        stub = PlannerServiceStub(channel)
        for n_plans in range(1, 20):
            assert finished(stub.Plan(plan_request(QUICK), timeout=240)).result.verdict == VERDICT_CERTIFIED
            status = stub.GetStatus(wire.GetStatusRequest(), timeout=120)
            assert status.verdicts["CERTIFIED"] == n_plans
            if sum(worker.jobs_done for worker in status.workers) > n_plans >= 3:
                return  # both workers were ready, and one helped the other
        pytest.fail("nobody helped")
