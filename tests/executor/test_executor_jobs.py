"""Jobs of a pool whose workers stay alive: results, errors, events, cancellation, deadlines."""

from __future__ import annotations

import asyncio
import logging
import os
import pickle
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, wait
from functools import partial
from pathlib import Path
from typing import Any

import executor_jobs as jobs
import pytest
from executor_waiting import Events, until

from service.executor import DeadlineExceeded, Job, JobCancelled, JobFailed, LocalPool, PoolClosed, WorkerState
from service.executor.ray_pool import RayWorker
from service.executor.worker import WorkerSetup

SOON_S = 120.0  # far more than anything takes


@pytest.fixture(scope="module")
def pool() -> Iterator[LocalPool]:
    """Two workers that all tests of this file share, since each leaves them as they were."""
    with LocalPool(2, grace_s=SOON_S) as pool:
        assert pool.wait_ready(SOON_S)
        yield pool


@pytest.fixture(scope="module")
def single() -> Iterator[LocalPool]:
    """One worker, so that jobs wait for each other."""
    with LocalPool(1, grace_s=SOON_S) as pool:
        assert pool.wait_ready(SOON_S)
        yield pool


@pytest.fixture(scope="module")
def patient() -> Iterator[LocalPool]:
    """One worker that is not killed."""
    with LocalPool(1, grace_s=SOON_S) as pool:
        assert pool.wait_ready(SOON_S)
        yield pool


@pytest.fixture(scope="module")
def killing_pool() -> Iterator[LocalPool]:
    with LocalPool(1, grace_s=0.05) as pool:
        yield pool


@pytest.fixture
def strict(killing_pool: LocalPool) -> LocalPool:
    """One worker, which is up, and is killed soon when its job does not stop."""
    assert until(lambda: [worker.state for worker in killing_pool.stats().workers] == [WorkerState.IDLE])
    return killing_pool


def begun_before_its_deadline(pool: LocalPool, fn: Callable[..., Any]) -> Job[Any]:
    """Submit a job with a deadline that passes soon after it has begun; return it when it has ended."""
    for left_s in (0.1, 1.0, 10.0, 60.0):
        job = pool.submit(fn, deadline=time.monotonic() + left_s)
        wait([job], SOON_S)
        if job.attempts:
            break
    return job


def test_a_result_comes_back(pool: LocalPool) -> None:
    assert pool.submit(jobs.add, 1, right=2).result(SOON_S) == 3


def test_functions_run_in_another_process(pool: LocalPool) -> None:
    assert pool.submit(jobs.pid).result(SOON_S) in {worker.pid for worker in pool.stats().workers}


def test_a_job_knows_the_callers_time(pool: LocalPool) -> None:
    before = time.monotonic()
    assert before < pool.submit(jobs.now).result(SOON_S) < time.monotonic()


def test_a_job_on_another_machine_knows_the_callers_time() -> None:
    worker = RayWorker(pickle.dumps(WorkerSetup((), None, None)))
    answer = worker.run(1, pickle.dumps((jobs.now, (), {})), False, now=1e6)
    assert pickle.loads(answer.payload) == pytest.approx(1e6, abs=60.0)


def test_workers_have_a_lower_priority(pool: LocalPool) -> None:
    assert pool.submit(os.nice, 0).result(SOON_S) > os.nice(0)


def test_map_and_wait_work_as_with_any_executor(pool: LocalPool) -> None:
    assert list(pool.map(jobs.add, range(20), range(20))) == [2 * i for i in range(20)]
    done, left = wait([pool.submit(pow, 2, i) for i in range(5)], SOON_S)
    assert (sorted(job.result() for job in done), left) == ([1, 2, 4, 8, 16], set())


def test_partial_functions_run(pool: LocalPool) -> None:
    events = Events()
    assert pool.submit(partial(jobs.count_up, count=2), on_event=events).result(SOON_S) == "counted"
    assert events.seen == [0, 1]


def test_large_arguments_and_results_arrive_whole(pool: LocalPool) -> None:
    assert pool.submit(jobs.size_of, bytes(20_000_000)).result(SOON_S) == 20_000_000
    assert pool.submit(jobs.many_bytes, 20_000_000).result(SOON_S) == bytes(20_000_000)


def test_an_exception_comes_back_with_where_it_was_raised(pool: LocalPool) -> None:
    error = pool.submit(jobs.raise_value_error, "no such joint").exception(SOON_S)
    assert isinstance(error, ValueError)
    assert str(error) == "no such joint"
    assert "in raise_value_error" in str(error.__cause__)


def test_an_exception_that_cannot_be_unpickled_becomes_text(pool: LocalPool) -> None:
    with pytest.raises(JobFailed, match=r"Stubborn: 1 and 2"):
        pool.submit(jobs.raise_stubborn).result(SOON_S)


def test_system_exit_is_an_error_and_ends_no_worker(pool: LocalPool) -> None:
    restarts = pool.stats().restarts
    with pytest.raises(JobFailed, match="SystemExit: 3"):
        pool.submit(jobs.raise_exit).result(SOON_S)
    assert pool.stats().restarts == restarts


def test_a_result_that_cannot_be_pickled_is_an_error(pool: LocalPool) -> None:
    with pytest.raises(JobFailed, match="returned what cannot be pickled, a lock"):
        pool.submit(jobs.return_a_lock).result(SOON_S)


def test_an_event_that_cannot_be_pickled_is_an_error(pool: LocalPool) -> None:
    with pytest.raises(TypeError, match="pickle"):
        pool.submit(jobs.report_a_lock).result(SOON_S)


def test_a_call_that_cannot_be_pickled_is_refused_at_once(pool: LocalPool) -> None:
    with pytest.raises(TypeError, match="picklable"):
        pool.submit(lambda: 1)
    with pytest.raises(TypeError, match="picklable"):
        pool.submit(jobs.add, 1, (i for i in range(3)))


def test_a_function_of_the_main_script_is_refused_at_once(pool: LocalPool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jobs.add, "__module__", "__main__")
    with pytest.raises(TypeError, match="add is a function of the main script"):
        pool.submit(jobs.add, 1, 2)


def test_events_arrive_in_order_and_before_the_result(pool: LocalPool) -> None:
    events = Events()
    job = pool.submit(jobs.count_up, 500, on_event=events)
    job.add_done_callback(lambda _: events("done"))
    assert job.result(SOON_S) == "counted"
    assert until(lambda: "done" in events.seen)
    assert events.seen == [*range(500), "done"]


def test_an_event_handler_that_fails_harms_no_job(pool: LocalPool, caplog: pytest.LogCaptureFixture) -> None:
    job = pool.submit(jobs.count_up, 2, on_event=lambda event: 1 / 0)
    assert job.result(SOON_S) == "counted"
    assert "an event of job" in caplog.text


def test_jobs_run_in_order_of_submission(single: LocalPool, tmp_path: Path) -> None:
    names = [f"job {i}" for i in range(30)]
    wait([single.submit(jobs.append_mark, tmp_path, name) for name in names], SOON_S)
    assert (tmp_path / "marks").read_text().splitlines() == names


def test_a_queued_job_has_a_position(single: LocalPool, tmp_path: Path) -> None:
    running = single.submit(jobs.wait_for_file, tmp_path / "go")
    queued = [single.submit(jobs.pid) for _ in range(3)]
    assert until(running.running)
    assert [single.queue_position(job) for job in (running, *queued)] == [None, 1, 2, 3]
    assert (single.stats().running, single.stats().queued) == (1, 3)
    queued[0].cancel()
    assert [single.queue_position(job) for job in queued] == [None, 1, 2]
    (tmp_path / "go").touch()
    wait(queued, SOON_S)
    assert single.queue_position(queued[2]) is None


def test_a_queued_job_that_is_cancelled_never_runs(single: LocalPool, tmp_path: Path) -> None:
    running = single.submit(jobs.wait_for_file, tmp_path / "go")
    queued = single.submit(jobs.append_mark, tmp_path, "queued")
    done = Events()
    queued.add_done_callback(done)
    assert queued.cancel()
    assert queued.cancelled()
    with pytest.raises(CancelledError):
        queued.result(SOON_S)
    assert wait([queued], SOON_S).done == {queued}
    (tmp_path / "go").touch()
    assert running.result(SOON_S)
    single.submit(jobs.pid).result(SOON_S)
    assert not (tmp_path / "marks").exists()
    assert done.seen == [queued]


def test_a_cancelled_running_job_stops_and_returns_its_result(pool: LocalPool) -> None:
    events = Events()
    job = pool.submit(jobs.run_until_stopped, on_event=events)
    events.first()
    restarts = pool.stats().restarts
    assert job.cancel()
    assert job.result(SOON_S) == "the best so far"
    assert pool.stats().restarts == restarts


def test_a_cancel_stops_one_job_only(pool: LocalPool) -> None:
    first, second = Events(), Events()
    stopped = pool.submit(jobs.run_until_stopped, on_event=first)
    other = pool.submit(jobs.run_until_stopped, on_event=second)
    first.first(), second.first()
    stopped.cancel()
    assert stopped.result(SOON_S) == "the best so far"
    time.sleep(0.15)
    assert other.running()
    begun = Events()
    after = pool.submit(jobs.run_until_stopped, on_event=begun)  # on the worker whose job was stopped just now
    begun.first()
    time.sleep(0.05)
    assert after.running()
    other.cancel(), after.cancel()
    assert {other.result(SOON_S), after.result(SOON_S)} == {"the best so far"}


def test_a_finished_job_cannot_be_cancelled(pool: LocalPool) -> None:
    job = pool.submit(jobs.add, 1, 2)
    job.result(SOON_S)
    assert not job.cancel()
    assert job.result() == 3


@pytest.mark.parametrize("fn", [jobs.never_poll, jobs.stuck_in_native_code])
def test_a_job_that_does_not_stop_is_killed_and_its_worker_replaced(strict: LocalPool, fn: object) -> None:
    events = Events()
    restarts = strict.stats().restarts
    job = strict.submit(fn, on_event=events)
    worker = events.first()
    assert job.cancel()
    with pytest.raises(JobCancelled, match="ended"):
        job.result(SOON_S)
    assert not job.cancelled()
    assert strict.submit(jobs.pid).result(SOON_S) != worker
    assert strict.stats().restarts == restarts


def test_a_worker_has_no_signal_handler_that_could_raise_in_a_job(pool: LocalPool) -> None:
    assert pool.submit(jobs.signal_handlers).result(SOON_S) == []


def test_a_cancelled_job_that_raises_job_cancelled_keeps_its_worker(patient: LocalPool) -> None:
    events = Events()
    job = patient.submit(jobs.raise_when_stopped, on_event=events)
    worker = events.first()
    assert job.cancel()
    with pytest.raises(JobCancelled, match="stopped by itself"):
        job.result(SOON_S)
    assert patient.submit(jobs.pid).result(SOON_S) == worker
    assert patient.stats().restarts == 0


def test_a_job_that_stops_at_its_deadline_raises_deadline_exceeded(patient: LocalPool) -> None:
    job = begun_before_its_deadline(patient, jobs.raise_when_stopped)
    with pytest.raises(DeadlineExceeded, match="it stopped by itself"):
        job.result(SOON_S)


def test_a_job_that_raises_job_cancelled_without_a_cancel_has_failed(pool: LocalPool) -> None:
    with pytest.raises(JobFailed, match="JobCancelled"):
        pool.submit(jobs.raise_cancelled).result(SOON_S)


def test_a_kill_delivers_no_incomplete_event() -> None:
    with LocalPool(1, grace_s=0.005) as pool:
        for _ in range(3):
            sizes: list[int] = []
            job = pool.submit(
                jobs.report_and_never_poll, 200_000, on_event=lambda event, to=sizes: to.append(len(event))
            )
            assert until(lambda got=sizes: len(got) > 3)
            job.cancel()
            with pytest.raises(JobCancelled):
                job.result(SOON_S)
            assert set(sizes) == {200_000}


def test_a_late_cancel_does_not_stop_the_next_job(patient: LocalPool) -> None:
    for i in range(40):
        events = Events()
        job = patient.submit(jobs.run_until_stopped, on_event=events)
        after = patient.submit(jobs.add, i, 1)
        events.first()
        job.cancel()
        assert after.result(SOON_S) == i + 1
    assert patient.stats().restarts == 0


def test_a_job_queued_at_its_deadline_never_runs(single: LocalPool, tmp_path: Path) -> None:
    running = single.submit(jobs.wait_for_file, tmp_path / "go")
    queued = single.submit(jobs.append_mark, tmp_path, "queued", deadline=time.monotonic() + 0.05)
    late = single.submit(jobs.append_mark, tmp_path, "late", deadline=time.monotonic() - 1.0)
    for job in (queued, late):
        with pytest.raises(DeadlineExceeded, match="started 0 times"):
            job.result(SOON_S)
    assert single.stats().queued == 0
    (tmp_path / "go").touch()
    assert running.result(SOON_S)
    single.submit(jobs.pid).result(SOON_S)
    assert not (tmp_path / "marks").exists()


def test_a_deadline_stops_a_running_job(pool: LocalPool) -> None:
    job = begun_before_its_deadline(pool, jobs.run_until_stopped)
    assert job.result(SOON_S) == "the best so far"


def test_a_deadline_kills_a_job_that_does_not_stop(strict: LocalPool) -> None:
    with pytest.raises(DeadlineExceeded, match="ended"):
        begun_before_its_deadline(strict, jobs.never_poll).result(SOON_S)
    assert strict.submit(jobs.add, 1, 2, deadline=time.monotonic() + SOON_S).result(SOON_S) == 3


def test_a_cancelled_coroutine_stops_its_job(pool: LocalPool) -> None:
    async def time_out() -> None:
        events = Events()
        job = pool.submit(jobs.run_until_stopped, on_event=events)
        events.first()
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(asyncio.wrap_future(job), 0.05)
        assert job.result(SOON_S) == "the best so far"

    asyncio.run(time_out())


def test_stats_describe_each_worker(single: LocalPool, tmp_path: Path) -> None:
    before = single.stats()
    job = single.submit(jobs.wait_for_file, tmp_path / "go")
    assert until(job.running)
    (worker,) = single.stats().workers
    assert (worker.state, worker.pid) == (WorkerState.BUSY, job.pid)
    assert worker.rss_bytes > 1_000_000
    (tmp_path / "go").touch()
    job.result(SOON_S)
    assert until(lambda: single.stats().done == before.done + 1)
    (after,) = single.stats().workers
    assert (after.state, after.jobs_done) == (WorkerState.IDLE, before.workers[0].jobs_done + 1)
    assert (single.stats().ready, single.stats().running) == (1, 0)


def test_the_output_of_workers_goes_to_the_log(
    pool: LocalPool, caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str]
) -> None:
    with caplog.at_level(logging.INFO, "service.executor"):
        job = pool.submit(jobs.say, "four score and seven")
        job.result(SOON_S)
        assert until(lambda: "four score and seven" in caplog.text)
    assert f"(pid {job.pid})" in caplog.text
    assert capfd.readouterr() == ("", "")


def test_a_draining_pool_refuses_jobs_and_finishes_accepted_ones() -> None:
    with LocalPool(1) as pool:
        queued = [pool.submit(jobs.nap, 0.02) for _ in range(3)]
        assert pool.drain(SOON_S)
        assert [job.result(0) for job in queued] == [0.02] * 3
        with pytest.raises(PoolClosed):
            pool.submit(jobs.pid)


def test_a_drain_cancels_jobs_that_do_not_finish_in_time() -> None:
    with LocalPool(1, grace_s=SOON_S) as pool:
        soft, hard = Events(), Events()
        partial_result = pool.submit(jobs.run_until_stopped, on_event=soft)
        soft.first()
        queued = pool.submit(jobs.never_poll, on_event=hard)
        assert not pool.drain(0.05)
        assert partial_result.result(0) == "the best so far"
        assert queued.cancelled()
    assert hard.seen == []


def test_shutdown_finishes_jobs_or_cancels_queued_ones(tmp_path: Path) -> None:
    with LocalPool(1) as pool:
        finished = [pool.submit(jobs.append_mark, tmp_path, str(i)) for i in range(3)]
    assert [job.result(0) for job in finished] == ["0", "1", "2"]
    pool = LocalPool(1)
    running = pool.submit(jobs.wait_for_file, tmp_path / "go")
    assert until(running.running)
    queued = pool.submit(jobs.append_mark, tmp_path, "3")
    queued.add_done_callback(lambda _: (tmp_path / "go").touch())
    pool.shutdown(cancel_futures=True)
    pool.shutdown()
    assert running.result(0)
    assert queued.cancelled()
    assert "3" not in (tmp_path / "marks").read_text().split()
    with pytest.raises(PoolClosed):
        pool.submit(jobs.pid)


def test_a_pool_needs_a_worker() -> None:
    with pytest.raises(ValueError, match="workers must be at least 1; got 0"):
        LocalPool(0)


def test_jobs_of_many_threads_run_once_each(pool: LocalPool) -> None:
    n_done = pool.stats().done
    submitted: list[tuple[int, Job[Any]]] = []

    def submit_some(first: int) -> None:
        for number in range(first, first + 50):
            submitted.append((number, pool.submit(jobs.add, number, 1)))
            if number % 7 == 0:
                wait([submitted[-1][1]])  # so that it finds an idle worker at times

    threads = [threading.Thread(target=submit_some, args=(100 * index,)) for index in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [job.result(SOON_S) for _, job in submitted] == [number + 1 for number, _ in submitted]
    assert {job.attempts for _, job in submitted} == {1}
    assert until(lambda: pool.stats().done == n_done + 300)


def test_a_job_that_finds_an_idle_worker_needs_no_other_thread(
    single: LocalPool, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert until(lambda: [worker.state for worker in single.stats().workers] == [WorkerState.IDLE])
    submitted: list[Job[Any]] = []

    def has_started() -> bool:  # not the first one, if the supervisor does something at that moment
        submitted.append(single.submit(jobs.add, 1, 2))
        return submitted[-1].started is not None

    with monkeypatch.context() as patch:
        patch.setattr(single._supervisor, "_call", lambda *_: True)
        assert until(has_started, 5.0)
    assert [job.result(SOON_S) for job in submitted] == [3] * len(submitted)
