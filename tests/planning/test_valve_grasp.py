"""Grasping a rim with the gripper: refused without fingers, closed while it holds, and never deep in the wheel."""

import json
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from shared_plans import write_undrawn

from costs.robot import RobotError, load_robot
from service.demands.valve.demand import ValveDemand
from service.demands.valve.given import read_given_valve
from service.demands.valve.wheel import make_wheel
from service.errors import RequestError
from service.planner import plan
from service.replay.replay import verify_result
from service.request.file import parse_request
from service.result.result import Verdict

WHEEL = {"centre": [0.68, 0.12, 1.1], "axis": [-1.0, 0.0, 0.0], "radius": 0.14}
TUBE = 0.015
PAD = (0.014, 0.02, 0.06)  # of a finger: along the radius, across it, along the hand [m]


def request(valve: dict, **robot: object):
    start = {"posture": "reach_ready"}
    return parse_request({"robot": {"name": "atlas", **robot}, "start": start, "task": {"valve": {**WHEEL, **valve}}})


@pytest.fixture(scope="module")
def grasped(tmp_path_factory):
    result = plan(request({"mode": "grasp", "turn_deg": 100}, hand="gripper"))
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    return result, write_undrawn(result, tmp_path_factory.mktemp("grasp") / "out")


def move(pose: pin.SE3, points: np.ndarray) -> np.ndarray:
    return points @ pose.rotation.T + pose.translation


def locate_pads(result, phase: str, side: str) -> list[tuple[np.ndarray, np.ndarray]]:
    """Corners of both fingers at dense samples of a phase, in the world."""
    motion = result.motion
    model, data = motion.robot.model, motion.robot.model.createData()
    part = next(part for part in motion.phases if part.name == phase)
    corners = {}
    for body in motion.robot.bodies:
        if body.link.startswith(f"{side}_finger"):
            corners[body.link] = body
    rows = []
    for q in motion.curve(np.linspace(part.first, part.last, 60)):
        pin.forwardKinematics(model, data, q)
        placed = [move(data.oMi[body.joint], body.vertices) for _, body in sorted(corners.items())]
        rows.append((placed[0], placed[1]))
    return rows


def fill(corners: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Random points of a convex body."""
    return rng.dirichlet(np.full(len(corners), 0.3), size=600) @ corners


def measure_rim(points: np.ndarray) -> float:
    """Distance of points to the true rim, a torus [m]."""
    offset = points - WHEEL["centre"]
    height = offset @ np.array(WHEEL["axis"])
    flat = np.linalg.norm(offset - height[:, None] * np.array(WHEEL["axis"]), axis=1)
    return float((np.hypot(flat - WHEEL["radius"], height) - TUBE).min())


def test_a_grasp_by_a_hook_is_refused_by_name():
    with pytest.raises(RequestError, match=r"task\.valve\.mode: grasp needs a hand with fingers, .* robot 'atlas' has"):
        plan(request({"mode": "grasp"}))


def test_a_hook_between_spokes_needs_a_peg():
    with pytest.raises(RequestError, match=r"hook needs a peg, and robot 'atlas' has grippers"):
        plan(request({"mode": "hook"}, hand="gripper"))


def test_a_peg_that_is_too_short_is_named():
    with pytest.raises(RequestError, match=r"the free peg of the hook is 0\.025 m long; at least 0\.06 m"):
        plan(request({}, tool_distance_m=0.08))


def test_the_phases_close_the_fingers_before_the_turn_and_open_them_after(grasped):
    result, _ = grasped
    assert [phase.name for phase in result.motion.phases] == ["reach", "insert", "close", "turn", "open", "retract"]
    assert result.figures["turned_deg"] == pytest.approx(100.0, abs=0.5)
    motion = result.motion
    column = motion.robot.joint_names.index("l_grip_1")
    ends = {phase.name: motion.curve(np.array([phase.first, phase.last]))[:, column] for phase in motion.phases}
    assert ends["reach"][0] == pytest.approx(0.0)
    assert ends["insert"][0] == pytest.approx(ends["insert"][1]) == pytest.approx(ends["close"][0])
    assert ends["turn"][0] == pytest.approx(ends["turn"][1]) == pytest.approx(ends["close"][1])
    assert ends["insert"][0] > ends["turn"][0] + 0.01
    assert ends["retract"][1] == pytest.approx(ends["insert"][0])


def test_closed_fingers_are_on_both_sides_of_the_true_rim_and_overlap_it_by_less_than_2_mm(grasped):
    result, _ = grasped
    rng = np.random.default_rng(0)
    for phase, farthest in (("turn", 4e-3), ("close", 0.02), ("insert", np.inf)):
        for pads in locate_pads(result, phase, "l"):
            distances = [measure_rim(fill(pad, rng)) for pad in pads]
            assert min(distances) > -2e-3
            assert max(distances) < farthest
            if phase == "turn":
                radii = [np.linalg.norm((pad.mean(axis=0) - WHEEL["centre"])[1:]) for pad in pads]
                assert min(radii) < WHEEL["radius"] - TUBE
                assert max(radii) > WHEEL["radius"] + TUBE


def test_a_recorded_grasp_is_held_to_its_request_and_the_fingers_to_their_places(grasped):
    _, folder = grasped
    assert verify_result(folder)["verdict"] == "CERTIFIED"
    data = json.loads((folder / "result.json").read_text())
    kept = [t for p in data["phases"] if p["name"] == "turn" for t in p["targets"] if "finger" in t.get("frame", "")]
    assert len(kept) == 2


def test_the_gripper_is_two_boxes_that_slide_apart():
    robot = load_robot("atlas", hand="gripper")
    assert robot.n == load_robot("atlas").n + 4
    data = robot.model.createData()
    q = np.zeros(robot.n)
    for value in (0.0, 0.03):
        for number in (1, 2):
            q[robot.joint_names.index(f"l_grip_{number}")] = value
        pin.framesForwardKinematics(robot.model, data, q)
        tool = data.oMf[robot.model.getFrameId("l_tool")]
        lows = {}
        for body in robot.bodies:
            if body.link in ("l_finger_1", "l_finger_2"):
                points = move(tool.inverse(), move(data.oMi[body.joint], body.vertices))
                np.testing.assert_allclose(np.ptp(points, axis=0), PAD, atol=1e-9)
                lows[body.link] = points[:, 0].min(), points[:, 0].max(), points[:, 2].max()
        assert lows["l_finger_1"][0] == pytest.approx(0.006 + value)
        assert lows["l_finger_2"][1] == pytest.approx(-0.006 - value)
        assert lows["l_finger_1"][2] == pytest.approx(0.02)


def test_hands_of_robots_that_are_not_bundled_and_unknown_ones_are_refused():
    with pytest.raises(RobotError, match="hand 'claw' is not known; expected hook or gripper"):
        load_robot("atlas", hand="claw")
    with pytest.raises(RobotError, match="a gripper has its own"):
        load_robot("atlas", hand="gripper", tool_distance_m=0.2)
    with pytest.raises(RequestError, match="hand belongs to a bundled robot"):
        parse_request({"robot": {"urdf": "a.urdf", "hand": "gripper"}, "goal": {"posture": "stand"}})


def test_the_choice_of_a_record_is_read_back_and_another_hand_is_refused(grasped):
    result, _ = grasped
    valve = result.request.task.valve
    wheel = make_wheel(read_given_valve(valve), valve)
    stroke = ValveDemand(wheel, valve).keep_choices(result.motion)["stroke"]
    assert (stroke.hand, stroke.strokes) == ("left", 1)
    assert stroke.gap_rad in wheel.gaps
    other = ValveDemand(wheel, replace(valve, hand="right")).keep_choices(result.motion)
    assert "no hand that the task permits" in other
    hooked = replace(valve, mode="hook")
    as_hook = ValveDemand(make_wheel(read_given_valve(valve), hooked), hooked)
    assert "no hand that the task permits" in as_hook.keep_choices(result.motion)
