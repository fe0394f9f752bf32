"""Forces along the timed curve: what the ground gives is what the base lacks, foot by foot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from costs.curve import Curve, TimeLaw
from costs.robot import RobotModel, load_robot
from costs.scene import Scene
from service.verify import Motion, Phase, PlantedContact
from service.verify.forces.dynamics import compute_forces, compute_inverse_dynamics, list_sample_times
from service.verify.timeline import find_time, find_times

FEET = ("l_foot", "r_foot")
TIMES = np.linspace(0.1, 1.9, 7)


@pytest.fixture(scope="module")
def atlas() -> RobotModel:
    return load_robot("atlas")


def _squat(robot: RobotModel, feet: tuple[str, ...]) -> Motion:
    """Arms and pelvis move (the feet with them: forces do not ask whether they stay)."""
    first = robot.postures["stand"]
    last = first + 0.2 * np.sin(np.arange(robot.n))
    tangents = np.zeros((2, robot.n))
    law = TimeLaw(np.array([0.0, 1.0, 2.0]), np.array([0.0, 0.5, 1.0]), np.array([0.0, 1.0, 0.0]))
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, first)
    sole = np.zeros((1, 3))
    contacts = [PlantedContact(foot, data.oMf[robot.model.getFrameId(foot)].homogeneous, sole) for foot in feet]
    phase = Phase("squat", 0.0, 1.0, contacts=tuple(contacts))
    return Motion(robot, Scene(), Curve(np.arange(2.0), np.stack([first, last]), tangents), law, (phase,))


@pytest.mark.parametrize("feet", [FEET, FEET[:1]])
def test_the_ground_carries_all_that_the_base_cannot(atlas: RobotModel, feet: tuple[str, ...]) -> None:
    motion = _squat(atlas, feet)
    assert motion.law is not None
    found = compute_forces(motion, motion.law, motion.phases[0], TIMES)
    weight = 9.81 * sum(inertia.mass for inertia in atlas.model.inertias)
    assert found.wrench[0, :, 2].mean() == pytest.approx(weight, rel=0.3)
    assert np.abs(found.torque[0, :, :6]).max() < 1e-8 * weight


def test_the_legs_carry_their_foot_s_share_and_the_arms_none(atlas: RobotModel) -> None:
    motion = _squat(atlas, FEET[:1])
    assert motion.law is not None
    standing = compute_forces(motion, motion.law, motion.phases[0], TIMES).torque[0]
    free = compute_forces(motion, motion.law, replace(motion.phases[0], contacts=()), TIMES).torque[0]
    names = np.array(atlas.joint_names)
    carries = np.array([name.startswith(("l_leg", "base")) for name in names])
    assert np.allclose(standing[:, ~carries], free[:, ~carries], rtol=0.0, atol=1e-12)
    # The same wrench handed to the inverse dynamics as an external force of the foot.
    model, data = atlas.model, atlas.model.createData()
    s, speed, gain = motion.law.at(TIMES)
    slope, bend = motion.curve(s, 1), motion.curve(s, 2)
    wrench = compute_forces(motion, motion.law, motion.phases[0], TIMES).wrench[0]
    joint = int(model.frames[model.getFrameId("l_foot")].parentJoint)
    for k, q in enumerate(motion.curve(s)):
        pin.forwardKinematics(model, data, q)
        external = pin.StdVec_Force([pin.Force.Zero() for _ in range(model.njoints)])
        external[joint] = data.oMi[joint].actInv(pin.Force(wrench[k]))
        expected = pin.rnea(model, data, q, slope[k] * speed[k], slope[k] * gain[k] + bend[k] * speed[k] ** 2, external)
        assert np.allclose(standing[k], expected, rtol=0.0, atol=1e-8)


def test_a_phase_that_stands_on_nothing_has_no_wrench(atlas: RobotModel) -> None:
    motion = _squat(atlas, ())
    assert motion.law is not None
    wrench = compute_forces(motion, motion.law, motion.phases[0], TIMES).wrench[0]
    assert wrench.shape == (len(TIMES), 6)
    assert np.all(np.isnan(wrench))


def test_times_of_path_parameters_are_those_of_the_law(atlas: RobotModel) -> None:
    law = TimeLaw(
        np.array([0.0, 0.5, 1.25, 2.0, 2.5]), np.array([0.0, 0.25, 1.0, 1.0, 1.5]), np.array([0.0, 1.0, 1.0, 0.0, 2.0])
    )
    law = replace(
        law, path=np.concatenate([[0.0], np.cumsum(0.5 * (law.speed[1:] + law.speed[:-1]) * np.diff(law.times))])
    )
    times = np.linspace(0.0, 2.5, 41)
    assert np.allclose(find_times(law, law.at(times)[0]), times, atol=1e-7)
    assert find_time(law, float(law.path[2])) == pytest.approx(1.25)
    assert find_time(None, 1.0) is None


def test_samples_lie_on_both_sides_of_every_jump(atlas: RobotModel) -> None:
    motion = _squat(atlas, FEET)
    assert motion.law is not None
    times = list_sample_times(motion, motion.law, 0.0, 1.0, 0.3)
    assert times[0] == 0.0
    assert times[-1] == 2.0
    assert np.diff(times).max() <= 0.3
    assert np.sum(np.abs(times - 1.0) < 2e-7) == 2


def test_forces_of_the_latest_states_are_kept_and_those_of_others_are_not(atlas: RobotModel) -> None:
    motion, rng = _squat(atlas, FEET), np.random.default_rng(3)
    q = np.tile(atlas.postures["stand"], (2, 1))
    v, a = rng.normal(size=(2, *q.shape))
    first = compute_inverse_dynamics(motion, q, v, a)
    assert compute_inverse_dynamics(motion, q.copy(), v.copy(), a.copy()) is first
    assert not first.torque.flags.writeable
    assert len(compute_inverse_dynamics(motion, q, v, a, has_jacobians=False).jacobians) == 0
    before = a.copy()
    a[1, 10] += 1e-9  # changed in place, as a caller might
    other = compute_inverse_dynamics(motion, q, v, a)
    data = atlas.model.createData()
    np.testing.assert_allclose(other.torque[1], pin.rnea(atlas.model, data, q[1], v[1], a[1]), rtol=1e-12)
    assert compute_inverse_dynamics(motion, q, v, before) is first, "the phases of a motion are timed in turn"
    another = replace(motion, robot=replace(atlas, model=atlas.model.copy()))
    assert compute_inverse_dynamics(another, q, v, a) is not other
