"""A real server whose folder of robots changes while it runs."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import grpc
import pytest
from planner_calls import finished, plan_request, refusal, uploaded
from planner_server import planner_server

from service.proto.planner.v1 import planner_pb2 as wire
from service.proto.planner.v1.planner_pb2_grpc import PlannerServiceStub
from service.proto.planner.v1.result_pb2 import VERDICT_CERTIFIED

pytestmark = pytest.mark.filterwarnings("error")

URDF = """<robot name="swinger"><link name="base"/><link name="tip">
<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><geometry><box size="0.1 0.1 0.5"/></geometry></collision></link>
<joint name="swing" type="revolute"><parent link="base"/><child link="tip"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="{upper}" velocity="1" effort="10"/></joint></robot>"""


@pytest.fixture
def robots(tmp_path: Path) -> Path:
    folder = tmp_path / "robots"
    folder.mkdir()
    return folder


@pytest.fixture
def stub(tmp_path: Path, robots: Path) -> Iterator[PlannerServiceStub]:
    with (
        planner_server(tmp_path / "data", "--robots", str(robots)) as started,
        grpc.insecure_channel(started.address) as channel,
    ):
        yield PlannerServiceStub(channel)


def test_robots_come_change_break_and_go_while_the_server_runs(stub: PlannerServiceStub, robots: Path) -> None:
    post = {"name": "post", "type": "box", "size": [0.1, 0.1, 0.1], "position": [1, 0, 0]}
    goal, scene = {"joints": {"swing": 1.5}}, {"obstacles": [post]}
    message = plan_request({"robot": {"name": "swinger"}, "goal": goal, "scene": scene})

    def told() -> str:
        return refusal(lambda: list(stub.Plan(message, timeout=240)))[1]

    def described() -> dict[str, str]:
        return {one.name: one.description for one in stub.ListRobots(wire.ListRobotsRequest(), timeout=240).robots}

    (robots / "other").mkdir()
    (robots / "other" / "robot.urdf").write_text(URDF.format(upper=1))
    assert told() == "robot.name: unknown robot 'swinger'; expected atlas, other"
    urdf = robots / "swinger" / "robot.urdf"
    urdf.parent.mkdir()
    urdf.write_text(URDF.format(upper=1))
    assert "1.5 is outside the joint's limits; expected -1 to 1" in told()
    urdf.write_text(URDF.format(upper=2.5))
    assert finished(stub.Plan(message, timeout=240)).result.verdict == VERDICT_CERTIFIED
    assert described()["swinger"] == "1 degrees of freedom"
    urdf.write_text("<robot")
    assert told().startswith("robot: swinger/robot.urdf: not well-formed XML")
    assert described()["swinger"].startswith("cannot be used: robot: swinger/robot.urdf: not well-formed XML")
    urdf.unlink()
    assert "unknown robot 'swinger'" in told()
    assert set(described()) == {"other", "atlas"}


def test_own_robot_of_a_shipped_name_takes_its_place_and_the_server_says_so(tmp_path: Path, robots: Path) -> None:
    (robots / "atlas").mkdir()
    (robots / "atlas" / "robot.urdf").write_text(URDF.format(upper=1))
    with (
        planner_server(tmp_path / "data", "--robots", str(robots)) as started,
        grpc.insecure_channel(started.address) as channel,
    ):
        (told,) = PlannerServiceStub(channel).ListRobots(wire.ListRobotsRequest(), timeout=240).robots
        assert told.description == (
            "1 degrees of freedom (this server's own, which overrides scopt's robot of that name)"
        )
        (line,) = [
            line for line in map(json.loads, started.log.read_text().splitlines()) if "override" in line["event"]
        ]
        assert (line["level"], line["names"]) == ("warning", ["atlas"])


def test_own_robot_is_left_out_of_a_scan(stub: PlannerServiceStub, robots: Path) -> None:
    urdf = robots / "swinger" / "robot.urdf"
    urdf.parent.mkdir()
    urdf.write_text(URDF.format(upper=1))
    points = [(x, y, z) for x in (-0.05, 0.0, 0.05) for y in (-0.05, 0.0, 0.05) for z in (0.05, 0.1, 0.2)]
    points += [(1.0, 0.02 * i, 0.02 * j) for i in range(20) for j in range(20)]
    cloud = "".join(f"{x} {y} {z}\n" for x, y, z in points).encode()
    cloud_id = stub.UploadCloud(uploaded(cloud, format="xyz"), timeout=120).cloud_id

    def built(robot: str) -> wire.BuildSceneRequest:
        clouds = wire.CloudsSpec(clouds=[{"file": cloud_id}], sensor=(3.0, 0.0, 0.2), robot=robot)  # type: ignore[list-item]
        return wire.BuildSceneRequest(clouds=clouds)

    scene = list(stub.BuildScene(built("swinger"), timeout=240))[-1].scene
    assert scene.figures["robot_points"] == 27
    assert "left out 27 points on the robot itself" in scene.notes
    fields = refusal(lambda: list(stub.BuildScene(built("nobody"), timeout=240)))[2]
    assert fields == {
        "clouds.robot": "clouds.robot: unknown robot 'nobody'; expected atlas; this server also has swinger"
    }
    for name in ("", "n" * 300, "a/b", "\0", "../swinger"):
        code, _, fields = refusal(lambda name=name: list(stub.BuildScene(built(name), timeout=240)))  # type: ignore[misc]
        assert (code, list(fields)) == ("INVALID_ARGUMENT", ["clouds.robot"]), name
