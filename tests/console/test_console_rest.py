"""The rest of a plan that the operator's page asks for, where a target was shifted."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from shared_plans import write_example

from service.cli.console.jobs import make_rest
from service.cli.console.robot import RobotSeat, Standstill
from service.errors import ExecutionError, RequestError
from service.proto.planner.v1 import execution_pb2 as wire
from service.result.folder import read_result

SHIFT = [0.0, 0.04, -0.02]


def stand_still(folder: Path, phase: str, shifts: dict[str, list[float]]) -> Standstill:
    """The robot in the middle of a phase, measured with an error of 0.1 mrad."""
    data = read_result(folder)
    row = next(entry for entry in data["phases"] if entry["name"] == phase)
    k = (row["first"] + row["last"]) // 2
    names, values = data["trajectory"]["joint_names"], data["trajectory"]["positions"][k]
    start: dict[str, Any] = {"joint_names": names[7:], "positions": [value + 1e-4 for value in values[7:]]}
    start["base"] = {"position": values[:3], "quaternion_wxyz": values[3:7]}
    return Standstill("plan", phase, data["trajectory"]["times"][k], start, shifts)


def test_the_rest_reaches_for_what_the_operator_shifted_from_where_the_robot_is(tmp_path: Path) -> None:
    folder = Path(shutil.copytree(write_example("pose_goal"), tmp_path / "plan"))
    standstill = stand_still(folder, "reach", {"l_hand": SHIFT})
    request = make_rest(folder, standstill)
    assert request.resume is not None
    assert request.goal is not None
    assert request.goal.poses[0].position == pytest.approx(np.array([0.60, 0.25, 1.05]) + SHIFT)
    assert request.start.positions == pytest.approx(standstill.start["positions"])
    with pytest.raises(RequestError, match="r_hand was shifted: adjust: this plan has no target 'r_hand'"):
        make_rest(folder, stand_still(folder, "reach", {"r_hand": SHIFT}))


@pytest.mark.parametrize(
    ("mode", "rate", "words"),
    [
        (wire.EXECUTION_MODE_RUNNING, 1.0, "the robot is running; pause it first"),
        (wire.EXECUTION_MODE_PAUSED, 0.2, "the robot is paused; pause it first, and wait until it rests"),
        (wire.EXECUTION_MODE_DONE, 0.0, "the robot is done; there is no rest to plan"),
    ],
)
def test_a_rest_is_planned_only_where_the_robot_rests_in_a_plan(mode: Any, rate: float, words: str) -> None:
    seat = RobotSeat(None, lambda event: None)  # type: ignore[arg-type]
    with pytest.raises(ExecutionError, match="the robot carries out no plan"):
        seat.find_standstill()
    state = wire.WatchResponse(
        status=wire.ExecutionStatus(mode=mode, phase="reach"),
        plan=wire.LoadedPlan(plan_id="a", joint_names=["one"]),
        pose=wire.RobotPose(clock_s=1.5, rate=rate, measured=[0.5], measured_base=[1, 2, 3, 1, 0, 0, 0]),
    )
    seat._take_state(state)
    with pytest.raises(ExecutionError, match=words):
        seat.find_standstill()
    state.status.mode, state.pose.rate = wire.EXECUTION_MODE_PAUSED, 0.0
    state.status.shifts.add(link="l_hand", offset_m=SHIFT)
    seat._take_state(state)
    found = seat.find_standstill()
    assert (found.plan_id, found.phase, found.clock_s, found.shifts) == ("a", "reach", 1.5, {"l_hand": SHIFT})
    assert found.start["base"] == {"position": [1, 2, 3], "quaternion_wxyz": [1, 0, 0, 0]}
