"""Robots whose base slides and turns on the ground, without a joint for that in their URDF."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from robot_files import joint, link, robot, write_urdf

from costs.robot import RobotError, load_robot
from service import RequestError, certify, parse_request, plan, prepare, read_trajectory, write_result
from service.errors import ResultError
from service.execution.reference import PlannedReference
from service.replay.replay import verify_result

WIDE = '<limit lower="-2" upper="2" velocity="2" effort="60"/>'
WALL = {"name": "wall", "type": "box", "size": [0.2, 3.0, 2.0], "position": [1.5, 0.3, 1.0]}
SRDF = """<robot name="car"><virtual_joint name="world" type="planar" parent_frame="odom" child_link="base"/>
<group name="arm"><joint name="lift"/></group>
<group_state name="home" group="arm"><joint name="lift" value="-0.5"/><joint name="world" value="0.1 0.2 0.5"/>
</group_state></robot>"""


def _write_car(folder: Path) -> Path:
    mass = '<inertial><mass value="2"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    lift = joint("lift", "base", "arm", inside=WIDE, xyz="0.4 0 0.5").replace('xyz="0 0 1"', 'xyz="0 1 0"')
    return write_urdf(
        folder,
        robot(
            link("base", '<box size="0.6 0.5 0.3"/>').replace("</link>", mass),
            link("arm", '<box size="0.1 0.1 0.3"/>').replace("</link>", mass),
            lift,
        ),
    )


def _request(folder: Path, base: dict[str, Any] | None = None, root: str = "planar", **fields: Any) -> Any:
    (folder / "car.srdf").write_text(SRDF)
    data = {
        "robot": {"urdf": str(_write_car(folder)), "srdf": str(folder / "car.srdf"), "root": root},
        "start": {"posture": "home", **({} if base is None else {"base": base})},
        "goal": {"joints": {"base_x": 3.0, "base_y": 0.5, "base_yaw": 1.0, "lift": 0.2}},
        **fields,
    }
    return parse_request(data, folder=folder)


def test_a_base_drives_around_a_wall_and_its_record_is_verified(tmp_path: Path) -> None:
    # The base is drawn 1 cm into the floor on which its wheels stand.
    request = _request(tmp_path, scene={"obstacles": [WALL], "floor": -0.14})
    result = plan(request)
    assert result.verdict.value == "CERTIFIED", result.explanation
    assert result.joint_names == ("base_x", "base_y", "base_yaw", "lift")
    np.testing.assert_allclose(result.positions[[0, -1]], [[0.1, 0.2, 0.5, -0.5], [3.0, 0.5, 1.0, 0.2]], atol=1e-6)
    assert np.abs(result.velocities[:, :2]).max() <= 1.0
    # The straight line is inside the wall, which is 3 m wide.
    assert np.abs(result.positions[:, 1] - 0.3).max() > 1.5
    folder = tmp_path / "out"
    write_result(result, folder)
    assert verify_result(folder)["verdict"] == "CERTIFIED"
    outcome = certify(read_trajectory(folder / "trajectory.csv"), request)
    assert outcome.is_certified, outcome.failures
    with pytest.raises(ResultError, match=r"robot\.root is planar, and nothing drives the base"):
        PlannedReference.read(folder)


def test_what_drives_on_a_floor_may_not_be_deep_in_it(tmp_path: Path) -> None:
    with pytest.raises(RequestError, match="start is in collision: base is 30 mm inside floor"):
        prepare(_request(tmp_path, scene={"floor": -0.12}))


def test_a_joint_that_nothing_asks_to_move_stays_at_its_limit(tmp_path: Path) -> None:
    at_limit = {"joints": {"lift": -2.0, "base_x": 0.0}}
    result = plan(_request(tmp_path, start=at_limit, goal={"joints": {"base_x": 1.0}}, scene={"floor": -0.15}))
    assert result.verdict.value == "CERTIFIED", result.explanation
    np.testing.assert_allclose(result.positions[:, 3], -2.0, atol=1e-9)


def test_a_start_pose_of_the_base_lies_in_the_plane(tmp_path: Path) -> None:
    turned = {"position": [1.0, -2.0, 0.0], "quaternion_wxyz": [np.cos(0.4), 0.0, 0.0, np.sin(0.4)]}
    np.testing.assert_allclose(prepare(_request(tmp_path, turned)).start, [1.0, -2.0, 0.8, -0.5])
    for base, words in (
        ({"position": [0.0, 0.0, 0.4]}, "height of 0.4 m"),
        ({"position": [0.0, 0.0, 0.0], "quaternion_wxyz": [0.99, 0.14, 0.0, 0.0]}, "tilt"),
        ({"position": [11.0, 0.0, 0.0]}, "base_x: 11 is outside"),
    ):
        with pytest.raises(RequestError, match=words):
            prepare(_request(tmp_path, base))


def test_a_fixed_root_leaves_the_base_where_it_is_and_says_what_would_move_it(tmp_path: Path) -> None:
    _request(tmp_path)
    fixed = load_robot(urdf=tmp_path / "robot.urdf", srdf=tmp_path / "car.srdf")
    assert fixed.joint_names == ("lift",)
    np.testing.assert_allclose(fixed.postures["home"], [-0.5])
    assert "`robot.root: planar` lets the base move" in " ".join(fixed.notes)
    floating = load_robot(urdf=tmp_path / "robot.urdf", srdf=tmp_path / "car.srdf", root="floating")
    assert not floating.is_planar
    np.testing.assert_allclose(floating.postures["home"], [0.1, 0.2, 0.0, 0.5, 0.0, 0.0, -0.5])


def test_a_planar_root_belongs_to_robots_by_urdf_without_one(tmp_path: Path) -> None:
    with pytest.raises(RequestError, match="root planar belongs to a robot given by urdf"):
        parse_request({"robot": {"name": "atlas", "root": "planar"}, "goal": {"joints": {"any": 0.0}}}, folder=tmp_path)
    drive = joint("drive", "floor", "base", "planar", "")
    urdf = write_urdf(tmp_path, robot(link("floor"), link("base", '<box size="1 1 1"/>'), drive))
    with pytest.raises(RobotError, match="'drive' is a planar base already"):
        load_robot(urdf=urdf, root="planar")
