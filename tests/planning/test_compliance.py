"""An earlier motion is kept where its mechanism has moved a little: only the arm that holds it yields."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from given_wheels import wheel_request
from shared_plans import copy_undrawn, write_once, write_undrawn
from typer.testing import CliRunner

from costs.kinematics import KinematicsEngine, locate_links
from costs.rotation import make_tangent_basis
from service.cli.app import app
from service.errors import DamagedResultError, RequestError
from service.planner import plan
from service.replay.replay import verify_result
from service.replay.rest import make_rest_request
from service.request.file import parse_request, to_json
from service.request.schema import PlanRequest
from service.result.folder import read_result
from service.result.result import PlanResult, Verdict
from service.verify import Motion
from service.wire.requests import request_from_message, request_to_message

VALVE = wheel_request()
CENTRE = np.array(VALVE["task"]["valve"]["centre"])
MOVED = np.array([0.006, -0.005, 0.004])


@pytest.fixture(scope="module")
def turned() -> Path:
    """A valve turned by 60 degrees."""
    return write_once(parse_request(VALVE))


@pytest.fixture(scope="module")
def kept(turned: Path) -> PlanResult:
    """The same motion, kept for a valve that is some millimetres away."""
    return plan(_moved(turned, MOVED))


def _moved(folder: Path, offset: Sequence[float] | np.ndarray) -> PlanRequest:
    """The request to keep the motion for the valve elsewhere."""
    request = make_rest_request(folder, "reach", None, is_compliant=True)
    return replace(request, task=parse_request(wheel_request(centre=(CENTRE + offset).tolist())).task)


def _notes(result: PlanResult) -> str:
    return " | ".join(note for note in result.notes if "earlier motion" in note)


def test_only_the_arm_that_holds_the_wheel_is_elsewhere_at_the_same_times(
    turned: Path, kept: PlanResult, tmp_path: Path
) -> None:
    result = kept
    assert "is kept" in _notes(result)
    assert verify_result(write_undrawn(result, tmp_path / "out"))["verdict"] == "CERTIFIED"
    assert result.motion is not None
    data, motion = read_result(turned), result.motion
    names = motion.robot.joint_names
    earlier = np.array(data["curve"]["positions"])
    columns = [data["curve"]["joint_names"].index(name) for name in names]
    off = np.abs(motion.curve.positions - earlier[:, columns]).max(axis=0)
    (side,) = {name[0] for name, size in zip(names, off, strict=True) if size > 1e-4}
    assert all(name.startswith(f"{side}_arm") for name, size in zip(names, off, strict=True) if size > 1e-4)
    times = data["trajectory"]["times"]
    for phase, before in zip(motion.phases, data["phases"], strict=True):
        duration = times[before["last"]] - times[before["first"]]
        now = _time(motion, phase.last) - _time(motion, phase.first)
        # The wheel turns as it did; the short ways there and back bend, and are slower where a limit asks for it.
        assert (
            now == pytest.approx(duration, abs=1e-6)
            if phase.name == "turn"
            else duration - 1e-6 <= now < max(1.0, 1.1 * duration)
        )
    tool = f"{side}_peg"
    assert result.figures["hand_displaced_mm"] == pytest.approx(
        1e3 * _largest_distance(result, earlier[:, columns], tool), abs=0.2
    )
    assert 1e3 * np.linalg.norm(MOVED) - 1.5 < result.figures["hand_displaced_mm"] < 15.0


def test_a_figure_that_is_smaller_than_the_motion_s_is_refused(kept: PlanResult, tmp_path: Path) -> None:
    folder = copy_undrawn(write_undrawn(kept, tmp_path / "whole"), tmp_path / "out")
    honest = read_result(folder)
    for name in ("hand_displaced_mm", "hand_displaced_deg", "turned_deg", "holds_torque_nm"):
        figures = {**honest["figures"], name: 0.9 * honest["figures"][name]}
        (folder / "result.json").write_text(json.dumps({**honest, "figures": figures}))
        with pytest.raises(DamagedResultError, match=f"figures.{name} is "):
            verify_result(folder)


def _time(motion: Motion, s: float) -> float:
    """Return when a motion is at a path parameter [s]."""
    assert motion.law is not None
    return float(np.interp(s, motion.law.path, motion.law.times))


def _largest_distance(result: PlanResult, earlier: np.ndarray, tool: str) -> float:
    """Largest distance of a tool from the earlier motion at the knots of phases with a hand on the wheel [m]."""
    motion = result.motion
    assert motion is not None
    engine, curve = KinematicsEngine(motion.robot), motion.curve
    is_free = np.zeros(len(curve.knots), dtype=bool)
    for phase in motion.phases:
        is_free |= (curve.knots >= phase.first) & (curve.knots < phase.last) & (phase.name == "reach")
    rows = np.flatnonzero(~is_free)
    places = [[locate_links(engine, q[row], [tool])[tool][:3, 3] for row in rows] for q in (earlier, curve.positions)]
    return float(np.linalg.norm(np.array(places[0]) - places[1], axis=1).max())


def test_the_peg_stays_in_the_wheel_where_it_is_now(kept: PlanResult) -> None:
    motion = kept.motion
    assert motion is not None
    turn = next(phase for phase in motion.phases if phase.name == "turn")
    q = motion.curve(np.linspace(turn.first, turn.last, 30))
    engine = KinematicsEngine(motion.robot)
    tool = next(target.frame for target in turn.targets if hasattr(target, "frame"))
    pegs = np.array([locate_links(engine, row, [tool])[tool][:3, 3] for row in q]) - (CENTRE + MOVED)
    first, second = make_tangent_basis(np.array([-1.0, 0.0, 0.0]))
    radius = np.hypot(pegs @ first, pegs @ second)
    assert np.ptp(radius) < 2e-3
    assert np.ptp(pegs[:, 0]) < 2e-3


def test_a_wheel_that_moved_too_far_is_named_in_millimetres_and_turned_anew(turned: Path) -> None:
    result = plan(_moved(turned, [0.0, 0.03, 0.0]))
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    assert "is displaced by up to 3" in _notes(result)
    assert "expected at most 15 mm and 5 deg" in _notes(result)
    assert "hand_displaced_mm" not in result.figures


def test_a_robot_that_is_elsewhere_cannot_keep_the_motion(turned: Path) -> None:
    request = _moved(turned, MOVED)
    joints = {**request.start.joints, "l_arm_elx": request.start.joints["l_arm_elx"] + 0.01}
    result = plan(replace(request, start=replace(request.start, joints=joints)))
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    assert "l_arm_elx is 0.01 off the beginning of the earlier motion" in _notes(result)


def test_a_message_says_the_same(turned: Path) -> None:
    request = _moved(turned, MOVED)
    assert request_from_message(request_to_message(request)) == request


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"nominal": None}, "is_compliant needs the earlier motion with its knots and tangents"),
        ({"knots": [0.0, 0.0]}, "expected increasing knots, one per waypoint, and as many tangents as positions"),
        ({"law_speed": [0.0]}, "expected an increasing law_path"),
    ],
)
def test_a_motion_that_is_none_is_refused(change: dict[str, Any], words: str, turned: Path) -> None:
    data = to_json(_moved(turned, MOVED))
    resume = data["resume"]
    if "nominal" in change:
        del resume["nominal"]
    elif "knots" in change:
        resume["nominal"]["phases"]["turn"]["knots"][1] = resume["nominal"]["phases"]["turn"]["knots"][0]
    else:
        resume["nominal"]["law_speed"][-2] = 0.0
    with pytest.raises(RequestError, match=words):
        parse_request(data)


def test_the_command_keeps_the_motion(turned: Path, tmp_path: Path) -> None:
    offset = ",".join(map(str, MOVED))
    arguments = ["plan", str(turned), "--from-phase", "reach", "--compliant", "--adjust", f"valve:{offset}"]
    done = CliRunner().invoke(app, [*arguments, "--out", str(tmp_path / "out")])
    assert done.exit_code == 0, done.output
    assert "the earlier motion is kept: " in done.output
    without = CliRunner().invoke(app, ["plan", str(turned), "--compliant"])
    assert "--adjust and --compliant go with --from-phase" in without.output
