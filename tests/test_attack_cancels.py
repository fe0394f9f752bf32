"""Cancels at random moments: no worker crashes, and what comes after is as if nothing had been."""

from __future__ import annotations

from benchmarks.attack_cancels import run


def test_cancels_crash_no_worker_and_leave_the_next_plan_as_it_is() -> None:
    report = run(20, seed=1)
    assert report.crashes == []
    assert report.wrong == []
    assert report.n_cancels == 20
    assert set(report.outcomes) == {"scene", "detect", "plan", "verify"}
    assert report.n_compared == 4
