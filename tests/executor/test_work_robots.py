"""Robots stay loaded until their files change; a server's own robots are named by their folder."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from costs.robot import bundled_robots
from service.errors import RequestError
from service.request.file import parse_request
from service.request.schema import PlanRequest, RobotRequest
from service.request.tasks.reach import GoalRequest
from service.server.robots import RobotFolder
from service.work.look import describe_robots
from service.work.robots import RobotCache

URDF = """<robot name="{name}"><link name="base"/><link name="tip">
<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><geometry><box size="0.1 0.1 {height}"/></geometry></collision></link>
<joint name="swing" type="revolute"><parent link="base"/><child link="tip"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" velocity="1" effort="10"/></joint></robot>"""


def _request(robot: RobotRequest) -> PlanRequest:
    return PlanRequest(robot=robot, goal=GoalRequest(posture="-"))


def _write(path: Path, height: float, changed_s: int) -> None:
    path.write_text(URDF.format(name=path.parent.name, height=height))
    os.utime(path, (changed_s, changed_s))


def test_robot_is_loaded_once_and_anew_when_its_file_changes(tmp_path: Path) -> None:
    urdf = tmp_path / "robot.urdf"
    _write(urdf, 0.5, 1)
    robots, request = RobotCache(), _request(RobotRequest(urdf=str(urdf)))
    first = robots.get(request)
    assert robots.get(request) is first
    _write(urdf, 0.7, 2)
    second = robots.get(request)
    assert second is not first
    assert second.bodies[0].vertices[:, 2].max() == pytest.approx(0.35)


def test_robot_used_least_recently_goes_first(tmp_path: Path) -> None:
    requests = []
    for name in ("a", "b", "c"):
        (tmp_path / name).mkdir()
        _write(tmp_path / name / "robot.urdf", 0.5, 1)
        requests.append(_request(RobotRequest(urdf=str(tmp_path / name / "robot.urdf"))))
    robots = RobotCache(max_robots=2)
    first, second = robots.get(requests[0]), robots.get(requests[1])
    assert robots.get(requests[0]) is first
    robots.get(requests[2])
    assert robots.get(requests[0]) is first
    assert robots.get(requests[1]) is not second


def test_file_that_has_gone_is_told(tmp_path: Path) -> None:
    urdf = tmp_path / "robot.urdf"
    _write(urdf, 0.5, 1)
    robots, request = RobotCache(), _request(RobotRequest(urdf=str(urdf)))
    robots.get(request)
    urdf.unlink()
    with pytest.raises(RequestError, match="is not there"):
        robots.get(request)


def test_folder_gives_its_robots_names(tmp_path: Path) -> None:
    (tmp_path / "swinger").mkdir()
    _write(tmp_path / "swinger" / "robot.urdf", 0.5, 1)
    (tmp_path / "notes").mkdir()
    folder = RobotFolder(tmp_path)
    assert set(folder.requests()) == {"swinger"}
    placed = folder.insert_files(_request(RobotRequest(name="swinger")))
    assert placed.robot.urdf == str(tmp_path.resolve() / "swinger" / "robot.urdf")
    assert RobotCache().get(placed).joint_names == ("swing",)
    atlas = _request(RobotRequest(name="atlas"))
    assert folder.insert_files(atlas) == atlas


def test_what_a_request_says_about_a_robot_of_the_folder_stays(tmp_path: Path) -> None:
    (tmp_path / "swinger").mkdir()
    _write(tmp_path / "swinger" / "robot.urdf", 0.5, 1)
    patch = {"link": "tip", "points": [[0.05, 0.0, 0.1]], "normal": [-1.0, 0.0, 0.0]}
    hand = {"link": "tip", "hook": "tip", "tool": "tip"}
    data = {"name": "swinger", "root": "floating", "contacts": {"side": patch}, "hands": {"left": hand}}
    request = parse_request({"robot": data, "goal": {"posture": "-"}})
    placed = RobotFolder(tmp_path).insert_files(request)
    assert placed.robot.contacts == request.robot.contacts
    robot = RobotCache().get(placed)
    assert (robot.contacts["side"].link, robot.hands["left"].tool) == ("tip", "tip")


def test_folder_comes_before_the_package_where_both_know_a_name(tmp_path: Path) -> None:
    (tmp_path / "atlas").mkdir()
    _write(tmp_path / "atlas" / "robot.urdf", 0.5, 1)
    folder = RobotFolder(tmp_path)
    (told,) = [robot for robot in describe_robots(folder.requests()) if robot["name"] == "atlas"]
    assert told["joint_names"] == ["swing"]
    assert RobotCache().get(folder.insert_files(_request(RobotRequest(name="atlas")))).joint_names == ("swing",)


def test_problems_name_the_folder_s_robots_and_not_where_it_is(tmp_path: Path) -> None:
    (tmp_path / "swinger").mkdir()
    _write(tmp_path / "swinger" / "robot.urdf", 0.5, 1)
    unknown, broken = RobotFolder(tmp_path).hide_paths(
        ["robot: unknown robot 'swingr'; known: atlas", f"{tmp_path.resolve()}/swinger/robot.urdf: has no links"]
    )
    assert unknown == "robot: unknown robot 'swingr'; known: atlas; this server also has swinger"
    assert broken == "swinger/robot.urdf: has no links"


@pytest.mark.parametrize("name", ["../swinger", "..", "a/b", "notes", "."])
def test_name_never_leads_out_of_the_folder(tmp_path: Path, name: str) -> None:
    (tmp_path / "robots" / "notes").mkdir(parents=True)
    (tmp_path / "swinger").mkdir()
    _write(tmp_path / "swinger" / "robot.urdf", 0.5, 1)
    request = _request(RobotRequest(name=name))
    assert RobotFolder(tmp_path / "robots").insert_files(request) == request


def test_robot_that_cannot_be_read_says_so_in_the_list(tmp_path: Path) -> None:
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "robot.urdf").write_text("<robot")
    found = {robot["name"]: robot for robot in describe_robots(RobotFolder(tmp_path).requests())}
    assert set(found) == {"broken", *bundled_robots()}
    assert "cannot be used" in found["broken"]["description"]
    assert "stand" in found["atlas"]["postures"]
