"""Keys that nudge hands and neck, as steps that are planned and certified."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

from costs.robot import RobotModel, load_robot
from service import RequestError, parse_request, plan
from service.request.tasks.nudges import KEYS, NUDGE_M, NUDGE_RAD, TRANSLATIONS, NudgeSettings, Touch, make_nudge
from service.request.tasks.steps import StepsSection
from service.result.result import Verdict

START = {"robot": {"name": "atlas"}, "start": {"posture": "reach_ready"}}
EVERYTHING = NudgeSettings(middle=(0.4, 0.0, 1.0), neck=("neck_ry", 0.0))


@pytest.fixture(scope="module")
def atlas() -> RobotModel:
    return load_robot("atlas")


def _find_tools(robot: RobotModel, q: np.ndarray) -> dict[str, pin.SE3]:
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    return {link: data.oMf[robot.model.getFrameId(link)].copy() for link in ("l_tool", "r_tool")}


def _nudge(robot: RobotModel, key: str, settings: NudgeSettings) -> tuple[dict[str, pin.SE3], dict[str, pin.SE3]]:
    """Tools before and after a certified nudge."""
    result = plan(parse_request({**START, "task": {"steps": [make_nudge(key, settings)]}}), robot=robot)
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    assert result.motion is not None
    first, last = result.motion.curve(result.motion.curve.knots[[0, -1]])
    return _find_tools(robot, first), _find_tools(robot, last)


@pytest.mark.parametrize("key", KEYS)
@pytest.mark.parametrize("hand", ["left", "right", "both"])
def test_every_key_is_a_step_of_a_request(key: str, hand: Any) -> None:
    settings = NudgeSettings(hand=hand, middle=EVERYTHING.middle, neck=EVERYTHING.neck)
    request = parse_request({**START, "task": {"steps": [make_nudge(key, settings)]}})
    assert request.task is not None


@pytest.mark.parametrize("key", TRANSLATIONS)
def test_a_nudge_that_may_touch_is_a_guarded_move_with_its_pieces_and_force(key: str) -> None:
    step = make_nudge(key, NudgeSettings(hand="left", touch=Touch(("wall",), 25.0)))
    section = parse_request({**START, "task": {"steps": [step]}}).section
    assert isinstance(section, StepsSection)
    (touch,) = (own.touch for own in section.steps)
    assert touch is not None
    assert (touch.pieces, touch.force_n, touch.window_m) == (("wall",), 25.0, (0.0, NUDGE_M))
    assert touch.direction == TRANSLATIONS[key]


def test_an_arrow_moves_one_hand_up_and_the_other_keeps_its_pose(atlas: RobotModel) -> None:
    before, after = _nudge(atlas, "Up", NudgeSettings(hand="right"))
    moved = after["r_tool"].translation - before["r_tool"].translation
    assert moved == pytest.approx([0.0, 0.0, NUDGE_M], abs=1.5e-3)
    assert np.linalg.norm(after["l_tool"].translation - before["l_tool"].translation) < 1.5e-3


@pytest.mark.parametrize(("key", "is_own"), [("e", True), ("E", False)])
def test_a_letter_turns_a_hand_about_its_own_axis_and_a_capital_about_the_worlds(
    atlas: RobotModel, key: str, is_own: bool
) -> None:
    before, after = _nudge(atlas, key, NudgeSettings(hand="left", other_hand="lock"))
    first, last = before["l_tool"].rotation, after["l_tool"].rotation
    turn = first.T @ last if is_own else last @ first.T
    assert Rotation.from_matrix(turn).as_rotvec() == pytest.approx([0.0, -NUDGE_RAD, 0.0], abs=0.01)


def test_both_hands_turn_about_the_point_between_them(atlas: RobotModel) -> None:
    tools = _find_tools(atlas, atlas.postures["reach_ready"])
    middle = 0.5 * (tools["l_tool"].translation + tools["r_tool"].translation)
    x, y, z = middle.tolist()
    before, after = _nudge(atlas, "w", NudgeSettings(hand="both", middle=(x, y, z)))
    turn = Rotation.from_rotvec([-NUDGE_RAD, 0.0, 0.0])
    for tool in ("l_tool", "r_tool"):
        wanted = middle + turn.apply(before[tool].translation - middle)
        assert np.linalg.norm(after[tool].translation - wanted) < 1.5e-3


@pytest.mark.parametrize(
    ("key", "settings", "sentence"),
    [
        ("x", NudgeSettings(), "key: there is no 'x'; expected"),
        ("w", NudgeSettings(hand="both"), "turns both hands about the point between them"),
        ("q", NudgeSettings(), "turns the neck; expected its joint"),
        ("w", NudgeSettings(touch=Touch((), 20.0)), "key w: touches nothing; expected Up, Down"),
        ("Up", NudgeSettings(hand="both", touch=Touch((), 20.0)), "one hand touches at a time"),
    ],
)
def test_a_key_that_cannot_be_carried_out_is_refused(key: str, settings: NudgeSettings, sentence: str) -> None:
    with pytest.raises(RequestError, match=sentence):
        make_nudge(key, settings)
