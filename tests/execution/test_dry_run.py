"""Dry runs of drivers against a plan's start, and the driver of joint trajectories against a played controller."""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from small_plan import small_plan

from service.errors import ExecutionError, RequestError
from service.execution.driver import JointCommand, RobotReading
from service.execution.execution import Execution
from service.execution.reference import PlannedReference
from service.execution.tracking import KinematicRobot, track
from service.work.robot.dry import compare_readings
from service.work.robot.robot import open_robot
from service.work.robot.trajectory import STOP_S, TrajectoryDriver, make_goal

PERIOD = 0.01


@pytest.fixture(scope="module")
def reference() -> PlannedReference:
    return PlannedReference(small_plan().motion)


def _read(reference: PlannedReference) -> RobotReading:
    return KinematicRobot(reference.joint_names, reference.at(0.0).q, PERIOD).read()


def _compare(reference: PlannedReference, reading: RobotReading, names: tuple[str, ...] | None = None) -> list[str]:
    readings = [replace(reading, time_s=k * PERIOD) for k in range(3)]
    names = reference.joint_names if names is None else names
    return [f"{one.what} {one.where}" for one in compare_readings(names, PERIOD, readings, reference, 0.05)]


def test_a_robot_at_the_start_of_a_plan_matches(reference: PlannedReference) -> None:
    assert _compare(reference, _read(reference)) == []


def test_each_difference_of_a_driver_is_named(reference: PlannedReference) -> None:
    names, good = reference.joint_names, _read(reference)
    turned = int(np.abs(good.q).argmax())
    assert abs(good.q[turned]) > 0.1

    def change(value: float) -> RobotReading:
        q = good.q.copy()
        q[turned] = value
        return replace(good, q=q)

    name = names[turned]
    assert _compare(reference, change(-good.q[turned])) == [f"sign {name}"]
    assert _compare(reference, change(np.rad2deg(good.q[turned]))) == [f"unit {name}"]
    assert _compare(reference, change(0.9 * good.q[turned] - 0.06)) == [f"start {name}"]
    assert _compare(reference, change(np.nan)) == ["value q"]
    fewer = replace(good, q=good.q[1:], qd=good.qd[1:], torque=good.torque[1:])
    assert _compare(reference, fewer, names[1:]) == [f"joints {names[0]}"]
    still = [good] * 3
    assert [one.what for one in compare_readings(names, PERIOD, still, reference, 0.05)] == ["clock"]
    assert "clock period" in [f"{d.what} {d.where}" for d in compare_readings(names, 3.0, still, reference, 0.05)]
    moved = [
        replace(change(good.q[turned] + 0.01 * k), time_s=0.1 * k, qd=-0.1 * np.ones(len(names))) for k in range(4)
    ]
    assert [f"{d.what} {d.where}" for d in compare_readings(names, PERIOD, moved, reference, 0.05)] == [f"sign {name}"]


class PlayedController:
    """A controller that follows goals exactly; implements ``TrajectoryTransport``."""

    def __init__(self, names: tuple[str, ...], start: np.ndarray) -> None:
        self.names, self.q, self.qd = list(names)[::-1], start[::-1].copy(), np.zeros(len(start))
        self.time_s, self.goals, self.error, self.is_closed = 1000.0, list[dict[str, Any]](), "", False

    def read_state(self) -> dict[str, Any] | None:
        self.time_s += 1e-4
        return {
            "stamp": self.time_s,
            "name": self.names,
            "position": self.q.tolist(),
            "velocity": self.qd.tolist(),
            "effort": [],
        }

    def send_goal(self, goal: dict[str, Any]) -> None:
        self.goals.append(goal)
        order = [goal["joint_names"].index(name) for name in self.names]
        first = goal["points"][0]
        self.q, self.qd = (np.array(first[key])[order] for key in ("positions", "velocities"))
        self.time_s += first["time_from_start"]

    def read_error(self) -> str:
        return self.error

    def close(self) -> None:
        self.is_closed = True


def test_a_plan_is_carried_out_by_a_controller_of_trajectories(
    reference: PlannedReference, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(time, "sleep", lambda seconds: None)
    played = PlayedController(reference.joint_names, reference.at(0.0).q)
    driver = TrajectoryDriver(played, 0.02)
    report = track(Execution(reference, driver), settle_s=0.0)
    assert report.verdict == "TRACKED"
    watched = {one.sentence: one.watched_by for one in report.assumptions}
    assert watched["the joints follow the commands, as their servos do"] == "angles against the commands"
    assert watched["planted links rest on their surfaces, which carry them"] == ""  # no force is measured
    assert driver.joint_names == reference.joint_names[::-1]  # a controller has an order of its own
    assert np.abs(driver.read().q[::-1] - reference.at(reference.duration_s).q).max() < 0.02
    assert all(np.isfinite(point["positions"]).all() for goal in played.goals for point in goal["points"])


def test_a_controller_that_hears_nothing_more_comes_to_rest() -> None:
    command = JointCommand(np.array([1.0]), np.array([0.5]), np.zeros(1))
    near, rest = make_goal(["a"], command, 0.02)["points"]
    assert near == {"positions": [1.0], "velocities": [0.5], "time_from_start": 0.02}
    assert rest["velocities"] == [0.0]
    # Constant deceleration from 0.5 to rest within STOP_S covers half of what the speed would.
    assert rest["positions"] == [1.0 + 0.25 * STOP_S]


def test_a_controller_that_refuses_a_goal_ends_the_execution_at_rest(
    reference: PlannedReference, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(time, "sleep", lambda seconds: None)
    played = PlayedController(reference.joint_names, reference.at(0.0).q)
    execution = Execution(reference, TrajectoryDriver(played, 0.02))
    for _ in range(10):
        execution.step()
    played.error, before = "PATH_TOLERANCE_VIOLATED", len(played.goals)
    report = track(execution, settle_s=0.0)
    assert report.verdict == "ABORTED"
    assert "PATH_TOLERANCE_VIOLATED" in report.reason
    assert len(played.goals) - before < 40


def test_wrong_options_of_a_trajectory_robot_are_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(RequestError, match="transport: expected MODULE:FUNCTION"):
        open_robot("trajectory")
    with pytest.raises(RequestError, match="cannot be opened"):
        open_robot("trajectory,transport=no_such_module:open")
    with pytest.raises(RequestError, match="period_ms 0"):
        open_robot("trajectory,transport=a:b,period_ms=0")
    played = PlayedController(("a", "a"), np.zeros(2))
    monkeypatch.setattr(sys.modules[__name__], "open_played", lambda: played, raising=False)
    with pytest.raises(ExecutionError, match="missing or repeated"):
        open_robot(f"trajectory,transport={__name__}:open_played")
    assert played.is_closed
