"""Feet of a robot: in which phases ankles keep the balance, and shares of the weight."""

from dataclasses import replace

import numpy as np
import pytest
from shared_plans import write_example

from service.execution.driver import RobotReading
from service.execution.reference import PlannedReference
from service.execution.stance.capture_point import BalanceSettings
from service.execution.stance.feet import Feet, Sight
from service.execution.stance.touchdown import Stage, TouchdownSettings
from service.verify import PlantedContact

PERIOD = 1e-3
SETTINGS = BalanceSettings()
FEET = ("l_foot", "r_foot")
LOAD_GAIN = 4e-5


@pytest.fixture(scope="module")
def reference():
    return PlannedReference.read(write_example("steps"))


def make_feet(reference, phases, balance=SETTINGS, margin=0.05):
    margins = [margin] * len(phases)
    return Feet(
        reference.robot, reference.joint_names, phases, PERIOD, TouchdownSettings(), balance, LOAD_GAIN, margins
    )


def list_phases(reference, *held):
    """Return phases in which both feet are planted, with a hand as well where ``held`` says so."""
    first = reference.phases[0]
    hand = PlantedContact("l_hand", np.eye(4), np.zeros((1, 3)), normal=np.array([0.0, 0.0, 1.0]))
    return [replace(first, contacts=(*first.contacts, hand) if with_hand else first.contacts) for with_hand in held]


def see(reference, *, v=(0.0, 0.0, 0.0), more=0.0):
    """Return a robot on its plan at its start whose base has a speed and whose left foot carries ``more`` [m/s, N]."""
    wanted = reference.at(0.0)
    q, speeds, n = wanted.configuration, np.zeros(reference.robot.n), len(reference.joint_names)
    speeds[:3] = v
    forces = {foot: wanted.contact_wrenches[foot][:3].copy() for foot in FEET}
    forces["l_foot"][2] += more
    forces["r_foot"][2] -= more
    zero = np.zeros(3)
    reading = RobotReading(0.0, wanted.q, np.zeros(n), np.eye(3), zero, zero, {}, np.zeros(n))
    return Sight(0.0, 1.0, 0, wanted, reading, q, speeds, q, forces)


def run(feet, sight, seconds=0.5):
    state = feet.start()
    for _ in range(round(seconds / PERIOD)):
        state = feet.step(state, sight)
    return state


@pytest.mark.parametrize(
    ("with_hand", "margin", "balances"), [(False, 0.05, True), (True, 0.05, False), (False, 0.01, False)]
)
def test_ankles_balance_a_robot_on_its_feet_alone_if_the_plan_leaves_them_room(reference, with_hand, margin, balances):
    state = run(make_feet(reference, list_phases(reference, with_hand), margin=margin), see(reference))
    stages = {foot: landing.stage for foot, landing in state.landings.items()}
    assert stages == dict.fromkeys(FEET, Stage.BALANCING if balances else Stage.STIFF)


def test_without_balance_the_ankles_of_planted_feet_follow_the_plan(reference):
    state = run(make_feet(reference, list_phases(reference, False), None), see(reference))
    assert {landing.stage for landing in state.landings.values()} == {Stage.STIFF}
    assert state.balance is None


def test_the_foot_that_carries_too_much_goes_up_and_the_other_one_down(reference):
    state = run(make_feet(reference, list_phases(reference, False)), see(reference, more=100.0))
    left, right = (state.landings[foot].height.offset[2] for foot in FEET)
    assert left == pytest.approx(0.5 * LOAD_GAIN * 100.0, rel=0.05)
    assert right == pytest.approx(-left)


def test_a_planted_foot_that_lost_the_ground_looks_for_it(reference):
    sight = see(reference)
    sight.forces["r_foot"][2] = 0.0
    height = run(make_feet(reference, list_phases(reference, False)), sight).landings["r_foot"].height
    assert height.offset[2] == pytest.approx(-0.5 * TouchdownSettings().probe_speed, rel=0.02)


@pytest.mark.parametrize(("share", "speed"), [(0.0, -1.0), (0.3, -0.5), (0.6, 0.0), (1.5, 0.0), (3.0, 0.0)])
def test_a_foot_that_carries_little_beside_a_hand_looks_for_its_ground(reference, share, speed):
    settings, sight = TouchdownSettings(), see(reference)
    planned = sight.wanted.contact_wrenches["r_foot"][2]
    sight.forces["r_foot"][2] = share * planned
    state = run(make_feet(reference, list_phases(reference, True, True)), sight).landings["r_foot"]
    missing = (settings.seek_share - share) * planned
    wanted = {-1.0: -settings.probe_speed, -0.5: -settings.seek_gain * missing, 0.0: 0.0}[speed]
    assert state.height.offset[2] == pytest.approx(0.5 * max(wanted, -settings.probe_speed), rel=0.03)


def test_a_foot_that_went_down_too_far_beside_a_hand_goes_back_up_to_the_plan(reference):
    feet, sight = make_feet(reference, list_phases(reference, True, True)), see(reference)
    planned = sight.wanted.contact_wrenches["r_foot"][2]
    sight.forces["r_foot"][2] = 0.0
    state = run(feet, sight, 0.3)
    low = state.landings["r_foot"].height.offset[2]
    sight.forces["r_foot"][2] = 4.0 * planned
    heights = []
    for _ in range(3000):
        state = feet.step(state, sight)
        heights.append(state.landings["r_foot"].height.offset[2])
    assert low < -5e-3
    assert np.diff(heights).min() > -3e-5  # it first has to stop
    assert heights[-1] == pytest.approx(0.0, abs=5e-4)


def test_the_margin_of_the_capture_point_is_measured_before_the_feet_are_alone(reference):
    feet = make_feet(reference, list_phases(reference, True, False))
    sight = replace(see(reference), time_s=reference.phases[0].end_s)
    still = run(feet, sight, 0.01)
    moved = run(feet, replace(sight, v=sight.v - 0.4 * np.eye(len(sight.v))[0]), 0.01)  # backwards
    assert 0.05 < still.margin_m < 0.2
    assert moved.margin_m < still.margin_m - 0.02
    assert run(make_feet(reference, list_phases(reference, True, True)), sight, 0.01).margin_m is None
    assert run(feet, see(reference), 0.01).margin_m is None


def test_the_body_moves_against_its_error_before_the_feet_are_alone(reference):
    phases = list_phases(reference, True, False)
    v = np.array([-0.05, 0.02, 0.0])  # of the base: the capture point is behind the plan's and left of it
    state = run(make_feet(reference, phases), see(reference, v=v), 0.2)
    assert state.landings["l_foot"].stage is Stage.BALANCING
    np.testing.assert_allclose(state.trim[:2], -0.2 * SETTINGS.trim_gain * state.balance.error, rtol=0.02)
    assert state.trim[0] > 0.001 > -0.0003 > state.trim[1]
    assert state.trim[2] == 0.0
    far = run(make_feet(reference, phases), see(reference, v=10.0 * v), 2.0)
    assert np.linalg.norm(far.trim) == pytest.approx(SETTINGS.trim_m)


def test_the_body_keeps_to_the_plan_where_no_contact_leaves_the_feet_alone(reference):
    for held in ((False, False), (True, True), (True,)):
        state = run(make_feet(reference, list_phases(reference, *held)), see(reference, v=(-0.05, 0.0, 0.0)), 0.2)
        np.testing.assert_array_equal(state.trim, 0.0)


def test_the_body_goes_back_to_the_plan_slowly_once_the_feet_are_alone(reference):
    feet = make_feet(reference, list_phases(reference, True, False))
    sight = see(reference, v=(-0.05, 0.0, 0.0))
    state = before = run(feet, sight, 0.2)
    for _ in range(1000):
        state = feet.step(state, replace(sight, phase=1))
    np.testing.assert_allclose(state.trim, np.exp(-1.0 / SETTINGS.trim_fade_s) * before.trim, rtol=1e-3)


def test_a_body_that_leans_to_the_left_is_righted_by_its_feet(reference):
    """The balance wants the pressure farther to the left then; feet that gave it would lean the body farther."""
    sight = see(reference, v=(0.0, 0.05, 0.0), more=100.0)
    state = run(make_feet(reference, list_phases(reference, False)), sight)
    assert state.balance.error[1] > 0.01
    left, right = (state.landings[foot].height.offset[2] for foot in FEET)
    assert left > 0.0005 > -0.0005 > right
