"""Work handed over from the event loop: what the server ends itself, it says so."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator

import grpc
import pytest
from executor_jobs import nap

from service.executor.local_pool import LocalPool
from service.server import jobs
from service.server.admission import Admission
from service.server.jobs import JobHandle, JobRunner, await_result
from service.server.refusals import STOPPING
from service.trust.rpc import Refusal


@pytest.fixture(scope="module")
def pool() -> Iterator[LocalPool]:
    with LocalPool(1, grace_s=0.05) as made:
        yield made


async def _begun(runner: JobRunner) -> JobHandle[None]:
    handle = runner.start("scene", nap, 60.0, deadline=None, budget_s=0.0)
    while handle.job.started is None:
        await asyncio.sleep(0.01)
    return handle


def test_work_that_took_longer_than_it_may_is_told_how_long_that_is(
    pool: LocalPool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(jobs, "OVERTIME_S", 0.0)

    async def ends() -> Refusal:
        runner = JobRunner(pool, Admission(1, 4))
        handle = await _begun(runner)
        runner.stop_overdue()
        with pytest.raises(Refusal) as refused:
            await await_result(handle)
        return refused.value

    refusal = asyncio.run(ends())
    assert refusal.code is grpc.StatusCode.DEADLINE_EXCEEDED
    assert refusal.text.startswith("scene may take 0 s")


def test_what_a_stopping_server_ends_is_sent_elsewhere(pool: LocalPool) -> None:
    async def ends() -> list[grpc.StatusCode]:
        runner = JobRunner(pool, Admission(1, 4))
        handles = [await _begun(runner), runner.start("scene", nap, 60.0, deadline=None, budget_s=60.0)]
        runner.stop_all(STOPPING)
        errors = await asyncio.gather(*(await_result(handle) for handle in handles), return_exceptions=True)
        await asyncio.wait_for(runner.wait_until_empty(), 60.0)
        return [error.code for error in errors if isinstance(error, Refusal)]

    assert asyncio.run(ends()) == [grpc.StatusCode.UNAVAILABLE] * 2
