"""Pelvis estimator against a motion whose truth is known: squats on both feet, with noisy sensors."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest

from costs.robot import load_robot
from service.errors import ExecutionError
from service.execution.driver import RobotReading
from service.execution.sensing.estimator import PELVIS, PelvisEstimator, SensorNoise, find_toe

PERIOD = 1e-2
ROUND_S = 14.0  # after which the motion repeats
WEIGHT = 158.56 * 9.81
LEGS = (("hpy", -1.0), ("kny", 2.0), ("aky", -1.0))  # knees bend, the soles stay level


@pytest.fixture(scope="module")
def atlas():
    return load_robot("atlas")


class Squat:
    """Atlas bends both knees alike and leans about the axis through its toes, which stay where they are."""

    def __init__(self, robot, seed=0):
        self.robot, self.random = robot, np.random.default_rng(seed)
        self.names = robot.joint_names[6:]
        self.data = robot.model.createData()
        self.toe = find_toe(robot, "l_foot")
        self.anchor = None
        self.anchor = self.truth(0.0)[0]["toe"]

    def truth(self, t):
        """Return places of pelvis and toe, rotation, and joints at a time."""
        q = self.robot.postures["stand"].copy()
        bend = 0.12 * (1.0 - np.cos(4.0 * np.pi * t / ROUND_S))
        for side in "lr":
            for joint, sign in LEGS:
                q[self.robot.joint_names.index(f"{side}_leg_{joint}")] += sign * bend
        rotation = pin.rpy.rpyToMatrix(0.0, 0.03 * np.sin(6.0 * np.pi * t / ROUND_S), 0.0)
        q[:6] = 0.0
        pin.framesForwardKinematics(self.robot.model, self.data, q)
        place = self.data.oMf[self.robot.model.getFrameId("l_foot")]
        offset = rotation @ place.act(self.toe.place)
        pelvis = np.array([0.0, 0.0, 0.9]) if self.anchor is None else self.anchor - offset
        return {"pelvis": pelvis, "toe": pelvis + offset}, rotation, q[6:]

    def read(self, t, noise=1.0, bias=0.0, left=0.5):
        """Return noisy sensors at a time; ``left`` is the left foot's share of the weight, None for none."""
        h, draw = 1e-3, self.random.standard_normal
        (before, _, q0), (now, rotation, q), (after, turned, q1) = (self.truth(t + k * h) for k in (-1, 0, 1))
        acceleration = (after["pelvis"] - 2.0 * now["pelvis"] + before["pelvis"]) / h**2
        upward = np.array([0.0, 0.0, 9.81])
        shares = {"l_foot": 0.0, "r_foot": 0.0} if left is None else {"l_foot": left, "r_foot": 1.0 - left}
        return RobotReading(
            time_s=t,
            q=q + noise * 1e-4 * draw(len(q)),
            qd=(q1 - q0) / (2.0 * h) + noise * 1e-2 * draw(len(q)),
            imu_rotation=rotation,
            imu_angular_velocity=pin.log3(rotation.T @ turned) / h + noise * 2e-3 * draw(3),
            imu_acceleration=rotation.T @ (acceleration + upward) + bias + noise * 0.05 * draw(3),
            foot_wrenches={
                foot: np.array([0, 0, WEIGHT * share + noise * 5.0 * draw(), 0, 0, 0]) for foot, share in shares.items()
            },
            torque=np.zeros(len(q)),
        )


def follow(squat, duration, load=lambda t: 0.5, **noise):
    """Return times, errors of position and speed, and the references of a run."""
    estimator = PelvisEstimator(squat.robot, squat.names, PERIOD)
    estimate = estimator.start(squat.read(0.0, **noise), squat.truth(0.0)[0]["pelvis"])
    errors, speeds, references = [], [], []
    for k in range(1, round(duration / PERIOD)):
        t = k * PERIOD
        estimate = estimator.step(estimate, squat.read(t, left=load(t), **noise))
        errors.append(estimate.position - squat.truth(t)[0]["pelvis"])
        ahead, behind = (squat.truth(t + h)[0]["pelvis"] for h in (1e-3, -1e-3))
        speeds.append(estimate.speed - (ahead - behind) / 2e-3)
        references.append(estimate.reference)
    return np.array(errors), np.array(speeds), references


def test_without_noise_the_estimate_is_the_truth(atlas):
    errors, speeds, _ = follow(Squat(atlas), 4.0, noise=0.0)
    assert np.abs(errors).max() < 1e-3
    assert np.abs(speeds[20:]).max() < 2e-3  # it starts at rest, the robot does not


def test_over_five_minutes_the_drift_is_bounded_while_both_toes_take_turns(atlas):
    squat = Squat(atlas, 1)
    estimator = PelvisEstimator(atlas, squat.names, PERIOD)
    estimate = estimator.start(squat.read(0.0), squat.truth(0.0)[0]["pelvis"])
    errors, references = [], []
    times = np.arange(round(ROUND_S / PERIOD)) * PERIOD
    readings = [squat.read(t, left=0.5 + 0.4 * np.sin(4.0 * np.pi * t / ROUND_S), bias=0.02) for t in times]
    truths = [squat.truth(t)[0]["pelvis"] for t in times]
    for k in range(1, round(300.0 / PERIOD)):
        reading = readings[k % len(times)]
        estimate = estimator.step(estimate, reading)
        if k % 20 == 0:
            errors.append(estimate.position - truths[k % len(times)])
            references.append(estimate.reference)
    norms = np.linalg.norm(errors, axis=1)
    assert {"l_foot", "r_foot"} == set(references)
    assert norms.max() < 5e-3
    late, early = norms[-len(norms) // 10 :].mean(), norms[: len(norms) // 10].mean()
    assert late < early + 1e-3


def test_the_toe_with_the_larger_force_counts_and_below_half_of_the_weight_the_pelvis(atlas):
    squat = Squat(atlas)
    estimator = PelvisEstimator(atlas, squat.names, PERIOD)
    base = squat.read(0.0, noise=0.0)

    def choose(left, right):
        wrenches = {"l_foot": np.array([0, 0, left, 0, 0, 0.0]), "r_foot": np.array([0, 0, right, 0, 0, 0.0])}
        return estimator.choose_reference(replace(base, foot_wrenches=wrenches))

    assert choose(0.6 * WEIGHT, 0.4 * WEIGHT) == "l_foot"
    assert choose(0.2 * WEIGHT, 0.31 * WEIGHT) == "r_foot"
    assert choose(0.3 * WEIGHT, 0.19 * WEIGHT) == PELVIS
    assert choose(0.0, 0.0) == PELVIS


def test_the_orientation_is_that_of_the_imu(atlas):
    squat = Squat(atlas)
    estimator = PelvisEstimator(atlas, squat.names, PERIOD)
    estimate = estimator.start(squat.read(0.0), np.zeros(3))
    reading = squat.read(1.0)
    np.testing.assert_array_equal(estimator.step(estimate, reading).rotation, reading.imu_rotation)


def test_a_change_of_the_reference_does_not_move_the_estimate(atlas):
    squat = Squat(atlas, 2)
    errors, _, references = follow(squat, 6.0, load=lambda t: 0.8 if int(t) % 2 else 0.2)
    assert len(set(references)) == 2
    changes = np.flatnonzero([a != b for a, b in pairwise(references)])
    steps = np.linalg.norm(np.diff(errors, axis=0), axis=1)
    assert steps[changes].max() < 3.0 * np.percentile(steps, 99)


def test_a_pelvis_that_rests_on_a_seat_stays_where_it_is(atlas):
    squat = Squat(atlas, 3)
    squat.truth = lambda t, still=squat.truth: still(0.0)
    errors, speeds, references = follow(squat, 5.0, load=lambda t: None, bias=0.05)
    assert set(references) == {PELVIS}
    assert np.abs(errors).max() < 2e-3
    assert np.abs(speeds).max() < 2e-2


def test_a_foot_that_was_just_put_down_is_not_yet_at_rest(atlas):
    squat = Squat(atlas, 4)
    estimator = PelvisEstimator(atlas, squat.names, PERIOD, SensorNoise())
    estimate = estimator.start(squat.read(0.0, noise=0.0, left=1.0), squat.truth(0.0)[0]["pelvis"])
    assert set(estimate.anchors) == {"l_foot"}
    first = estimator.step(estimate, squat.read(0.0, noise=0.0, left=0.8))
    moved = squat.read(0.0, noise=0.0, left=0.8)
    moved.q[list(squat.names).index("r_leg_aky")] -= 0.1  # the foot comes flat
    second = estimator.step(first, moved)
    assert np.linalg.norm(second.anchors["r_foot"] - first.anchors["r_foot"]) > 5e-3
    np.testing.assert_array_equal(second.anchors["l_foot"], first.anchors["l_foot"])


def test_the_toe_is_at_the_front_of_the_sole(atlas):
    toe = find_toe(atlas, "l_foot")
    bare = find_toe(replace(atlas, contacts={}), "l_foot")
    assert toe.place[0] > 0.05
    assert bare.place[0] > 0.05
    assert abs(toe.place[2] - bare.place[2]) < 0.01


def test_a_robot_without_feet_is_refused(atlas):
    with pytest.raises(ExecutionError, match="two feet"):
        PelvisEstimator(replace(atlas, link_groups={}), atlas.joint_names[6:], PERIOD)


def test_an_unknown_joint_is_refused(atlas):
    with pytest.raises(ExecutionError, match="no joint 'tail'"):
        PelvisEstimator(atlas, ("tail",), PERIOD)
