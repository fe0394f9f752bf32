"""Arms in contact: they yield to forces beyond their bounds, look for surfaces, and come back to the plan."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from costs.robot import load_robot
from costs.robot.servo import list_servo_joints
from service.errors import ExecutionError
from service.execution.yielding import Yielding, YieldSettings, find_arms, find_branch, holds_arm
from service.verify import PlantedContact

PERIOD = 1e-3


@pytest.fixture(scope="module")
def robot():
    return load_robot("atlas")


def planted(robot, link, normal=(0.0, 0.0, 1.0)):
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, robot.postures["reach_ready"])
    pose = data.oMf[robot.model.getFrameId(link)].homogeneous
    return PlantedContact(link, pose, np.zeros((1, 3)), force_cap_n=200.0, normal=np.array(normal))


def press(robot, contact, force, seconds, *, expected=50.0, landing=False, is_waiting=False):
    """Return the displacement of an arm after a constant force along z."""
    yielding = Yielding(robot, list_servo_joints(robot), [contact])
    states = yielding.start()
    for _ in range(round(seconds / PERIOD)):
        states = yielding.step(
            states,
            robot.postures["reach_ready"],
            () if landing else (contact,),
            (contact,) if landing else (),
            is_waiting=is_waiting,
            measured={contact.link: np.array([0.0, 0.0, force])},
            expected={contact.link: np.array([0.0, 0.0, expected, 0.0, 0.0, 0.0])},
            period_s=PERIOD,
        )
    return yielding, states[contact.link]


def test_a_force_within_its_bounds_moves_nothing(robot):
    _, state = press(robot, planted(robot, "l_lfarm"), 60.0, 0.1)
    assert not state.offset.any()


@pytest.mark.parametrize(("force", "sign"), [(190.0, 1.0), (10.0, -1.0)])
def test_a_contact_moves_along_its_normal_off_a_force_and_towards_a_missing_one(robot, force, sign):
    contact = planted(robot, "l_lfarm")
    yielding, state = press(robot, contact, force, 0.2)
    model, data, q = robot.model, robot.model.createData(), robot.postures["reach_ready"].copy()
    pin.framesForwardKinematics(model, data, q)
    frame = model.getFrameId("l_lfarm")
    before = data.oMf[frame].translation.copy()
    q[yielding.arms["l_lfarm"].columns] += state.offset
    pin.framesForwardKinematics(model, data, q)
    moved = data.oMf[frame].translation - before
    assert sign * state.travel > 3e-4
    assert moved[2] == pytest.approx(state.travel, rel=0.05)


def test_only_while_the_plan_waits_a_link_looks_for_its_surface(robot):
    contact = planted(robot, "l_lfarm")
    assert press(robot, contact, 0.0, 0.5, landing=True)[1].travel == 0.0
    settings = YieldSettings()
    _, state = press(robot, contact, 0.0, 0.5, landing=True, is_waiting=True)
    assert state.travel == pytest.approx(-0.5 * settings.search_speed, rel=1e-6)
    assert press(robot, contact, 0.0, 5.0, landing=True, is_waiting=True)[1].travel == -settings.most_m


def test_a_released_arm_comes_back_to_the_plan(robot):
    contact = planted(robot, "l_lfarm")
    yielding, state = press(robot, contact, 190.0, 0.2)
    states = {"l_lfarm": state}
    for _ in range(5000):
        states = yielding.step(
            states, robot.postures["reach_ready"], (), (), is_waiting=False, measured={}, expected={}, period_s=PERIOD
        )
    assert np.abs(states["l_lfarm"].offset).max() < 1e-5


def test_feet_and_trunk_do_not_yield(robot):
    contacts = [planted(robot, link) for link in ("utorso", "r_foot", "pelvis", "r_hand")]
    assert set(find_arms(robot, list_servo_joints(robot), contacts)) == {"r_hand"}


def test_an_arm_is_held_by_its_forearm_and_not_by_the_other_arm(robot):
    left, right = planted(robot, "l_lfarm"), planted(robot, "r_lfarm")
    assert holds_arm(robot.model, "l_hand", [left])
    assert not holds_arm(robot.model, "l_hand", [right])
    branch = find_branch(robot.model, robot.model.frames[robot.model.getFrameId("l_hand")].parentJoint)
    assert {robot.model.names[joint] for joint in branch} == {n for n in robot.model.names if n.startswith("l_arm")}


def test_settings_that_contradict_each_other_are_refused():
    with pytest.raises(ExecutionError, match="touch_n is at most landing_n"):
        replace(YieldSettings(), touch_n=50.0)
