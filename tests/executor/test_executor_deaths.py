"""A pool's jobs when workers die, send nonsense, stop reading or never become ready."""

from __future__ import annotations

import logging
import os
import signal
import struct
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import CancelledError
from pathlib import Path

import executor_jobs as jobs
import pytest
from executor_waiting import Events, is_running, parent_of, until

from service.executor import (
    Job,
    JobCancelled,
    LocalPool,
    WorkerDied,
    WorkerState,
    local_pool,
    supervisor,
    worker_handle,
)
from service.executor.channel import Kind

SOON_S = 120.0  # far more than anything takes
SUPPORT = Path(jobs.__file__).parent


def pids(pool: LocalPool) -> list[int]:
    return [worker.pid for worker in pool.stats().workers if worker.pid is not None]


def running_on(pool: LocalPool, todo: list[Job[str]]) -> list[int]:
    """Return the process ids of the workers that run one of these jobs."""
    pids = [job.pid for job in todo if job.pid is not None and job.running() and pool.queue_position(job) is None]
    return [pid for pid in pids if is_running(pid)]  # the pool learns of a death a moment later


@pytest.fixture(scope="module")
def healing_pool() -> Iterator[LocalPool]:
    """One worker that tests of this file may kill."""
    with LocalPool(1) as pool:
        yield pool


@pytest.fixture
def single(healing_pool: LocalPool) -> LocalPool:
    """One worker, which is up."""
    assert until(lambda: [worker.state for worker in healing_pool.stats().workers] == [WorkerState.IDLE])
    return healing_pool


@pytest.fixture
def short_retry_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    """Failed starts are repeated after 10 and 20 ms instead of 100 and 200."""
    monkeypatch.setattr(supervisor, "FIRST_WAIT_S", 0.01)


def test_killing_workers_under_load_loses_no_job_and_ends_none_twice(tmp_path: Path) -> None:
    n_ends: Counter[int] = Counter()
    victims: list[list[int]] = []
    with LocalPool(2) as pool:
        assert pool.wait_ready(SOON_S)
        todo = [pool.submit(jobs.append_mark_late, tmp_path, str(i), 0.004) for i in range(150)]
        for job in todo:
            job.add_done_callback(lambda job: n_ends.update([job.number]))  # type: ignore[attr-defined]
        for n_done in range(10, 140, 20):
            assert until(lambda n_done=n_done: sum(job.done() for job in todo) >= n_done, SOON_S)
            assert until(lambda: victims.append(running_on(pool, todo)) or victims[-1])
            os.kill(victims[-1][0], signal.SIGKILL)
        assert [job.result(SOON_S) for job in todo] == [str(i) for i in range(150)]
        assert pool.stats().restarts == 7
    assert n_ends == Counter(job.number for job in todo)
    assert set((tmp_path / "marks").read_text().split()) == {str(i) for i in range(150)}


def test_a_job_whose_worker_dies_is_started_again(single: LocalPool, tmp_path: Path) -> None:
    job = single.submit(jobs.kill_own_worker, tmp_path, 2)
    assert job.result(SOON_S) == 3
    assert job.attempts == 3


def test_messages_sent_before_a_worker_died_count(single: LocalPool) -> None:
    events = Events()

    assert single.wait_ready(SOON_S)
    (worker,) = pids(single)

    def wait_for_death(event: bytes) -> None:  # where messages are read
        events(event)
        if len(events.seen) == 1:
            assert until(lambda: not is_running(worker))
            time.sleep(0.05)  # until the fork server has reported it

    job = single.submit(jobs.return_and_die, 12, on_event=wait_for_death)
    assert job.result(SOON_S) == "done"
    assert (job.attempts, len(events.seen)) == (1, 12)


def test_a_job_started_again_runs_before_queued_ones(single: LocalPool, tmp_path: Path) -> None:
    deadly = single.submit(jobs.kill_own_worker, tmp_path, 1)
    waiting = single.submit(jobs.append_mark, tmp_path, "waited")
    assert deadly.result(SOON_S) == 2
    waiting.result(SOON_S)
    assert (tmp_path / "marks").read_text().split() == ["run", "run", "waited"]


def test_a_job_that_always_kills_its_worker_fails_and_the_pool_goes_on(single: LocalPool, tmp_path: Path) -> None:
    restarts = single.stats().restarts
    job = single.submit(jobs.kill_own_worker, tmp_path, 99)
    with pytest.raises(WorkerDied, match=r"worker ended \(SIGKILL\), job started 3 times") as caught:
        job.result(SOON_S)
    assert (caught.value.cause, caught.value.attempts) == ("SIGKILL", 3)
    assert single.submit(jobs.add, 1, 2).result(SOON_S) == 3
    assert single.stats().restarts == restarts + 3


def test_the_error_of_a_crash_has_its_signal_and_the_last_output(single: LocalPool) -> None:
    with pytest.raises(WorkerDied, match="SIGSEGV") as caught:
        single.submit(jobs.crash, max_attempts=1).result(SOON_S)
    assert "the last words" in caught.value.last_output
    assert "executor_jobs.py" in caught.value.last_output  # the stack at the crash


def test_the_error_of_a_worker_that_exits_has_its_exit_code(single: LocalPool) -> None:
    with pytest.raises(WorkerDied, match="exit 7"):
        single.submit(jobs.exit_silently, 7, max_attempts=2).result(SOON_S)


def test_a_cancelled_job_is_not_started_again() -> None:
    events = Events()
    with LocalPool(1, grace_s=30.0) as pool:
        job = pool.submit(jobs.never_poll, on_event=events)
        worker = events.first()
        job.cancel()
        time.sleep(0.02)
        os.kill(worker, signal.SIGKILL)
        with pytest.raises(JobCancelled):
            job.result(SOON_S)
        assert job.attempts == 1


def test_a_job_waiting_to_be_started_again_can_be_cancelled(tmp_path: Path) -> None:
    with LocalPool(1, warm_up=jobs.warm_up, start_timeout_s=SOON_S) as pool:
        events = Events()
        job = pool.submit(jobs.never_poll, on_event=events)
        os.kill(parent_of(events.first()), signal.SIGKILL)  # so that it takes a while until there is another worker
        assert until(lambda: pool.queue_position(job) == 1)
        assert job.cancel()
        with pytest.raises(CancelledError):
            job.result(SOON_S)


def test_each_job_ends_once_however_close_its_end_is_to_the_kill() -> None:
    n_ends: Counter[int] = Counter()
    outcomes: Counter[str] = Counter()
    grace_s = 0.02

    def note(job: Job[str]) -> None:
        n_ends[job.number] += 1
        outcomes["killed" if job.exception() else job.result()] += 1  # which of them, only the clock knows

    with LocalPool(2, grace_s=grace_s) as pool:
        for i in range(10):
            job = pool.submit(jobs.stop_late, grace_s * (0.5 + i / 10), on_event=(events := Events()))
            job.add_done_callback(note)
            events.first()
            job.cancel()
        assert pool.drain(SOON_S)
    assert set(n_ends.values()) == {1}
    assert sum(outcomes.values()) == 10
    assert set(outcomes) <= {"killed", "stopped"}


@pytest.fixture
def unwatched(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody looks whether workers are stopped, and replaces them."""
    monkeypatch.setattr(local_pool, "WATCH_EVERY_S", 3600.0)


@pytest.mark.usefixtures("unwatched")
def test_a_worker_suspended_while_it_sends_its_result_delays_no_other_job() -> None:
    stopped: list[int] = []

    def stop(worker: int) -> None:  # runs where messages are read, so that the result has not arrived yet
        if not stopped:
            os.kill(worker, signal.SIGSTOP)
        stopped.append(worker)

    with LocalPool(2) as pool:
        assert pool.wait_ready(SOON_S)
        job = pool.submit(jobs.report_then_return, 20_000_000, on_event=stop)
        assert until(lambda: stopped)
        assert [pool.submit(jobs.add, i, i).result(SOON_S) for i in range(20)] == [2 * i for i in range(20)]
        assert not job.done()
        os.kill(stopped[0], signal.SIGKILL)
        assert job.result(SOON_S) == bytes(20_000_000)
        assert job.attempts == 2


@pytest.mark.usefixtures("unwatched")
def test_a_worker_that_stops_reading_delays_no_other_job() -> None:
    with LocalPool(2, grace_s=0.05) as pool:
        assert pool.wait_ready(SOON_S)
        suspended = pids(pool)[0]
        os.kill(suspended, signal.SIGSTOP)
        job = pool.submit(jobs.size_of, bytes(20_000_000))
        assert until(lambda: job.pid is not None)
        assert job.pid == suspended
        assert [pool.submit(jobs.add, i, i).result(SOON_S) for i in range(20)] == [2 * i for i in range(20)]
        job.cancel()
        with pytest.raises(JobCancelled):
            job.result(SOON_S)
        assert pool.wait_ready(SOON_S)
        assert until(lambda: not is_running(suspended))


@pytest.mark.parametrize("fn", [jobs.send_nonsense, jobs.close_sockets])
def test_a_worker_that_sends_nonsense_or_closes_its_socket_is_replaced(single: LocalPool, fn: object) -> None:
    with pytest.raises(WorkerDied, match="SIGKILL"):
        single.submit(fn, max_attempts=2).result(SOON_S)
    assert single.submit(jobs.add, 1, 2).result(SOON_S) == 3


@pytest.mark.parametrize("payload", [b"\xff" * 64, struct.pack("<BQQ", Kind.READY, 0, 0)])
def test_a_worker_that_sends_nonsense_while_idle_gets_no_job(single: LocalPool, payload: bytes) -> None:
    restarts = single.stats().restarts
    single.submit(jobs.send_nonsense_later, payload).result(SOON_S)
    assert until(lambda: single.stats().restarts == restarts + 1)
    assert single.submit(jobs.add, 1, 2).result(SOON_S) == 3


def test_a_job_that_reports_without_end_delays_no_other_job() -> None:
    with LocalPool(2, grace_s=SOON_S) as pool:
        # The callback is slower than the events are sent.
        reporting = pool.submit(jobs.report_until_stopped, on_event=lambda _: time.sleep(0.0005))
        assert until(reporting.running)
        assert pool.submit(jobs.add, 1, 2).result(SOON_S) == 3
        reporting.cancel()
        assert reporting.result(SOON_S) == "stopped"


def test_processes_started_by_a_killed_worker_end_with_it() -> None:
    events = Events()
    with LocalPool(1, grace_s=0.05) as pool:
        job = pool.submit(jobs.start_child, on_event=events)
        worker, child = events.first()
        assert os.getsid(child) != os.getsid(worker)
        job.cancel()
        assert until(lambda: not is_running(worker) and not is_running(child))
        assert pool.submit(jobs.add, 1, 2).result(SOON_S) == 3


def test_the_pool_survives_the_death_of_its_fork_server(tmp_path: Path) -> None:
    with LocalPool(2) as pool:
        assert pool.wait_ready(SOON_S)
        old = pids(pool)
        job = pool.submit(jobs.wait_for_file, tmp_path / "go")
        assert until(job.running)
        os.kill(parent_of(old[0]), signal.SIGKILL)
        assert until(lambda: not any(is_running(pid) for pid in old))
        (tmp_path / "go").touch()
        assert job.result(SOON_S)
        assert job.attempts == 2
        assert pool.wait_ready(SOON_S)
        assert not set(pids(pool)) & set(old)


SERVER = """
import sys, time
sys.path.insert(0, sys.argv[1])
import executor_jobs as jobs
from service.executor import LocalPool

def show(pids):
    print(" ".join(map(str, pids)) + "\\n", end="", flush=True)  # in one piece: two threads print

pool = LocalPool(3)
pool.submit(jobs.start_child, on_event=show)
pool.submit(jobs.stuck_in_native_code, on_event=lambda pid: show([pid]))
pool.wait_ready()
show(worker.pid for worker in pool.stats().workers)
time.sleep(60)
"""


def test_no_process_is_left_when_the_server_is_killed() -> None:
    with subprocess.Popen([sys.executable, "-c", SERVER, str(SUPPORT)], stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None
        started = {int(pid) for _ in range(3) for pid in server.stdout.readline().split()}
        assert len(started) == 4  # three workers and what one of them started
        fork_server = {parent_of(min(started))}
        server.kill()
        assert until(lambda: not any(is_running(pid) for pid in started | fork_server))


def test_a_server_killed_while_its_modules_load_leaves_no_process(tmp_path: Path) -> None:
    note = f"pathlib.Path({str(tmp_path / 'pid')!r}).write_text(str(os.getpid()))"
    (tmp_path / "loads_slowly.py").write_text(f"import os, pathlib, time; {note}; time.sleep(60)")
    code = (
        f"import sys, time; sys.path.insert(0, {str(tmp_path)!r}); from service.executor import LocalPool\n"
        "LocalPool(1, preload=('loads_slowly',)); time.sleep(60)"
    )
    with subprocess.Popen([sys.executable, "-c", code]) as server:
        assert until(lambda: (tmp_path / "pid").exists() and (tmp_path / "pid").read_text())
        server.kill()
        assert until(lambda: not is_running(int((tmp_path / "pid").read_text())))


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_workers_ignore_interrupts(single: LocalPool, number: int) -> None:
    assert single.submit(jobs.signal_itself, number).result(SOON_S) == "still here"
    fork_server = parent_of(pids(single)[0])
    os.kill(fork_server, number)
    time.sleep(0.02)
    assert is_running(fork_server)


def test_the_memory_of_a_worker_is_bounded() -> None:
    with LocalPool(1, max_bytes=2**29) as pool:
        with pytest.raises(MemoryError):
            pool.submit(jobs.allocate, 2**30).result(SOON_S)
        assert pool.submit(jobs.allocate, 2**20).result(SOON_S) == 2**20
        assert pool.stats().restarts == 0


def test_a_worker_is_replaced_after_recycle_after_jobs() -> None:
    with LocalPool(1, recycle_after=5) as pool:
        seen = [pool.submit(jobs.pid).result(SOON_S) for _ in range(5)]
        assert until(lambda: seen[0] not in pids(pool) and pool.stats().ready == 1)
        seen += [pool.submit(jobs.pid).result(SOON_S) for _ in range(3)]
        assert [len(set(seen[:5])), len(set(seen[5:]))] == [1, 1]
        assert seen[0] != seen[5]
        assert pool.stats().restarts == 0


def test_a_pool_grows_and_shrinks_without_losing_what_runs(tmp_path: Path) -> None:
    with LocalPool(1) as pool:
        pool.resize(3)
        assert pool.wait_ready(SOON_S)
        assert until(lambda: pool.stats().ready == 3)
        running = [pool.submit(jobs.wait_for_file, tmp_path / "go") for _ in range(2)]
        assert until(lambda: pool.stats().running == 2)
        pool.resize(1)
        assert until(lambda: len(pool.stats().workers) == 2)
        (tmp_path / "go").touch()
        assert all(job.result(SOON_S) for job in running)
        assert until(lambda: len(pool.stats().workers) == 1)
        assert pool.submit(jobs.add, 1, 2).result(SOON_S) == 3
        assert pool.stats().restarts == 0


def test_every_worker_is_warmed_up_before_its_first_job() -> None:
    with LocalPool(2, warm_up=jobs.warm_up) as pool:
        answers = [pool.submit(jobs.was_warmed_up).result(SOON_S) for _ in range(6)]
    assert answers == [["warm"]] * 6


@pytest.mark.usefixtures("short_retry_waits")
def test_jobs_fail_when_workers_cannot_be_warmed_up(caplog: pytest.LogCaptureFixture) -> None:
    with LocalPool(1, warm_up=jobs.fail_to_warm_up) as pool:
        assert not pool.wait_ready(0.01)
        with pytest.raises(WorkerDied, match="none could be started") as caught:
            pool.submit(jobs.pid).result(SOON_S)
    assert "no robot there" in caught.value.last_output
    assert "no robot there" in caplog.text


@pytest.mark.usefixtures("short_retry_waits")
def test_jobs_fail_when_workers_never_become_ready() -> None:
    with (
        LocalPool(1, warm_up=jobs.warm_up_without_end, start_timeout_s=0.3) as pool,
        pytest.raises(WorkerDied, match="none could be started"),
    ):
        pool.submit(jobs.pid).result(3 * SOON_S)


@pytest.mark.usefixtures("short_retry_waits")
def test_jobs_fail_when_a_preloaded_module_is_missing() -> None:
    with (
        LocalPool(1, preload=("no_such_module",)) as pool,
        pytest.raises(WorkerDied, match="No module named 'no_such_module'"),
    ):
        pool.submit(jobs.pid).result(SOON_S)


def test_modules_that_start_threads_are_imported_by_each_worker(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING, "service.executor"), LocalPool(2, preload=("executor_thread",)) as pool:
        assert pool.submit(jobs.thread_names).result(SOON_S) == ["MainThread", "of the module"]
    assert "executor_thread: 2 threads once imported" in caplog.text


def test_workers_compute_with_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "8")
    with LocalPool(1) as pool:
        for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
            assert pool.submit(jobs.environment, name).result(SOON_S) == "1"


@pytest.mark.usefixtures("single")  # idle, so that its own descriptors stay as they are
def test_a_closed_pool_leaves_neither_processes_nor_threads_nor_descriptors() -> None:
    threads = set(threading.enumerate())
    fds = len(os.listdir("/proc/self/fd"))
    with LocalPool(2) as pool:
        assert pool.wait_ready(SOON_S)
        workers = pids(pool)
        fork_server = parent_of(workers[0])
    assert not any(is_running(pid) for pid in (*workers, fork_server))
    assert set(threading.enumerate()) <= threads
    assert len(os.listdir("/proc/self/fd")) <= fds


def test_a_stopped_worker_is_replaced_and_its_job_started_elsewhere(tmp_path: Path) -> None:
    with LocalPool(1) as pool:
        job = pool.submit(jobs.wait_for_file, tmp_path / "go")
        os.kill(worker_of(job), signal.SIGSTOP)
        assert until(lambda: job.attempts == 2)
        (tmp_path / "go").touch()
        assert job.result(SOON_S)
        assert job.attempts == 2


def test_a_worker_that_waits_for_a_stopped_process_of_its_own_is_replaced(tmp_path: Path) -> None:
    with LocalPool(1) as pool:
        job = pool.submit(jobs.wait_for_stopped_child, tmp_path)
        assert job.result(SOON_S) == 2


def test_a_stopped_fork_server_is_continued_and_a_killed_one_replaced_by_its_standby(tmp_path: Path) -> None:
    with LocalPool(1, preload=("json",)) as pool:
        assert pool.wait_ready(SOON_S)
        job = pool.submit(jobs.wait_for_file, tmp_path / "go")
        worker = worker_of(job)
        os.kill(parent_of(worker), signal.SIGSTOP)
        os.kill(worker, signal.SIGKILL)
        assert until(lambda: job.attempts == 2)
        (tmp_path / "go").touch()
        assert job.result(SOON_S)
        for number in range(2):
            again = pool.submit(jobs.wait_for_file, tmp_path / f"go {number}")
            parent = parent_of(worker_of(again))
            os.kill(parent, signal.SIGKILL)
            assert until(lambda job=again: job.attempts == 2)
            last = parent_of(worker_of(again))
            assert last != parent
            (tmp_path / f"go {number}").touch()
            assert again.result(SOON_S)
    assert until(lambda: not is_running(last))


def test_a_worker_that_waits_with_the_interpreters_lock_is_replaced(tmp_path: Path) -> None:
    with LocalPool(1) as pool:
        assert pool.submit(jobs.keep_the_lock_once, tmp_path).result(SOON_S) == 2


def test_a_worker_that_computes_with_the_interpreters_lock_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(local_pool, "WATCH_EVERY_S", 0.05)  # so that a waiting one is replaced within half a second
    with LocalPool(1) as pool:
        job = pool.submit(jobs.sum_up, 4 * 10**7)
        assert job.result(SOON_S) > 0
        assert job.attempts == 1


def test_a_worker_that_computes_with_the_interpreters_lock_for_too_long_is_replaced(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(worker_handle, "STUCK_S", 0.3)
    with LocalPool(1) as pool, pytest.raises(WorkerDied, match="SIGKILL"):
        pool.submit(jobs.sum_up, 10**11, max_attempts=1).result(SOON_S)


def test_workers_come_back_when_the_fork_server_and_a_standby_die_together(tmp_path: Path) -> None:
    with LocalPool(1, preload=("json",)) as pool:
        assert pool.wait_ready(SOON_S)
        job = pool.submit(jobs.wait_for_file, tmp_path / "go")
        fork_server = parent_of(worker_of(job))
        assert until(lambda: len(standbys(fork_server)) == local_pool.N_STANDBYS)
        standby, *others = standbys(fork_server)
        for pid in (fork_server, standby):
            os.kill(pid, signal.SIGKILL)
        assert until(lambda: job.attempts == 2)
        assert parent_of(worker_of(job)) in others
        (tmp_path / "go").touch()
        assert job.result(SOON_S)


def worker_of(job: Job[object]) -> int:
    """Wait until a job runs; return the process id of its worker."""
    assert until(lambda: job.pid is not None and job.running() and is_running(job.pid))
    assert job.pid is not None
    return job.pid


def standbys(fork_server: int) -> list[int]:
    children = Path(f"/proc/{fork_server}/task/{fork_server}/children").read_text().split()
    return [int(pid) for pid in children if Path(f"/proc/{pid}/comm").read_text().strip() == "scopt-standby"]
