"""What reaches a driver whatever it says, and what the guards on sensors and servos find."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from small_plan import small_plan

from service.errors import ExecutionError
from service.execution.driver import JointCommand, RobotReading
from service.execution.execution import Execution
from service.execution.guards import Severity
from service.execution.machine import Mode, Order
from service.execution.reference import PlannedReference
from service.execution.tracking import KinematicRobot, track
from service.execution.watch.driver_link import DriverLink
from service.execution.watch.readings import ReadingCheck
from service.execution.watch.servos import ServoWatch
from service.execution.watch.weight import WeightWatch

PERIOD = 1e-2
WEIGHT = 158.56 * 9.81
NUMBERS = st.one_of(st.floats(), st.sampled_from([np.nan, np.inf, -np.inf, 1e300, -1e300, 0.0]))


@pytest.fixture(scope="module")
def reference():
    return PlannedReference(small_plan().motion)


class Liar(KinematicRobot):
    """A robot that says something else in every cycle after the first, and records what it is commanded."""

    def __init__(self, reference, lies, has_feet=True):
        super().__init__(reference.joint_names, reference.at(0.0).q, PERIOD)
        self.lies, self.heard = list(lies), []
        if has_feet:
            self.foot_wrenches = {
                foot: np.array([0.0, 0.0, 0.5 * WEIGHT, 0.0, 0.0, 0.0]) for foot in ("l_foot", "r_foot")
            }

    def read(self):
        reading = super().read()
        if self.commands == 0 or not self.lies:
            return reading
        return self.lies[self.commands % len(self.lies)](reading)

    def command(self, command):
        self.heard.append(command)
        super().command(command)


def put(field, index, value):
    def lie(reading):
        array = np.array(getattr(reading, field), dtype=float)
        array.flat[index % max(array.size, 1)] = value
        return replace(reading, **{field: array})

    return lie


def put_force(foot, value):
    def lie(reading):
        wrenches = dict(reading.foot_wrenches)
        if value is None:
            wrenches.pop(foot, None)
        else:
            wrenches[foot] = value
        return replace(reading, foot_wrenches=wrenches)

    return lie


def fail(reading):
    raise OSError("no answer")


LIES = st.one_of(
    st.builds(
        put,
        st.sampled_from(["q", "qd", "torque", "imu_rotation", "imu_angular_velocity", "imu_acceleration"]),
        st.integers(0, 27),
        NUMBERS,
    ),
    st.builds(
        put_force,
        st.sampled_from(["l_foot", "r_foot", "nose"]),
        st.one_of(st.none(), st.lists(NUMBERS, min_size=6, max_size=6).map(np.array), st.just(np.zeros(2))),
    ),
    st.builds(lambda time: lambda reading: replace(reading, time_s=time), st.one_of(NUMBERS, st.none())),
    st.sampled_from([
        fail,
        lambda reading: None,
        lambda reading: replace(reading, q=reading.q[1:]),
        lambda reading: replace(reading, qd="fast"),
        lambda reading: replace(reading, foot_wrenches=None),
        lambda reading: replace(reading, torque=np.zeros(0)),
        lambda reading: replace(reading, imu_rotation=np.zeros((3, 3))),
        lambda reading: reading,
    ]),
)  # fmt: skip


@settings(
    max_examples=12,
    deadline=None,
    phases=(Phase.explicit, Phase.generate),
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(lies=st.lists(LIES, min_size=1, max_size=5), has_feet=st.booleans())
def test_whatever_a_driver_says_it_is_commanded_finite_and_continuous_values(reference, lies, has_feet):
    robot = Liar(reference, lies, has_feet)
    execution = Execution(reference, robot)
    for _ in range(20):
        execution.step()
    q = np.array([command.q for command in robot.heard])
    everything = np.array([[command.q, command.qd, command.tau] for command in robot.heard])
    assert np.isfinite(everything).all()
    limits = reference.robot.velocity[reference.joint_columns] * PERIOD
    assert (np.abs(np.diff(q, axis=0)) <= limits + 0.02).all()


@pytest.mark.parametrize(
    ("lie", "word"),
    [
        (put("q", 3, np.nan), "encoder of"),
        (put("q", 3, 9.0), "encoder of"),
        (put("imu_rotation", 0, np.nan), "inertial unit"),
        (put_force("l_foot", None), "force sensor of l_foot says nothing"),
        (put_force("l_foot", np.array([0.0, 0.0, -500.0, 0.0, 0.0, 0.0])), "the ground pulls with 500 N"),
        (lambda reading: replace(reading, time_s=0.0), "old, at 0.000 s"),
        (lambda reading: replace(reading, time_s=reading.time_s - 0.05), "old"),
        (fail, "OSError no answer"),
    ],
)
def test_a_sensor_that_fails_makes_the_robot_hold_and_is_named(reference, lie, word):
    robot = Liar(reference, [lie])
    report = track(Execution(reference, robot), settle_s=0.1)
    assert report.verdict == "ABORTED"
    assert word in report.reason
    assert report.run_s < 1.5


def test_one_lost_reading_is_bridged(reference):
    robot = Liar(reference, [lambda reading: reading] * 20 + [fail] + [lambda reading: reading] * 20)
    execution = Execution(reference, robot)
    cycles = [execution.step() for _ in range(40)]
    found = [finding.severity for cycle in cycles for finding in cycle.findings]
    assert found
    assert set(found) == {Severity.NOTE}
    assert cycles[-1].state.mode is Mode.RUNNING


def test_nothing_is_commanded_once_the_driver_is_silent(reference):
    robot = Liar(reference, [])
    execution = Execution(reference, robot)
    execution.step()
    robot.command = fail
    states = [execution.step().state for _ in range(100)]
    assert states[-1].mode is Mode.ABORTED
    assert execution.is_lost


def test_a_command_that_is_not_finite_is_not_handed_over(reference):
    robot = Liar(reference, [])
    first = reference.at(0.0)
    link = DriverLink(robot, JointCommand(first.q, 0.0 * first.q, first.tau))
    link.command(JointCommand(first.q * np.nan, first.qd, first.tau))
    np.testing.assert_array_equal(robot.heard[-1].q, first.q)
    assert link.n_refused == 1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"q": np.zeros(3)}, "reading.q is not"),
        ({"torque": np.zeros(3)}, "reading.torque has 3 numbers"),
        ({"time_s": np.nan}, "reading.time_s"),
        ({"imu_rotation": np.zeros((3, 3))}, "inertial unit"),
        ({"foot_wrenches": {"l_foot": np.zeros(2)}}, "foot_wrenches"),
    ],
)
def test_a_driver_whose_first_reading_makes_no_sense_is_refused_before_any_command(reference, change, message):
    robot = Liar(reference, [])
    read = robot.read
    robot.read = lambda: replace(read(), **change)
    with pytest.raises(ExecutionError, match=message):
        Execution(reference, robot)
    assert robot.heard == []


def test_a_robot_without_force_sensors_is_carried_out_and_says_what_is_not_watched(reference):
    report = track(Execution(reference, Liar(reference, [], has_feet=False)))
    assert report.verdict == "TRACKED"
    assert any("no force is measured at l_foot and r_foot" in sentence for sentence in report.unwatched)


def test_a_stuck_joint_is_found_by_its_angle_where_no_torque_is_measured(reference):
    robot = Liar(reference, [], has_feet=False)
    read, start = robot.read, reference.at(0.0).q.copy()
    elbow = reference.joint_names.index("l_arm_elx")

    def stuck():
        reading = read()
        q = reading.q.copy()
        q[elbow] = start[elbow]
        return replace(reading, q=q, torque=np.zeros(0))

    robot.read = stuck
    report = track(Execution(reference, robot))
    assert (report.verdict, report.faults[-1].name) == ("ABORTED", "blocked joint")
    assert "l_arm_elx is" in report.reason
    assert any("no torques are measured" in sentence for sentence in report.unwatched)


def test_a_servo_that_makes_half_of_its_torque_is_weak(reference):
    names = tuple(reference.joint_names)
    watch = ServoWatch(reference, names, PERIOD)
    first = reference.at(0.0)
    elbow = names.index("l_arm_elx")
    sent = JointCommand(first.q, 0.0 * first.q, first.tau.copy())
    sent.tau[elbow] = 40.0
    torque = sent.tau.copy()
    torque[elbow] = 20.0
    robot = KinematicRobot(names, first.q, PERIOD)
    reading = replace(robot.read(), torque=torque)
    state, found = watch.start(reading), ()
    for _ in range(60):
        found, state = watch.step(state, reading, sent, torque, 0)
    assert [(finding.severity, finding.name, finding.link) for finding in found] == [
        (Severity.HOLD, "weak servo", "l_arm_elx")
    ]


def test_forces_that_do_not_carry_the_robot_are_not_believed(reference):
    planted = reference.phases[0].contacts
    half = {contact.link: np.array([0.0, 0.0, 0.5 * WEIGHT, 0.0, 0.0, 0.0]) for contact in planted}
    dead = {"l_foot": np.zeros(3), "r_foot": half["r_foot"][:3]}
    lifted = {"l_foot": np.zeros(3), "r_foot": 2.0 * half["r_foot"][:3]}
    for forces, count in ((dead, 1), (lifted, 0)):
        watch, found = WeightWatch.of(reference.robot), ()
        for _ in range(20):
            found, watch = watch.step(planted, forces, half, PERIOD)
        assert [finding.link for finding in found] == count * ["force of l_foot"]


def test_readings_that_repeat_themselves_while_joints_move_are_not_believed(reference):
    names = tuple(reference.joint_names)
    check = ReadingCheck(reference.robot, names, PERIOD)
    first = KinematicRobot(names, reference.at(0.0).q, PERIOD).read()
    state = check.start(first)
    sent = JointCommand(first.q, np.full(len(first.q), 0.2), first.torque)
    moved, kinds = first, set()
    for k in range(1, 40):
        q = first.q + 1e-6 * k if k < 5 else first.q
        moved = replace(first, time_s=k * PERIOD, q=q)
        _, found, state = check.step(state, moved, sent)
        kinds |= {finding.name for finding in found if finding.severity is Severity.HOLD}
    assert kinds == {"encoders"}


def test_a_pause_on_the_way_back_stops_it_and_resume_goes_on_back(reference):
    execution = Execution(reference, KinematicRobot(reference.joint_names, reference.at(0.0).q, PERIOD))
    balance = execution.machine.balance
    execution.machine.balance = replace(balance, margin=np.where(balance.times > 1.0, 0.01, 0.1))
    while execution.state.time_s < 4.0:
        execution.step()
    execution.give(Order.ABORT)
    while execution.state.mode is not Mode.RETURNING or execution.state.rate >= 0.0:
        execution.step()
    execution.give(Order.PAUSE)
    states = [execution.step().state for _ in range(100)]
    assert {state.mode for state in states} == {Mode.PAUSED}
    assert states[-1].rate == 0.0
    assert states[-1].time_s > 2.0
    execution.give(Order.RESUME)
    assert execution.run().mode is Mode.ABORTED
    assert execution.state.time_s == pytest.approx(1.0, abs=0.03)
    assert isinstance(execution.watch.readings.good, RobotReading)
