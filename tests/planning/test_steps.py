"""Steps planned for Atlas: what a plan of them promises, where it ends, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

from service.demands import hold_to_request
from service.errors import RequestError
from service.planner import plan
from service.replay.rebuild import make_setup_demands
from service.request.file import parse_request
from service.result.result import PlanResult, Verdict
from service.setup.prepare import prepare
from service.verify import Motion, Status, verify

DOORWAY = Path(__file__).resolve().parents[2] / "examples" / "data" / "doorway.urdf"
WALL = {"name": "wall", "type": "box", "size": [0.1, 2.0, 2.4], "position": [0.85, 0.0, 1.2]}
ARM = {"r_arm_elx": -1.2, "r_arm_ely": 1.8}


def request_of(steps: list[dict[str, Any]], **more: Any) -> dict[str, Any]:
    return {"robot": {"name": "atlas"}, "task": {"steps": steps}, **more}


def plan_steps(steps: list[dict[str, Any]], **more: Any) -> PlanResult:
    return plan(parse_request(request_of(steps, **more)))


def trace(motion: Motion, frame: str, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places (S, 3) and orientations (S, 3, 3) of a frame, by forward kinematics pose by pose."""
    model = motion.robot.model
    data, index = model.createData(), model.getFrameId(frame)
    places, turns = [], []
    for q in motion.curve(s):
        pin.framesForwardKinematics(model, data, q)
        places.append(data.oMf[index].translation.copy())
        turns.append(data.oMf[index].rotation.copy())
    return np.array(places), np.array(turns)


MOVES = [
    {"name": "line",
     "move": {"hand": "right", "by": {"translation": [0.05, 0, 0.1]}, "along": "line", "speed_m_s": 0.1}},
    {"name": "turn", "screw": {"hand": "right", "axis": [0, 0, 1], "axes": "hand", "rotation_deg": 40}},
    {"name": "body", "body": {"pelvis_m": [0.0, 0.0, -0.04], "torso_rpy_deg": [0, 0, 8]}},
    {"name": "joints", "move": {"joints": ARM, "along": "joint_quintic", "hand": "right", "other_hand": "lock"}},
    {"name": "both", "move": {"hand": "both", "by": {"translation": [0, 0, 0.04]}, "along": "line", "duration_s": 2.5}},
    {"check": "is it there"},
    {"move": {"posture": "stand"}},
]  # fmt: skip


@pytest.fixture(scope="module", name="moves")
def _moves() -> PlanResult:
    return plan_steps(MOVES)


@pytest.fixture(scope="module", name="motion")
def _motion(moves: PlanResult) -> Motion:
    assert moves.motion is not None
    return moves.motion


def phase_samples(motion: Motion, name: str) -> np.ndarray:
    phase = next(phase for phase in motion.phases if phase.name == name)
    return np.linspace(phase.first, phase.last, 400)


def test_a_list_of_steps_is_certified_up_to_the_check_and_lists_the_rest(moves: PlanResult, motion: Motion) -> None:
    assert moves.verdict is Verdict.CERTIFIED
    assert [phase.name for phase in motion.phases] == ["line", "turn", "body", "joints", "both"]
    assert any("before step '6 check' (is it there)" in note and "'7 move'" in note for note in moves.notes)


def test_a_hand_on_a_line_is_within_a_millimetre_between_the_waypoints(motion: Motion) -> None:
    places, turns = trace(motion, "r_tool", phase_samples(motion, "line"))
    way = np.array([0.05, 0.0, 0.1])
    along = (places - places[0]) @ way / (way @ way)
    assert np.linalg.norm(places - places[0] - np.outer(along, way), axis=1).max() < 1e-3
    assert along[-1] == pytest.approx(1.0, abs=1e-4)
    assert np.all(np.diff(along) > -1e-9)
    off = Rotation.from_matrix(turns[0].T @ turns).magnitude()
    assert np.rad2deg(off.max()) < 0.5


def test_the_speed_on_a_line_is_within_five_percent_but_for_its_ramps(motion: Motion) -> None:
    assert motion.law is not None
    ends = [np.interp(s, motion.law.path, motion.law.times) for s in phase_samples(motion, "line")[[0, -1]]]
    times = np.linspace(*ends, 2001)
    places, _ = trace(motion, "r_tool", motion.law.at(times)[0])
    speed = np.linalg.norm(np.diff(places, axis=0), axis=1) / np.diff(times)
    done = np.linalg.norm(places[1:] - places[0], axis=1)
    inside = (done > 0.012) & (done < done[-1] - 0.012)
    assert np.abs(speed[inside] / 0.1 - 1.0).max() < 0.05


def test_the_other_hand_keeps_its_pose_while_one_moves(motion: Motion) -> None:
    for name in ("line", "turn", "body"):
        places, _ = trace(motion, "l_tool", phase_samples(motion, name))
        assert np.linalg.norm(places - places[0], axis=1).max() < 2e-3


def test_joints_follow_the_polynomial_of_degree_five(motion: Motion) -> None:
    assert motion.law is not None
    s = phase_samples(motion, "joints")
    ends = [np.interp(at, motion.law.path, motion.law.times) for at in s[[0, -1]]]
    share = np.linspace(0.0, 1.0, 101)
    q = motion.curve(motion.law.at(ends[0] + share * (ends[1] - ends[0]))[0])
    done = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    for name, end in ARM.items():
        column = motion.robot.joint_names.index(name)
        np.testing.assert_allclose(q[:, column], q[0, column] + done * (end - q[0, column]), atol=1e-4)
    locked = [k for k, name in enumerate(motion.robot.joint_names) if name.startswith("l_arm")]
    assert np.ptp(q[:, locked], axis=0).max() < 1e-6


def test_the_promises_are_made_again_from_the_request_alone(motion: Motion) -> None:
    demands = make_setup_demands(prepare(parse_request(request_of(MOVES))))
    held = hold_to_request(demands, motion)
    assert held.differences == ()
    assert verify(held.motion).status is Status.CERTIFIED


@pytest.mark.parametrize(
    ("step", "change", "word"),
    [
        (0, {"move": {**MOVES[0]["move"], "by": {"translation": [0.05, 0, 0.12]}}}, "line"),
        (0, {"move": {**MOVES[0]["move"], "speed_m_s": 0.2}}, "line"),
        (1, {"screw": {**MOVES[1]["screw"], "rotation_deg": -40}}, "turn"),
        (3, {"move": {**MOVES[3]["move"], "along": "joint_cubic"}}, "joints"),
        (4, {"move": {**MOVES[4]["move"], "duration_s": 3.0}}, "both"),
        (2, {"body": {"pelvis_m": [0.0, 0.0, -0.05], "torso_rpy_deg": [0, 0, 8]}}, "body"),
    ],
)
def test_a_motion_does_not_answer_for_other_steps(motion: Motion, step: int, change: dict[str, Any], word: str) -> None:
    steps = [{"name": MOVES[step]["name"], **change} if k == step else own for k, own in enumerate(MOVES)]
    demands = make_setup_demands(prepare(parse_request(request_of(steps))))
    held = hold_to_request(demands, motion)
    assert any(word in difference for difference in held.differences)
    assert verify(held.motion).status is Status.VIOLATED


def test_a_step_that_is_left_out_is_missed(motion: Motion) -> None:
    demands = make_setup_demands(prepare(parse_request(request_of([MOVES[1], *MOVES]))))
    assert any("the steps have" in difference for difference in hold_to_request(demands, motion).differences)


def test_a_line_that_the_arm_cannot_follow_ends_the_plan_there_and_names_step_and_reason() -> None:
    far = {"name": "too far", "move": {"frame": "r_tool", "by": {"translation": [0.0, 0.0, 1.6]}, "along": "line"}}
    result = plan_steps([MOVES[0], far])
    assert result.verdict is Verdict.NOT_FOUND
    assert result.motion is not None
    assert [phase.name for phase in result.motion.phases] == ["line", "too far"]
    (reason,) = result.explanation
    assert reason.startswith("step 'too far': r_tool follows its way to ")
    assert "at their limits" in reason


def test_a_circle_on_a_wall_is_followed_at_its_depth_and_feed_under_thrust() -> None:
    face = {"point": [0.8, 0.0, 1.2], "normal": [-1.0, 0.0, 0.0], "pieces": ["wall"]}
    follow = {"hand": "right", "face": face, "circle": {"centre": [0.7, -0.2, 1.1], "radius_m": 0.1}, "thrust_n": 15.0}
    result = plan_steps([{"name": "cut", "follow": follow}], scene={"obstacles": [WALL]})
    assert result.verdict is Verdict.CERTIFIED
    motion = result.motion
    assert motion is not None
    assert [phase.name for phase in motion.phases] == ["cut: reach", "cut: approach", "cut: path", "cut: retreat"]
    places, turns = trace(motion, "r_tool", phase_samples(motion, "cut: path"))
    offset = places - [0.8, -0.2, 1.1]
    assert np.abs(offset[:, 0]).max() < 1e-3
    assert np.abs(np.linalg.norm(offset[:, 1:], axis=1) - 0.1).max() < 1e-3
    angle = np.unwrap(np.arctan2(offset[:, 2], -offset[:, 1]))  # to the right and up, for somebody who faces the wall
    assert angle[-1] - angle[0] == pytest.approx(-2.0 * np.pi, abs=0.02)  # clockwise
    assert turns[:, 0, 2].min() > np.cos(np.deg2rad(2.0))
    loads = [phase.loads for phase in motion.phases]
    assert [len(own) for own in loads] == [0, 0, 1, 0]
    np.testing.assert_allclose(loads[2][0].force, [15.0, 0.0, 0.0], atol=1e-9)
    lighter = replace(motion, phases=tuple(replace(phase, loads=()) for phase in motion.phases))
    demands = make_setup_demands(prepare(result.request))
    assert any("loads" in difference for difference in hold_to_request(demands, lighter).differences)


def test_a_touch_bears_the_force_at_which_it_stops() -> None:
    touch = {"hand": "right", "direction": [0.0, 0.0, 2.0], "window_m": [0.02, 0.06], "force_n": 10.0}
    result = plan_steps([{"name": "feel", "touch": touch}], start={"posture": "reach_ready"})
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    assert result.motion is not None
    (load,) = result.motion.phases[-1].loads
    np.testing.assert_allclose(load.force, [0.0, 0.0, 10.0], atol=1e-9)
    harder = request_of([{"name": "feel", "touch": {**touch, "force_n": 20.0}}], start={"posture": "reach_ready"})
    held = hold_to_request(make_setup_demands(prepare(parse_request(harder))), result.motion)
    assert any("loads" in difference for difference in held.differences)


def test_two_parts_are_pressed_in_one_plan() -> None:
    press = {"normal": [-1, 0, 0], "force_n": 15, "travel_m": 0.008, "height_m": 0.02}
    steps = [{"press": {"at": [0.74, -0.25, z], **press}} for z in (1.4, 1.2)]
    result = plan_steps(steps, start={"posture": "reach_ready"})
    assert result.verdict is Verdict.CERTIFIED
    assert result.motion is not None
    assert result.motion.robot.joint_names[-2:] == ("press_1", "press_2")
    ends = result.motion.curve.positions[[0, -1], -2:]
    np.testing.assert_allclose(ends, [[0.0, 0.0], [0.008, 0.008]], atol=1e-3)


def test_a_gripper_pushes_a_leaf_by_the_ends_of_its_closed_fingers() -> None:
    handle = {"link": "leaf", "place": [-0.02, -0.8, 1.1], "axis": [1, 0, 0], "tool": "tip", "tilt_deg": 35}
    mechanism = {
        "urdf": str(DOORWAY), "position": [0.74, 0.55, 0], "joints": {"hinge": {"friction": 4}}, "handle": handle,
        "hand": "right", "moves": [{"joint": "hinge", "to": 0.4}],
    }  # fmt: skip
    robot = {"name": "atlas", "hand": "gripper"}
    result = plan_steps([{"mechanism": mechanism}], robot=robot, start={"posture": "reach_ready"})
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    motion = result.motion
    assert motion is not None
    phase = next(phase for phase in motion.phases if phase.pushes)
    assert {contact.frame for push in phase.pushes for contact in push.contacts} <= {"r_finger_1", "r_finger_2"}
    grips = [motion.robot.joint_names.index(name) for name in ("r_grip_1", "r_grip_2")]
    during = motion.curve(np.linspace(phase.first, phase.last, 9))[:, grips]
    np.testing.assert_allclose(during, 0.0, atol=1e-6)


@pytest.mark.parametrize(
    ("step", "problem"),
    [
        ({"move": {"hand": "right", "frame": "r_tool", "by": {"translation": [0, 0, 1]}}}, "hand and frame"),
        ({"move": {"joints": {"r_arm_elx": 1.0}}}, "outside the joint's limits"),
        ({"move": {"frame": "r_toool", "by": {"translation": [0, 0, 0.1]}}}, "unknown frame 'r_toool'"),
        ({"move": {"hand": "right", "by": {"translation": [0, 0, 0]}}}, "neither translates nor rotates"),
        ({"move": {"hand": "right", "by": {"translation": [0, 0, 0.1]}, "along": "joint_cubic"}}, "needs joints"),
        ({"move": {"hand": "right", "by": {"translation": [0, 0, 0.1]}, "speed_m_s": 0.1}}, "goes with along"),
        ({"screw": {"axis": [0, 0, 0], "hand": "right", "rotation_deg": 10}}, "axis has no length"),
        ({"touch": {"direction": [1, 0, 0], "window_m": [0.2, 0.1], "force_n": 5, "hand": "left"}}, "ends before"),
        ({"move": {"posture": "stand"}, "wait": "until"}, "exactly one of"),
        ({}, "exactly one of"),
        ({"follow": {"hand": "left", "face": {"point": [1, 0, 1], "normal": [1, 0, 0], "pieces": ["wal"]},
                     "polyline": [[1, 0, 1], [1, 0.1, 1]]}}, "unknown piece 'wal'; expected wall"),
        ({"follow": {"hand": "left", "face": {"point": [0.8, 0, 1], "normal": [-1, 0, 0], "pieces": ["wall"]},
                     "circle": {"centre": [0.8, 0.9, 1.2], "radius_m": 0.2}}}, "100 mm beyond wall"),
        ({"follow": {"hand": "left", "face": {"point": [0.8, 0, 1], "normal": [-1, 0, 0], "pieces": ["wall"]},
                     "polyline": [[0.8, 0.5, 1.2], [0.8, 0.5, 2.5]]}}, "100 mm beyond wall"),
    ],
)  # fmt: skip
def test_a_wrong_step_is_refused_with_its_field(step: dict[str, Any], problem: str) -> None:
    with pytest.raises(RequestError) as caught:
        prepare(parse_request(request_of([step], scene={"obstacles": [WALL]})))
    (line,) = caught.value.problems
    assert line.startswith("task.steps[0]")
    assert problem in line


def test_a_lean_that_slides_off_under_thrust_is_refused() -> None:
    face = {"point": [0.8, 0.0, 1.2], "normal": [-1.0, 0.0, 0.0]}
    circle = {"centre": [0.8, -0.2, 1.1], "radius_m": 0.1}
    follow = {"hand": "right", "face": face, "circle": circle, "tilt_deg": 30.0, "thrust_n": 5.0}
    with pytest.raises(RequestError, match=r"task.steps\[0\]: follow.tilt_deg: 30 deg"):
        prepare(parse_request(request_of([{"follow": follow}])))


def test_a_posture_that_the_robot_does_not_have_is_refused_with_those_that_it_has() -> None:
    with pytest.raises(RequestError, match=r"'sit' in task.steps\[0\].move.posture; atlas has stand"):
        prepare(parse_request(request_of([{"move": {"posture": "sit"}}])))


def test_a_plan_without_a_step_before_the_check_says_so() -> None:
    result = plan_steps([{"check": "is it there"}, MOVES[0]])
    assert result.verdict is Verdict.NOT_FOUND
    assert "nothing comes before step '1 check'" in result.explanation[0]


def test_a_move_ends_in_a_region_or_looks_at_a_place() -> None:
    region = {"x_min_m": 0.0, "x_max_m": 0.1, "z_min_m": 0.05}
    pose = {"link": "r_hand", "position": [0.4, -0.3, 1.0], "position_tolerance_m": 0.5, "region": region}
    result = plan_steps([{"move": {"poses": [pose]}}, {"move": {"by": {"translation": [0, 0, 0.03]}, "hand": "right"}}])
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    assert result.motion is not None
    places, _ = trace(result.motion, "r_hand", phase_samples(result.motion, "1 move"))
    assert 0.4 - 1e-3 <= places[-1, 0] <= 0.5 + 1e-3
    assert places[-1, 2] >= 1.05 - 1e-3
    assert any(check.name.startswith("region.1 move") for check in result.certificate.checks)  # type: ignore[union-attr]


def test_a_region_on_a_line_and_one_of_an_unknown_frame_are_refused() -> None:
    pose = {"link": "r_hand", "region": {"z_min_m": 1.0}}
    with pytest.raises(RequestError, match="go with along: free"):
        parse_request(request_of([{"move": {"poses": [pose], "along": "line"}}]))
    with pytest.raises(RequestError, match=r"poses\[0\]\.relative_to"):
        prepare(parse_request(request_of([{"move": {"poses": [{**pose, "relative_to": "r_hnd"}]}}])))
