"""Motions of other planners that are not what their file seems to say: used, refused, or noted by name."""

from __future__ import annotations

import copy
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from other_planners import JOINTS, START, least_jerk, make_request, to_message, via_points
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from service import CertifiedTrajectory, RequestError, certify, load_request, parse_request, plan, read_trajectory
from service.cli.app import app
from service.replay.exchange.base_motion import read_base_motion
from service.replay.exchange.export import export
from service.replay.exchange.messages import parse_trajectory
from service.request.schema import PlanRequest

DATA = Path(os.environ.get("SCOPT_DATA", Path(__file__).parents[3] / "shared" / "data"))
LIES = DATA.parent / "cases" / "lies"
MESSAGE = to_message(least_jerk(via_points(), 1.6, 0.1))
GRIPPER = """
<link name="left"/><link name="right"/>
<joint name="finger" type="prismatic"><parent link="part3"/><child link="left"/><axis xyz="0 1 0"/>
<limit lower="-0.1" upper="0.1" velocity="1" effort="10"/></joint>
<joint name="other_finger" type="prismatic"><parent link="part3"/><child link="right"/><axis xyz="0 1 0"/>
<limit lower="-0.2" upper="0.2" velocity="2" effort="10"/><mimic joint="finger" multiplier="-2" offset="0.01"/></joint>
</robot>"""
Data = dict[str, Any]


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> PlanRequest:
    return parse_request(make_request(tmp_path_factory.mktemp("arm")))


@pytest.fixture(scope="module")
def gripper(tmp_path_factory: pytest.TempPathFactory) -> PlanRequest:
    """The arm with two fingers without shape, one of which follows the other."""
    data = make_request(tmp_path_factory.mktemp("gripper"))
    urdf = Path(data["robot"]["urdf"])
    urdf.write_text(urdf.read_text().replace("</robot>", GRIPPER))
    return parse_request(data)


def _certify(message: Data, request: PlanRequest, **more: Any) -> CertifiedTrajectory:
    return certify(parse_trajectory(copy.deepcopy(message), "plan"), request, **more)


def _stretch(factor: float) -> Data:
    """The message with its times multiplied, and its derivatives as they are then."""
    message = copy.deepcopy(MESSAGE)
    for point in message["points"]:
        stamp = point["time_from_start"]
        point["time_from_start"] = factor * (stamp["sec"] + 1e-9 * stamp["nanosec"])
        point["velocities"] = [value / factor for value in point["velocities"]]
        point["accelerations"] = [value / factor**2 for value in point["accelerations"]]
    return message


@pytest.mark.parametrize("factor", [1.0, 10.0, 100.0])
def test_times_of_a_slow_motion_are_not_doubted(arm: PlanRequest, factor: float) -> None:
    outcome = _certify(_stretch(factor), arm)
    assert (outcome.is_certified, outcome.notes) == (True, ())


@pytest.mark.parametrize(
    ("factor", "words"),
    [
        (1e3, "lasts 3200 s, and the joints can do it in 0.8 s at their speed limits; are its times in milliseconds?"),
        (
            1e-3,
            "lasts 0.0032 s, and the joints need at least 0.8 s at their speed limits; are its times in another unit",
        ),
    ],
)
def test_implausible_times_are_noted(arm: PlanRequest, factor: float, words: str) -> None:
    outcome = _certify(_stretch(factor), arm)
    assert any(words in note for note in outcome.notes)


@pytest.mark.parametrize(
    ("times", "words"),
    [
        (lambda k: 1e5 * k, r"lasts 3\.2e\+06 s; expected at most 86400 s \(are these milliseconds or microsec"),
        (lambda k: 3.0, r"all 33 points are at 3 s; expected times that increase, or none"),
        (lambda k: 1.7e9 + k, r"begins at 1700000000 s; are these times of the clock\? Subtract the first"),
        (lambda k: 0.0, r"has no times, or all are 0; --untimed"),
    ],
)  # fmt: skip
def test_impossible_times_are_refused(arm: PlanRequest, times: Callable[[int], float], words: str) -> None:
    message = copy.deepcopy(MESSAGE)
    for k, point in enumerate(message["points"]):
        point["time_from_start"] = times(k)
    with pytest.raises(RequestError, match=words):
        _certify(message, arm)


def test_a_message_with_all_times_0_is_a_path(arm: PlanRequest) -> None:
    message = copy.deepcopy(MESSAGE)
    for point in message["points"]:
        point["time_from_start"] = {"sec": 0, "nanosec": 0}
    outcome = _certify(message, arm, timed=False)
    assert outcome.is_certified
    assert "all points are at 0 s: read as a path without times" in outcome.notes


def test_a_late_first_point_is_noted(arm: PlanRequest) -> None:
    message = _stretch(1.0)
    for point in message["points"]:
        point["time_from_start"] += 5.0
    outcome = _certify(message, arm)
    assert outcome.is_certified
    assert outcome.notes == ("the first point is at 5 s: the robot waits at its start until then",)


def _display(**more: Any) -> Data:
    state = {"joint_state": {"name": list(JOINTS), "position": START.tolist()}}
    several = {"header": {"frame_id": ""}, "joint_names": [], "points": []}
    shown = {"model_id": "arm", "trajectory": [{"joint_trajectory": MESSAGE, "multi_dof_joint_trajectory": several}]}
    return {**shown, "trajectory_start": state, **more}


def test_a_display_trajectory_of_the_same_robot_and_start_has_no_notes(arm: PlanRequest) -> None:
    outcome = _certify(_display(), arm)
    assert (outcome.is_certified, outcome.notes) == (True, ())


@pytest.mark.parametrize(
    ("around", "words"),
    [
        ({"model_id": "panda"}, "model_id is 'panda', the request's robot is 'arm': held to the request's"),
        ({"error_code": {"val": -1}}, "its planner reports the error code -1"),
        ({"success": False}, "its planner reports success: False"),
        ({"success": [False]}, "its planner reports success: [False]"),
        ({"solution": {"joint_names": ["hip"]}, "planning_time": 2.0}, "not read: 'solution', 'planning_time'"),
    ],
)  # fmt: skip
def test_what_stands_around_a_trajectory_is_noted(arm: PlanRequest, around: Data, words: str) -> None:
    outcome = _certify(_display(**around), arm)
    assert outcome.is_certified
    assert outcome.notes == (words,)


def test_fields_of_the_message_that_are_not_used_are_noted(arm: PlanRequest) -> None:
    message = copy.deepcopy(MESSAGE)
    message["header"]["stamp"] = {"sec": 7, "nanosec": 0}
    message["points"][3] |= {"effort": [1.0, 0.0, 0.0, 0.0], "jerk": [9.0] * 4}
    message["limits"] = {"elbow": 0.0}
    assert _certify(message, arm).notes == (
        "effort of the points is not compared; torques are computed from the motion",
        "not read: 'points[].jerk', 'header.stamp'",
    )


@pytest.mark.parametrize(
    ("state", "words"),
    [
        ({"position": [*START[:2], 1.4, START[3]]}, "trajectory_start has elbow at 1.4000, the request's start"),
        ({"name": ["elbow"], "position": [1.1]}, "trajectory_start has elbow at 1.1000"),
    ],
)  # fmt: skip
def test_a_start_state_elsewhere_than_the_requests_start_refutes(arm: PlanRequest, state: Data, words: str) -> None:
    joints = {"name": list(JOINTS), **state}
    outcome = _certify(_display(trajectory_start={"joint_state": joints}), arm)
    assert not outcome.is_certified
    assert outcome.failures[0].startswith(words)


def test_what_a_start_state_says_besides_is_noted(arm: PlanRequest) -> None:
    joints = {"name": [*JOINTS, "hip"], "position": [*START, 0.3], "velocity": [0.0, 0.2, 0.0, 0.0, 0.0]}
    objects = [{"link_name": "part3", "object": {"id": "box7"}}]
    pose = {"translation": {"x": 2.0, "y": 0.0, "z": 0.0}, "rotation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
    state = {"joint_state": joints, "attached_collision_objects": objects, "is_diff": True}
    state["multi_dof_joint_state"] = {"joint_names": ["virtual_joint"], "transforms": [pose]}
    assert _certify(_display(trajectory_start=state), arm).notes == (
        "trajectory_start moves: 'shoulder' at 0.2 rad/s or m/s",
        "trajectory_start has joints that arm lacks: 'hip'",
        "trajectory_start carries 'box7', which the request does not attach: not checked",
        "trajectory_start places the base at [2.0, 0.0, 0.0] m, and that of arm is fixed: not compared",
    )


def test_a_start_state_with_fewer_positions_than_names_is_refused(arm: PlanRequest) -> None:
    with pytest.raises(RequestError, match="trajectory_start names 4 joints and has 1 positions"):
        _certify(_display(trajectory_start={"joint_state": {"name": list(JOINTS), "position": [0.0]}}), arm)


def test_a_key_that_is_given_twice_is_refused(tmp_path: Path) -> None:
    text = json.dumps(MESSAGE)
    (tmp_path / "plan.json").write_text(text[:-1] + ', "points": []}')
    with pytest.raises(RequestError, match=r"is no JSON: .*the key 'points' twice"):
        read_trajectory(tmp_path / "plan.json")
    (tmp_path / "plan.yaml").write_text("joint_names: [a]\npoints: []\npoints: []\n")
    with pytest.raises(RequestError, match=r"no valid YAML: .*the key 'points' twice"):
        read_trajectory(tmp_path / "plan.yaml")


# Followers of mimic joints: other_finger is at 0.01 - 2 finger.


def _with_fingers(
    finger: Callable[[float], float], follow: Callable[[float], float], *, has_leader: bool = True
) -> Data:
    """The message with a finger that moves by a function of 0 to 1 (at rest at both ends), and its follower."""
    message = copy.deepcopy(MESSAGE)
    message["joint_names"] += [*(["finger"] if has_leader else []), "other_finger"]
    shares = np.linspace(0.0, 1.0, len(message["points"]))
    for s, point in zip(shares, message["points"], strict=True):
        value = finger(float(s))
        point["positions"] += [*([value] if has_leader else []), follow(value)]
        point["velocities"] = point["accelerations"] = []
    return message


def _close(s: float) -> float:
    return 0.05 * s**2 * (3.0 - 2.0 * s)


def test_a_follower_that_follows_is_accepted(gripper: PlanRequest) -> None:
    outcome = _certify(_with_fingers(_close, lambda f: 0.01 - 2.0 * f), gripper, interpolation="spline")
    assert outcome.is_certified, outcome.failures
    assert not any("finger'" in note for note in outcome.notes)
    still = _with_fingers(lambda s: 0.0, lambda f: 0.01, has_leader=False)
    outcome = _certify(still, gripper, interpolation="spline")
    assert outcome.is_certified
    assert outcome.notes[0] == "the trajectory leaves out finger: taken to stay at the request's start"


@pytest.mark.parametrize(
    ("follow", "has_leader", "words"),
    [
        (lambda f: f, True, r"of 'other_finger' differ from those of 'finger', which it follows: at point 32 0\.05,"),
        (lambda f: 0.01 - 2.05 * f, True, r"at point 32 -0\.0925, expected -0\.09"),
        (lambda f: 0.01 - 2.0 * f, False, r"at point 32 -0\.09, expected 0\.01"),
    ],
    ids=["same", "5 % more", "leader left out"],
)  # fmt: skip
def test_a_follower_elsewhere_is_refused_with_the_difference(
    gripper: PlanRequest, follow: Callable[[float], float], has_leader: bool, words: str
) -> None:
    with pytest.raises(RequestError, match=words):
        _certify(_with_fingers(_close, follow, has_leader=has_leader), gripper, interpolation="spline")


def test_velocities_of_a_follower_are_compared_too(gripper: PlanRequest) -> None:
    message = _with_fingers(_close, lambda f: 0.01 - 2.0 * f)
    whole = copy.deepcopy(MESSAGE["points"])
    for k, (point, own) in enumerate(zip(message["points"], whole, strict=True)):
        rate = 0.05 * 6.0 * (s := k / 32.0) * (1.0 - s) / 3.2
        point["velocities"] = [*own["velocities"], rate, -2.0 * rate]
    assert _certify(message, gripper).is_certified
    message["points"][7]["velocities"][-1] = 0.5
    with pytest.raises(
        RequestError, match=r"velocities of 'other_finger' differ from those of 'finger'.*at point 7 0\.5"
    ):
        _certify(message, gripper)
    for point in message["points"]:
        point["velocities"][-1] = 0.0
    outcome = _certify(message, gripper)
    assert outcome.is_certified
    assert outcome.notes[0] == "velocities of 'other_finger' are all 0: those of 'finger', which it follows, are used"


# The base in MultiDOFJointTrajectory.


def _base(place: Callable[[float], list[float]], yaw: Callable[[float], float] = lambda t: 0.0) -> Data:
    points = []
    for point in MESSAGE["points"]:
        t = point["time_from_start"]["sec"] + 1e-9 * point["time_from_start"]["nanosec"]
        turn = {"x": 0.0, "y": 0.0, "z": float(np.sin(yaw(t) / 2.0)), "w": float(np.cos(yaw(t) / 2.0))}
        transform = {"translation": dict(zip("xyz", place(t), strict=True)), "rotation": turn}
        points.append({"transforms": [transform], "velocities": [], "time_from_start": point["time_from_start"]})
    return {"header": {"frame_id": "world"}, "joint_names": ["virtual_joint"], "points": points}


def _whole(base: Data) -> Data:
    return {"joint_trajectory": MESSAGE, "multi_dof_joint_trajectory": base}


def test_a_base_that_a_fixed_robot_does_not_have_is_refused_if_it_moves(arm: PlanRequest) -> None:
    with pytest.raises(RequestError, match=r"moves the base \(by 1\.067 m at point 32\), and the base of arm is fixed"):
        _certify(_whole(_base(lambda t: [t / 3.0, 0.0, 0.0])), arm)
    outcome = _certify(_whole(_base(lambda t: [0.5, 0.0, 0.0])), arm)
    assert outcome.is_certified
    assert outcome.notes == (
        "the trajectory gives a base that stays at [0.5, 0.0, 0.0] m, and that of arm is fixed: not compared",
    )


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda b: b["joint_names"].append("arm"), "moves 2 joints by multi_dof_joint_trajectory"),
        (lambda b: b["points"].pop(), "multi_dof_joint_trajectory has 32 points, joint_trajectory 33"),
        (lambda b: b["points"][4].update(time_from_start=0.45), r"point 4 of multi.* at 0\.45 s, of joint_tr.* 0\.4 s"),
        (lambda b: b["points"][4].update(transforms=[]), "point 4 has 0 transforms; expected one"),
        (lambda b: b["points"][4]["transforms"][0].pop("rotation"), "rotation of point 4 is None; expected w, x, y, z"),
        (lambda b: b["points"][4]["transforms"][0]["rotation"].update(w=0.0), "quaternion at point 4 has the length 0"),
    ],
    ids=["two joints", "one point less", "another time", "no transform", "no rotation", "no quaternion"],
)  # fmt: skip
def test_a_malformed_base_is_refused(arm: PlanRequest, change: Callable[[Data], object], words: str) -> None:
    base = _base(lambda t: [0.0, 0.0, 0.0])
    change(base)
    with pytest.raises(RequestError, match=words):
        _certify(_whole(base), arm)


def test_a_planar_base_moves_in_its_plane(tmp_path: Path) -> None:
    data = make_request(tmp_path)
    data["robot"]["root"] = "planar"
    data["goal"]["joints"] |= {"base_x": -0.2, "base_yaw": 0.1}
    request = parse_request(data)

    def ease(t: float) -> float:
        s = t / 3.2
        return s**3 * (10.0 - 15.0 * s + 6.0 * s**2)

    base = _base(lambda t: [-0.2 * ease(t), 0.0, 0.0], lambda t: 0.1 * ease(t))
    outcome = _certify(_whole(base), request, interpolation="spline")
    assert outcome.is_certified, outcome.failures
    linear = _certify(_whole(base), request)
    assert "'virtual_joint' moves and has no velocities: those of the joints are not used" in linear.notes[0]
    assert not linear.is_certified
    times = [point["time_from_start"] for point in base["points"]]
    for point, stamp in zip(base["points"], times, strict=True):
        s = (stamp["sec"] + 1e-9 * stamp["nanosec"]) / 3.2
        rate = 30.0 * s**2 * (1.0 - s) ** 2 / 3.2
        linear_rate = {"x": -0.2 * rate, "y": 0.0, "z": 0.0}
        point["velocities"] = [{"linear": linear_rate, "angular": {"x": 0.0, "y": 0.0, "z": 0.1 * rate}}]
    outcome = _certify(_whole(base), request)
    assert (outcome.is_certified, outcome.interpolation) == (True, "cubic"), outcome.failures
    base["points"][9]["transforms"][0]["translation"]["z"] = 0.3
    with pytest.raises(RequestError, match=r"the base leaves its plane at point 9: base_z is 0\.3, expected 0"):
        _certify(_whole(base), request)


def test_a_base_in_another_frame_is_noted_and_one_in_the_start_state_compared(tmp_path: Path) -> None:
    data = make_request(tmp_path)
    data["robot"]["root"] = "planar"
    request = parse_request(data)
    base = _base(lambda t: [0.0, 0.0, 0.0])
    base["header"]["frame_id"] = "odom"
    outcome = _certify(_whole(base), request)
    assert outcome.is_certified, outcome.failures
    assert outcome.notes[0] == "poses of 'virtual_joint' are read in the request's world; their frame_id is 'odom'"
    elsewhere = _base(lambda t: [0.4, 0.0, 0.0])["points"][0]["transforms"]
    state = {"multi_dof_joint_state": {"joint_names": ["virtual_joint"], "transforms": elsewhere}}
    outcome = _certify({**_whole(base), "trajectory_start": state}, request)
    assert outcome.failures[0].startswith("trajectory_start has base_x at 0.4000, the request's start has 0.0000")


@pytest.mark.skipif(not LIES.is_dir(), reason="../shared/cases is not there")
@pytest.mark.parametrize("interpolation", ["auto", "spline"])
def test_a_base_that_moves_by_1_m_under_a_turn_of_the_neck_is_refuted(interpolation: Any) -> None:
    folder = LIES / "certify_multi"
    outcome = certify(read_trajectory(folder / "plan.json"), load_request(folder / "request.yaml"), interpolation)
    assert not outcome.is_certified
    assert any("foot" in check.text and not check.ok for check in outcome.certificate.checks)


def test_our_own_export_with_its_base_is_certified(tmp_path: Path) -> None:
    pytest.importorskip("rosbags", reason="the extra 'ros' reads bags")
    pytest.importorskip("mcap", reason="the extra 'ros' writes MCAP")
    request = load_request(Path(__file__).parents[2] / "examples" / "requests" / "pose_goal.yaml")
    result = plan(request)
    path = export(result, "mcap", tmp_path / "plan.mcap")
    outcome = certify(read_trajectory(path, "/display_planned_path"), request, robot=result.robot)
    assert outcome.is_certified, outcome.failures
    assert outcome.notes[:2] == (
        "accelerations are not used, since those of 'virtual_joint' are not known",
        "the bag's trajectories on '/joint_trajectory' are not read",
    )


@pytest.mark.parametrize("seed", range(5))
def test_twists_in_the_axes_of_the_world_give_the_rates_of_the_angles(seed: int) -> None:
    rng = np.random.default_rng(seed)
    place, rates = rng.uniform(-1.2, 1.2, 6), rng.uniform(-1.0, 1.0, 6)
    h = 1e-6

    def turn(t: float) -> Rotation:
        return Rotation.from_euler("ZYX", place[3:] + t * rates[3:])

    angular = (turn(h) * turn(-h).inv()).as_rotvec() / (2.0 * h)
    points = []
    for k in range(2):
        pose = place + k * rates
        w, x, y, z = Rotation.from_euler("ZYX", pose[3:]).as_quat(scalar_first=True).tolist()
        transform = {
            "translation": dict(zip("xyz", pose[:3], strict=True)),
            "rotation": {"w": w, "x": x, "y": y, "z": z},
        }
        twist = {"linear": dict(zip("xyz", rates[:3], strict=True)), "angular": dict(zip("xyz", angular, strict=True))}
        points.append({"transforms": [transform], "velocities": [twist], "time_from_start": float(k)})
    motion = read_base_motion({"joint_names": ["virtual_joint"], "points": points}, "plan")
    assert motion is not None
    assert motion.rates is not None
    np.testing.assert_allclose(motion.rates[0], rates, atol=1e-8)


def test_a_base_alone_is_a_trajectory(tmp_path: Path) -> None:
    data = make_request(tmp_path)
    data["robot"]["root"] = "planar"
    data["goal"] = {"joints": {"base_x": -0.2}}
    base = _base(lambda t: [-0.2 * (t / 3.2) ** 2 * (3.0 - 2.0 * t / 3.2), 0.0, 0.0])
    outcome = _certify(
        {"joint_trajectory": {}, "multi_dof_joint_trajectory": base}, parse_request(data), interpolation="spline"
    )
    assert outcome.is_certified, outcome.failures
    assert (
        outcome.notes[0]
        == "the trajectory leaves out base, shoulder, elbow, wrist: taken to stay at the request's start"
    )


def test_the_certificate_that_is_written_has_the_notes_on_the_trajectory(tmp_path: Path) -> None:
    (tmp_path / "request.json").write_text(json.dumps(make_request(tmp_path)))
    (tmp_path / "plan.json").write_text(json.dumps(_display(model_id="panda")))
    command = ["certify", tmp_path / "plan.json", "-r", tmp_path / "request.json", "--certificate", tmp_path / "c.json"]
    done = CliRunner().invoke(app, [str(word) for word in command])
    assert done.exit_code == 0, done.output
    note = "model_id is 'panda', the request's robot is 'arm': held to the request's"
    assert note in json.loads((tmp_path / "c.json").read_text())["notes"]
    assert f"note: {note}" in done.stdout
