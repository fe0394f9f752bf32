"""Online pose control: eq. 6 and 7 of Liu et al., Humanoids 2015."""

from dataclasses import replace

import cvxpy as cp
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from costs.robot import load_robot
from service.errors import ExecutionError
from service.execution.gains import PRESETS, TABLE_I, PoseGains, TaskGains
from service.execution.pose_control import Command, PoseController
from service.execution.shift import LARGEST_SHIFT_M, Shift, ShiftLimits, step_shift

PERIOD = 4e-3
LIMITS = ShiftLimits()


@pytest.fixture(scope="module")
def atlas():
    return load_robot("atlas")


def place(robot, q, link):
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    return data.oMf[robot.model.getFrameId(link)]


def move(robot, t, duration=2.0):
    """Desired pose and speed: from standing, arms out and hips down and back to rest, feet where they are in ``q``."""
    start, end = robot.postures["stand"].copy(), robot.postures["stand"].copy()
    for joint, value in (("r_arm_shx", -0.6), ("r_arm_elx", -0.6), ("back_bkz", 0.3)):
        end[robot.joint_names.index(joint)] += value
    u = np.clip(t / duration, 0.0, 1.0)
    blend, slope = u * u * (3.0 - 2.0 * u), 6.0 * u * (1.0 - u) / duration
    return start + blend * (end - start), slope * (end - start)


def follow(controller, duration, shifts=None, start=None, limits=LIMITS):
    """Run the controller over ``move``; ``shifts`` maps a time to goals of shifts by link.  Returns all commands."""
    robot = controller.robot
    command = Command.at_rest(move(robot, 0.0)[0] if start is None else start)
    commands, running, pending = [command], {}, dict(shifts or {})
    for k in range(round(duration / controller.period_s)):
        t = (k + 1) * controller.period_s
        for at in [at for at in pending if at <= t]:
            for link, goal in pending.pop(at).items():
                running[link] = running.get(link, Shift.zero()).towards(np.array(goal))
        running = {link: step_shift(shift, limits, controller.period_s) for link, shift in running.items()}
        command = controller.step(command, *move(robot, t), running)
        commands.append(command)
    return commands


def test_the_preset_has_the_numbers_of_table_1():
    rows = {
        "joint": (0.05, 2.0, 0.9),
        "pelvis": (0.05, 4.0, 0.9),
        "foot": (500.0, 4.0, 0.9),
        "hand": (50.0, 4.0, 0.9),
        "com": (5.0, 2.0, 0.9),
        "torso": (500.0, 2.0, 0.0),
    }
    for task, row in rows.items():
        gains = getattr(TABLE_I, task)
        assert (gains.weight, gains.kp, gains.kd) == row
    assert (TABLE_I.damping, TABLE_I.feed_forward) == (0.005, 0.0)
    for task in rows:
        assert getattr(PRESETS["follow"], task) == replace(getattr(TABLE_I, task), kd=0.0)


@settings(max_examples=6)
@given(seed=st.integers(0, 1000), feed=st.sampled_from([0.0, 1.0]))
def test_the_speeds_are_those_that_cvxpy_finds_for_equation_6(atlas, seed, feed):
    rng = np.random.default_rng(seed)
    gains = replace(TABLE_I, feed_forward=feed)
    controller = PoseController(atlas, gains, PERIOD, has_rate_limits=False)
    inside = np.clip(atlas.postures["stand"] + 0.05 * rng.normal(size=atlas.n), atlas.lower, atlas.upper)
    command = Command(inside, 0.2 * rng.normal(size=atlas.n), np.zeros(atlas.n, dtype=bool))
    q_d, qd_d = inside + 0.05 * rng.normal(size=atlas.n), 0.3 * rng.normal(size=atlas.n)
    shift = Shift(np.array([0.01, 0.0, -0.02]), np.array([0.03, 0.0, 0.01]), np.zeros(3))

    model = atlas.model
    now, goal = model.createData(), model.createData()
    for data, q in ((now, command.q), (goal, q_d)):
        pin.computeJointJacobians(model, data, q)
        pin.framesForwardKinematics(model, data, q)
        pin.jacobianCenterOfMass(model, data, q)
    x = cp.Variable(atlas.n)
    cost = gains.damping * cp.sum_squares(x[6:] - feed * qd_d[6:])
    e, de = q_d - command.q, qd_d - command.qd
    cost += 0.05 * cp.sum_squares(x[6:] - 2.0 * e[6:] - 0.9 * de[6:] - feed * qd_d[6:])
    axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    tasks = [("pelvis", slice(0, 3), gains.pelvis), ("utorso", slice(3, 6), gains.torso)]
    tasks += [(link, slice(0, 6), gains.foot) for link in ("l_foot", "r_foot")]
    tasks += [(link, slice(0, 6), gains.hand) for link in ("l_hand", "r_hand")]
    for link, rows, g in tasks:
        frame = model.getFrameId(link)
        J, Jd = (pin.getFrameJacobian(model, data, frame, axes)[rows] for data in (now, goal))
        turn = pin.log3(goal.oMf[frame].rotation @ now.oMf[frame].rotation.T)
        error = np.concatenate([goal.oMf[frame].translation - now.oMf[frame].translation, turn])[rows]
        speed = Jd @ qd_d
        if link == "r_hand":
            error[:3] += shift.offset
            speed[:3] += shift.speed
        cost += g.weight * cp.sum_squares(J @ x - g.kp * error - g.kd * (speed - J @ command.qd) - feed * speed)
    com, com_d = now.Jcom, goal.Jcom @ qd_d
    wanted = 2.0 * (goal.com[0] - now.com[0]) + 0.9 * (com_d - com @ command.qd) + feed * com_d
    cost += 5.0 * cp.sum_squares(com @ x - wanted)
    low, high = (atlas.lower[6:] - command.q[6:]) / PERIOD, (atlas.upper[6:] - command.q[6:]) / PERIOD
    cp.Problem(cp.Minimize(cost), [low <= x[6:], x[6:] <= high]).solve(
        solver=cp.CLARABEL, tol_gap_abs=1e-11, tol_gap_rel=1e-11, tol_feas=1e-11
    )
    after = controller.step(command, q_d, qd_d, {"r_hand": shift})
    np.testing.assert_allclose(after.qd, x.value, atol=2e-5)
    np.testing.assert_allclose(after.q, command.q + PERIOD * after.qd, atol=0.0)  # eq. 7


def test_following_with_the_speed_fed_forward_has_no_lag(atlas):
    commands = follow(PoseController(atlas, period_s=PERIOD), 2.0)
    errors = [np.abs(c.q - move(atlas, k * PERIOD)[0]).max() for k, c in enumerate(commands)]
    assert max(errors) < 2e-3


def test_equation_6_as_printed_follows_a_moving_joint_one_over_kp_late(atlas):
    joint = atlas.joint_names.index("neck_ry")
    controller = PoseController(atlas, TABLE_I, PERIOD)
    command, rate = Command.at_rest(atlas.postures["stand"]), 0.05
    desired, speeds = atlas.postures["stand"].copy(), np.zeros(atlas.n)
    speeds[joint] = rate
    for _ in range(2000):
        desired = desired + PERIOD * speeds
        command = controller.step(command, desired, speeds)
    # w (v - kp e - kd (r - v)) + w_d v = 0 with v = r: e = r (1 + w_d / w) / kp.
    assert desired[joint] - command.q[joint] == pytest.approx(rate * (1.0 + 0.005 / 0.05) / 2.0, rel=2e-2)


@pytest.mark.parametrize("link", ["l_foot", "r_hand"])
def test_a_contact_that_is_1_cm_off_is_reached_without_a_jump(atlas, link):
    goal = np.array([0.006, -0.006, 0.005])
    still = follow(PoseController(atlas, period_s=PERIOD), 3.0)
    commands = follow(PoseController(atlas, period_s=PERIOD), 3.0, {0.7: {link: goal}})
    reached = place(atlas, commands[-1].q, link).translation - place(atlas, still[-1].q, link).translation
    np.testing.assert_allclose(reached, goal, atol=5e-4)
    joints = slice(6, None)
    rates, gains = np.array([c.qd for c in commands]), np.diff([c.qd for c in commands], axis=0) / PERIOD
    assert np.all(np.abs(gains[:, joints]) <= atlas.acceleration[joints] + 1e-6)
    assert np.abs(rates[:, joints]).max() < 1.5
    # The base has no limits of its own: its command jumps no more than that of the plan without the shift.
    plain = np.diff([c.qd for c in still], axis=0)[:, :6] / PERIOD
    assert np.abs(gains[:, :6]).max() < np.abs(plain).max() + 4.0 * LIMITS.acceleration


def test_a_shift_while_the_earlier_one_runs_does_not_jump(atlas):
    shifts = {0.5: {"r_hand": [0.1, 0.0, 0.0]}, 0.8: {"r_hand": [-0.05, 0.0, 0.1]}, 1.0: {"l_hand": [0.0, 0.05, 0.0]}}
    commands = follow(PoseController(atlas, period_s=PERIOD), 5.0, shifts)
    still = follow(PoseController(atlas, period_s=PERIOD), 5.0)
    reached = place(atlas, commands[-1].q, "r_hand").translation - place(atlas, still[-1].q, "r_hand").translation
    np.testing.assert_allclose(reached, [-0.05, 0.0, 0.1], atol=5e-3)
    gains = np.diff([c.qd for c in commands], axis=0)[:, 6:] / PERIOD
    assert np.all(np.abs(gains) <= atlas.acceleration[6:] + 1e-6)


def test_a_jump_of_the_plan_itself_is_smoothed_to_the_limits(atlas):
    controller = PoseController(atlas, period_s=PERIOD)
    command = Command.at_rest(atlas.postures["stand"])
    end = atlas.postures["reach_ready"]
    rates = []
    for _ in range(500):
        command = controller.step(command, end, np.zeros(atlas.n))
        rates.append(command.qd)
    gains = np.diff(rates, axis=0)[:, 6:] / PERIOD
    assert np.all(np.abs(gains) <= atlas.acceleration[6:] + 1e-6)
    assert np.all(np.abs(rates)[:, 6:] <= atlas.velocity[6:])


def test_joint_limits_hold_for_a_target_beyond_them(atlas):
    beyond = atlas.postures["stand"].copy()
    beyond[6:] = atlas.upper[6:] + 0.3
    for has_rate_limits in (True, False):
        controller = PoseController(atlas, period_s=PERIOD, has_rate_limits=has_rate_limits)
        command = Command.at_rest(atlas.postures["stand"])
        for _ in range(700):
            command = controller.step(command, beyond, np.zeros(atlas.n))
            assert np.all(command.q <= atlas.upper + 1e-9)
            assert np.all(command.q >= atlas.lower - 1e-9)
        assert command.is_bound[6:].any()


def test_with_rate_limits_a_joint_brakes_before_its_limit(atlas):
    joint = atlas.joint_names.index("neck_ry")
    controller = PoseController(atlas, period_s=PERIOD)
    beyond = atlas.postures["stand"].copy()
    beyond[joint] = atlas.upper[joint] + 2.0
    command, rates = Command.at_rest(atlas.postures["stand"]), [0.0]
    for _ in range(700):
        command = controller.step(command, beyond, np.zeros(atlas.n))
        rates.append(command.qd[joint])
    assert max(rates) > 1.0
    assert np.abs(np.diff(rates)).max() <= atlas.acceleration[joint] * PERIOD * (1.0 + 1e-6)
    assert command.q[joint] == pytest.approx(atlas.upper[joint], abs=1e-3)


def test_a_start_outside_its_limits_is_brought_back(atlas):
    start = atlas.postures["stand"].copy()
    joint = atlas.joint_names.index("neck_ry")
    start[joint] = atlas.upper[joint] + 0.05
    controller, command = PoseController(atlas, period_s=PERIOD), Command.at_rest(start)
    for _ in range(2000):
        command = controller.step(command, atlas.postures["stand"], np.zeros(atlas.n))
    assert command.q[joint] <= atlas.upper[joint]


def test_a_shift_keeps_its_bounds_and_does_not_overshoot():
    shift, speeds = Shift.zero().towards(np.array([0.2, 0.0, 0.0])), [np.zeros(3)]
    for _ in range(1250):
        shift = step_shift(shift, LIMITS, PERIOD)
        speeds.append(shift.speed)
        assert shift.offset[0] <= 0.2 + 1e-6
    assert shift.is_at_goal
    assert np.linalg.norm(speeds, axis=1).max() <= LIMITS.speed + 1e-12
    assert np.linalg.norm(np.diff(speeds, axis=0), axis=1).max() <= LIMITS.acceleration * PERIOD + 1e-12


@pytest.mark.parametrize(
    ("goal", "message"),
    [([0.0, 0.0], "three finite numbers"), ([np.nan, 0, 0], "three finite numbers"), ([1.0, 0.0, 0.0], "1 m long")],
)
def test_a_shift_that_makes_no_sense_is_refused(goal, message):
    assert LARGEST_SHIFT_M < 1.0
    with pytest.raises(ExecutionError, match=message):
        Shift.zero().towards(np.array(goal))


def test_an_unknown_link_of_a_shift_is_refused_with_the_known_ones(atlas):
    with pytest.raises(ExecutionError, match="l_foot"):
        PoseController(atlas, period_s=PERIOD).check_link("l_fot")


def test_a_configuration_that_is_not_finite_is_refused(atlas):
    controller, q = PoseController(atlas, period_s=PERIOD), atlas.postures["stand"].copy()
    q[8] = np.nan
    with pytest.raises(ExecutionError, match="no solution"):
        controller.step(Command.at_rest(atlas.postures["stand"]), q, np.zeros(atlas.n))


@pytest.mark.parametrize("kwargs", [{"kd": 1.0}, {"kp": -1.0}, {"weight": -0.1}])
def test_gains_that_make_no_sense_are_refused(kwargs):
    with pytest.raises(ExecutionError, match="expected"):
        TaskGains(**{"weight": 1.0, "kp": 1.0, "kd": 0.5, **kwargs})


def test_a_damping_of_zero_is_refused():
    with pytest.raises(ExecutionError, match="positive damping"):
        PoseGains(*[TaskGains(1.0, 1.0, 0.0)] * 6, damping=0.0)
