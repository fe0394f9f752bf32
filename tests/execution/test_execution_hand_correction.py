"""Correction of hands that are measured beside their planned places."""

import numpy as np
import pinocchio as pin
import pytest

from costs.robot import load_robot
from service.execution.hands.correction import HandCorrection
from service.execution.sensing.filters import PidGains
from service.execution.shift import Shift

PERIOD = 0.01
HANDS = ("l_hand", "r_hand")


@pytest.fixture(scope="module")
def robot():
    return load_robot("atlas")


def place(robot, q, hand):
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    return data.oMf[robot.model.getFrameId(hand)].translation.copy()


def run(robot, planned, measured, seconds, *, shifts=None, held=(), limit=0.05):
    hands = HandCorrection(robot, HANDS, PidGains(kp=0.0, ki=2.0, limit=limit), PERIOD)
    states = hands.start()
    for _ in range(round(seconds / PERIOD)):
        states = hands.step(states, planned, measured, shifts or {}, held)
    return states


def test_the_target_moves_against_the_measured_error_of_its_own_hand(robot):
    planned = robot.postures["reach_ready"]
    measured = planned.copy()
    measured[robot.joint_names.index("l_arm_ely")] += 0.01
    error = place(robot, planned, "l_hand") - place(robot, measured, "l_hand")
    states = run(robot, planned, measured, 0.5)
    assert np.linalg.norm(error) > 1e-3
    np.testing.assert_allclose(
        states["l_hand"].offset, 2.0 * 0.5 * error, rtol=1e-9
    )  # the first sample is not filtered
    np.testing.assert_array_equal(states["r_hand"].offset, 0.0)


def test_a_hand_that_does_not_follow_its_shift_is_corrected_up_to_the_limit(robot):
    q = robot.postures["reach_ready"]
    offset = np.array([0.0, 0.0, 0.04])
    shift = Shift(offset, np.zeros(3), offset)
    states = run(robot, q, q, 0.5, shifts={"l_hand": shift}, limit=0.03)
    step = 2.0 * 0.04 * PERIOD
    np.testing.assert_allclose(states["l_hand"].offset[:2], 0.0)
    assert 0.03 - step <= states["l_hand"].offset[2] <= 0.03
    np.testing.assert_array_equal(states["r_hand"].offset, 0.0)


def test_a_hand_that_holds_on_keeps_its_correction(robot):
    planned = robot.postures["reach_ready"]
    measured = planned.copy()
    measured[2] -= 0.01
    states = run(robot, planned, measured, 0.2, held=["r_hand"])
    assert states["l_hand"].offset[2] == pytest.approx(0.004)
    np.testing.assert_array_equal(states["r_hand"].offset, 0.0)
