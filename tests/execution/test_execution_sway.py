"""Hands of a robot that something else balances stay at their places in the world while its base sways in physics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from service import parse_request, plan
from service.demands.resistance import MechanismPhysics
from service.errors import ExecutionError, RequestError
from service.execution.driver import RobotReading
from service.execution.execution import Execution
from service.execution.guards import Severity
from service.execution.hands.swaying import SwayCorrection
from service.execution.reference import PlannedReference
from service.request.schema import PlanRequest
from service.result.result import PlanResult
from service.setup.prepare import prepare
from service.simulation.model import build_physics
from service.simulation.options import SimulationOptions
from service.simulation.robot import SimulatedRobot
from service.start.robot import load_requested_robot
from service.verify import Sway

SWAY, TOOL = Sway(0.03, 2.0), "l_tool"
CYCLE = 4  # steps of the physics per command
SWING_S = 3.0  # of the base, to and fro


def _request(**robot: object) -> PlanRequest:
    pose = {"link": TOOL, "position": [0.55, 0.3, 0.15]}
    options = {"sway_m": SWAY.distance_m, "sway_deg": SWAY.angle_deg}
    return parse_request(
        {"robot": {"name": "atlas", "root": "fixed", **robot}, "goal": {"poses": [pose]}, "options": options}
    )


@pytest.fixture(scope="module")
def result() -> PlanResult:
    """A reach of the left hand, with the legs locked as Atlas stands."""
    robot = load_requested_robot(_request())
    q = robot.postures["stand"]
    locked = {name: float(q[k]) for k, name in enumerate(robot.joint_names) if "_leg_" in name}
    return plan(_request(locked=locked))


def _swing(time_s: float) -> np.ndarray:
    """Return the pose of the base, which comes to both limits of its sway."""
    share = np.sin(2.0 * np.pi * time_s / SWING_S)
    turn = np.deg2rad(0.95 * SWAY.angle_deg) * share * np.array([0.0, 1.0, 0.0])
    return np.array(pin.SE3(pin.exp3(turn), 0.95 * SWAY.distance_m * share * np.array([0.6, 0.8, 0.0])).homogeneous)


class _Swaying(SimulatedRobot):
    """A robot whose base swings; it measures where the base is, or does not."""

    tells = True

    def command(self, command: object) -> None:
        self.sway(_swing(self.time_s))
        super().command(command)

    def read(self) -> RobotReading:
        reading = super().read()
        return reading if self.tells else replace(reading, base_offset=None)


def _track(result: PlanResult, last_s: float, *, tells: bool) -> tuple[float, Execution]:
    """Return how far the tool was beside its place at most, at the end of the plan, in a swing of some seconds [m]."""
    assert result.motion is not None
    reference = PlannedReference(result.motion)
    model = build_physics(result.motion, MechanismPhysics({}), SimulationOptions())
    begin_s = reference.duration_s - 0.1
    robot = _Swaying(model, reference.at(begin_s).configuration, steps=CYCLE)
    robot.tells = tells
    execution = Execution(reference, robot, begin_s=begin_s)
    data, frame = result.motion.robot.model.createData(), result.motion.robot.model.getFrameId(TOOL)

    def place(q: np.ndarray) -> pin.SE3:
        pin.forwardKinematics(result.motion.robot.model, data, q)
        return pin.updateFramePlacement(result.motion.robot.model, data, frame).copy()

    wanted, worst = place(reference.at(reference.duration_s).configuration), 0.0
    while robot.time_s < last_s:
        execution.step()
        if robot.time_s > 0.3:
            now = pin.SE3(robot.pose_world_base) * place(robot.configuration())
            worst = max(worst, float(np.linalg.norm(now.translation - wanted.translation)))
    return worst, execution


def test_a_hand_stays_at_its_place_while_the_base_sways(result: PlanResult) -> None:
    assert result.verdict.value == "CERTIFIED"
    corrected, execution = _track(result, SWING_S, tells=True)
    assert corrected < 0.006
    watched = [one.watched_by for one in execution.watch.list_assumptions() if "keeps its base" in one.sentence]
    assert watched == ["measured pose of the base"]
    assert _track(result, 0.3 * SWING_S, tells=False)[0] > 0.025


def test_a_base_beyond_its_sway_is_found_and_the_robot_holds(result: PlanResult) -> None:
    motion = result.motion
    assert motion is not None
    correction = SwayCorrection(motion, 0.004)
    reading = RobotReading(0.0, np.zeros(0), np.zeros(0), np.eye(3), np.zeros(3), np.zeros(3), {}, np.zeros(0))
    assert correction.judge(reading) == ()
    far = np.eye(4)
    far[0, 3] = 0.04
    (finding,) = correction.judge(replace(reading, base_offset=far))
    assert (finding.severity, finding.name) == (Severity.HOLD, "sway")
    assert finding.sentence == "the base is 40 mm and 0.0 deg off its place; the plan holds within 30 mm and 2 deg"


def test_legs_that_are_not_locked_are_refused_with_sway() -> None:
    with pytest.raises(RequestError, match=r"options.sway_m: 0.03, and l_leg_hpz and 11 others move the legs"):
        prepare(_request())


def test_a_base_whose_pose_is_none_is_refused(result: PlanResult) -> None:
    assert result.motion is not None
    reference = PlannedReference(result.motion)
    model = build_physics(result.motion, MechanismPhysics({}), SimulationOptions())
    robot = SimulatedRobot(model, reference.at(0.0).configuration, steps=CYCLE)
    robot.data.mocap_pos[0] = np.nan
    with pytest.raises(ExecutionError, match="base_offset is no 4 x 4 pose"):
        Execution(reference, robot)
