"""Arms in contact: they yield to forces beyond their bounds, look for surfaces, and come back to the plan."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from costs.robot import load_robot
from costs.robot.servo import list_servo_joints
from service.errors import ExecutionError
from service.execution.yielding import (
    Yielding,
    YieldSettings,
    bound_forces,
    find_arms,
    find_branch,
    holds_arm,
    press_trunk,
)
from service.verify import PlantedContact

PERIOD = 1e-3
SETTINGS = YieldSettings()


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
    bounds = bound_forces(
        SETTINGS,
        () if landing else (contact,),
        (contact,) if landing else (),
        is_waiting=is_waiting,
        expected={contact.link: np.array([0.0, 0.0, expected, 0.0, 0.0, 0.0])},
    )
    measured, states = {contact.link: np.array([0.0, 0.0, force])}, yielding.start()
    for _ in range(round(seconds / PERIOD)):
        states = yielding.step(states, robot.postures["reach_ready"], bounds, measured, PERIOD)
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
        states = yielding.step(states, robot.postures["reach_ready"], {}, {}, PERIOD)
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


def lean_on(force, *, waiting=True, seconds=0.5, offset=None):
    """Let the trunk, which is about to touch a wall ahead, feel ``force(offset)`` [N]; return the body's offsets."""
    wall = PlantedContact("utorso", np.eye(4), np.zeros((4, 3)), normal=np.array([-1.0, 0.0, 0.0]))
    bounds = bound_forces(SETTINGS, [], [wall], is_waiting=waiting, expected={})
    offsets = [np.zeros(3) if offset is None else offset]
    for _ in range(round(seconds / 1e-3)):
        measured = {"utorso": np.array([-force(offsets[-1][0]), 0.0, 0.0])}
        offsets.append(press_trunk(SETTINGS, offsets[-1], bounds, measured, 1e-3))
    return np.array(offsets)


def test_the_trunk_looks_for_the_surface_that_the_plan_waits_for():
    offsets = lean_on(lambda x: max(2e4 * (x - 0.008), 0.0), seconds=2.0)
    assert offsets[-1][0] == pytest.approx(0.008, abs=1e-3)
    assert 2e4 * (offsets[-1][0] - 0.008) > 5.0
    assert np.diff(offsets[:, 0]).max() <= SETTINGS.search_speed * 1e-3 + 1e-12
    assert not lean_on(lambda x: 0.0, waiting=False).any()


def test_the_body_goes_no_further_than_it_may_and_back_without_a_contact():
    offsets = lean_on(lambda x: 0.0, seconds=3.0)
    assert np.linalg.norm(offsets[-1]) == pytest.approx(SETTINGS.most_m)
    back = offsets[-1]
    for _ in range(4000):
        back = press_trunk(SETTINGS, back, {}, {}, 1e-3)
    assert np.linalg.norm(back) < 1e-4


def test_a_link_that_is_let_go_next_yields_to_less_force():
    contact = PlantedContact(
        "r_ufarm", np.eye(4), np.zeros((4, 3)), normal=np.array([0.0, 0.0, 1.0]), force_cap_n=100.0
    )
    expected = {"r_ufarm": np.array([0.0, 0.0, 20.0, 0.0, 0.0, 0.0])}
    held = bound_forces(SETTINGS, [contact], [], is_waiting=False, expected=expected)["r_ufarm"]
    leaving = bound_forces(SETTINGS, [contact], [], leaving={"r_ufarm"}, is_waiting=False, expected=expected)["r_ufarm"]
    assert held.most == pytest.approx(SETTINGS.most_share * 400.0)
    assert leaving.most == SETTINGS.landing_n
    assert (held.least, leaving.least) == (10.0, 0.0)
