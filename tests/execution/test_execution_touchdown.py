"""Soft touchdown of a foot: toe up, ankle without torque, and the foot where the ground is."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from costs.robot import load_robot
from service.errors import ExecutionError
from service.execution.driver import JointCommand, RobotReading
from service.execution.reference import ReferencePhase
from service.execution.stance.touchdown import (
    FootReading,
    Stage,
    TouchdownSettings,
    TouchdownState,
    find_ankle,
    find_landing,
    soften,
    step_touchdown,
)
from service.verify import PlantedContact

PERIOD = 2e-3
SETTINGS = TouchdownSettings()
AIR = FootReading(0.0, 0.0, 0.0, np.zeros(2))


@pytest.fixture(scope="module")
def atlas():
    return load_robot("atlas")


@pytest.fixture(scope="module")
def ankle(atlas):
    return find_ankle(atlas, atlas.joint_names[6:], "r_foot")


def run(ankle, foot, seconds=1.0, *, state=None, lands=True, planted=False, balances=False, left=lambda t: 1.0):
    """Step with what ``foot(t, state)`` reads and the time left(t) to the planned touch; return all states."""
    states = [state or TouchdownState.stiff()]
    for k in range(round(seconds / PERIOD)):
        t = k * PERIOD
        reading = foot(t, states[-1]) if callable(foot) else foot
        states.append(
            step_touchdown(
                SETTINGS,
                states[-1],
                ankle,
                reading,
                lands=lands,
                planted=planted,
                balances=balances,
                left_s=left(t),
                period_s=PERIOD,
            )
        )
    return states


@pytest.mark.parametrize("foot", ["l_foot", "r_foot"])
def test_the_ankle_turns_the_toe_up_by_the_angle(atlas, foot):
    ankle = find_ankle(atlas, atlas.joint_names[6:], foot)
    q, data = atlas.postures["stand"].copy(), atlas.model.createData()
    frame = atlas.model.getFrameId(foot)
    pin.framesForwardKinematics(atlas.model, data, q)
    flat = data.oMf[frame].rotation.copy()
    q[6 + ankle.joints] += 0.1 * ankle.toe_up
    pin.framesForwardKinematics(atlas.model, data, q)
    turn = pin.log3(flat.T @ data.oMf[frame].rotation)
    np.testing.assert_allclose(turn, [0.0, -0.1, 0.0], atol=5e-3)
    toe = data.oMf[frame].act(np.array([0.15, 0.0, -0.07]))
    heel = data.oMf[frame].act(np.array([-0.08, 0.0, -0.07]))
    assert toe[2] > heel[2] + 0.02


def test_a_foot_tilts_smoothly_on_its_way_down(ankle):
    states = run(ankle, AIR, 0.6)
    tilts = np.array([state.tilt for state in states])
    assert tilts[-1] == SETTINGS.tilt_rad
    assert np.diff(tilts).max() <= SETTINGS.tilt_rate * PERIOD + 1e-12
    np.testing.assert_allclose(states[-1].offset, SETTINGS.tilt_rad * ankle.toe_up)
    assert {state.stage for state in states[1:]} == {Stage.TILTED}


def test_a_foot_in_the_air_that_meets_something_goes_up_until_it_is_clear_and_comes_back(ankle):
    edge = 0.008  # above the plan's path, between 0.2 and 0.6 s

    def read(t, state):
        depth = edge - float(state.height.offset[2]) if 0.2 <= t < 0.6 else 0.0
        return FootReading(max(2e4 * depth, 0.0), 0.0, 0.0, np.zeros(2))

    states = run(ankle, read, 2.0, lands=False)
    heights = np.array([state.height.offset[2] for state in states])
    passed = round(0.55 / PERIOD)
    assert 2e4 * (edge - heights[passed]) < 2.0 * SETTINGS.touch_n
    assert heights[: round(0.2 / PERIOD)].max() == 0.0
    assert heights[-1] == pytest.approx(0.0, abs=1e-4)


def test_a_foot_that_has_not_left_the_ground_yet_is_not_raised(ankle):
    states = run(ankle, FootReading(200.0, 0.0, 0.0, np.zeros(2)), 0.5, lands=False)
    assert states[-1].height.offset[2] == 0.0
    assert not states[-1].is_clear


@pytest.mark.parametrize("foot", ["l_foot", "r_foot"])
def test_the_heel_of_a_tilted_foot_comes_down_to_where_the_plan_has_its_sole(atlas, foot):
    ankle = find_ankle(atlas, atlas.joint_names[6:], foot)
    raised = run(ankle, AIR, 0.6)[-1].height.offset[2]
    assert raised > 2e-3
    model, data = atlas.model, atlas.model.createData()
    frame, lowest = model.frames[model.getFrameId(foot)], []
    for tilt in (0.0, SETTINGS.tilt_rad):
        q = atlas.postures["stand"].copy()
        q[6 + ankle.joints] += tilt * ankle.toe_up
        pin.forwardKinematics(model, data, q)
        place = data.oMi[frame.parentJoint]
        bodies = [body.vertices for body in atlas.bodies if body.link == foot]
        lowest.append(min((place.rotation @ part.T)[2].min() + place.translation[2] for part in bodies))
    assert lowest[1] + raised == pytest.approx(lowest[0], abs=3e-4)


def test_the_ankle_is_free_shortly_before_the_planned_touch(ankle):
    states = run(ankle, AIR, 0.6, left=lambda t: 0.6 - t)
    free = next(k for k, state in enumerate(states) if state.stage is Stage.FREE)
    assert 0.6 - (free - 1) * PERIOD == pytest.approx(SETTINGS.free_s, abs=2 * PERIOD)
    assert states[-1].softness == 1.0
    assert not states[-1].has_touched


def meet_ground(height, stiffness=1e5):
    """Return what a foot reads over ground at a height over the plan's [m], once it has come down to its place."""

    def read(t, state):
        depth = height - float(state.height.offset[2]) if t > 0.3 else 0.0
        return FootReading(max(stiffness * depth, 0.0), 0.0, 0.01, np.zeros(2))

    return read


@pytest.mark.parametrize("height", [0.004, 0.012])  # the tilted foot is held 2.6 mm up
def test_an_early_touch_frees_the_ankle_and_the_foot_presses_lightly_on_the_ground(ankle, height):
    states = run(ankle, meet_ground(height), 1.0)
    touched = next(k for k, state in enumerate(states) if state.has_touched)
    assert touched * PERIOD == pytest.approx(0.3 + SETTINGS.touch_s, abs=3 * PERIOD)
    assert states[-1].height.offset[2] == pytest.approx(height - SETTINGS.press_n / 1e5, abs=2e-4)
    heights = np.array([state.height.offset[2] for state in states])
    speeds = np.diff(heights) / PERIOD
    assert np.abs(speeds).max() <= SETTINGS.limits.speed + 1e-9
    assert np.abs(np.diff(speeds)).max() <= SETTINGS.limits.acceleration * PERIOD + 1e-9


def test_a_foot_that_has_touched_does_not_follow_the_plan_further_down(ankle):
    pressed = FootReading(SETTINGS.press_n, -0.1, 0.01, np.zeros(2))
    left = 0.5 * SETTINGS.free_s
    states = run(ankle, pressed, left, left=lambda t: left - t)
    touched = next(k for k, state in enumerate(states) if state.has_touched)
    seconds = (len(states) - 1 - touched) * PERIOD
    assert states[-1].height.offset[2] == pytest.approx(0.1 * seconds, rel=0.1)


def test_a_foot_that_loses_the_ground_after_the_planned_touch_goes_slowly_on_down(ankle):
    flat = FootReading(80.0, 0.0, 0.0, np.zeros(2))
    states = run(ankle, lambda t, state: flat if t < 0.2 else AIR, 0.6, left=lambda t: -t)
    assert states[-1].has_touched
    lost = next(state for state, k in zip(states, range(len(states)), strict=True) if k * PERIOD >= 0.2)
    down = float(states[-1].height.offset[2] - lost.height.offset[2])
    assert down == pytest.approx(-0.4 * SETTINGS.press_speed, rel=0.05)


def test_a_foot_without_ground_looks_for_it_below_and_stops_there(ankle):
    ground = -0.011

    def foot(t, state):
        return FootReading(80.0 if state.height.offset[2] <= ground else 0.0, 0.0, 0.0, np.zeros(2))

    states = run(ankle, foot, 2.0, left=lambda t: 0.3 - t)
    assert states[-1].has_touched
    assert states[-1].height.offset[2] == pytest.approx(ground, abs=1.5e-3)
    speeds = np.diff([state.height.offset[2] for state in states]) / PERIOD
    assert speeds.min() >= -SETTINGS.probe_speed - 1e-9


def test_a_foot_looks_no_further_than_it_may(ankle):
    states = run(ankle, AIR, 4.0, left=lambda t: 0.1 - t)
    assert states[-1].height.offset[2] == pytest.approx(-SETTINGS.probe_m, abs=2e-4)
    assert not states[-1].has_touched


def test_a_short_knock_is_no_touch(ankle):
    knock = FootReading(200.0, 0.0, 0.0, np.zeros(2))
    states = run(ankle, lambda t, state: knock if abs(t - 0.3) < 1e-9 else AIR, 0.5)
    assert not any(state.has_touched for state in states)


def test_a_planted_foot_comes_flat_and_then_its_ankle_becomes_stiff_gradually(ankle):
    flat = FootReading(400.0, 0.0, 0.005, np.array([0.0, 0.02]))
    landed = run(ankle, flat, 0.3, left=lambda t: -t)[-1]
    states = run(ankle, flat, 1.0, state=landed, lands=False, planted=True, left=lambda t: 0.0)
    assert states[-1].stage is Stage.SETTLED
    softness = np.array([state.softness for state in states])
    assert softness[0] == 1.0
    assert softness[-1] == 0.0
    assert np.abs(np.diff(softness)).max() <= PERIOD / SETTINGS.settle_s + 1e-12
    np.testing.assert_allclose(states[-1].offset, 0.0, atol=1e-12)


def test_on_a_slope_the_ankle_stays_adapted_until_the_foot_is_lifted(ankle):
    slope = FootReading(400.0, 0.0, 0.06, np.array([0.0, 0.06]))
    landed = run(ankle, slope, 0.3, left=lambda t: -t)[-1]
    standing = run(ankle, slope, 1.0, state=landed, lands=False, planted=True, left=lambda t: 0.0)[-1]
    np.testing.assert_array_equal(standing.offset, [0.0, 0.06])
    assert standing.softness == 0.0
    lifted = run(ankle, AIR, 1.0, state=standing, lands=False)
    offsets = np.array([state.offset for state in lifted])
    np.testing.assert_allclose(offsets[-1], 0.0, atol=1e-12)
    assert np.abs(np.diff(offsets, axis=0)).max() <= SETTINGS.tilt_rate * PERIOD + 1e-12


def test_a_foot_that_stands_from_the_start_is_never_softened(ankle):
    states = run(ankle, FootReading(700.0, 0.0, 0.0, np.zeros(2)), 0.5, lands=False, planted=True, left=lambda t: 0.0)
    assert {state.stage for state in states} == {Stage.STIFF}
    assert {state.softness for state in states} == {0.0}


def test_the_ankle_of_a_planted_foot_gives_way_to_the_balance_gradually_and_becomes_stiff_after_it(ankle):
    reading = FootReading(700.0, 0.0, 0.0, np.array([0.0, 0.02]))
    states = run(ankle, reading, 0.5, lands=False, planted=True, balances=True)
    softness = np.array([state.softness for state in states])
    assert states[-1].stage is Stage.BALANCING
    assert softness[-1] == 1.0
    assert np.diff(softness).max() <= PERIOD / SETTINGS.settle_s + 1e-12
    after = run(ankle, reading, 0.5, state=states[-1], lands=False, planted=True)
    assert after[-1].softness == 0.0
    np.testing.assert_allclose(after[-1].offset, 0.0, atol=1e-12)
    lifted = run(ankle, AIR, 0.5, state=states[-1], lands=False)
    offsets = np.array([state.offset for state in lifted])
    np.testing.assert_allclose(offsets[-1], 0.0, atol=1e-12)
    assert np.abs(np.diff(offsets, axis=0)).max() <= SETTINGS.tilt_rate * PERIOD + 1e-12


def test_a_foot_that_comes_down_keeps_no_balance_before_it_has_touched(ankle):
    falling = run(ankle, AIR, 0.3, left=lambda t: 0.2 - t)[-1]
    assert run(ankle, AIR, 0.1, state=falling, lands=False, planted=True, balances=True)[-1].stage is Stage.FREE
    flat = FootReading(400.0, 0.0, 0.0, np.zeros(2))
    standing = run(ankle, flat, 0.1, state=falling, lands=False, planted=True, balances=True)[-1]
    assert standing.stage is Stage.BALANCING
    assert standing.softness == 1.0


def test_a_free_ankle_is_commanded_where_it_is_with_its_torque_fed_back(ankle):
    n = 30
    command = JointCommand(np.full(n, 0.3), np.full(n, 0.1), np.full(n, 7.0))
    reading = RobotReading(
        0.0, np.full(n, 0.25), np.full(n, -0.2), np.eye(3), np.zeros(3), np.zeros(3), {}, np.full(n, 20.0)
    )
    free = replace(TouchdownState.stiff(), stage=Stage.FREE, softness=1.0)
    soft = soften(SETTINGS, ankle, free, command, reading)
    np.testing.assert_array_equal(soft.q[ankle.joints], 0.25)
    np.testing.assert_allclose(soft.qd[ankle.joints], 0.1 + (1.0 - SETTINGS.damping_share) * (-0.2 - 0.1))
    # In the air 7 N m carry the foot; from the touch on nothing is wanted.
    np.testing.assert_allclose(soft.tau[ankle.joints], 7.0 + SETTINGS.torque_gain * (7.0 - 20.0))
    touched = soften(SETTINGS, ankle, replace(free, has_touched=True), command, reading)
    turned = touched.qd[ankle.joints] - soft.qd[ankle.joints]  # the damping that is left turns the toe down
    np.testing.assert_allclose(turned, -SETTINGS.damping_share * SETTINGS.flat_rate * ankle.toe_up)
    late = soften(SETTINGS, ankle, replace(free, has_touched=True, since_s=1.0), command, reading)
    np.testing.assert_array_equal(late.qd, soft.qd)
    np.testing.assert_allclose(touched.tau[ankle.joints], -SETTINGS.torque_gain * 20.0)
    balancing = soften(SETTINGS, ankle, replace(free, stage=Stage.BALANCING), command, reading, np.array([5.0, -3.0]))
    np.testing.assert_array_equal(balancing.q[ankle.joints], 0.25)
    np.testing.assert_array_equal(balancing.tau[ankle.joints], [5.0, -3.0])
    others = np.setdiff1d(np.arange(n), ankle.joints)
    for name in ("q", "qd", "tau"):
        np.testing.assert_array_equal(getattr(soft, name)[others], getattr(command, name)[others])
    stiff = soften(SETTINGS, ankle, replace(free, softness=0.0, offset=np.array([0.0, 0.01])), command, reading)
    np.testing.assert_allclose(stiff.q[ankle.joints], [0.3, 0.31])
    np.testing.assert_array_equal(stiff.tau, command.tau)


def test_a_foot_in_the_air_lands_in_the_next_phase_that_plants_it():
    sole = np.zeros((4, 3))
    left, right = (PlantedContact(link, np.eye(4), sole) for link in ("l_foot", "r_foot"))
    stand = ReferencePhase("stand", 0, 1, (left, right), ())
    swing, land = replace(stand, name="swing", contacts=(left,)), replace(stand, name="land", contacts=(left,))
    after = replace(stand, name="after")
    phases = (stand, swing, land, after, swing)
    assert find_landing(phases, 1, "r_foot") is after
    assert find_landing(phases, 2, "r_foot") is after
    for index, foot in ((0, "r_foot"), (1, "l_foot"), (3, "r_foot"), (4, "r_foot")):
        assert find_landing(phases, index, foot) is None


def test_a_foot_without_an_ankle_is_refused(atlas):
    with pytest.raises(ExecutionError, match="no ankle of two joints"):
        find_ankle(atlas, atlas.joint_names[6:20], "r_foot")


@pytest.mark.parametrize("kwargs", [{"tilt_rad": 1.0}, {"torque_gain": 1.5}])
def test_settings_that_make_no_sense_are_refused(kwargs):
    with pytest.raises(ExecutionError, match="expected 0 to"):
        TouchdownSettings(**kwargs)
