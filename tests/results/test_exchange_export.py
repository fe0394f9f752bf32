"""Exports of a plan, each read by a program that did not write it."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import numpy as np
import pytest
import trimesh
import yaml
from other_planners import JOINTS, make_request

from service import RequestError, ResultError, certify, parse_request, plan, read_trajectory, write_result
from service.replay.exchange.export import export
from service.replay.exchange.recorded_plan import RecordedPlan
from service.replay.exchange.ros_messages import triangulate
from service.result.result import PlanResult


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> PlanResult:
    folder = tmp_path_factory.mktemp("arm")
    request = make_request(folder)
    urdf = Path(request["robot"]["urdf"])
    mesh = urdf.parent / "arm_parts" / "meshes" / "tip.obj"
    mesh.parent.mkdir(parents=True)
    trimesh.creation.box((0.05, 0.05, 0.05)).export(mesh)
    shape = '<link name="part3"><collision><geometry><mesh filename="package://arm_parts/meshes/tip.obj"/></geometry></collision>'
    urdf.write_text(urdf.read_text().replace('<link name="part3">', shape))
    return plan(parse_request(request))


def test_numpy_reads_the_arrays_and_they_are_certified(result: PlanResult, tmp_path: Path) -> None:
    write_result(result, tmp_path / "out")
    path = export(tmp_path / "out", "numpy", tmp_path / "out.npz")
    with np.load(path) as data:
        np.testing.assert_array_equal(data["positions"], result.positions)
        np.testing.assert_array_equal(data["accelerations"], result.accelerations)
        assert data["piece_names"].tolist() == ["post"]
        assert data["piece_vertices"].shape == (8, 3)
    outcome = certify(read_trajectory(path), result.request)
    assert outcome.is_certified, outcome.failures


def test_mcap_is_read_by_the_readers_of_mcap(result: PlanResult, tmp_path: Path) -> None:
    pytest.importorskip("rosbags", reason="the extra 'ros' writes messages")
    reader = pytest.importorskip("mcap_ros2.reader", reason="the reader of Foxglove for MCAP")
    path = export(result, "mcap", tmp_path / "plan.mcap")
    messages: dict[str, list[object]] = {}
    for message in reader.read_ros2_messages(str(path)):
        messages.setdefault(message.channel.topic, []).append(message.ros_msg)
    shown = messages["/display_planned_path"][0]
    points = shown.trajectory[0].joint_trajectory.points  # type: ignore[attr-defined]
    np.testing.assert_array_equal([point.velocities for point in points], result.velocities)
    assert list(shown.trajectory_start.joint_state.name) == list(JOINTS)  # type: ignore[attr-defined]
    assert len(messages["/joint_states"]) == len(result.times)
    piece = messages["/planning_scene"][0].world.collision_objects[0]  # type: ignore[attr-defined]
    corners = np.array([(v.x, v.y, v.z) for v in piece.meshes[0].vertices])
    body = trimesh.Trimesh(corners, [list(t.vertex_indices) for t in piece.meshes[0].triangles])
    assert piece.id == "post"
    assert body.is_watertight
    assert body.volume == pytest.approx(0.1 * 0.1 * 0.5)
    outcome = certify(read_trajectory(path), result.request)
    assert outcome.is_certified, outcome.failures


def test_a_bag_of_ros_2_is_read_by_sqlite_and_its_robot_by_yourdfpy(result: PlanResult, tmp_path: Path) -> None:
    pytest.importorskip("rosbags", reason="the extra 'ros' writes messages")
    decoder = pytest.importorskip("mcap_ros2.decoder", reason="another decoder of CDR")
    schema = pytest.importorskip("mcap.records", reason="another decoder of CDR")
    folder = export(result, "ros2", tmp_path / "plan-ros2")
    database = sqlite3.connect(folder / "bag" / "bag.db3")
    kinds = dict(database.execute("select name, type from topics"))
    assert kinds["/joint_trajectory"] == "trajectory_msgs/msg/JointTrajectory"
    query = "select data from messages join topics on topics.id = topic_id where name = '/joint_trajectory'"
    (raw,) = database.execute(query).fetchone()
    database.close()
    from service.replay.exchange.ros_messages import describe

    text = describe("trajectory_msgs/msg/JointTrajectory").encode()
    kind = schema.Schema(1, data=text, encoding="ros2msg", name="trajectory_msgs/msg/JointTrajectory")
    message = decoder.DecoderFactory().decoder_for("cdr", kind)(raw)
    np.testing.assert_array_equal([point.positions for point in message.points], result.positions)
    plain = yaml.safe_load((folder / "joint_trajectory.yaml").read_text())
    assert plain["joint_names"] == list(JOINTS)
    assert certify(read_trajectory(folder / "bag"), result.request).is_certified
    assert certify(read_trajectory(folder / "joint_trajectory.yaml"), result.request).is_certified


@pytest.mark.filterwarnings("ignore:.*DEPRECATED FOR REMOVAL:DeprecationWarning")  # of yourdfpy's use of trimesh
def test_yourdfpy_finds_the_meshes_of_the_exported_robot(result: PlanResult, tmp_path: Path) -> None:
    pytest.importorskip("rosbags", reason="the extra 'ros' writes messages")
    yourdfpy = pytest.importorskip("yourdfpy", reason="another reader of URDF")
    folder = export(result, "ros2", tmp_path / "plan-ros2")
    robot = yourdfpy.URDF.load(
        str(folder / "robot" / "robot.urdf"),
        load_meshes=False,
        build_scene_graph=False,
        load_collision_meshes=True,
        build_collision_scene_graph=True,
    )
    last_link = 0.13 * 0.06**2 + 0.05**3  # its box and its mesh
    assert any(mesh.volume == pytest.approx(last_link) for mesh in robot.collision_scene.geometry.values())
    assert tuple(robot.actuated_joint_names) == JOINTS


def test_an_export_replaces_only_an_earlier_one(result: PlanResult, tmp_path: Path) -> None:
    pytest.importorskip("rosbags", reason="the extra 'ros' writes messages")
    folder = tmp_path / "other"
    folder.mkdir()
    (folder / "thesis.tex").write_text("years of work")
    with pytest.raises(ResultError, match="holds no earlier export"):
        export(result, "ros2", folder)
    assert (folder / "thesis.tex").read_text() == "years of work"
    export(result, "ros2", tmp_path / "again")
    export(result, "ros2", tmp_path / "again")
    assert not list(tmp_path.glob(".again*"))


def test_a_plan_without_a_certificate_is_exported_only_on_demand(result: PlanResult, tmp_path: Path) -> None:
    from dataclasses import replace

    from service.result.result import Verdict

    doubtful = replace(result, verdict=Verdict.FEASIBLE_AT_SAMPLES)
    with pytest.raises(ResultError, match="--any-verdict"):
        export(doubtful, "numpy", tmp_path / "a.npz")
    assert export(doubtful, "numpy", tmp_path / "a.npz", any_verdict=True).is_file()
    with pytest.raises((ResultError, RequestError)):
        export(tmp_path / "nowhere", "numpy", tmp_path / "b.npz")


def test_triangles_of_a_piece_point_outwards() -> None:
    corners, triangles = triangulate(np.random.default_rng(1).normal(size=(20, 3)))
    assert trimesh.Trimesh(corners, triangles).volume > 0.0
    assert triangulate(np.zeros((3, 3)))[1].shape == (0, 3)


def test_the_samples_of_a_result_are_recorded(result: PlanResult) -> None:
    recorded = RecordedPlan.of(result)
    assert recorded.joint_names == JOINTS
    assert recorded.root_link == "stand"
    step = np.diff(recorded.times)
    mean = 0.5 * (recorded.velocities[1:] + recorded.velocities[:-1]) * step[:, None]
    np.testing.assert_allclose(np.diff(recorded.positions, axis=0), mean, atol=2e-4)
