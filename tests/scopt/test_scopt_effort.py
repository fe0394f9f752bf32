"""Clocks of time limits."""

from __future__ import annotations

import pytest

from scopt import EffortClock


def test_effort_is_processor_time_however_long_the_process_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    cpu, wall = [10.0], [100.0]
    monkeypatch.setattr("scopt.settings.time.process_time", lambda: cpu[0])
    monkeypatch.setattr("scopt.settings.time.monotonic", lambda: wall[0])
    clock = EffortClock()
    assert clock() == 0.0
    cpu[0], wall[0] = 13.0, 129.0
    assert clock() == pytest.approx(3.0), "the machine was busy with something else for most of 29 s"


def test_a_process_that_only_waits_uses_up_its_limit_as_well(monkeypatch: pytest.MonkeyPatch) -> None:
    wall = [100.0]
    monkeypatch.setattr("scopt.settings.time.process_time", lambda: 10.0)
    monkeypatch.setattr("scopt.settings.time.monotonic", lambda: wall[0])
    clock, hasty = EffortClock(), EffortClock(wall_share=0.5)
    wall[0] = 160.0
    assert clock() == pytest.approx(6.0)
    assert hasty() == pytest.approx(30.0)


def test_the_processors_clock_is_asked_once_in_two_milliseconds(monkeypatch: pytest.MonkeyPatch) -> None:
    wall, asked = [100.0], []
    monkeypatch.setattr("scopt.settings.time.process_time", lambda: asked.append(wall[0]) or float(len(asked)))
    monkeypatch.setattr("scopt.settings.time.monotonic", lambda: wall[0])
    clock = EffortClock()
    for wall[0] in (100.0, 100.001, 100.0015, 100.003):
        clock()
    assert asked == [100.0, 100.0, 100.003]
