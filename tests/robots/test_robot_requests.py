"""What a request may say about a robot's joints, and what the command line tells of a robot."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from robot_files import joint, link, robot, write_urdf
from stranger import check_folder
from typer.testing import CliRunner

from costs.scene import ConvexPiece, Scene
from service import RequestError, load_request, parse_request, plan, prepare, read_result, write_result
from service.cli.app import app
from service.start.robot import load_requested_robot
from service.start.robot_report import check_robot
from service.verify import Status, verify

WIDE = '<limit lower="-3" upper="3" velocity="2" effort="60"/>'
BOX = '<box size="0.1 0.1 0.3"/>'
FINGER = '<box size="0.02 0.02 0.1"/>'


def _part(name: str, shape: str, mass: float = 1.0) -> str:
    inertia = '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/>'
    inertial = f'<inertial><mass value="{mass}"/>{inertia}</inertial>'
    return link(name, shape).replace("</link>", inertial + "</link>")


def _gripper_text(apart: float = 0.1) -> str:
    """An arm of two links with a gripper whose fingers move together."""
    slide = '<limit lower="0" upper="0.04" velocity="0.2" effort="20"/>'
    follow = '<mimic joint="left" multiplier="-1" offset="0"/>'
    narrow = slide.replace('lower="0" upper="0.04"', 'lower="-0.04" upper="0"')

    def finger(name: str, child: str, x: float, inside: str) -> str:
        return joint(name, "fore", child, "prismatic", inside, f"{x} 0 0.35").replace(
            'axis xyz="0 0 1"', 'axis xyz="1 0 0"'
        )

    return robot(
        _part("base", BOX), _part("upper", BOX), _part("fore", BOX), _part("lf", FINGER), _part("rf", FINGER),
        joint("turn", "base", "upper", inside=WIDE, xyz="0 0 0.5"),
        joint("bend", "upper", "fore", inside=WIDE, xyz="0.2 0 0.3").replace('axis xyz="0 0 1"', 'axis xyz="0 1 0"'),
        finger("left", "lf", 0.5 * apart, slide), finger("right", "rf", -0.5 * apart, narrow + follow),
    )  # fmt: skip


def _request(folder: Path, robot_fields: dict[str, Any] | None = None, **fields: Any) -> Any:
    urdf = write_urdf(folder, _gripper_text())
    goal = {"joints": {"turn": 0.6, "left": 0.03}}
    return parse_request({"robot": {"urdf": str(urdf), **(robot_fields or {})}, "goal": goal, **fields}, folder=folder)


def test_a_gripper_with_a_follower_is_planned_certified_and_checked_again(tmp_path: Path) -> None:
    box = {"name": "post", "type": "box", "size": [0.1, 0.1, 0.4], "position": [0.5, 0.5, 0.8]}
    result = plan(_request(tmp_path, scene={"obstacles": [box]}))
    assert result.verdict.value == "CERTIFIED"
    folder = tmp_path / "out"
    write_result(result, folder)
    assert read_result(folder)["trajectory"]["joint_names"] == ["turn", "bend", "left"]
    outcome = CliRunner().invoke(app, ["verify", str(folder)])
    assert outcome.stdout.strip().splitlines()[-1].startswith("CERTIFIED"), outcome.stdout


def test_a_follower_that_meets_an_obstacle_is_found(tmp_path: Path) -> None:
    motion = plan(_request(tmp_path)).motion
    assert motion is not None
    # The fingers open; only the right one, which follows, moves into the pin.
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * [0.005, 0.025, 0.025]
    inside = Scene((ConvexPiece("pin", corners + np.array([0.12, 0.0, 1.15]), "obstacle"),))
    still = replace(
        motion,
        scene=inside,
        curve=replace(
            motion.curve, positions=motion.curve.positions * [0, 0, 1], tangents=motion.curve.tangents * [0, 0, 1]
        ),
    )
    certificate = verify(still)
    assert certificate.status is Status.VIOLATED
    assert any("rf" in check.text and "pin" in check.text for check in certificate.failed()), certificate.failed()


def test_locked_joints_are_fixed_and_unknown_ones_refused(tmp_path: Path) -> None:
    locked = load_requested_robot(_request(tmp_path, {"locked": {"bend": 0.5}}))
    assert locked.joint_names == ("turn", "left")
    with pytest.raises(RequestError, match="locked joint 'bent' is not a movable joint; expected turn, bend"):
        load_requested_robot(_request(tmp_path, {"locked": {"bent": 0.5}}))
    with pytest.raises(RequestError, match=r"'bend' at 30 is outside its limits; expected -3 to 3.* Use 0\.523599"):
        load_requested_robot(_request(tmp_path, {"locked": {"bend": 30.0}}))
    with pytest.raises(RequestError, match=r"'left' at 0\.5 is outside its limits; expected 0 to 0\.04$"):
        load_requested_robot(_request(tmp_path, {"locked": {"left": 0.5}}))
    with pytest.raises(RequestError, match=r"goal\.joints\.turn: robot\.locked fixes this joint"):
        prepare(_request(tmp_path, {"locked": {"turn": 0.5}}))


def test_torques_are_left_out_where_the_request_says_so(tmp_path: Path) -> None:
    some = load_requested_robot(_request(tmp_path, {"torque": {"unchecked": ["bend"]}}))
    np.testing.assert_array_equal(some.effort, [60.0, np.inf, 20.0])
    result = plan(_request(tmp_path, {"torque": {"check": False}}))
    assert result.certificate is not None
    assert result.certificate.coverage.joints_without_torque_limit == ("turn", "bend", "left")
    with pytest.raises(RequestError, match=r"unknown joint 'bent' in robot\.torque\.unchecked"):
        load_requested_robot(_request(tmp_path, {"torque": {"unchecked": ["bent"]}}))


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (90.0, "joints are in radians, are these degrees? Use 1.5708."),
        (3.2, "expected -3 to 3"),
        (-170.0, "Use -2.96706."),
    ],
)
def test_degrees_in_joint_goals_are_recognised(tmp_path: Path, value: float, words: str) -> None:
    request = _request(tmp_path)
    request = parse_request(
        {"robot": {"urdf": request.robot.urdf}, "goal": {"joints": {"turn": value}}}, folder=tmp_path
    )
    with pytest.raises(RequestError) as refusal:
        prepare(request)
    assert words in str(refusal.value)
    assert ("degrees" in str(refusal.value)) == (value != 3.2)


def _scopt(*arguments: object) -> Any:
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def test_robots_tells_joints_links_and_followers_of_a_urdf(tmp_path: Path) -> None:
    urdf = write_urdf(tmp_path, _gripper_text())
    told = json.loads(_scopt("robots", urdf, "--json").stdout)
    assert [(one["name"], one["unit"], one["lower"], one["upper"]) for one in told["joints"]] == [
        ("turn", "rad", -3.0, 3.0), ("bend", "rad", -3.0, 3.0), ("left", "m", 0.0, 0.04),
    ]  # fmt: skip
    assert told["followers"] == [{"name": "right", "follows": "left", "multiplier": -1.0, "offset": 0.0}]
    assert [one["shapes"] for one in told["links"]] == [1] * 5
    text = _scopt("robots", urdf).stdout
    assert "right     -1 x left +0" in text
    assert _scopt("robots", tmp_path / "none.urdf").exit_code == 3
    assert _scopt("robots", "atlas", "--json").exit_code == 0


def test_check_proposes_an_srdf_for_links_that_overlap_at_rest(tmp_path: Path) -> None:
    urdf = write_urdf(tmp_path, _gripper_text(apart=0.01))
    with pytest.raises(RequestError, match="scopt robots check URDF --write-srdf FILE"):
        prepare(parse_request({"robot": {"urdf": str(urdf)}, "goal": {"joints": {"turn": 0.5}}}, folder=tmp_path))
    srdf = tmp_path / "robot.srdf"
    told = json.loads(_scopt("robots", "check", urdf, "--write-srdf", srdf, "--json").stdout)
    assert [pair["links"] for pair in told["overlapping"]] == [["lf", "rf"]]
    data = {"robot": {"urdf": str(urdf), "srdf": str(srdf)}, "goal": {"joints": {"turn": 0.5}}}
    model = load_requested_robot(parse_request(data, folder=tmp_path))
    assert model.ignored_reasons["lf", "rf"] == "srdf (Default)"
    assert not check_robot(model).overlapping
    # What is left out although it overlaps is certified as it is at the start alone.
    still = plan(parse_request(data, folder=tmp_path))
    assert still.certificate is not None
    assert [own.reason for own in still.certificate.coverage.left_out if own.pair == ("lf", "rf")] == ["kept"]
    data["goal"] = {"joints": {"turn": 0.5, "left": 0.002}}
    assert plan(parse_request(data, folder=tmp_path)).verdict.value == "FEASIBLE_AT_SAMPLES"


def test_a_request_file_may_lock_joints_and_leave_torques_out(tmp_path: Path) -> None:
    write_urdf(tmp_path, _gripper_text())
    path = tmp_path / "r.yaml"
    path.write_text(
        "robot: {urdf: robot.urdf, locked: {bend: 0.2}, torque: {check: false}}\ngoal: {joints: {turn: 0.3}}\n"
    )
    assert load_request(path).robot.locked == {"bend": 0.2}


def test_a_stranger_replays_the_certificate_of_a_gripper(tmp_path: Path) -> None:
    box = {"name": "post", "type": "box", "size": [0.1, 0.1, 0.4], "position": [0.5, 0.5, 0.8]}
    write_result(plan(_request(tmp_path, scene={"obstacles": [box]})), tmp_path / "out")
    code, said = check_folder(tmp_path / "out")
    assert code == 0, said
    # Another file is another robot.
    urdf = tmp_path / "out" / "robot" / "robot.urdf"
    urdf.write_text(urdf.read_text().replace('multiplier="-1"', 'multiplier="-9"'))
    assert check_folder(tmp_path / "out")[0] == 1


def _walker(folder: Path, **fields: Any) -> Any:
    """A body on two legs of half a metre, each with a foot; nothing says where its base is or which links are feet."""
    leg, foot = '<box size="0.08 0.08 0.3"/>', '<box size="0.2 0.1 0.04"/>'
    text = robot(
        _part("trunk", '<box size="0.2 0.4 0.3"/>', 5.0),
        *(_part(f"{side}_{name}", shape) for side in "lr" for name, shape in (("leg", leg), ("foot", foot))),
        *(joint(f"{side}_hip", "trunk", f"{side}_leg", inside=WIDE, xyz=f"0 {y} -0.4") for side, y in HIPS),
        *(joint(f"{side}_ankle", f"{side}_leg", f"{side}_foot", inside=WIDE, xyz="0 0 -0.25") for side in "lr"),
    )  # fmt: skip
    urdf = write_urdf(folder, text)
    request = {"robot": {"urdf": str(urdf), "root": "floating"}, "scene": {"floor": True}}
    return parse_request({**request, "goal": {"joints": {"l_hip": 0.0}}, **fields}, folder=folder)


HIPS = (("l", 0.15), ("r", -0.15))
FEET = {"options": {"feet": ["l_foot", "r_foot"]}}


def test_a_robot_that_nothing_places_stands_with_its_lowest_sole_at_0(tmp_path: Path) -> None:
    setup = prepare(_walker(tmp_path, **FEET))
    assert setup.start[2] == pytest.approx(0.4 + 0.25 + 0.02)
    assert setup.notes[-1].startswith("start: neither base nor posture says where the base is; it is 0.6700 m high")
    again = plan(_walker(tmp_path, **FEET))
    assert again.verdict.value == "CERTIFIED"
    write_result(again, tmp_path / "out")
    outcome = CliRunner().invoke(app, ["verify", str(tmp_path / "out")])
    assert outcome.stdout.strip().splitlines()[-1].startswith("CERTIFIED"), outcome.stdout


def test_a_base_that_the_start_gives_stays_there(tmp_path: Path) -> None:
    base = {"position": [0.3, 0.0, 0.67], "quaternion_wxyz": [1.0, 0.0, 0.0, 0.0]}
    setup = prepare(_walker(tmp_path, start={"base": base}, **FEET))
    np.testing.assert_array_equal(setup.start[:6], [0.3, 0.0, 0.67, 0.0, 0.0, 0.0])


def test_the_links_that_could_be_feet_are_named(tmp_path: Path) -> None:
    words = r"list the planted links \(lowest at the start: l_foot, r_foot\)"
    with pytest.raises(RequestError, match=words):
        prepare(_walker(tmp_path))


def test_links_that_cannot_be_drawn_are_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(RequestError, match="drawn link 'bass' is unknown; expected base"):
        load_requested_robot(_request(tmp_path, {"drawn_links": ["bass"]}))
    text = _gripper_text().replace(
        "</robot>", '<link name="flange"/>' + joint("weld", "fore", "flange", "fixed", "") + "</robot>"
    )
    urdf = write_urdf(tmp_path, text)
    request = parse_request(
        {"robot": {"urdf": str(urdf), "drawn_links": ["flange"]}, "goal": {"joints": {"turn": 0.1}}}, folder=tmp_path
    )
    with pytest.raises(RequestError, match="drawn link 'flange' has no <visual>; give it a <collision>"):
        load_requested_robot(request)
    with pytest.raises(RequestError, match="drawn_links belong to a robot given by urdf"):
        parse_request({"robot": {"name": "atlas", "drawn_links": ["l_hand"]}, "goal": {"posture": "stand"}})
