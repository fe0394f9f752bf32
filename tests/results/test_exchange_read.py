"""Trajectory files of other planners: what is read from them, and what is refused."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from other_planners import JOINTS, least_jerk, to_message, via_points

from service import RequestError, read_trajectory
from service.replay.exchange.joint_trajectory import MAX_POINTS, JointTrajectory
from service.replay.exchange.text_files import MAX_YAML_BYTES, parse_trajectory

COLUMNS = least_jerk(via_points(), 1.6, 0.2)
MESSAGE = to_message(COLUMNS)


def _is_same(trajectory: JointTrajectory) -> bool:
    written = (COLUMNS["times"], COLUMNS["positions"], COLUMNS["velocities"], COLUMNS["accelerations"])
    read = (trajectory.times, trajectory.positions, trajectory.velocities, trajectory.accelerations)
    return trajectory.joint_names == JOINTS and all(
        np.allclose(a, b, atol=1e-6) for a, b in zip(read, written, strict=True)
    )


@pytest.mark.parametrize(
    "wrap",
    [
        lambda message: message,
        lambda message: {"joint_trajectory": message, "multi_dof_joint_trajectory": {"points": []}},
        lambda message: {"model_id": "arm", "trajectory": [{"joint_trajectory": message}], "trajectory_start": {}},
        lambda message: {"planned_trajectory": {"joint_trajectory": message}, "error_code": {"val": 1}},
    ],
    ids=["JointTrajectory", "RobotTrajectory", "DisplayTrajectory", "MotionPlanResponse"],
)
@pytest.mark.parametrize("suffix", [".yaml", ".json"])
def test_messages_of_moveit_are_read(tmp_path: Path, wrap: Any, suffix: str) -> None:
    path = tmp_path / f"plan{suffix}"
    data = wrap(MESSAGE)
    path.write_text(json.dumps(data) if suffix == ".json" else yaml.safe_dump(data) + "---\n")
    assert _is_same(read_trajectory(path))


def test_times_of_ros_1_are_read() -> None:
    message = to_message(COLUMNS)
    for point in message["points"]:
        stamp = point["time_from_start"]
        point["time_from_start"] = {"secs": stamp["sec"], "nsecs": stamp["nanosec"]}
    assert _is_same(parse_trajectory(message, "ros1"))


def test_arrays_of_numpy_are_read_also_as_a_batch_of_one(tmp_path: Path) -> None:
    path = tmp_path / "plan.npz"
    arrays = {name: COLUMNS[name] for name in ("positions", "velocities", "accelerations")}
    np.savez(path, joint_names=np.array(JOINTS), times=COLUMNS["times"], **arrays)
    assert _is_same(read_trajectory(path))
    np.savez(path, joint_names=np.array(JOINTS), dt=0.2, **{name: value[None] for name, value in arrays.items()})
    assert _is_same(read_trajectory(path))


def _write(tmp_path: Path, name: str, content: str | bytes) -> Path:
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.yaml", "joint_names: [a]\npoints: [&x {positions: [0]}, *x]", r"alias '\*x' is not read"),
        ("a.yaml", "[" * 40 + "]" * 40, r"nested deeper than 12 levels"),
        ("a.yaml", "- 1\n---\n- 2", r"holds 2 documents"),
        ("a.yaml", "!!python/object/apply:os.system ['ls']", r"no valid YAML"),
        ("a.json", "[" * 100_000, r"is no JSON"),
        ("a.json", "{}", r"holds no trajectory; expected joint_names"),
        ("a.json", '{"joint_names": ["a"], "points": [{"positions": [true]}]}', r"a number is needed"),
        ("a.json", '{"joint_names": ["a"], "points": [{"positions": [1, 2]}]}', r"expected 1, one per"),
        ("a.json", '{"joint_names": ["a"], "points": [{"positions": [1e999]}, {"positions": [1]}]}', r"is inf"),
        ("a.json", '{"joint_names": ["a"], "points": [{"positions": [1]}]}', r"has 1 points; expected 2"),
        ("a.json", '{"joint_names": ["a"], "positions": [[0], [1]], "dt": -1}', r"dt is -1"),
        ("a.csv", "", r"its first line must name the columns"),
        ("a.csv", "0,1\n1,2\n", r"its first line must name the columns"),
        ("a.csv", "time,a\n0,1\n1\n", r"point 1 has 1 columns; expected 2"),
        ("a.csv", "time,a\n0,1\n1,x\x1b[2J\n", r"point 1 holds 'x\\x1b\[2J'"),
        ("a.csv", "time,a,a\n0,1,2\n1,2,3\n", r"joint 'a' is given twice"),
        ("a.csv", b"time,\xff\n", r"is no UTF-8 text"),
        ("a.npz", b"PK\x03\x04 nothing", r"is no archive of numpy.savez"),
        ("a.mcap", b"\x89MCAP0\r\n", r"cannot be read as a bag"),
        ("a.bag", b"#ROSBAG V2.0\n", r"cannot be read as a bag"),
        ("a.txt", "", r"is no trajectory by its name"),
    ],
)  # fmt: skip
def test_strange_files_are_refused_in_one_line(tmp_path: Path, name: str, content: str | bytes, words: str) -> None:
    if name.endswith((".mcap", ".bag")):
        pytest.importorskip("rosbags", reason="the extra 'ros' reads bags")
    with pytest.raises(RequestError, match=words) as error:
        read_trajectory(_write(tmp_path, name, content))
    assert str(error.value).isprintable()


def test_a_missing_file_and_a_folder_without_a_bag_are_refused(tmp_path: Path) -> None:
    with pytest.raises(RequestError, match=r"b\.csv: does not exist"):
        read_trajectory(tmp_path / "b.csv")
    with pytest.raises(RequestError, match="or a bag's folder"):
        read_trajectory(tmp_path)


def test_gigantic_files_are_refused_before_they_are_read(tmp_path: Path) -> None:
    path = tmp_path / "large.yaml"
    with path.open("wb") as file:
        file.truncate(MAX_YAML_BYTES + 1)
    with pytest.raises(RequestError, match=f"expected at most {MAX_YAML_BYTES}"):
        read_trajectory(path)
    rows = "\n".join("0,0" for _ in range(MAX_POINTS + 1))
    with pytest.raises(RequestError, match=f"has {MAX_POINTS + 1} points"):
        read_trajectory(_write(tmp_path, "long.csv", f"time,a\n{rows}"))
    bomb = tmp_path / "bomb.npz"
    with zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("positions.npy", bytes(80 * 2**20))
    with pytest.raises(RequestError, match="unpacks to"):
        read_trajectory(bomb)


@given(data=st.recursive(st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=3), lambda inner: (
    st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(
        ["joint_names", "points", "positions", "velocities", "times", "dt", "trajectory", "time_from_start", "sec",
         "multi_dof_joint_trajectory", "transforms", "trajectory_start", "joint_state", "name", "position", "success"]),
        inner, max_size=4)), max_leaves=12))  # fmt: skip
@settings(max_examples=40)
def test_any_data_is_a_trajectory_or_refused(data: object) -> None:
    lines = []
    try:
        parse_trajectory(data, "data")
    except RequestError as error:
        lines = str(error).splitlines()
    assert all(line.isprintable() for line in lines)
