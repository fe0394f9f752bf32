"""The executor on a Ray cluster of this machine: its actors do what local workers do."""

from __future__ import annotations

import importlib.util
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import executor_jobs as jobs
import numpy as np
import pytest
from executor_waiting import Events, is_running, until
from ray_cluster import SOON_S, ray_cluster

from service.executor import DeadlineExceeded, JobCancelled, JobFailed, WorkerDied
from service.executor import Pool as CancellableExecutor

if importlib.util.find_spec("ray") is None:
    pytest.skip("ray is not installed (make test-ray has an environment with it)", allow_module_level=True)


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    with ray_cluster() as address:
        yield address


@pytest.fixture(scope="module")
def pool(address: str) -> Iterator[CancellableExecutor]:
    from service.executor.ray_pool import RayPool

    with RayPool(address, 2, warm_up=jobs.warm_up) as pool:
        assert pool.wait_ready(SOON_S)
        workers = [worker.pid for worker in pool.stats().workers]
        yield pool
        workers += [worker.pid for worker in pool.stats().workers]
    assert until(lambda: not any(is_running(pid) for pid in workers if pid is not None))


@pytest.fixture(autouse=True)
def _all_workers_ready(pool: CancellableExecutor) -> None:
    assert until(lambda: pool.stats().ready == 2, SOON_S)


def test_results_come_back(pool: CancellableExecutor) -> None:
    assert list(pool.map(jobs.add, range(10), range(10))) == [2 * i for i in range(10)]
    assert pool.submit(jobs.many_bytes, 5_000_000).result(SOON_S) == bytes(5_000_000)
    assert pool.submit(jobs.was_warmed_up).result(SOON_S) == ["warm"]


def test_exceptions_come_back(pool: CancellableExecutor) -> None:
    error = pool.submit(jobs.raise_value_error, "no such joint").exception(SOON_S)
    assert isinstance(error, ValueError)
    assert "in raise_value_error" in str(error.__cause__)
    with pytest.raises(JobFailed, match="Stubborn: 1 and 2"):
        pool.submit(jobs.raise_stubborn).result(SOON_S)


def test_events_arrive_in_order_and_before_the_result(pool: CancellableExecutor) -> None:
    events = Events()
    job = pool.submit(jobs.count_up, 200, on_event=events)
    job.add_done_callback(lambda _: events("done"))
    assert job.result(SOON_S) == "counted"
    assert until(lambda: "done" in events.seen)
    assert events.seen == [*range(200), "done"]
    assert pool.submit(jobs.count_up, 200).result(SOON_S) == "counted"


def test_a_cancelled_running_job_stops(pool: CancellableExecutor) -> None:
    events = Events()
    job = pool.submit(jobs.run_until_stopped, on_event=events)
    assert events.first() in [worker.pid for worker in pool.stats().workers]
    restarts = pool.stats().restarts
    job.cancel()
    assert job.result(SOON_S) == "the best so far"
    assert pool.stats().restarts == restarts


def test_a_queued_job_that_is_cancelled_never_runs(pool: CancellableExecutor, tmp_path: Path) -> None:
    running = [pool.submit(jobs.wait_for_file, tmp_path / "go") for _ in range(2)]
    queued = pool.submit(jobs.append_mark, tmp_path, "queued")
    assert until(lambda: pool.stats().running == 2, SOON_S)
    assert pool.queue_position(queued) == 1
    assert queued.cancel()
    (tmp_path / "go").touch()
    assert all(job.result(SOON_S) for job in running)
    assert not (tmp_path / "marks").exists()


@pytest.mark.parametrize("fn", [jobs.mark_and_never_poll, jobs.mark_and_keep_the_lock])
def test_a_job_that_does_not_stop_is_killed_and_its_actor_replaced(
    pool: CancellableExecutor, tmp_path: Path, fn: object
) -> None:
    job = pool.submit(fn, tmp_path)
    # No event: an actor sends them by a thread, which native code that keeps the interpreter's lock does not let run.
    assert until(lambda: (tmp_path / "marks").exists(), SOON_S)
    restarts = pool.stats().restarts
    job.cancel()
    with pytest.raises(JobCancelled):
        job.result(SOON_S)
    assert until(lambda: job.pid is not None and not is_running(job.pid))
    assert pool.stats().restarts == restarts


def test_a_deadline_stops_or_kills(pool: CancellableExecutor) -> None:
    job = pool.submit(jobs.run_until_stopped, deadline=time.monotonic() + 2.0)
    assert job.result(SOON_S) == "the best so far"
    with pytest.raises(DeadlineExceeded):
        pool.submit(jobs.never_poll, deadline=time.monotonic() + 2.0).result(SOON_S)
    with pytest.raises(DeadlineExceeded):
        pool.submit(jobs.pid, deadline=time.monotonic() - 0.1).result(SOON_S)


def test_a_job_whose_actor_dies_is_started_again(pool: CancellableExecutor, tmp_path: Path) -> None:
    job = pool.submit(jobs.kill_own_worker, tmp_path, 1)
    assert job.result(SOON_S) == 2
    with pytest.raises(WorkerDied, match="job started 2 times"):
        pool.submit(jobs.kill_own_worker, tmp_path, 99, max_attempts=2).result(SOON_S)


def test_killing_actors_under_load_loses_no_job(pool: CancellableExecutor, tmp_path: Path) -> None:
    todo = [pool.submit(jobs.append_mark_late, tmp_path, str(i), 0.02) for i in range(60)]
    for n_done in (10, 30):
        assert until(lambda n_done=n_done: sum(job.done() for job in todo) >= n_done, SOON_S)
        victim = next(worker.pid for worker in pool.stats().workers if worker.pid is not None)
        os.kill(victim, signal.SIGKILL)
    assert [job.result(SOON_S) for job in todo] == [str(i) for i in range(60)]


def test_memory_of_an_actor_is_bounded(address: str, pool: CancellableExecutor) -> None:
    from service.executor.ray_pool import RayPool

    assert pool.submit(jobs.size_after, 2**30).result(SOON_S) == 2**30
    pool.resize(1)  # the cluster has two CPUs
    try:
        with RayPool(address, 1, max_bytes=2**29) as bounded:
            with pytest.raises(MemoryError):
                bounded.submit(jobs.size_after, 2**30).result(SOON_S)
            assert bounded.submit(jobs.size_after, 2**20).result(SOON_S) == 2**20
    finally:
        pool.resize(2)


def test_a_job_knows_the_callers_time(pool: CancellableExecutor) -> None:
    before = time.monotonic()
    assert before - 1.0 < pool.submit(jobs.now).result(SOON_S) < time.monotonic()


def test_a_plan_made_there_is_the_plan_made_here(pool: CancellableExecutor) -> None:
    from executor_plan import bend_an_elbow

    events = Events()
    verdict, waypoints = pool.submit(bend_an_elbow, on_event=events).result(SOON_S)
    assert verdict == "CERTIFIED"
    assert "certificate" in events.seen
    np.testing.assert_allclose(waypoints, bend_an_elbow()[1], atol=1e-9)
