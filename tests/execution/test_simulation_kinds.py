"""Every kind of hold, moved in both directions: certified, and done in physics at both ends of the hands' friction."""

from __future__ import annotations

from functools import cache
from itertools import islice
from typing import Any

import pytest

pytest.importorskip("mujoco", reason="needs MuJoCo: pip install 'scopt[sim]'")
from benchmarks.tasks.given_cases import make_doors
from service.execution.execution import Execution
from service.execution.reference import PlannedReference
from service.execution.tracking import track
from service.planner import plan
from service.request.file import parse_request, request_hash
from service.result.result import PlanResult
from service.simulation.follow import WorkWatch
from service.simulation.model import build_physics
from service.simulation.options import SimulationOptions
from service.simulation.report import make_report
from service.simulation.resistance import MechanismPhysics, Resistance, read_mechanism_physics
from service.simulation.robot import SimulatedRobot
from service.simulation.run import execute_motion

BAR = '<collision><origin xyz="0 0 {z}" rpy="1.5708 0 0"/><geometry><cylinder radius="0.01" length="0.3"/></geometry></collision>'
PLATE = '<collision><origin xyz="-0.15 0 0"/><geometry><box size="0.3 0.3 0.02"/></geometry></collision>'
CAP = '<collision><origin rpy="0 1.5708 0"/><geometry><cylinder radius="0.02" length="0.02"/></geometry></collision>'
FROM_FRONT, FROM_ABOVE = ([1, 0, 0], [-0.12, 0, 0]), ([0, 0, -1], [0, 0, 0.12])


def mechanism(
    shape: str, joint: str, axis: str, place: list[float], to: float, friction: float, *, tool: str = "peg",
    hand: tuple[list[float], list[float]] = FROM_FRONT, at: tuple[float, float, float] = (0.6, -0.25, 1.05),
    tilt_deg: float = 30.0,
) -> dict[str, Any]:  # fmt: skip
    """A request that moves a shape on a joint by a hand at a place."""
    urdf = (
        f'<robot name="m"><link name="base"/><link name="part">{shape}</link><joint name="move" type="{joint}">'
        f'<parent link="base"/><child link="part"/><axis xyz="{axis}"/>'
        '<limit lower="-1.5" upper="1.5" velocity="1" effort="200"/></joint></robot>'
    )
    handle = {"link": "part", "place": place, "axis": hand[0], "approach": hand[1], "tool": tool, "tilt_deg": tilt_deg}
    return {
        "mechanism": {
            "urdf": urdf,
            "position": list(at),
            "handle": handle,
            "joints": {"move": {"friction": friction}},
            "moves": [{"joint": "move", "to": to}],
        }
    }


def wheel(mode: str, turn_deg: float) -> dict[str, Any]:
    """A request that turns a wheel with three spokes."""
    return {
        "valve": {
            "mode": mode, "centre": [0.68, 0.12, 1.1], "axis": [-1, 0, 0], "radius": 0.14, "turn_deg": turn_deg,
            "torque_nm": 5.0, "spokes_deg": [30, 150, 270],
        }
    }  # fmt: skip


RAIL = BAR.format(z=0)
LEVER = BAR.format(z=0.2)
HOLDS: dict[str, dict[str, Any]] = {
    "side of a rod, away": mechanism(RAIL, "prismatic", "1 0 0", [-0.019, 0, 0], 0.1, 30, hand=FROM_ABOVE),
    "side of a rod, towards": mechanism(RAIL, "prismatic", "-1 0 0", [0.019, 0, 0], 0.1, 30, hand=FROM_ABOVE),
    "side of a rod on a lever, away": mechanism(LEVER, "revolute", "0 1 0", [-0.019, 0, 0.2], 0.6, 5, hand=FROM_ABOVE),
    "side of a rod on a lever, towards": mechanism(
        LEVER, "revolute", "0 -1 0", [0.019, 0, 0.2], 0.6, 5, hand=FROM_ABOVE
    ),
    "hatch, up": mechanism(PLATE, "revolute", "0 1 0", [-0.28, 0, -0.019], 0.4, 5, at=(0.85, -0.25, 1.0)),
    "hatch, down": mechanism(PLATE, "revolute", "0 -1 0", [-0.28, 0, 0.019], 0.4, 5, at=(0.85, -0.25, 1.1)),
    "tip": mechanism(
        CAP, "prismatic", "1 0 0", [-0.01, 0, 0], 0.02, 20, tool="tip", at=(0.72, -0.25, 1.2), tilt_deg=10
    ),
    "hook on a wheel, left": wheel("hook", 80.0),
    "hook on a wheel, right": wheel("hook", -80.0),
    "fingers on a rim, left": wheel("grasp", 60.0),
    "fingers on a rim, right": wheel("grasp", -60.0),
}


@cache
def planned(name: str) -> PlanResult:
    hand = "gripper" if "fingers" in name else "hook"
    result = plan(
        parse_request(
            {"robot": {"name": "atlas", "hand": hand}, "start": {"posture": "reach_ready"}, "task": HOLDS[name]}
        )
    )
    assert result.verdict.value == "CERTIFIED", result.explanation
    return result


@pytest.mark.parametrize("name", HOLDS)
def test_a_hold_is_certified_and_done(name: str) -> None:
    result = planned(name)
    assert result.motion is not None
    made, _ = make_report(execute_motion(result.motion, result.request, "CERTIFIED", request_hash(result.request)))
    assert [(run["hand_friction"], run["verdict"]) for run in made["runs"]] == [(0.3, "DONE"), (0.6, "DONE")], made[
        "explanation"
    ]
