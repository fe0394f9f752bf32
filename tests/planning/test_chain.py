"""Phases solved from any poses in any order, with a solver that only counts."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.body.task_plan import PlannedPhase
from service.demands.phase import FrameMotion, TaskPhase
from service.tasks.chain import PhaseMotion, solve_phases

HAND = FrameMotion("tool", None, np.zeros(3), np.array([0.0, 0.0, 1.0]))
START = np.array([0.0])


def led(name: str) -> TaskPhase:
    return TaskPhase(name, frames=(HAND,))


def free(name: str) -> TaskPhase:
    return TaskPhase(name)


@dataclass
class CountingWork:
    """Solves each phase at once: a led one goes one unit from its known end, a free one joins both."""

    stuck_at: str = ""
    calls: list[tuple[str, str]] = field(default_factory=list)

    def lead(self, phase: TaskPhase, first: np.ndarray | None, last: np.ndarray | None) -> PhaseMotion:
        self.calls.append((phase.name, "between" if first is not None and last is not None else
                           "forwards" if first is not None else "backwards"))  # fmt: skip
        first = last - 1.0 if first is None else first
        return self._solve(phase, first, first + 1.0 if last is None else last)

    def join(self, phase: TaskPhase, first: np.ndarray, last: np.ndarray) -> PhaseMotion:
        self.calls.append((phase.name, "joined"))
        return self._solve(phase, first, last)

    def _solve(self, phase: TaskPhase, first: np.ndarray, last: np.ndarray) -> PhaseMotion:
        q = np.stack([first, last])
        stuck = object() if phase.name == self.stuck_at else None
        return PhaseMotion(q, lambda: PlannedPhase(phase, q, stuck is None), stuck)


def test_a_step_is_landed_backwards_and_lifted_forwards() -> None:
    work = CountingWork()
    phases = [free("shift"), led("lift"), free("swing"), led("land")]
    chain = solve_phases(phases, START, {1: np.array([3.0]), 4: np.array([8.0])}, work)
    assert work.calls == [("land", "backwards"), ("shift", "joined"), ("lift", "forwards"), ("swing", "joined")]
    assert [phase.name for phase in chain.planned] == ["shift", "lift", "swing", "land"]
    np.testing.assert_array_equal(chain.q.ravel(), [0.0, 3.0, 3.0, 4.0, 4.0, 7.0, 7.0, 8.0])
    assert chain.stuck is None


def test_what_is_begun_is_joined_to_the_start_and_followed_to_the_end() -> None:
    work = CountingWork()
    phases = [free("reach"), led("insert"), led("turn"), led("retract")]
    turn = PhaseMotion.of(PlannedPhase(phases[2], np.array([[5.0], [9.0]]), True))
    chain = solve_phases(phases, START, {}, work, {2: turn})
    assert work.calls == [("insert", "backwards"), ("reach", "joined"), ("retract", "forwards")]
    np.testing.assert_array_equal(chain.q.ravel(), [0.0, 4.0, 4.0, 5.0, 5.0, 9.0, 9.0, 10.0])


def test_a_led_phase_between_two_poses_keeps_both() -> None:
    work = CountingWork()
    solve_phases([led("hold")], START, {1: np.array([0.5])}, work)
    assert work.calls == [("hold", "between")]


@pytest.mark.parametrize(("stuck_at", "names"), [("land", ["land"]), ("lift", ["shift", "lift"])])
def test_a_chain_ends_at_the_first_phase_that_is_stuck(stuck_at: str, names: list[str]) -> None:
    work = CountingWork(stuck_at)
    phases = [free("shift"), led("lift"), free("swing"), led("land")]
    chain = solve_phases(phases, START, {1: np.array([3.0]), 4: np.array([8.0])}, work)
    assert chain.stuck is not None
    assert [phase.name for phase in chain.planned] == names
    assert not chain.planned[-1].is_feasible


def test_a_phase_that_leads_nowhere_is_refused() -> None:
    with pytest.raises(ValueError, match="'away' leads nothing"):
        solve_phases([led("hold"), free("away")], START, {}, CountingWork())


@given(st.lists(st.booleans(), min_size=1, max_size=8), st.sets(st.integers(1, 8)))
def test_any_phases_are_solved_once_and_join(is_led: list[bool], borders: set[int]) -> None:
    """Wherever poses are known: after every phase that leads nothing, and at some others."""
    phases = [led(f"p{k}") if leads else free(f"p{k}") for k, leads in enumerate(is_led)]
    known = {k for k in borders if k <= len(phases)} | {k + 1 for k, leads in enumerate(is_led) if not leads}
    poses = {k: np.array([100.0 * k]) for k in known}
    work = CountingWork()
    chain = solve_phases(phases, START, poses, work)
    assert sorted(name for name, _ in work.calls) == [phase.name for phase in phases]
    planned = chain.planned
    assert [phase.name for phase in planned] == [phase.name for phase in phases]
    assert planned[0].q[0] == START
    for k, (before, after) in enumerate(pairwise(planned), start=1):
        assert before.q[-1] == after.q[0]
        assert k not in poses or after.q[0] == poses[k]
    assert len(phases) not in poses or planned[-1].q[-1] == poses[len(phases)]
