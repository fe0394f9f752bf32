"""Cancels at random moments: no worker crashes, and what comes after is as if nothing had been."""

from __future__ import annotations

import executor_jobs as jobs
import pytest

from benchmarks.attack.cancels import Report, deaths, run
from service.executor import LocalPool, WorkerDied


def test_cancels_crash_no_worker_and_leave_the_next_plan_as_it_is() -> None:
    report = run(4, seed=1, is_short=True)
    assert report.crashes == []
    assert report.wrong == []
    assert report.n_cancels == 4
    assert set(report.outcomes) == {"scene", "detect", "plan", "verify"}
    assert report.n_compared == 1


def test_a_worker_that_crashes_is_reported() -> None:
    report = Report()
    with deaths(report), LocalPool(1) as pool, pytest.raises(WorkerDied):
        pool.submit(jobs.crash, max_attempts=1).result(240.0)
    assert any("SIGSEGV" in line for line in report.crashes)
    assert not report.is_clean
