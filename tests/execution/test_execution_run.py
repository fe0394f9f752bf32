"""A plan carried out through a driver: in every phase paused, displaced, aborted, and replaced by another plan."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from small_plan import small_plan

from costs.curve import Curve
from service.errors import ExecutionError
from service.execution.execution import Execution
from service.execution.machine import MachineSettings, Mode, Order
from service.execution.reference import PlannedReference
from service.execution.sensing.forces import ForceMeter
from service.execution.settings import ExecutionSettings
from service.execution.tracking import Action, KinematicRobot, track
from service.execution.watch.pelvis import PelvisSettings
from service.execution.watch.watch import WatchSettings
from service.verify import Motion

PERIOD = 1e-2
BORDER_S = 4.0  # between the phases of the small plan
WEIGHT = 158.56 * 9.81


@pytest.fixture(scope="module")
def motion():
    return small_plan().motion


@pytest.fixture(scope="module")
def reference(motion):
    return PlannedReference(motion)


@pytest.fixture(scope="module")
def landing(motion):
    """The same motion, in whose first phase only the left foot is planted."""
    first, second = motion.phases
    return PlannedReference(replace(motion, phases=(replace(first, contacts=first.contacts[:1]), second)))


def start(reference, settings=None):
    return Execution(reference, KinematicRobot(reference.joint_names, reference.at(0.0).q, PERIOD), settings)


def press(driver, **upright):
    driver.foot_wrenches = {foot: np.array([0.0, 0.0, force, 0.0, 0.0, 0.0]) for foot, force in upright.items()}


def place(reference, q, link):
    data = reference.robot.model.createData()
    pin.framesForwardKinematics(reference.robot.model, data, q)
    return data.oMf[reference.robot.model.getFrameId(link)].translation.copy()


def collect(execution, actions=(), **kwargs):
    cycles = []
    report = track(execution, actions, on_cycle=cycles.append, **kwargs)
    return report, cycles


def check_command(reference, cycles):
    robot, columns = reference.robot, reference.joint_columns
    qd = np.array([cycle.command.qd[columns] for cycle in cycles])
    assert np.all(np.abs(np.diff(qd, axis=0)) <= robot.acceleration[columns] * PERIOD + 1e-9)
    assert np.all(np.abs(qd) <= robot.velocity[columns] + 1e-9)
    q = np.array([cycle.command.q[columns] for cycle in cycles])
    np.testing.assert_allclose(np.diff(q, axis=0), PERIOD * qd[1:], atol=1e-12)


def test_a_plan_is_followed_phase_by_phase_to_its_end(reference):
    report, cycles = collect(start(reference))
    assert report.verdict == "TRACKED"
    assert [(change.mode, change.phase) for change in report.changes][:2] == [("running", "bend"), ("running", "turn")]
    end = reference.at(reference.duration_s).configuration
    np.testing.assert_allclose(cycles[-1].command.q[:-1], end[:-1], atol=2e-3)
    assert max(report.off_m.values()) < 2e-3
    assert report.acceleration_share <= 1.0 + 1e-9
    check_command(reference, cycles)


@pytest.mark.parametrize("at", [1.0, 5.0])
def test_a_pause_in_every_phase_holds_the_robot_still_until_it_is_resumed(reference, at):
    report, cycles = collect(start(reference), [Action(at, Order.PAUSE), Action(at + 1.5, Order.RESUME)])
    still = [cycle for cycle in cycles if cycle.state.mode is Mode.PAUSED and cycle.state.rate == 0.0]
    assert len(still) * PERIOD > 1.0
    assert np.abs(still[-1].command.qd).max() < 0.02
    assert report.verdict == "TRACKED"
    assert report.run_s == pytest.approx(reference.duration_s + 0.15 + 1.5 + 0.3, abs=0.35)
    check_command(reference, cycles)


@pytest.mark.parametrize("at", [1.0, 5.0])
def test_an_abort_in_every_phase_ends_at_rest_in_balance(reference, at):
    report, cycles = collect(start(reference), [Action(at, Order.ABORT)], settle_s=1.0)
    assert (report.verdict, report.reason) == ("ABORTED", "aborted by the operator")
    assert report.plan_s == pytest.approx(at, abs=0.4)
    assert np.abs(cycles[-1].command.qd).max() < 1e-2
    check_command(reference, cycles)


def test_an_abort_where_the_margin_is_thin_goes_back_to_a_pose_with_more(reference):
    execution = start(reference)
    balance = execution.machine.balance
    thin = np.where(balance.times > 2.0, 0.01, 0.1)
    execution.machine.balance = replace(balance, margin=thin)
    report, cycles = collect(execution, [Action(5.0, Order.ABORT)], settle_s=1.0)
    assert report.plan_s == pytest.approx(2.0, abs=0.03)
    assert report.changes[-1].phase == "bend"
    np.testing.assert_allclose(cycles[-1].command.q[:-1], reference.at(2.0).configuration[:-1], atol=3e-2)
    check_command(reference, cycles)


@pytest.mark.parametrize(("at", "link"), [(1.0, "r_hand"), (5.0, "r_hand")])
def test_a_target_displaced_in_every_phase_is_reached_without_a_jump(reference, at, link):
    offset = np.array([0.008, -0.006, 0.01])
    report, cycles = collect(start(reference), [Action(at, link=link, offset=offset)])
    assert report.verdict == "TRACKED"
    last = cycles[-1]
    planned = place(reference, last.wanted.configuration, link)
    np.testing.assert_allclose(place(reference, last.command.q, link) - planned, offset, atol=1.5e-3)
    check_command(reference, cycles)


def test_what_carries_the_robot_is_not_shifted_and_a_foot_that_lands_stays_where_it_is(landing):
    begin = BORDER_S - 0.3
    execution = Execution(landing, KinematicRobot(landing.joint_names, landing.at(begin).q, PERIOD), None, begin)
    press(execution.driver, l_foot=0.5 * WEIGHT, r_foot=0.5 * WEIGHT)
    with pytest.raises(ExecutionError, match="l_foot carries the robot in 'bend'; it can be shifted while it moves"):
        execution.shift("l_foot", np.array([0.1, 0.0, 0.0]))
    execution.shift("r_foot", np.array([0.1, 0.0, 0.0]))
    offsets = []
    while len(offsets) < 60:
        execution.step()
        offsets.append((execution.state.phase, float(execution.shifts["r_foot"].offset[0])))
    landed = [offset for phase, offset in offsets if phase == 1]
    assert 0.005 < landed[0] < 0.05
    assert landed == landed[:1] * len(landed)
    with pytest.raises(ExecutionError, match="r_foot carries the robot"):
        execution.shift("r_foot", np.zeros(3))


def rest_of(motion: Motion, q):
    """Return the motion's second half from another configuration."""
    positions = np.stack([q, 0.5 * (q + motion.curve.positions[-1]), motion.curve.positions[-1]])
    return PlannedReference(replace(motion, curve=Curve(motion.curve.knots, positions, np.zeros_like(positions))))


@pytest.mark.parametrize("at", [1.0, 5.0])
def test_in_every_phase_another_plan_goes_on_where_the_execution_stands(motion, reference, at):
    made = []

    def replan(execution, action):
        assert action.link == "goal"
        assert execution.is_at_rest
        made.append(execution.state.time_s)
        return rest_of(motion, execution.command.q)

    report, cycles = collect(start(reference), [Action(at, link="goal", plans=True)], replan=replan)
    assert made
    assert made[0] == pytest.approx(at, abs=0.2)
    assert report.verdict == "TRACKED"
    assert report.run_s == pytest.approx(at + 0.3 + reference.duration_s + 0.15, abs=0.3)
    check_command(reference, cycles)


def test_another_plan_is_refused_while_the_robot_moves_and_if_it_starts_elsewhere(motion, reference):
    execution = start(reference)
    for _ in range(150):
        execution.step()
    with pytest.raises(ExecutionError, match="moves; pause it"):
        execution.replace_plan(reference)
    execution.give(Order.PAUSE)
    for _ in range(60):
        execution.step()
    with pytest.raises(ExecutionError, match=r"l_arm_elx .* off the last command"):
        execution.replace_plan(PlannedReference(motion))


def test_a_pause_that_nobody_ends_is_reported(reference):
    report, _ = collect(start(reference), [Action(1.0, Order.PAUSE)])
    assert report.verdict == "ABORTED"
    assert "never resumed" in report.reason


def test_a_foot_that_lands_late_is_waited_for(landing):
    execution = start(landing, ExecutionSettings(touchdown=None))
    press(execution.driver, l_foot=WEIGHT, r_foot=0.0)
    execution = Execution(landing, execution.driver, execution.settings)

    def touch(cycle):
        if cycle.state.mode is Mode.WAITING and cycle.state.waited_s > 1.0:
            press(execution.driver, l_foot=0.5 * WEIGHT, r_foot=0.5 * WEIGHT)

    report = track(execution, on_cycle=touch)
    assert report.verdict == "TRACKED"
    (waited,) = [change for change in report.changes if change.mode == "waiting"]
    assert waited.plan_s == BORDER_S
    assert "r_foot carries 0 N; 'turn' needs it" in waited.reason


def test_a_foot_that_never_lands_is_looked_for_and_then_the_plan_is_aborted(landing):
    driver = KinematicRobot(landing.joint_names, landing.at(0.0).q, PERIOD)
    press(driver, l_foot=WEIGHT, r_foot=0.0)
    # The pelvis leans while the foot goes down, which the inertial unit of this robot does not show.
    watch = WatchSettings(pelvis=PelvisSettings(lean_rad=0.3, place_m=0.5))
    execution = Execution(landing, driver, ExecutionSettings(machine=MachineSettings(wait_s=1.5), watch=watch))
    lowest = []
    report = track(execution, on_cycle=lambda cycle: lowest.append(execution.list_shifts()["r_foot"].offset[2]))
    assert report.verdict == "ABORTED"
    assert "r_foot carries 0 N" in report.reason
    assert min(lowest) == pytest.approx(-0.03, abs=1e-3)


def test_a_robot_that_falls_is_commanded_no_further(reference):
    driver = KinematicRobot(reference.joint_names, reference.at(0.0).q, PERIOD)
    press(driver, l_foot=0.5 * WEIGHT, r_foot=0.5 * WEIGHT)
    execution = Execution(reference, driver)
    read = driver.read
    driver.read = lambda: replace(
        read(), imu_rotation=pin.rpy.rpyToMatrix(0.0, 0.5 if driver.commands > 200 else 0.0, 0.0)
    )
    report = track(execution)
    assert report.verdict == "FELL"
    assert "pelvis leans 29 deg" in report.reason
    assert report.plan_s == pytest.approx(2.0 - 0.15, abs=0.05)


def test_the_force_of_a_hand_is_found_from_the_torques_of_its_arm(reference):
    robot, names = reference.robot, reference.joint_names
    meter = ForceMeter(robot, names, ("l_tool",), PERIOD)
    driver = KinematicRobot(names, reference.at(2.0).q, PERIOD)
    q, force = reference.at(2.0).configuration, np.array([20.0, -35.0, 60.0])
    data = robot.model.createData()
    held = pin.rnea(robot.model, data, q, np.zeros(robot.n), np.zeros(robot.n))
    pin.computeJointJacobians(robot.model, data, q)
    pin.updateFramePlacements(robot.model, data)
    axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    jacobian = pin.getFrameJacobian(robot.model, data, robot.model.getFrameId("l_tool"), axes)[:3]
    reading = replace(driver.read(), torque=(held - jacobian.T @ force)[reference.joint_columns])
    measured = meter.step(None, reading, np.zeros(len(names)))
    np.testing.assert_allclose(measured.hands["l_tool"], force, atol=1e-6)
    assert measured.sizes["l_tool"] == pytest.approx(np.linalg.norm(force))


def test_a_tool_that_no_arm_carries_has_no_force(reference):
    with pytest.raises(ExecutionError, match="carry pelvis alone"):
        ForceMeter(reference.robot, reference.joint_names, ("pelvis",), PERIOD)


def test_a_driver_with_other_joints_is_refused(reference):
    with pytest.raises(ExecutionError, match="the driver's joints are not those of the plan"):
        Execution(reference, KinematicRobot(reference.joint_names[1:], reference.at(0.0).q[1:]))


def test_a_robot_that_stands_elsewhere_is_refused_with_its_joint(reference):
    q = reference.at(0.0).q.copy()
    q[3] += 0.3
    with pytest.raises(ExecutionError, match=rf"not at the plan's start: {reference.joint_names[3]} is"):
        Execution(reference, KinematicRobot(reference.joint_names, q))


def test_orders_after_the_end_are_refused(reference):
    execution = start(reference)
    execution.run()
    for order in Order:
        with pytest.raises(ExecutionError, match="is done; plan again"):
            execution.give(order)
