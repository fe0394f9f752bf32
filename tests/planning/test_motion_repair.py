"""A motion that is repaired: phases that fail are solved again, the others keep their curves and times."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
from tiny_robots import PLANAR, chain

from costs.scene import Scene
from service.body.aims import Aims
from service.body.monitor import Monitor
from service.body.task_plan import PlannedPhase, Solved, TaskPlan
from service.body.whole_body import WholeBody
from service.demands.phase import TaskPhase
from service.motion.execute import make_motion, repair_plan
from service.motion.timing import TimingSettings
from service.verify import Basis, Certificate, Check, Motion, verify
from service.verify.certificate import Where
from service.verify.timeline import find_times


def fail_at(motion: Motion, s: float) -> Certificate:
    """Return the motion's certificate with one more check, which fails at a path parameter."""
    proof = verify(motion)
    check = Check("made.up", False, 1.0, 0.0, "m", "made up", Where(s, None, None), Basis.SAMPLES)
    return replace(proof, checks=(*proof.checks, check))


class Bent(Solved):
    """Waypoints that stand for a solved phase."""

    def __init__(self, q: np.ndarray) -> None:
        object.__setattr__(self, "bent", q)

    @property
    def x(self) -> np.ndarray:
        return self.bent  # type: ignore[attr-defined]

    @property
    def is_feasible(self) -> bool:
        return True


def bend(q: np.ndarray) -> Solved:
    """Return the waypoints with those between the ends moved."""
    moved = q.copy()
    moved[1:-1] += 0.01
    return Bent(moved)


def test_phases_that_hold_keep_curve_and_times_in_a_repair() -> None:
    robot = chain(PLANAR)
    body = WholeBody.standing(robot, Scene(()), np.zeros(2), (), Aims())
    corners = np.array([[0.0, 0.0], [0.5, 0.3], [0.2, 0.8], [0.6, 0.1]])
    paths = [a + (b - a) * np.linspace(0.0, 1.0, 6)[:, None] for a, b in pairwise(corners)]
    phases = tuple(PlannedPhase(TaskPhase(f"p{k}"), path, True, resolve=bend) for k, path in enumerate(paths))
    plan = TaskPlan(body, phases)
    timing = TimingSettings()
    motion = make_motion(plan, timing)
    middle = 0.5 * (motion.phases[1].first + motion.phases[1].last)
    repaired = repair_plan(plan, motion, fail_at(motion, middle), Monitor(60.0))
    assert repaired is not None
    assert [phase.kept is not None and phase.kept.is_settled for phase in repaired.phases] == [True, False, True]
    assert repaired.phases[1].kept is None
    again = make_motion(repaired, timing)
    assert motion.law is not None
    assert again.law is not None
    u = np.linspace(0.0, 1.0, 30)
    for k, pair in enumerate(zip(motion.phases, again.phases, strict=True)):
        q, p = (m.curve(own.first + u * (own.last - own.first)) for m, own in zip((motion, again), pair, strict=True))
        if k == 1:
            assert np.abs(q - p).max() > 1e-3
            continue
        np.testing.assert_allclose(q, p, atol=1e-12)
        before, after = (
            np.diff(find_times(law, np.array([own.first, own.last])))
            for law, own in zip((motion.law, again.law), pair, strict=True)
        )
        np.testing.assert_allclose(before, after, rtol=1e-9)
