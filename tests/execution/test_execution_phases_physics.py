"""The state machine in physics: paused, resumed and aborted in every phase of rising from a chair."""

from functools import cache

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="needs MuJoCo: pip install 'scopt[sim]'")
from shared_plans import write_example

from service.demands.kind import read_mechanism_physics
from service.execution.execution import Execution
from service.execution.machine import Mode, Order
from service.execution.reference import PlannedReference
from service.simulation.model import build_physics
from service.simulation.options import SimulationOptions
from service.simulation.robot import SimulatedRobot
from service.simulation.stand import read_recorded_request, stand_in_physics
from service.start.robot import resolve_stiffness

STEPS = 4  # of the physics per command
BEFORE_S = 0.5  # of a phase, when a run begins that is aborted in its middle
STANDS_M = 0.05  # of the pelvis from the plan


@cache
def read_plan():
    folder = write_example("chair")
    return PlannedReference.read(folder), read_recorded_request(folder)


def run_until(execution, is_there, most_s=12.0):
    for _ in range(round(most_s / execution.driver.period_s)):
        cycle = execution.step()
        if is_there(cycle):
            return cycle
    raise AssertionError(f"{execution.state.mode} at {execution.state.time_s:.2f} s: {execution.state.reason}")


def is_off(execution):
    robot, wanted = execution.driver, execution.reference.at(execution.state.time_s)
    return float(np.linalg.norm(robot.pose_world_base[:3, 3] - wanted.pose_world_base[:3, 3]))


def test_a_plan_is_paused_in_every_phase_and_ends_where_it_should():
    reference, request = read_plan()
    execution = Execution(reference, stand_in_physics(reference, request, SimulationOptions(), STEPS))
    for number, phase in enumerate(reference.phases):
        middle = 0.5 * (phase.begin_s + phase.end_s)
        run_until(execution, lambda cycle, at=middle: cycle.state.time_s >= at)
        execution.give(Order.PAUSE)
        run_until(execution, lambda cycle: execution.is_at_rest and cycle.state.mode is Mode.PAUSED)
        assert execution.state.phase in (number, number + 1)
        rests_at = execution.state.time_s
        run_until(execution, lambda cycle, until=execution.driver.time_s + 0.3: cycle.reading.time_s >= until)
        assert execution.state.time_s == rests_at
        assert is_off(execution) < STANDS_M
        execution.give(Order.RESUME)
    run_until(execution, lambda cycle: cycle.state.mode is Mode.DONE)
    assert is_off(execution) < STANDS_M


def test_a_plan_is_aborted_in_every_phase_and_the_robot_stays_up():
    reference, request = read_plan()
    options = SimulationOptions(hand_friction=request.options.hand_friction[0])
    stiffness = resolve_stiffness(reference.motion.robot, request)
    model = build_physics(reference.motion, read_mechanism_physics(request), options, stiffness)
    for phase in reference.phases:
        begin = max(phase.begin_s - BEFORE_S, 0.0)
        robot = SimulatedRobot(model, reference.at(begin).configuration, options, STEPS)
        execution = Execution(reference, robot, None, begin)
        middle = 0.5 * (phase.begin_s + phase.end_s)
        run_until(execution, lambda cycle, at=middle: cycle.state.time_s >= at)
        execution.give(Order.ABORT)
        run_until(execution, lambda cycle: cycle.state.mode is Mode.ABORTED)
        run_until(execution, lambda cycle, until=execution.driver.time_s + 0.5: cycle.reading.time_s >= until)
        assert execution.state.mode is Mode.ABORTED
        assert is_off(execution) < STANDS_M, phase.name
