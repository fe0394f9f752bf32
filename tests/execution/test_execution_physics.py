"""Executions in physics: a foot that lands on other ground than planned, and an abort on one leg."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pinocchio as pin
import pytest

pytest.importorskip("mujoco", reason="needs MuJoCo: pip install 'scopt[sim]'")
from shared_plans import write_example

from service.demands.resistance import MechanismPhysics
from service.execution.execution import Execution
from service.execution.machine import Mode, Order
from service.execution.reference import PlannedReference
from service.execution.settings import ExecutionSettings
from service.execution.stance.capture_point import BalanceSettings
from service.simulation.model import build_physics
from service.simulation.options import SimulationOptions
from service.simulation.robot import SimulatedRobot

FOOT = "r_foot"
BEFORE_S = 0.4  # that the robot has stood on one leg when the phase begins in which the foot comes down
SECONDS = 1.8
STEPS = 2  # of the physics per command
LANDING_S = 0.3  # after the planned or the first touch, until which landings are compared


@pytest.fixture(scope="module")
def reference():
    return PlannedReference.read(write_example("steps"))


@dataclass
class Landing:
    """What physics showed of a foot.

    Largest upright force and last tilt until 0.3 s after the touch [N, rad], error of the estimated pelvis, height over
    the plan at the end [m], and the last mode.
    """

    peak_n: float
    tilt: float
    pelvis_off: float
    height: float
    mode: Mode


def uneven(reference, rise):
    """Return the plan's motion with the stone below the right foot's first landing raised [m], and that phase."""
    land = next(k for k, phase in enumerate(reference.phases) if phase.name.endswith("land"))
    contact = next(contact for contact in reference.phases[land + 1].contacts if contact.link == FOOT)
    middle = contact.points.mean(axis=0)
    pieces = []
    for piece in reference.motion.scene.pieces:
        low, high = piece.vertices.min(axis=0), piece.vertices.max(axis=0)
        if np.all(low[:2] < middle[:2]) and np.all(middle[:2] < high[:2]) and abs(high[2] - middle[2]) < 0.02:
            piece = replace(piece, vertices=piece.vertices + np.array([0.0, 0.0, rise]))
        pieces.append(piece)
    return replace(reference.motion, scene=replace(reference.motion.scene, pieces=tuple(pieces))), land


def stand(reference, motion, begin, settings=None, steps=STEPS):
    options = SimulationOptions()
    model = build_physics(motion, MechanismPhysics({}), options)
    robot = SimulatedRobot(model, reference.at(begin).configuration, options, steps)
    return Execution(reference, robot, settings, begin)


@cache
def land(reference, *, soft, rise):
    """Let the right foot land on the first stone, which is higher than planned by ``rise`` [m]."""
    motion, phase = uneven(reference, rise)
    settings = ExecutionSettings() if soft else ExecutionSettings(touchdown=None)
    steps = 1 if rise < 0.0 else STEPS  # a foot that drops is stopped within milliseconds
    execution = stand(reference, motion, reference.phases[phase].begin_s - BEFORE_S, settings, steps)
    robot, data = execution.driver, reference.robot.model.createData()
    frame = reference.robot.model.getFrameId(FOOT)
    forces, tilts, off, planned = [], [], 0.0, 0
    for k in range(round(SECONDS / robot.period_s)):
        cycle = execution.step()
        planned = k if cycle.state.time_s < reference.phases[phase].end_s else planned
        forces.append(robot.measure_contact_wrenches()[FOOT][2])
        if k % 5 == 0:
            pin.framesForwardKinematics(reference.robot.model, data, robot.configuration())
            off = max(off, float(np.linalg.norm(cycle.estimate.position - robot.pose_world_base[:3, 3])))
        tilts.append(float(np.arccos(np.clip(data.oMf[frame].rotation[2, 2], -1.0, 1.0))))
    height = float(data.oMf[frame].translation[2])
    pin.framesForwardKinematics(reference.robot.model, data, cycle.wanted.configuration)
    height -= float(data.oMf[frame].translation[2])
    touched = np.flatnonzero(np.array(forces) > 5.0)
    first = int(touched[0]) if len(touched) else len(forces) - 1
    last = min(max(first, planned) + round(LANDING_S / robot.period_s), len(forces))
    return Landing(max(forces[first:last]), tilts[last - 1], off, height, execution.state.mode)


def test_a_soft_landing_on_ground_that_is_a_centimetre_higher_has_less_force_and_tilt_than_a_stiff_one(reference):
    soft, stiff = (land(reference, soft=soft, rise=0.01) for soft in (True, False))
    assert soft.peak_n < 0.5 * stiff.peak_n
    assert soft.tilt < 0.5 * stiff.tilt
    assert soft.mode is Mode.RUNNING


def test_a_foot_finds_ground_that_is_a_centimetre_lower(reference):
    soft = land(reference, soft=True, rise=-0.01)
    assert soft.height == pytest.approx(-0.01, abs=2.5e-3)
    assert soft.peak_n < 400.0
    assert soft.mode is Mode.RUNNING


@pytest.mark.parametrize("rise", [0.01, -0.01])
def test_the_estimated_pelvis_is_the_true_one_while_the_robot_changes_feet(reference, rise):
    assert land(reference, soft=True, rise=rise).pelvis_off < 6e-3


def test_an_abort_on_one_leg_ends_standing_in_balance(reference):
    swing = next(phase for phase in reference.phases if phase.name.endswith("swing"))
    execution = stand(reference, reference.motion, swing.begin_s + 0.2)
    robot = execution.driver
    for k in range(round(1.2 / robot.period_s)):
        if k == round(0.15 / robot.period_s):
            execution.give(Order.ABORT)
        cycle = execution.step()
    assert execution.state.mode is Mode.ABORTED
    assert np.abs(cycle.reading.qd).max() < 0.05
    tilt = np.arccos(robot.pose_world_base[2, 2])
    assert abs(tilt - np.arccos(cycle.wanted.pose_world_base[2, 2])) < 0.05


def push(reference, settings, newton=160.0, seconds=0.3):
    """Push the pelvis of a robot on its left leg aside; return how far that foot rolls [rad], and the mode."""
    swing = next(phase for phase in reference.phases if phase.name.endswith("swing"))
    execution = stand(reference, reference.motion, swing.begin_s + 0.2, settings)
    execution.give(Order.PAUSE)
    robot, data = execution.driver, reference.robot.model.createData()
    pelvis, frame = robot.model.mj.body("link:pelvis").id, reference.robot.model.getFrameId("l_foot")
    tilt = 0.0
    for k in range(round(1.6 / robot.period_s)):
        robot.data.xfrc_applied[pelvis, 1] = newton if 0.5 <= k * robot.period_s < 0.5 + seconds else 0.0
        execution.step()
        if k % 5 == 0:
            pin.framesForwardKinematics(reference.robot.model, data, robot.configuration())
            tilt = max(tilt, float(np.arccos(np.clip(data.oMf[frame].rotation[2, 2], -1.0, 1.0))))
    return tilt, execution.state.mode


def test_a_push_on_one_leg_rolls_the_foot_of_a_stiff_robot_and_not_of_one_that_keeps_its_balance(reference):
    balanced, stiff = (push(reference, ExecutionSettings(balance=own)) for own in (BalanceSettings(), None))
    assert balanced == (pytest.approx(0.0, abs=3e-3), Mode.PAUSED)
    assert stiff[0] > 0.015
