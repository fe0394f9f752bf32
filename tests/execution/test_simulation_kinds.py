"""Every kind of hold, most of them moved in both directions: certified, and done in physics.

Of two directions one is carried out at the lower end of the hands' friction and the other at the upper one; tips and
fronts of hands at both.  A rod pushed away is among the cases of ``planning/test_recorded_cases.py``.
"""

from __future__ import annotations

from functools import cache
from itertools import islice
from typing import Any

import pytest

pytest.importorskip("mujoco", reason="needs MuJoCo: pip install 'scopt[sim]'")
from benchmarks.tasks.given_cases import make_doors
from service.demands.kind import read_mechanism_physics
from service.demands.resistance import MechanismPhysics, Resistance
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
from service.simulation.robot import SimulatedRobot
from service.simulation.run import execute_motion

BAR = (
    '<collision><origin xyz="0 0 {z}" rpy="1.5708 0 0"/>'
    '<geometry><cylinder radius="0.01" length="0.3"/></geometry></collision>'
)
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
    task = {
        "urdf": urdf,
        "position": list(at),
        "handle": handle,
        "joints": {"move": {"friction": friction}},
        "moves": [{"joint": "move", "to": to}],
    }
    return {"task": {"mechanism": task}}


def wheel(mode: str, turn_deg: float) -> dict[str, Any]:
    """A task that turns a wheel with three spokes."""
    return {
        "valve": {
            "mode": mode, "centre": [0.68, 0.12, 1.1], "axis": [-1, 0, 0], "radius": 0.14, "turn_deg": turn_deg,
            "torque_nm": 5.0, "spokes_deg": [30, 150, 270],
        }
    }  # fmt: skip


def door(number: int, open_deg: float) -> dict[str, Any]:
    """One of the bench's doors, which a robot opens from where it stands."""
    (case,) = islice(make_doors(number + 1, 0, open_deg), number, None)
    return {"scene": case.request["scene"], "task": case.request["task"]}


RAIL = BAR.format(z=0)
LEVER = BAR.format(z=0.2)
HOLDS: dict[str, dict[str, Any]] = {
    "side of a rod, towards": mechanism(RAIL, "prismatic", "-1 0 0", [0.019, 0, 0], 0.1, 30, hand=FROM_ABOVE),
    "side of a rod on a lever, away": mechanism(LEVER, "revolute", "0 1 0", [-0.019, 0, 0.2], 0.4, 5, hand=FROM_ABOVE),
    "hatch, up": mechanism(PLATE, "revolute", "0 1 0", [-0.28, 0, -0.019], 0.4, 5, at=(0.85, -0.25, 1.0)),
    "hatch, down": mechanism(PLATE, "revolute", "0 -1 0", [-0.28, 0, 0.019], 0.4, 5, at=(0.9, -0.3, 1.0)),
    "tip": mechanism(
        CAP, "prismatic", "1 0 0", [-0.01, 0, 0], 0.02, 20, tool="tip", at=(0.72, -0.25, 1.2), tilt_deg=10
    ),
    "front of a hand": mechanism(RAIL, "prismatic", "1 0 0", [-0.01, 0, 0.02], 0.1, 30, tool="stub", tilt_deg=10),
    "hook on a wheel, left": {"task": wheel("hook", 80.0)},
    "fingers on a rim, right": {"robot": {"name": "atlas", "hand": "gripper"}, "task": wheel("grasp", -60.0)},
    "lever of a door, pushed": door(0, 30.0),
    "lever of a door, pulled": door(7, 15.0),
    "bar of a door, pushed": door(2, 30.0),
    "bar of a door, pulled": door(9, 20.0),
}
LOWER, UPPER = 0.3, 0.6  # ends of the hands' friction
LAST_WORDS = {  # of the names of two directions
    "away": (LOWER,), "towards": (UPPER,), "up": (LOWER,), "down": (UPPER,), "left": (LOWER,), "right": (UPPER,),
    "pushed": (UPPER,), "pulled": (LOWER,),
}  # fmt: skip
SETTLE_S, AFTER_S = 0.3, 1.0  # that the robot stands before and after
STUCK = 1e4  # friction of a joint that no hand moves [N m, N]


@cache
def planned(name: str) -> PlanResult:
    """The plan of a hold."""
    result = plan(parse_request({"robot": {"name": "atlas"}, "start": {"posture": "reach_ready"}, **HOLDS[name]}))
    assert result.verdict.value == "CERTIFIED", result.explanation
    return result


@pytest.mark.parametrize("name", HOLDS)
def test_a_hold_is_certified_and_done(name: str) -> None:
    result = planned(name)
    if "door" in HOLDS[name]["task"]:
        assert result.figures["opening_deg"] == pytest.approx(result.request.task.door.open_deg, abs=0.1)
    assert result.motion is not None
    assert tuple(result.request.options.hand_friction) == (LOWER, UPPER)
    for friction in LAST_WORDS.get(name.rpartition(" ")[2], (LOWER, UPPER)):
        options = SimulationOptions(hand_friction=friction, settle_s=SETTLE_S, after_s=AFTER_S)
        runs = execute_motion(result.motion, result.request, "CERTIFIED", request_hash(result.request), options)
        made, _ = make_report(runs)
        told = [(run["hand_friction"], run["verdict"]) for run in made["runs"]]
        assert told == [(friction, "DONE")], made["explanation"]


@pytest.mark.parametrize("is_stuck", [False, True])
def test_a_tracked_plan_is_judged_by_what_it_moved(is_stuck: bool) -> None:
    result = planned("side of a rod, towards")
    assert result.motion is not None
    reference = PlannedReference(result.motion)
    physics = read_mechanism_physics(result.request)
    if is_stuck:
        physics = MechanismPhysics({"move": Resistance(friction=STUCK)})
    options = SimulationOptions(hand_friction=LOWER, settle_s=SETTLE_S)
    robot = SimulatedRobot(build_physics(result.motion, physics, options), reference.at(0.0).configuration, options, 4)
    work = WorkWatch(robot)
    execution = Execution(reference, robot)
    report = track(execution, on_cycle=lambda cycle: work.look(execution), settle_s=AFTER_S)
    judged = work.judge()
    if not is_stuck:
        assert (report.verdict, judged.verdict, judged.reasons) == ("TRACKED", "DONE", ())
        assert judged.moves[0].share == pytest.approx(1.0, abs=0.05)
        return
    assert judged.verdict == "STOOD"
    assert judged.moves[0].share < 0.1
    assert judged.reasons[0].startswith("move moved by ")
