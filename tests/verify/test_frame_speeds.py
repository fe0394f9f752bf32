"""Speeds of tools and of approaching hands: bounds hold at every pose, and a faster law is refuted."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from still_door import motion_of
from tiny_robots import SPATIAL, chain

from benchmarks.planning.timing_reference import spline_through
from costs.curve import Curve, TimeLaw
from costs.robot import RobotModel
from costs.scene import Scene
from service.errors import RequestError
from service.motion.jams import list_cheap_speeds, list_jam_notes
from service.motion.slowing import slow_to_speeds
from service.motion.timing import time_curve
from service.planner import plan
from service.replay.whole import certify_whole
from service.request.file import load_request, parse_request, to_json
from service.result.result import Verdict
from service.setup.prepare import prepare
from service.verify import (
    Approach,
    FrameSpeed,
    HandLoad,
    LoadLimits,
    Motion,
    Phase,
    Status,
    VerifyError,
    limit_loads,
    list_frame_speeds,
    list_tools,
    trace_frame,
    verify,
)
from service.verify.forces.frame_speeds import LEAST_M_S, limit_approach

ROOT = Path(__file__).parents[2]


def _draw(seed: int) -> tuple[RobotModel, Curve, TimeLaw]:
    rng, robot = np.random.default_rng(seed), chain(SPATIAL)
    curve = spline_through(robot, np.cumsum(rng.uniform(-0.3, 0.3, (4, robot.n)), axis=0))
    return robot, curve, time_curve(robot, curve)


def _measure(robot: RobotModel, curve: Curve, law: TimeLaw, frame: str) -> float:
    """Return the largest speed of a frame by differences of positions over a tenth of a millisecond."""
    times = np.linspace(0.0, law.times[-1], 4000)
    before, after = (trace_frame(robot.model, frame, curve(law.at(t)[0]))[1] for t in (times - 5e-5, times + 5e-5))
    return float(np.linalg.norm(after - before, axis=1).max() / 1e-4)


@settings(max_examples=5, deadline=None)
@given(seed=st.integers(0, 10_000), share=st.sampled_from([0.3, 0.97, 1.03, 2.0]))
def test_a_speed_is_certified_if_and_only_if_no_pose_is_faster(seed: int, share: float) -> None:
    robot, curve, law = _draw(seed)
    (tool,) = list_tools(robot)
    fastest = _measure(robot, curve, law, tool)
    motion = Motion(robot, Scene(()), curve, law, tool_speed_m_s=share * fastest)
    (check,) = [check for check in verify(motion).checks if check.name == f"limits.tool_speed.{tool}"]
    assert check.ok == (share > 1.0)
    if check.ok:
        assert fastest * (1.0 - 1e-3) <= check.value <= check.limit
    else:
        assert "faster than" in check.text


@settings(max_examples=3, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_a_law_is_slowed_until_the_tool_keeps_its_speed(seed: int) -> None:
    robot, curve, law = _draw(seed)
    (tool,) = list_tools(robot)
    most = 0.3 * _measure(robot, curve, law, tool)
    motion = Motion(robot, Scene(()), curve, law, tool_speed_m_s=most)
    slow = replace(motion, law=slow_to_speeds(motion, law, list_frame_speeds(motion, ())))
    assert not [check for check in verify(slow).failed() if "tool_speed" in check.name]
    assert slow.law is not None
    assert slow.law.times[-1] < 4.0 * law.times[-1]


def test_only_the_part_near_its_end_is_held_to_an_approach() -> None:
    robot, curve, law = _draw(5)
    (tool,) = list_tools(robot)
    motion = Motion(robot, Scene(()), curve, law)
    first, last = curve.knots[[0, -1]].tolist()
    near = FrameSpeed("approach", tool, first, last, 0.01, near_m=0.01)
    slow = slow_to_speeds(motion, law, [near])
    s = slow.at(np.linspace(0.0, slow.times[-1], 20_000))[0]
    _, places = trace_frame(robot.model, tool, curve(s))
    speeds = np.linalg.norm(np.diff(places, axis=0), axis=1) / (slow.times[-1] / (len(s) - 1))
    is_near = np.linalg.norm(places[1:] - places[-1], axis=1) < 0.01
    assert speeds[is_near].max() <= 0.01
    assert speeds.max() > 0.01


def test_the_speed_of_an_approach_follows_from_cap_and_reaction() -> None:
    approach = Approach(stiffness_n_m=5e3, reaction_s=0.4, noise_n=20.0)
    assert limit_approach(LoadLimits("tool", ("leaf",), 30.0, 140.0), approach) == pytest.approx(90.0 / 2000.0)
    assert limit_approach(LoadLimits("tool", ("leaf",), 100.0, 115.0), approach) == LEAST_M_S


def test_a_hand_that_moves_a_mechanism_is_as_slow_as_one_that_may_find_it_jammed() -> None:
    still = motion_of(np.zeros((2, 2)))
    load = HandLoad("l_tool", "leaf", np.array([0.0, 0.8, 1.0]), np.array([20.0, 0.0, 0.0]))
    phases = (Phase("reach", 0.0, 0.5), Phase("open", 0.5, 1.0, loads=(load,)))
    assert list_frame_speeds(still, phases) == ()
    (pressing, approach) = list_frame_speeds(replace(still, pace="fast"), phases)
    (limit,) = limit_loads(still, phases[1])
    most = limit_approach(limit, still.approach)
    assert pressing == FrameSpeed("pressing.open.l_tool", "l_tool", 0.5, 1.0, most)
    assert (approach.name, approach.last, approach.most) == ("approach.reach.l_tool", 0.5, most)


def test_without_a_pace_short_pushes_are_slow_and_a_note_names_the_others() -> None:
    still = motion_of(np.zeros((3, 2)))
    load = HandLoad("l_tool", "leaf", np.array([0.0, 0.8, 1.0]), np.array([20.0, 0.0, 0.0]))
    phases = (Phase("reach", 0.0, 1.0), Phase("open", 1.0, 2.0, loads=(load,)))
    law = TimeLaw(np.arange(3.0), np.arange(3.0), np.ones(3))

    def turn(angle: float, **changes: object) -> Motion:
        q = np.array(still.curve.positions)
        q[2, still.robot.joint_names.index("l_arm_elx")] += angle
        curve = Curve(still.curve.knots, q, np.vstack([np.zeros((1, q.shape[1])), np.diff(q, axis=0)]))
        return replace(still, curve=curve, phases=phases, law=law, **changes)

    slow = Approach(reaction_s=2.5)
    names = ["pressing.open.l_tool", "approach.reach.l_tool"]
    assert [speed.name for speed in list_cheap_speeds(turn(0.02, approach=slow))] == names
    assert [speed.name for speed in list_cheap_speeds(turn(1.0, approach=slow))] == names[1:]
    assert list_cheap_speeds(turn(0.02, pace="fast")) == ()
    assert list_jam_notes(turn(0.001)) == list_jam_notes(turn(1.0, pace="fast")) == ()
    (note,) = list_jam_notes(turn(1.0))
    assert note.startswith("l_tool moves at up to 0.")
    assert "in phase 'open': if what it pushes jams, it presses with about" in note


def test_a_plan_keeps_tool_speed_and_pace_of_its_request_and_no_others() -> None:
    request = load_request(ROOT / "examples/requests/joint_goal.yaml")
    options = replace(request.options, tool_speed_m_s=0.1, pace="fast")
    request = parse_request(to_json(replace(request, options=options)))
    result = plan(request)
    assert result.verdict is Verdict.CERTIFIED
    motion, setup = result.motion, prepare(request)
    assert motion is not None
    assert motion.law is not None
    for tool in list_tools(motion.robot):
        assert _measure(motion.robot, motion.curve, motion.law, tool) <= 0.1
    certificate = certify_whole(setup, motion)
    assert certificate is not None
    assert certificate.status is Status.CERTIFIED
    for told in (replace(motion, tool_speed_m_s=0.2), replace(motion, pace=None)):
        assert certify_whole(setup, told) is None


@pytest.mark.parametrize(
    ("given_options", "words"),
    [
        ({"tool_speed_m_s": 0}, "tool_speed_m_s"),
        ({"jerk_scale": 0}, "jerk_scale"),
        ({"pace": "hasty"}, "pace"),
        ({"pace": "fast", "velocity_scale": 0.9}, "velocity_scale is 0.9 beside the pace fast"),
    ],
)
def test_a_wrong_limit_is_refused_in_one_line(given_options: dict[str, object], words: str) -> None:
    data = to_json(load_request(ROOT / "examples/requests/joint_goal.yaml"))
    with pytest.raises(RequestError, match=words):
        parse_request({**data, "options": {**data["options"], **given_options}})


def test_a_limit_that_is_none_is_refused_by_the_verifier() -> None:
    robot, curve, law = _draw(1)
    phases = (Phase("move", *curve.knots[[0, -1]].tolist()),)
    for wrong in ({"tool_speed_m_s": 0.0}, {"tool_speed_m_s": float("nan")}, {"pace": "hasty"}):
        with pytest.raises(VerifyError, match=next(iter(wrong))):
            verify(replace(Motion(robot, Scene(()), curve, law, phases), **wrong))
