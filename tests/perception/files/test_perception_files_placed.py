"""Units, poses, several files, rays without return: what becomes of a file's numbers."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from perception import Cloud, CloudError, read_cloud, read_clouds, rigid_pose, write_npz, write_pcd
from perception.files import read as reading
from perception.files.npz import read_npz
from perception.files.parse import parse_file
from perception.files.pcd import read_pcd
from perception.files.placing import METRES_BY_UNIT, move_points

ROOM = np.random.default_rng(0).uniform([-2, -2, 0], [2, 2, 2], (500, 3)).astype(np.float32).astype(float)
HIGH = ROOM[:3] + np.array([0.0, 0.0, 5.0])
SENSOR = np.array([0.25, -0.5, 1.5])
QUARTER = (np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5))


@pytest.fixture(autouse=True)
def _in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """The process that files are parsed in has tests of its own."""
    monkeypatch.setattr(reading, "parse_in_sandbox", parse_file)


def npz(folder: Path, points: np.ndarray, origin: np.ndarray = SENSOR, **more: np.ndarray) -> Path:
    path = folder / "cloud.npz"
    np.savez(path, points=points, origin=origin, **more)
    return path


@pytest.mark.parametrize("unit", sorted(METRES_BY_UNIT))
def test_a_cloud_reads_the_same_in_every_unit(tmp_path: Path, unit: str) -> None:
    metres = METRES_BY_UNIT[unit]
    path = npz(tmp_path, ROOM / metres, SENSOR / metres, misses=ROOM[:7] / metres)
    cloud = read_cloud(path, unit=unit)
    np.testing.assert_allclose(cloud.points, ROOM, atol=1e-12)
    np.testing.assert_allclose(cloud.origin, SENSOR, atol=1e-12)
    np.testing.assert_allclose(cloud.misses, ROOM[:7], atol=1e-12)
    assert cloud.notes == ()


def test_an_unknown_unit_is_refused(tmp_path: Path) -> None:
    with pytest.raises(CloudError, match="unit 'yard' is unknown; one of m, cm, mm"):
        read_cloud(npz(tmp_path, ROOM), unit="yard")


def test_a_quarter_turn_takes_x_to_y(tmp_path: Path) -> None:
    path = npz(tmp_path, np.array([[1.0, 0.0, 0.0], [0.0, 2.0, 0.5]]), np.zeros(3))
    for transform in ([10.0, 0.0, 0.0, np.pi / 2, 0.0, 0.0], (10.0, 0.0, 0.0, *QUARTER)):
        cloud = read_cloud(path, transform=transform)
        np.testing.assert_allclose(cloud.points, [[10.0, 1.0, 0.0], [8.0, 0.0, 0.5]], atol=1e-12)
        np.testing.assert_allclose(cloud.origin, [10.0, 0.0, 0.0], atol=1e-12)


@given(arrays(float, 6, elements=st.floats(-3, 3)))
def test_yaw_pitch_roll_matrix_and_quaternion_are_one_pose(numbers: np.ndarray) -> None:
    yaw, pitch, roll = numbers[3:]
    rotation = (
        Rotation.from_rotvec([0, 0, yaw]) * Rotation.from_rotvec([0, pitch, 0]) * Rotation.from_rotvec([roll, 0, 0])
    )
    pose = rigid_pose(numbers)
    np.testing.assert_allclose(pose[:3, :3], rotation.as_matrix(), atol=1e-12)
    np.testing.assert_array_equal(pose[:3, 3], numbers[:3])
    np.testing.assert_array_equal(rigid_pose(pose.ravel().tolist()), pose)
    np.testing.assert_allclose(rigid_pose([*numbers[:3], *rotation.as_quat(scalar_first=True)]), pose, atol=1e-12)


@pytest.mark.parametrize(
    ("transform", "says"),
    [
        ([1.0, 2.0, 3.0], "transform of 3 numbers"),
        (np.full((4, 4), np.nan), "transform holds NaN or infinity"),
        ([0.0, 0.0, 0.0, 90.0, 0.0, 0.0], r"turns by 90 rad, .* if these are degrees, 1.5708 rad is needed"),
        ([0.0, 0.0, 0.0, 0.1, 0.0, -180.0], "turns by -180 rad"),
        ("far away", "transform of 0 numbers"),
        (np.diag([2.0, 2.0, 2.0, 1.0]), "not rigid"),
        (np.diag([1.0, 1.0, -1.0, 1.0]), "not rigid"),
        (np.diag([1.0, 1.0, 1.0, 2.0]), "last row"),
        ([0.0] * 7, "quaternion 0 0 0 0"),
        ([1e300, 0, 0, 0, 0, 0], "1e\\+300"),
    ],
)
def test_a_transform_that_is_none_is_refused(transform: object, says: str) -> None:
    with pytest.raises(CloudError, match=says):
        rigid_pose(transform)  # type: ignore[arg-type]


def test_map_coordinates_keep_their_millimetres(tmp_path: Path) -> None:
    far = np.array([412_345.678, 5_318_008.135, 512.25])
    path = npz(tmp_path, ROOM + far, SENSOR + far)
    told = read_cloud(path)
    (note,) = told.notes
    assert re.search(r"map coordinates\? .* -41234\d -531800\d -512\.2\d 0 0 0 would", note)
    cloud = read_cloud(path, transform=[*-far, 0, 0, 0])
    assert cloud.notes == ()
    np.testing.assert_allclose(cloud.points, ROOM, atol=2e-9)
    np.testing.assert_allclose(cloud.origin, SENSOR, atol=2e-9)


def test_coordinates_that_float32_rounds_are_reported(tmp_path: Path) -> None:
    far = np.array([412_345.678, 5_318_008.135, 512.25])
    rounded = (ROOM + far).astype(np.float32)
    notes = read_cloud(npz(tmp_path, rounded), transform=[*-far, 0, 0, 0]).notes
    assert any("rounded to 0.5 m in float32" in note for note in notes)
    assert not any("float32" in note for note in read_cloud(npz(tmp_path, ROOM + far)).notes)
    assert not any("float32" in note for note in read_cloud(npz(tmp_path, ROOM.astype(np.float32))).notes)


@pytest.mark.parametrize(
    ("scale", "says"),
    [(1000.0, "unit mm .it would be 3.9 m."), (200.0, "cm .it would be 7.9 m."), (0.001, "only 0.0039 m")],
)
def test_a_wrong_unit_is_reported(tmp_path: Path, scale: float, says: str) -> None:
    (note,) = read_cloud(npz(tmp_path, scale * ROOM, scale * SENSOR)).notes
    assert re.search(says, note)


def test_the_viewpoint_comes_before_the_transform(tmp_path: Path) -> None:
    path = tmp_path / "sensor.pcd"
    viewpoint = (100.0, 0.0, 0.0, *QUARTER)
    write_pcd(path, np.array([[1000.0, 0, 0], [2000.0, 0, 500.0]]), viewpoint)
    cloud = read_cloud(path, unit="mm", transform=[0, 0, 1.0, np.pi, 0, 0], apply_viewpoint=True)
    # (1, 0, 0) m in the sensor's frame is (0.1, 1, 0) in the scan's, and half a turn and 1 m up makes (-0.1, -1, 1).
    np.testing.assert_allclose(cloud.points, [[-0.1, -1.0, 1.0], [-0.1, -2.0, 1.5]], atol=1e-7)
    np.testing.assert_allclose(cloud.origin, [-0.1, 0.0, 1.0], atol=1e-7)


def test_rays_start_where_the_user_says_when_the_file_does_not(tmp_path: Path) -> None:
    silent, telling = tmp_path / "silent.npy", npz(tmp_path, ROOM)
    np.save(silent, ROOM)
    cloud = read_cloud(silent, transform=[1, 2, 0, 0, 0, 0], sensor=[1, 2, 1.6])
    np.testing.assert_array_equal(cloud.origin, [1, 2, 1.6])
    assert cloud.notes == ()
    cloud = read_cloud(silent, transform=[1, 2, 0, 0, 0, 0])
    np.testing.assert_array_equal(cloud.origin, [1, 2, 0])
    assert "rays are taken to start at (1, 2, 0)" in cloud.notes[0]
    cloud = read_cloud(telling, sensor=[1, 2, 1.6])
    np.testing.assert_array_equal(cloud.origin, SENSOR)
    assert cloud.notes == ("the file says where its rays started; the sensor's position that is given is not used",)
    for sensor in ([1, 2], [1, 2, np.nan]):
        with pytest.raises(CloudError, match="is no position; three numbers, at most 1e"):
            read_cloud(silent, sensor=sensor)


def test_an_identity_for_a_viewpoint_does_not_say_where_rays_started(tmp_path: Path) -> None:
    path = tmp_path / "pcl.pcd"
    write_pcd(path, ROOM)
    pose = [1, 2, 0, 0, 0, 0]
    np.testing.assert_array_equal(read_cloud(path, transform=pose, sensor=[1, 2, 1.6]).origin, [1, 2, 1.6])
    np.testing.assert_array_equal(read_cloud(path, transform=pose).origin, [1, 2, 0])
    cloud = read_cloud(path, transform=[5000.0, 0, 0, 0, 0, 0])
    np.testing.assert_array_equal(cloud.origin, [5000.0, 0, 0])
    write_pcd(path, ROOM + np.array([5000.0, 0, 0]))
    cloud = read_cloud(path, transform=[-5000.0, 0, 0, 0, 0, 0])
    np.testing.assert_array_equal(cloud.origin, np.zeros(3))
    assert any("its zero lies 5000 m away" in note for note in cloud.notes)


def test_no_ray_starts_at_the_zero_of_a_map(tmp_path: Path) -> None:
    far = np.array([412_345.678, 5_318_008.135, 512.25])
    np.save(tmp_path / "map.npy", ROOM + far)
    cloud = read_cloud(tmp_path / "map.npy", transform=[*-far, 0, 0, 0])
    np.testing.assert_array_equal(cloud.origin, np.zeros(3))
    assert "its zero lies 5333970 m away; rays are taken to start at the world's (0, 0, 0)" in cloud.notes[0]


def test_a_level_cameras_frame_is_turned_by_two_quarter_turns(tmp_path: Path) -> None:
    ahead = np.column_stack([ROOM[:, 0] / 4, ROOM[:, 1] / 4, ROOM[:, 2] + 1.0])  # right, down, forward
    np.save(tmp_path / "camera.npy", ahead)
    cloud = read_cloud(tmp_path / "camera.npy", transform=[0, 0, 1.5, -np.pi / 2, 0, -np.pi / 2])
    right, down, forward = ahead.T
    np.testing.assert_allclose(cloud.points, np.column_stack([forward, -right, 1.5 - down]), atol=1e-12)


def test_merged_files_know_where_each_ray_started(tmp_path: Path) -> None:
    a, b = tmp_path / "a.pcd", tmp_path / "b.npz"
    write_pcd(a, ROOM, (*SENSOR, 1, 0, 0, 0), misses=HIGH)
    write_npz(b, Cloud(ROOM[:20], np.array([0.0, 0.0, 1.0]), (), ROOM[:5]))
    pose = rigid_pose([3.0, 0, 0, np.pi / 2, 0, 0])
    cloud = read_clouds([(a, None), (b, pose)])
    np.testing.assert_allclose(cloud.points, np.concatenate([ROOM, move_points(pose, ROOM[:20])]), atol=1e-6)
    np.testing.assert_allclose(cloud.starts[:500], np.broadcast_to(SENSOR, (500, 3)))
    np.testing.assert_allclose(cloud.starts[500:], np.broadcast_to([3.0, 0.0, 1.0], (20, 3)))
    starts, ends = cloud.rays
    np.testing.assert_allclose(ends[520:], np.concatenate([HIGH, move_points(pose, ROOM[:5])]), atol=1e-6)
    np.testing.assert_allclose(starts[520:523], np.broadcast_to(SENSOR, (3, 3)))
    np.testing.assert_allclose(starts[523:], np.broadcast_to([3.0, 0.0, 1.0], (5, 3)))


def test_notes_of_merged_files_name_their_file(tmp_path: Path) -> None:
    a, b = tmp_path / "a.xyz", tmp_path / "b.xyz"
    a.write_text("1 2 3\n4 5 6\n")
    b.write_text("1 2 3\n4 5 nan\n")
    notes = read_clouds([(a, None), (b, None)]).notes
    assert any(
        note.startswith(f"{a}: the file gives no sensor position; rays are taken to start at (0, 0, 0)")
        for note in notes
    )
    assert f"{b}: dropped 1 NaN or infinite points of 2 (50.0 %)" in notes


def test_one_file_among_several_reads_as_alone(tmp_path: Path) -> None:
    path = npz(tmp_path, ROOM)
    one, alone = read_clouds([(path, None)]), read_cloud(path)
    np.testing.assert_array_equal(one.points, alone.points)
    assert one.origin.shape == (3,)
    assert one.notes == alone.notes


def test_no_file_is_refused() -> None:
    with pytest.raises(CloudError, match="no cloud file is given"):
        read_clouds([])


def test_files_with_too_many_points_together_are_thinned_alike(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reading, "MAX_POINTS", 1200)
    path = npz(tmp_path, ROOM)
    one = read_cloud(path)
    assert len(read_clouds([(path, None)] * 2).points) == 2 * len(one.points) == 1000
    for n_files, step in ((3, 2), (5, 4)):
        cloud = read_clouds([(path, None)] * n_files)
        parts = np.split(cloud.points, n_files)
        assert abs(len(parts[0]) - len(one.points) / step) <= 1
        for part in parts:
            np.testing.assert_array_equal(part, parts[0])
        assert {tuple(row) for row in parts[0]} <= {tuple(row) for row in one.points}
        assert f"took 1 of every {step} points of all files, since at most 1200 are used together" in cloud.notes


@given(
    arrays(np.float32, st.tuples(st.integers(1, 30), st.just(3)), elements=st.floats(-50, 50, width=32)),
    arrays(np.float32, st.tuples(st.integers(0, 30), st.just(3)), elements=st.floats(-50, 50, width=32)),
    st.sampled_from(["ascii", "binary", "binary_compressed"]),
)
def test_rays_without_return_come_back_from_a_pcd(tmp_path_factory, points, misses, encoding) -> None:
    path = tmp_path_factory.mktemp("pcd") / "cloud.pcd"
    write_pcd(path, points, (0, 0, 1, 1, 0, 0, 0), encoding, misses)
    scan = read_pcd(path.read_bytes(), "cloud.pcd")
    np.testing.assert_array_equal(scan.points.astype(np.float32), points)
    np.testing.assert_array_equal(scan.misses.astype(np.float32), misses)


@given(st.integers(1, 20), st.integers(0, 20), st.booleans(), st.booleans())
def test_a_cloud_comes_back_from_an_npz(tmp_path_factory, n_points, n_misses, is_many, has_behind) -> None:
    path = tmp_path_factory.mktemp("npz") / "cloud.npz"
    rng = np.random.default_rng(n_points)
    origin = rng.normal(size=(n_points, 3) if is_many else 3)
    behind = rng.normal(size=(n_misses, 3)) if has_behind or is_many else None
    cloud = Cloud(rng.normal(size=(n_points, 3)), origin, (), rng.normal(size=(n_misses, 3)), behind)
    write_npz(path, cloud)
    scan = read_npz(path.read_bytes(), "cloud.npz")
    np.testing.assert_array_equal(scan.points, cloud.points)
    np.testing.assert_array_equal(scan.misses, cloud.misses)
    if is_many and n_points != 1:
        np.testing.assert_array_equal(scan.starts, origin)
    if n_misses and behind is not None:
        np.testing.assert_array_equal(scan.miss_starts, behind)


PLY_MISSES = (
    "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\n"
    "property uchar no_return\nend_header\n1 2 3 0\n4 5 6 1\n"
)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.csv", "x,y,z,no_return\n1,2,3,0\n4,5,6,1\n"),
        ("a.xyz", "# x y z intensity no_return\n1 2 3 9 0\n4 5 6 9 1\n"),
        ("a.ply", PLY_MISSES),
    ],
)
def test_a_no_return_column_makes_misses_in_text_files(tmp_path: Path, name: str, text: str) -> None:
    (tmp_path / name).write_text(text)
    cloud = read_cloud(tmp_path / name)
    np.testing.assert_array_equal(cloud.points, [[1, 2, 3]])
    np.testing.assert_array_equal(cloud.misses, [[4, 5, 6]])


def test_rows_may_say_where_their_own_ray_started(tmp_path: Path) -> None:
    path = tmp_path / "walk.csv"
    path.write_text("x,y,z,vp_x,vp_y,vp_z,no_return\n1,2,3,0,0,1,0\n4,5,6,0,1,1,1\n7,8,9,0,2,1,0\n")
    cloud = read_cloud(path, transform=[10, 0, 0, 0, 0, 0])
    np.testing.assert_array_equal(cloud.points, [[11, 2, 3], [17, 8, 9]])
    np.testing.assert_array_equal(cloud.origin, [[10, 0, 1], [10, 2, 1]])
    np.testing.assert_array_equal(cloud.miss_origin, [[10, 1, 1]])
    assert cloud.notes == ()


def test_a_cloud_of_misses_alone_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("x,y,z,no_return\n1,2,3,1\n4,5,6,1\n")
    with pytest.raises(CloudError, match="holds only 2 rays that met nothing"):
        read_cloud(tmp_path / "a.csv")


def test_returns_written_as_zeros_are_dropped_and_counted(tmp_path: Path) -> None:
    rows = np.concatenate([ROOM, np.zeros((200, 3))])
    starts = np.broadcast_to(SENSOR, rows.shape)
    for origin in (SENSOR, starts):
        cloud = read_cloud(npz(tmp_path, rows, origin))
        assert len(cloud.points) == len(cloud.starts) == 500
        assert "dropped 200 points of 700 that are exactly 0 0 0" in cloud.notes[0]
    assert len(read_cloud(npz(tmp_path, rows[:501])).points) == 501
    with pytest.raises(CloudError, match="all 200 points are 0 0 0"):
        read_cloud(npz(tmp_path, rows[500:]))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 3.4e38, 1e300])
def test_sentinels_of_drivers_count_as_no_points(tmp_path: Path, value: float) -> None:
    rows, starts = ROOM.copy(), np.broadcast_to(SENSOR, ROOM.shape).copy()
    rows[:50, 1] = value
    starts[50:60, 2] = value
    misses = ROOM[:10].copy()
    misses[:3] = value
    path = npz(tmp_path, rows, starts, misses=misses, miss_origin=SENSOR)
    cloud = read_cloud(path, unit="cm", transform=[1, 2, 3, 0.5, 0, 0])
    assert len(cloud.points) == 440
    assert len(cloud.misses) == 7


def test_a_cloud_of_nothing_but_nan_is_refused(tmp_path: Path) -> None:
    path = npz(tmp_path, np.full((100, 3), np.nan))
    with pytest.raises(CloudError, match="100 of 100 points are NaN or infinite") as caught:
        read_cloud(path, transform=[0, 0, 0, 1, 0, 0])
    assert str(path) in str(caught.value)
