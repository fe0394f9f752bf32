"""Carried bodies that rest on something at the start are raised first, and touch it in no other phase."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation
from shared_plans import write_undrawn

from service.errors import RequestError
from service.planner import plan
from service.replay.replay import verify_result
from service.request.file import parse_request
from service.result.result import PlanResult, Verdict
from service.setup.prepare import prepare
from service.start.robot import load_requested_robot
from service.start.standing import place_bodies
from service.verify import Status, verify

ROBOT = load_requested_robot(parse_request({"robot": {"name": "atlas"}, "goal": {"joints": {"l_arm_shx": 0.0}}}))
BEND = {"r_arm_shx": 0.6, "r_arm_elx": -1.6, "r_arm_ely": 1.6}
GOAL = {"joints": {"r_arm_shx": 0.9, "r_arm_elx": -1.2, "back_bkz": 0.3}}


def request(inside_m: float, goal: dict[str, Any] = GOAL) -> Any:
    """Return a request of Atlas with a level box in its hand, this deep in a table under it."""
    data = ROBOT.model.createData()
    q = ROBOT.postures["stand"].copy()
    for name, value in BEND.items():
        q[ROBOT.joint_names.index(name)] = value
    pin.framesForwardKinematics(ROBOT.model, data, q)
    hand = data.oMf[ROBOT.model.getFrameId("r_hand")]
    turn = Rotation.from_matrix(hand.rotation.T).as_quat(scalar_first=True)
    cargo = {
        "name": "cargo", "type": "box", "link": "r_hand", "touches": ["r_hook"], "size": [0.1, 0.1, 0.1],
        "position": (hand.rotation.T @ np.array([0.0, 0.0, -0.2])).tolist(), "quaternion_wxyz": turn.tolist(),
        "mass_kg": 1.0,
    }  # fmt: skip
    middle = hand.translation + np.array([0.0, 0.0, -0.25 + inside_m - 0.02])
    table = {"name": "table", "type": "box", "size": [0.16, 0.16, 0.04], "position": middle.tolist()}
    return parse_request({
        "robot": {"name": "atlas"},
        "start": {"posture": "stand", "joints": BEND},
        "scene": {"obstacles": [table]},
        "attached": [cargo],
        "goal": goal,
    })  # fmt: skip


@pytest.fixture(scope="module")
def raised() -> PlanResult:
    return plan(request(0.0))


def test_a_body_exactly_on_its_support_is_raised_and_the_motion_is_certified(
    raised: PlanResult, tmp_path: Path
) -> None:
    assert raised.verdict is Verdict.CERTIFIED, raised.explanation
    assert raised.motion is not None
    assert [phase.name for phase in raised.motion.phases] == ["raise", "reach"]
    write_undrawn(raised, tmp_path)
    assert verify_result(tmp_path)["verdict"] == "CERTIFIED"


def test_it_leaves_the_support_by_other_kinematics(raised: PlanResult) -> None:
    motion = raised.motion
    assert motion is not None
    table = next(piece for piece in motion.scene.pieces if piece.name == "table")
    heights = []
    for q in motion.curve(motion.samples[motion.samples <= motion.phases[0].last]):
        ((_, placed),) = place_bodies(motion.robot, q, "cargo")
        heights.append(placed[:, 2].min() - table.upper[2])
    assert min(heights) > -1e-5
    assert heights[-1] > 5e-3


def test_a_record_that_touches_the_support_after_it_was_raised_is_refuted(raised: PlanResult) -> None:
    motion = raised.motion
    assert motion is not None
    first, last = motion.phases
    swapped = replace(motion, phases=(replace(first, allowances=last.allowances), last))
    assert verify(swapped).status is not Status.CERTIFIED


@pytest.mark.parametrize("inside_m", [-3e-4, 1.5e-3])
def test_a_little_above_or_inside_counts_as_resting(inside_m: float) -> None:
    assert prepare(request(inside_m)).rests == (("cargo", "table"),)


def test_deeper_is_a_collision() -> None:
    with pytest.raises(RequestError, match=r"cargo is 4\.0 mm inside table"):
        prepare(request(4e-3))


def test_farther_needs_no_phase_of_its_own() -> None:
    assert prepare(request(-5e-3)).rests == ()
