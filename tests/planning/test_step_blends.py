"""Corners that are rounded: arcs tangent to both lines, a motion that does not rest in them, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from benchmarks.attack.gantry_files import write_gantry
from benchmarks.tasks.object_cases import make_gantry_place
from service.demands.steps.blends import SHARPEST_RAD, STRAIGHT_RAD, choose_cuts, find_turn, round_corner
from service.errors import RequestError
from service.planner import plan
from service.replay.replay import verify_result
from service.request.file import parse_request
from service.result.output import write_result
from service.verify import find_times, trace_frame

part = st.floats(-1.0, 1.0)
directions = st.tuples(part, part, part).map(np.array).filter(lambda way: np.linalg.norm(way) > 0.1)


@settings(deadline=None, max_examples=40)
@given(directions, directions, directions, st.floats(0.001, 0.2))
def test_an_arc_leads_from_one_line_to_the_other_along_both(
    corner: np.ndarray, before: np.ndarray, after: np.ndarray, cut: float
) -> None:
    into, out = before / np.linalg.norm(before), after / np.linalg.norm(after)
    turn = find_turn(before, after)
    assume(turn > STRAIGHT_RAD)
    arc = round_corner(corner - cut * into, np.eye(3), before, after, cut)
    assert (arc is None) == (turn > SHARPEST_RAD)
    if arc is None:
        return
    shares = np.linspace(0.0, 1.0, 21)
    places, tangents = arc.positions(shares), arc.tangents(shares)
    np.testing.assert_allclose(places[-1], corner + cut * out, atol=1e-9)
    for tangent, way in ((tangents[0], into), (tangents[-1], out)):
        np.testing.assert_allclose(tangent / np.linalg.norm(tangent), way, atol=1e-9)
    assert np.linalg.norm(places - corner, axis=1).max() <= cut + 1e-9


def test_a_sharp_corner_of_a_path_is_not_rounded_and_short_lines_are_shared() -> None:
    places = np.array([[0.0, 0, 0], [0.1, 0, 0], [0.1, 0.02, 0], [0.1, 0.1, 0], [0.1, 0.0, 0]])
    np.testing.assert_allclose(choose_cuts(places, 0.03), [0.0, 0.009, 0.009, 0.0, 0.0])
    assert not choose_cuts(places, 0.0).any()


def request_of(folder: Path, *moves: dict[str, Any]) -> dict[str, Any]:
    steps = [{"move": {"hand": "right", "along": "line", "speed_m_s": 0.1, **move}} for move in moves]
    return {**make_gantry_place(str(write_gantry(folder))).base, "task": {"steps": steps}}


ACROSS, ALONG, DOWN = ({"by": {"translation": way}} for way in ([0.1, 0, 0], [0, 0.1, 0], [0, 0.02, -0.1]))


def test_a_hand_goes_through_rounded_corners_without_a_rest(tmp_path: Path) -> None:
    request = request_of(tmp_path, {**ACROSS, "blend_m": 0.03}, {**ALONG, "blend_m": 0.02}, DOWN)
    result = plan(parse_request(request))
    assert result.verdict.value == "CERTIFIED", result.explanation
    motion = result.motion
    assert motion is not None
    assert motion.law is not None
    assert [phase.name for phase in motion.phases] == ["1 move", "1 move: corner", "2 move", "2 move: corner", "3 move"]
    borders = np.array([phase.last for phase in motion.phases[:-1]])
    times = find_times(motion.law, borders)
    _, places = trace_frame(
        motion.robot.model, "tool", motion.curve(motion.law.at(np.sort(np.r_[times, times + 1e-4]))[0])
    )
    speeds = np.linalg.norm(np.diff(places, axis=0)[::2], axis=1) / 1e-4
    assert speeds.min() > 0.08
    ends = motion.curve(np.array([motion.phases[0].first, motion.phases[-1].last]))
    _, (first, last) = trace_frame(motion.robot.model, "tool", ends)
    np.testing.assert_allclose(last - first, [0.1, 0.12, -0.1], atol=1e-3)
    assert verify_result(write_result(result, tmp_path / "out").folder)["verdict"] == "CERTIFIED"


@pytest.mark.parametrize(
    ("moves", "problem"),
    [
        (({**ACROSS, "blend_m": 0.03},), "task.steps[0].move.blend_m: the next step is no move along a line"),
        (({**ACROSS, "blend_m": 0.03}, {**DOWN, "hand": None, "frame": "hand"}), "moves another hand or frame"),
        (
            ({**ACROSS, "blend_m": 0.03}, {"by": {"translation": [0, 0, 0.1], "rotation_deg": [0, 0, 20]}}),
            "a rounded corner keeps the orientation",
        ),
        (({**ACROSS, "along": "free", "speed_m_s": None, "blend_m": 0.03}, DOWN), "blend_m goes with along: line"),
        (({**ACROSS, "blend_m": 0.06}, {**ALONG, "blend_m": 0.06}, DOWN), "its rounded corners take 120 mm"),
        (({**ACROSS, "blend_m": 0.03}, {"by": {"translation": [-0.1, 0.01, 0]}}), "the way turns by 174 deg there"),
    ],
)
def test_a_corner_that_cannot_be_rounded_is_refused(tmp_path: Path, moves: Any, problem: str) -> None:
    with pytest.raises(RequestError, match=problem.replace("[", r"\[")):
        plan(parse_request(request_of(tmp_path, *moves)))
