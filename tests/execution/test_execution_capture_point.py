"""Balance on the feet: capture point, pressures and ankle torques against the plan's."""

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation
from shared_plans import write_example

from service.errors import ExecutionError
from service.execution.reference import PlannedReference
from service.execution.stance.capture_point import BalanceControl, BalanceSettings, find_turn_rates
from service.execution.stance.touchdown import find_ankle

FEET = ("l_foot", "r_foot")
SETTINGS = BalanceSettings()


@pytest.fixture(scope="module")
def reference():
    return PlannedReference.read(write_example("steps"))


@pytest.fixture(scope="module")
def control(reference):
    ankles = {foot: find_ankle(reference.robot, reference.joint_names, foot).joints for foot in FEET}
    return BalanceControl(reference.robot, {foot: reference.joint_columns[own] for foot, own in ankles.items()})


def find_time(reference, name, share=0.5):
    phase = next(phase for phase in reference.phases if phase.name.endswith(name))
    return phase.begin_s + share * (phase.end_s - phase.begin_s)


def balance(reference, control, time, *, q=None, v=None, rate=1.0, forces=None):
    wanted = reference.at(time)
    planned = {foot: wanted.contact_wrenches[foot][:3] for foot in FEET}
    return control.step(
        wanted.configuration if q is None else q,
        rate * wanted.velocity if v is None else v,
        wanted,
        rate,
        reference.find_phase(time).contacts,
        planned if forces is None else forces,
    )


@pytest.mark.parametrize(("phase", "share"), [("shift", 0.5), ("swing", 0.3), ("swing", 0.7)])
def test_a_robot_on_its_plan_gets_the_plans_torques(reference, control, phase, share):
    time = find_time(reference, phase, share)
    wanted, made = reference.at(time), balance(reference, control, time)
    np.testing.assert_allclose(made.error, 0.0, atol=1e-12)
    for foot, torques in made.torques.items():
        ankle = find_ankle(reference.robot, reference.joint_names, foot).joints
        # The plan's torques also carry the foot, 2.4 kg, and the armature is not part of either.
        np.testing.assert_allclose(torques, wanted.tau[ankle], atol=2.0)


def test_a_speed_sideways_moves_the_pressure_sideways_by_the_gain(reference, control):
    time = find_time(reference, "swing")
    still = balance(reference, control, time)
    v = reference.at(time).velocity.copy()
    v[1] += 0.02
    moved = balance(reference, control, time, v=v)
    data = reference.robot.model.createData()
    height = pin.centerOfMass(reference.robot.model, data, reference.at(time).configuration)[2]
    assert moved.error == pytest.approx([0.0, 0.02 * np.sqrt(height / 9.81)], rel=1e-3)
    off = moved.pressures["l_foot"] - still.pressures["l_foot"]
    np.testing.assert_allclose(off, SETTINGS.gain * moved.error, atol=1e-9)


def test_the_pressure_stays_off_the_border_of_the_sole(reference, control):
    time = find_time(reference, "swing")
    v = reference.at(time).velocity.copy()
    v[1] += 1.0
    sole = next(contact.sole for contact in reference.find_phase(time).contacts if contact.link == "l_foot")
    highest = balance(reference, control, time, v=v).pressures["l_foot"][1]
    assert highest == pytest.approx(sole[:, 1].max() - SETTINGS.edge_m, abs=2e-3)


def test_a_robot_that_stands_aside_with_its_feet_is_on_its_plan(reference, control):
    time = find_time(reference, "shift")
    q = reference.at(time).configuration.copy()
    q[:2] += [0.02, -0.01]
    np.testing.assert_allclose(balance(reference, control, time, q=q).error, 0.0, atol=1e-12)


def test_feet_that_share_the_weight_wrongly_make_up_for_it_by_their_pressures(reference, control):
    time = find_time(reference, "shift")
    wanted = reference.at(time)
    forces = {foot: wanted.contact_wrenches[foot][:3].copy() for foot in FEET}
    forces["l_foot"][2] += 30.0
    forces["r_foot"][2] -= 30.0
    made = balance(reference, control, time, forces=forces)
    usual = balance(reference, control, time)
    data, model = reference.robot.model.createData(), reference.robot.model
    pin.framesForwardKinematics(model, data, wanted.configuration)
    places = {foot: data.oMf[model.getFrameId(foot)].translation[:2] for foot in FEET}

    def find_zmp(result, measured):
        total = sum(force[2] for force in measured.values())
        return sum(measured[foot][2] / total * (places[foot] + result.pressures[foot]) for foot in FEET)

    planned = {foot: wanted.contact_wrenches[foot] for foot in FEET}
    np.testing.assert_allclose(find_zmp(made, forces), find_zmp(usual, planned), atol=1e-9)


def test_a_paused_plan_wants_the_pressure_below_the_centre_of_mass(reference, control):
    time = find_time(reference, "swing", 0.2)
    made = balance(reference, control, time, rate=0.0)
    model, data = reference.robot.model, reference.robot.model.createData()
    com = pin.centerOfMass(model, data, reference.at(time).configuration)
    pin.framesForwardKinematics(model, data, reference.at(time).configuration)
    foot = data.oMf[model.getFrameId("l_foot")].translation
    np.testing.assert_allclose(made.pressures["l_foot"], (com - foot)[:2], atol=1e-9)


def test_rates_of_yaw_pitch_and_roll_make_the_angular_velocity():
    angles, rates, step = np.array([0.4, -0.3, 0.2]), np.array([0.5, -0.7, 0.9]), 1e-6
    before, after = (Rotation.from_euler("ZYX", angles + sign * step * rates) for sign in (-0.5, 0.5))
    omega = (after * before.inv()).as_rotvec() / step
    np.testing.assert_allclose(find_turn_rates(angles, omega), rates, atol=1e-6)


@pytest.mark.parametrize("kwargs", [{"gain": 1.0}, {"edge_m": -0.01}, {"least_m": -0.01}])
def test_settings_that_make_no_sense_are_refused(kwargs):
    with pytest.raises(ExecutionError, match="expected a gain above"):
        BalanceSettings(**kwargs)
