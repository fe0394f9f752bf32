"""An event loop of the caller that reads what workers send: who ends jobs, and what happens around it."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path

import executor_jobs as jobs
import pytest
from executor_waiting import Events, until

from service.executor import Job, LocalPool, PoolClosed, WorkerDied

SOON_S = 120.0  # far more than anything takes


@pytest.fixture(scope="module")
def pool() -> Iterator[LocalPool]:
    with LocalPool(1) as pool:
        assert pool.wait_ready(SOON_S)
        yield pool


def _run(body: Callable[[asyncio.AbstractEventLoop], Awaitable[None]]) -> None:
    async def run() -> None:
        await asyncio.wait_for(body(asyncio.get_running_loop()), SOON_S)

    asyncio.run(run())


def _note_thread(job: Job[object]) -> list[int]:
    threads: list[int] = []
    job.add_done_callback(lambda _: threads.append(threading.get_ident()))
    return threads


def test_jobs_end_in_the_thread_of_the_loop_that_reads_and_afterwards_in_the_pools(pool: LocalPool) -> None:
    async def body(loop: asyncio.AbstractEventLoop) -> None:
        with pool.read_in(loop):
            job = pool.submit(jobs.add, 1, 2)
            threads = _note_thread(job)
            assert await asyncio.wrap_future(job) == 3
            assert threads == [threading.get_ident()]

    _run(body)
    job = pool.submit(jobs.many_bytes, 3_000_000)
    threads = _note_thread(job)
    assert len(job.result(SOON_S)) == 3_000_000
    assert until(lambda: threads)
    assert threads != [threading.get_ident()]


def test_queued_jobs_follow_each_other_and_events_keep_their_order(pool: LocalPool) -> None:
    async def body(loop: asyncio.AbstractEventLoop) -> None:
        with pool.read_in(loop):
            events = Events()
            first = pool.submit(jobs.count_up, 200, on_event=events)
            others = [pool.submit(jobs.add, number, 0) for number in range(20)]
            assert await asyncio.gather(*(asyncio.wrap_future(job) for job in others)) == list(range(20))
            assert first.done()
            assert events.seen == list(range(200))

    _run(body)


def test_a_result_larger_than_the_sockets_buffer_arrives(pool: LocalPool) -> None:
    async def body(loop: asyncio.AbstractEventLoop) -> None:
        with pool.read_in(loop):
            assert len(await asyncio.wrap_future(pool.submit(jobs.many_bytes, 20_000_000))) == 20_000_000

    _run(body)


def test_a_job_whose_worker_dies_is_started_again_on_its_successor(pool: LocalPool, tmp_path: Path) -> None:
    async def body(loop: asyncio.AbstractEventLoop) -> None:
        with pool.read_in(loop):
            assert await asyncio.wrap_future(pool.submit(jobs.kill_own_worker, tmp_path, 1)) == 2
            with pytest.raises(WorkerDied):
                await asyncio.wrap_future(pool.submit(jobs.exit_silently, 3, max_attempts=2))
            assert await asyncio.wrap_future(pool.submit(jobs.add, 1, 1)) == 2

    _run(body)


def test_while_the_pools_thread_is_busy_the_loop_goes_on_and_reads_afterwards(pool: LocalPool, tmp_path: Path) -> None:
    async def body(loop: asyncio.AbstractEventLoop) -> None:
        with pool.read_in(loop):
            job = pool.submit(jobs.wait_for_file, tmp_path / "go")
            with pool._supervisor._guard:  # as the thread holds it while it works
                (tmp_path / "go").touch()
                for _ in range(10):
                    await asyncio.sleep(0.01)
                assert not job.done()
            assert await asyncio.wrap_future(job)

    _run(body)


def test_a_pool_that_ends_while_its_sockets_are_lent_leaves_nothing_behind() -> None:
    async def body(loop: asyncio.AbstractEventLoop) -> None:
        pool = LocalPool(1)
        assert await asyncio.to_thread(pool.wait_ready, SOON_S)
        with pool.read_in(loop):
            assert await asyncio.wrap_future(pool.submit(jobs.add, 1, 2)) == 3
            await asyncio.to_thread(pool.shutdown)
            with pytest.raises(PoolClosed):
                pool.submit(jobs.add, 1, 2)
        assert pool._supervisor._inbox._epoll.closed  # type: ignore[attr-defined]

    _run(body)
