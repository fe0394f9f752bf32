"""Motions that begin or end while joints move: their rates, what is refused, and what the verifier says."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.planning.timing_reference import chain
from costs.curve import Curve
from costs.scene import Scene
from service import plan
from service.errors import RequestError, ResultError
from service.execution.reference import check_executable
from service.execution.session import ReachSession
from service.motion.timing import TimingError, time_curve
from service.replay.whole import certify_whole
from service.request.file import load_request, parse_request, to_json
from service.request.schema import PlanRequest
from service.result.result import Verdict
from service.setup.prepare import prepare
from service.verify import Motion, Status, verify

ROOT = Path(__file__).parents[2]
LEFT, RIGHT = "l_arm_elx", "r_arm_elx"


def _request(start: dict[str, float], end: dict[str, float], **options: Any) -> PlanRequest:
    data = to_json(load_request(ROOT / "examples/requests/joint_goal.yaml"))
    data["start"]["rates"], data["goal"]["rates"] = start, end
    return parse_request({**data, "options": {**data["options"], **options}})


def _measure_rates(motion: Motion) -> tuple[dict[str, float], dict[str, float]]:
    """Return the rates of joints at both ends, from positions a microsecond apart."""
    assert motion.law is not None
    step, duration = 1e-6, motion.law.times[-1]
    q = motion.curve(motion.law.at(np.array([0.0, step, duration - step, duration]))[0])
    first, last = (q[1] - q[0]) / step, (q[3] - q[2]) / step
    names = motion.robot.joint_names
    return tuple({n: float(v) for n, v in zip(names, rate, strict=True) if abs(v) > 1e-4} for rate in (first, last))


@pytest.mark.parametrize(
    ("start", "end"),
    [({LEFT: 0.5}, {}), ({LEFT: -0.7, RIGHT: -0.2}, {RIGHT: 0.4}), ({}, {LEFT: -0.3, "back_bkz": 0.1})],
)
def test_a_motion_has_the_rates_of_its_request_at_both_ends(start: dict[str, float], end: dict[str, float]) -> None:
    request = _request(start, end)
    result = plan(request)
    assert result.verdict is Verdict.CERTIFIED
    motion = result.motion
    assert motion is not None
    for measured, wanted in zip(_measure_rates(motion), (start, end), strict=True):
        assert measured == pytest.approx(wanted, abs=1e-3)
    setup = prepare(request)
    certificate = certify_whole(setup, motion)
    assert certificate is not None
    assert certificate.status is Status.CERTIFIED
    assert certify_whole(setup, replace(motion, start_rates={}, end_rates={"back_bkx": 0.1})) is None
    with pytest.raises(ResultError, match="begins or ends in motion"):
        check_executable(motion)


def test_the_verifier_names_the_joint_that_has_another_rate() -> None:
    robot = chain(np.array([1.0]), np.array([2.0]))
    curve = Curve(np.array([0.0, 2.0]), np.array([[0.0], [2.0]]), np.ones((2, 1)))
    motion = Motion(robot, Scene(), curve, time_curve(robot, curve, ends=(0.5, 0.25)))
    name = robot.joint_names[0]
    for rates, is_ok in (({name: 0.5}, True), ({name: 0.501}, False), ({}, False)):
        held = replace(motion, start_rates=rates, end_rates={name: 0.25})
        check = next(check for check in verify(held).checks if check.name == "limits.rest")
        assert check.ok is is_ok
        assert is_ok or f"{name} is" in check.text


def test_a_straight_line_between_two_speeds_takes_the_time_worked_out_by_hand() -> None:
    # 2 rad at most 1 rad/s and 2 rad/s^2, from 0.5 to 0.6 rad/s: 0.25 s up over 0.1875 rad, 0.2 s down over 0.16 rad.
    robot = chain(np.array([1.0]), np.array([2.0]))
    curve = Curve(np.array([0.0, 2.0]), np.array([[0.0], [2.0]]), np.ones((2, 1)))
    law = time_curve(robot, curve, ends=(0.5, 0.6))
    assert law.speed[[0, -1]] == pytest.approx([0.5, 0.6])
    assert law.times[-1] == pytest.approx(0.25 + 0.2 + (2.0 - 0.1875 - 0.16), rel=0.01)
    short = Curve(np.array([0.0, 0.05]), np.array([[0.0], [0.05]]), np.ones((2, 1)))
    with pytest.raises(TimingError, match="no time law"):
        time_curve(robot, short, ends=(0.9, 0.0))


def test_rates_that_no_motion_can_have_are_refused_in_one_line() -> None:
    wrong: list[tuple[dict[str, float], dict[str, float], dict[str, Any], str]] = [
        ({LEFT: 50.0}, {}, {}, f"start.rates.{LEFT}: 50 rad/s is faster .* expected at most 6 rad/s"),
        ({}, {"l_arm_elz": 0.1}, {}, "unknown joint 'l_arm_elz' in goal.rates"),
        ({"l_leg_kny": 0.2}, {}, {}, "would move the planted l_foot"),
        ({LEFT: 0.1}, {}, {"timed": False}, "options.timed: false"),
        ({LEFT: 0.1}, {}, {"jerk_scale": 0.5}, "options.jerk_scale 0.5"),
        ({LEFT: 5.9}, {}, {"acceleration_scale": 0.01}, "to brake, 5.9 rad/s needs"),
        ({}, {LEFT: 5.9}, {"acceleration_scale": 0.01}, "to get up to it, 5.9 rad/s needs"),
    ]
    for start, end, options, words in wrong:
        with pytest.raises(RequestError, match=words) as refusal:
            prepare(_request(start, end, **options))
        assert len(refusal.value.problems) == 1
    with pytest.raises(RequestError, match=r"start\.rates"):
        _request({LEFT: float("nan")}, {})


def test_a_session_goes_on_at_the_rates_of_its_last_motion() -> None:
    session = ReachSession(_request({}, {LEFT: 0.3}))
    assert session.plan().verdict is Verdict.CERTIFIED
    back = replace(load_request(ROOT / "examples/requests/joint_goal.yaml").goal, joints={LEFT: 1.0, RIGHT: -1.0})
    result = session.plan(back)
    assert result.verdict is Verdict.CERTIFIED
    assert result.motion is not None
    assert _measure_rates(result.motion)[0] == pytest.approx({LEFT: 0.3}, abs=1e-3)
