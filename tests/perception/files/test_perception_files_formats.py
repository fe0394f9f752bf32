"""LAS, LAZ, E57 and bags: what is read from them, and what each that cannot be read is told."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path

import laspy
import numpy as np
import pytest
from cloud_files import CLOUD, cloud_message, las_bytes, write_bag, write_e57
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from perception import CloudError, read_cloud, read_clouds
from perception.files import read as reading
from perception.files.bag import _parse_message as scan_of_message
from perception.files.e57 import _to_cartesian
from perception.files.las import read_las
from perception.files.parse import parse_file

POINTS = np.round(np.random.default_rng(0).uniform(-5, 5, (300, 3)), 3)
MAP = np.array([412_345.0, 5_318_008.0, 512.0])
HALF = (0.0, 0.0, 0.0, 1.0)


@pytest.fixture(autouse=True)
def _in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """The process that files are parsed in has tests of its own."""
    monkeypatch.setattr(reading, "parse_in_sandbox", parse_file)


@pytest.mark.parametrize("is_compressed", [False, True])
def test_las_keeps_map_coordinates_to_its_scale(is_compressed: bool) -> None:
    scan = read_las(las_bytes(POINTS + MAP, is_compressed=is_compressed), "scan.las")
    np.testing.assert_allclose(scan.points, POINTS + MAP, atol=2e-9)
    assert scan.notes == ()
    assert scan.viewpoint is None


@pytest.mark.parametrize("is_compressed", [False, True])
def test_what_las_marks_as_withheld_or_noise_is_left_out(is_compressed: bool) -> None:
    withheld = np.arange(300) < 10
    classes = np.where(np.arange(300) >= 280, 7, 2).astype(np.uint8)
    scan = read_las(las_bytes(POINTS, is_compressed=is_compressed, withheld=withheld, classification=classes), "a.las")
    np.testing.assert_allclose(scan.points, POINTS[10:280], atol=2e-9)
    assert scan.notes == ("left out 30 points marked as withheld or noise",)


FEET = 'PROJCS["a",GEOGCS["b",UNIT["degree",0.0174532925199433]],UNIT["US survey foot",0.304800609601219]]'
METRES = 'PROJCS["a",GEOGCS["b",UNIT["degree",0.0174532925199433]],UNIT["metre",1,AUTHORITY["EPSG","9001"]]]'


@pytest.mark.parametrize(
    ("words", "unit"),
    [
        (FEET, "ft"),
        (METRES, "m"),
        ('GEOGCS["b",UNIT["degree",0.0174532925199433]]', ""),
        (f'COMPD_CS["c",{METRES},VERT_CS["d",UNIT["foot",0.3048]]]', ""),
        ('LOCAL_CS["mine",UNIT["fathom",1.8288]]', ""),
        ('LOCAL_CS["mine",UNIT["lie",1e-e]]', ""),
    ],
)
def test_the_unit_of_a_las_is_that_of_its_coordinate_system(words: str, unit: str) -> None:
    assert read_las(las_bytes(POINTS, crs=laspy.vlrs.known.WktCoordinateSystemVlr(words)), "a.las").unit == unit


@pytest.mark.parametrize(("code", "unit"), [(9001, "m"), (9002, "ft"), (9003, "ft"), (9036, "")])
def test_the_unit_of_a_las_may_be_a_key(code: int, unit: str) -> None:
    keys = laspy.vlrs.known.GeoKeyDirectoryVlr()
    keys.parse_record_data(struct.pack("<8H", 1, 1, 0, 1, 3076, 0, 1, code))
    assert read_las(las_bytes(POINTS, crs=keys), "a.las").unit == unit


def test_a_las_in_feet_that_is_read_as_metres_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "a.las"
    path.write_bytes(las_bytes(POINTS, crs=laspy.vlrs.known.WktCoordinateSystemVlr(FEET)))
    assert read_cloud(path).notes[0] == "its header says ft, but it was read as m: give the unit ft"
    assert not any("its header says" in note for note in read_cloud(path, unit="ft").notes)


def patched(content: bytes, at: int, kind: str, value: int) -> bytes:
    changed = bytearray(content)
    struct.pack_into(kind, changed, at, value)
    return bytes(changed)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"LASX" + las_bytes(POINTS)[4:], "does not begin with 'LASF'"),
        (las_bytes(POINTS)[:150], "is damaged, or no las file"),
        (las_bytes(POINTS)[:-500], "300 points of 34 bytes are announced, but only 9700 bytes"),
        (patched(las_bytes(POINTS), 107, "<I", 0), "announces no points"),
        (patched(las_bytes(POINTS), 107, "<I", 4_000_000_000), "announces 4000000000 points; at most 50000000"),
        (patched(las_bytes(POINTS, is_compressed=True), 107, "<I", 1_900_000), "is damaged, or no las file"),
        (las_bytes(POINTS, is_compressed=True)[:-200], "is damaged, or no las file"),
        (patched(las_bytes(POINTS), 100, "<I", 2**31), "2147483648 records of 54 bytes are announced"),
    ],
)
def test_a_lying_las_is_refused_in_one_line(tmp_path: Path, content: bytes, says: str) -> None:
    path = tmp_path / "liar.las"
    path.write_bytes(content)
    with pytest.raises(CloudError, match=says) as caught:
        parse_file(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def test_every_scan_of_an_e57_stands_at_its_pose(tmp_path: Path) -> None:
    pytest.importorskip("pye57")
    path = tmp_path / "a.e57"
    position, quaternion = np.array([1.0, 2.0, 3.0]), np.array([0.5, 0.5, -0.5, 0.5])
    write_e57(path, [{"points": POINTS, "position": position, "quaternion_wxyz": quaternion}, {"points": POINTS[:9]}])
    cloud = read_cloud(path)
    turned = Rotation.from_quat(quaternion, scalar_first=True).apply(POINTS) + position
    np.testing.assert_allclose(cloud.points, np.concatenate([turned, POINTS[:9]]), atol=1e-6)
    np.testing.assert_array_equal(cloud.origin, np.concatenate([np.tile(position, (300, 1)), np.zeros((9, 3))]))


def test_a_single_e57_scan_has_one_origin(tmp_path: Path) -> None:
    pytest.importorskip("pye57")
    path = tmp_path / "a.e57"
    write_e57(path, [{"points": POINTS, "position": (1.0, 2.0, 3.0)}])
    np.testing.assert_array_equal(read_cloud(path).origin, [1.0, 2.0, 3.0])
    with pytest.raises(CloudError, match="gives no viewpoint to apply"):
        read_cloud(path, apply_viewpoint=True)


def test_a_sensor_may_be_given_for_an_e57_without_a_pose(tmp_path: Path) -> None:
    pye57 = pytest.importorskip("pye57")
    with pye57.E57(str(tmp_path / "a.e57"), mode="w") as file:
        file.write_scan_raw({f"cartesian{axis}": POINTS[:, i].copy() for i, axis in enumerate("XYZ")})
    np.testing.assert_array_equal(read_cloud(tmp_path / "a.e57", sensor=[0, 0, 1.6]).origin, [0, 0, 1.6])
    np.testing.assert_array_equal(read_cloud(tmp_path / "a.e57").origin, np.zeros(3))


def test_an_e57_direction_without_range_is_a_ray_that_met_nothing(tmp_path: Path) -> None:
    pytest.importorskip("pye57")
    path = tmp_path / "a.e57"
    rows = np.array([[2.0, 0, 0], [0, 4.0, 0], [0, 0, 0.1], [9.0, 9.0, 9.0]])
    write_e57(path, [{"points": rows, "position": (0.0, 0.0, 1.0), "state": np.array([0, 0, 1, 2])}])
    cloud = read_cloud(path)
    np.testing.assert_allclose(cloud.points, [[2.0, 0.0, 1.0], [0.0, 4.0, 1.0]], atol=1e-6)
    # The median range of its points is 3 m.
    np.testing.assert_allclose(cloud.misses, [[0.0, 0.0, 4.0]], atol=1e-6)
    assert "1 rays without a return count as free up to their scan's median range" in cloud.notes


def test_spherical_coordinates_become_cartesian() -> None:
    ranges = np.array([[2.0, np.pi / 2, 0.0], [2.0, 0.0, np.pi / 6]])
    np.testing.assert_allclose(_to_cartesian(ranges), [[0, 2, 0], [np.sqrt(3), 0, 1]], atol=1e-12)


def test_an_e57_without_points_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("pye57")
    path = tmp_path / "a.e57"
    write_e57(path, [])
    with pytest.raises(CloudError, match="holds 0 scans without points"):
        parse_file(path)
    path.write_bytes(b"ASTM-E57" + bytes(100))
    with pytest.raises(CloudError, match="is damaged, or no e57 file"):
        parse_file(path)
    assert path.exists()


def bag(folder: Path, *messages: tuple[np.ndarray, str], storage: str = "mcap", topic: str = "/points") -> Path:
    pytest.importorskip("rosbags")
    write_bag(folder / "bag", {topic: messages}, storage)
    return folder / "bag"


@pytest.mark.parametrize(("storage", "suffix"), [("mcap", "mcap"), ("sqlite3", "db3")])
def test_a_bag_reads_as_folder_and_as_file(tmp_path: Path, storage: str, suffix: str) -> None:
    folder = bag(tmp_path, (POINTS, "lidar"), storage=storage)
    for path in (folder, folder / f"bag.{suffix}"):
        cloud = read_cloud(path)
        np.testing.assert_allclose(cloud.points, POINTS, atol=1e-6)
        np.testing.assert_array_equal(cloud.origin, np.zeros(3))
        assert "in the frame 'lidar'" in cloud.notes[0]


def test_topic_and_message_are_those_of_the_bags_among_several_files(tmp_path: Path) -> None:
    np.save(tmp_path / "beside.npy", POINTS + 9)
    path = bag(tmp_path, (POINTS, "lidar"), (POINTS + 1, "lidar"))
    cloud = read_clouds([(path, None), (tmp_path / "beside.npy", None)], topic="/points", message=1, sensor=[0, 0, 2])
    np.testing.assert_allclose(cloud.points, [*(POINTS + 1), *(POINTS + 9)], atol=1e-6)
    np.testing.assert_array_equal(cloud.starts, np.broadcast_to([0, 0, 2], cloud.points.shape))


def test_a_message_is_chosen_or_all_are_merged(tmp_path: Path) -> None:
    path = bag(tmp_path, *((POINTS + i, "lidar") for i in range(3)))
    for message, shift in ((0, 0), (1, 1), (-1, 2), (-3, 0)):
        cloud = read_cloud(path, message=message)
        np.testing.assert_allclose(cloud.points, POINTS + shift, atol=1e-6)
        assert any(f"message {message} of 3 was read" in note for note in cloud.notes)
    cloud = read_cloud(path, message="all")
    np.testing.assert_allclose(cloud.points, np.concatenate([POINTS, POINTS + 1, POINTS + 2]), atol=1e-6)
    assert any("merged 3 messages" in note and "stood still" in note for note in cloud.notes)
    for message in (3, -4):
        with pytest.raises(CloudError, match=f"topic /points: has no message {message}; it has 3, 0 is the first"):
            read_cloud(path, message=message)


def test_topics_are_listed_when_one_must_be_chosen(tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    write_bag(tmp_path / "bag", {"/left": [(POINTS, "l")], "/right": [(POINTS + 1, "r")]})
    with pytest.raises(CloudError, match="has clouds on 2 topics; name one: /left, /right"):
        read_cloud(tmp_path / "bag")
    with pytest.raises(CloudError, match="has no clouds on topic '/rear'; it has some on /left, /right"):
        read_cloud(tmp_path / "bag", topic="/rear")
    np.testing.assert_allclose(read_cloud(tmp_path / "bag", topic="/right").points, POINTS + 1, atol=1e-6)


def test_messages_of_different_frames_are_not_merged(tmp_path: Path) -> None:
    path = bag(tmp_path, (POINTS, "left"), (POINTS, "right"))
    with pytest.raises(CloudError, match=r"its messages are in different frames \(left, right\); choose one"):
        read_cloud(path, message="all")
    assert len(read_cloud(path, message=1).points) == 300


def test_too_many_messages_are_not_merged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("perception.files.bag.MAX_POINTS", 700)
    path = bag(tmp_path, *[(POINTS, "lidar")] * 4)
    with pytest.raises(CloudError, match="its first 3 messages have more than 700 points together; choose one"):
        read_cloud(path, message="all")


def test_a_bag_without_clouds_lists_what_it_has(tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    write_bag(tmp_path / "bag", {})
    with pytest.raises(CloudError, match=r"has no PointCloud2, and no depth image .* its topics are none"):
        parse_file(tmp_path / "bag")
    write_bag(tmp_path / "quiet", {"/points": []})
    with pytest.raises(CloudError, match="topic /points: holds no message"):
        parse_file(tmp_path / "quiet")


def test_a_message_without_points_is_reported_or_merged(tmp_path: Path) -> None:
    path = bag(tmp_path, (POINTS[:0], "lidar"), (POINTS, "lidar"))
    with pytest.raises(CloudError, match="message 0 of 2 holds no points; choose another one, or all"):
        read_cloud(path)
    np.testing.assert_allclose(read_cloud(path, message="all").points, POINTS, atol=1e-6)
    (tmp_path / "none").mkdir()
    with pytest.raises(CloudError, match="its 1 messages hold no points; at least one is needed"):
        read_cloud(bag(tmp_path / "none", (POINTS[:0], "lidar")))


def test_a_bag_without_its_metadata_names_the_files_in_it(tmp_path: Path) -> None:
    path = bag(tmp_path, (POINTS, "lidar"))
    (path / "metadata.yaml").unlink()
    with pytest.raises(CloudError, match=r"is a folder without metadata.yaml; give a file in it: bag.mcap"):
        read_cloud(path)


def test_a_recording_that_was_cut_off_is_reported_with_what_mends_it(tmp_path: Path) -> None:
    path = next(bag(tmp_path, (POINTS, "lidar")).glob("*.mcap"))
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(CloudError, match="its recording was cut off, it seems; 'mcap recover' makes it whole again"):
        read_cloud(path)
    ros1_bag(tmp_path / "old.bag", [POINTS, POINTS])
    whole = (tmp_path / "old.bag").read_bytes()
    (tmp_path / "old.bag").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(CloudError, match="its recording was cut off, it seems; 'rosbag reindex' makes it whole again"):
        read_cloud(tmp_path / "old.bag")


def test_packed_messages_outside_of_their_bag_are_reported(tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    from rosbags.rosbag2 import CompressionMode

    write_bag(tmp_path / "bag", {"/points": [(POINTS, "lidar")]}, "sqlite3", CompressionMode.MESSAGE)
    np.testing.assert_allclose(read_cloud(tmp_path / "bag").points, POINTS, atol=1e-6)
    with pytest.raises(CloudError, match=r"its messages are compressed, .* give the bag's folder"):
        read_cloud(next((tmp_path / "bag").glob("*.db3")))


def test_topic_and_message_go_with_bags_alone(tmp_path: Path) -> None:
    (tmp_path / "a.xyz").write_text("1 2 3\n4 5 6\n")
    with pytest.raises(CloudError, match="is no bag, so it has no topic and message; leave them out"):
        read_cloud(tmp_path / "a.xyz", topic="/points")


def message(points: np.ndarray = POINTS, **changes: object) -> object:
    pytest.importorskip("rosbags")
    from rosbags.typesys import Stores, get_typestore

    return cloud_message(get_typestore(Stores.ROS2_HUMBLE), points, **changes)


def field(name: str, offset: int, datatype: int) -> object:
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_HUMBLE).types["sensor_msgs/msg/PointField"](name, offset, datatype, 1)


def test_rows_of_an_organised_message_may_be_padded() -> None:
    pytest.importorskip("rosbags")
    grid = POINTS[:6].reshape(2, 3, 3)
    rows = np.zeros((2, 80), np.uint8)
    rows[:, :72] = grid.astype(">f8").reshape(2, -1).view(np.uint8)
    fields = [field(axis, 8 * i, 8) for i, axis in enumerate("xyz")]
    data = rows.ravel()
    padded = message(data=data, fields=fields, height=2, width=3, point_step=24, row_step=80, is_bigendian=True)
    np.testing.assert_array_equal(scan_of_message(padded, "bag").points, POINTS[:6])


KINDS_OF_FIELDS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_any_layout_of_a_message_is_understood(data: st.DataObject) -> None:
    pytest.importorskip("rosbags")
    names = data.draw(st.permutations(["x", "y", "z", "intensity", "ring"]))
    datatypes = data.draw(st.lists(st.sampled_from(list(KINDS_OF_FIELDS)), min_size=5, max_size=5))
    gaps = data.draw(st.lists(st.integers(0, 5), min_size=6, max_size=6))
    height, width, pad = (data.draw(st.integers(*limits)) for limits in ((1, 3), (1, 4), (0, 7)))
    is_big = data.draw(st.booleans())
    order = ">" if is_big else "<"
    fields, formats, offsets, at = [], [], [], 0
    for name, datatype, gap in zip(names, datatypes, gaps, strict=False):
        formats.append(order + KINDS_OF_FIELDS[datatype])
        offsets.append(at + gap)
        fields.append(field(name, at + gap, datatype))
        at += gap + np.dtype(formats[-1]).itemsize
    dtype = np.dtype({"names": list(names), "formats": formats, "offsets": offsets, "itemsize": at + gaps[5]})
    grid = np.zeros((height, width), dtype)
    for i, axis in enumerate("xyz"):
        grid[axis] = np.arange(i, i + height * width).reshape(height, width)
    rows = [row.tobytes() + b"\xff" * pad for row in grid]
    raw = np.frombuffer(b"".join(rows), np.uint8)
    layout = {"point_step": dtype.itemsize, "row_step": len(rows[0]), "height": height, "width": width}
    scan = scan_of_message(message(data=raw, fields=fields, is_bigendian=is_big, **layout), "bag")
    np.testing.assert_array_equal(scan.points, np.arange(height * width)[:, None] + np.arange(3.0))


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"width": 2**31, "height": 2}, "announces 4294967296 points; at most 2000000"),
        ({"width": 301}, "301 points of 20 bytes are announced, 6000 bytes are there"),
        ({"height": 2, "width": 160}, "320 points of 20 bytes are announced, 6000 bytes are there"),
        ({"point_step": 12, "row_step": 3600}, "field 'z' at byte 12 lies outside points of 12 bytes"),
        ({"fields": []}, "its fields have no 'x'; x, y and z are needed"),
    ],
)
def test_a_lying_message_is_refused(changes: dict[str, object], says: str) -> None:
    with pytest.raises(CloudError, match=says):
        scan_of_message(message(**changes), "bag")


def test_a_field_of_no_known_type_is_refused() -> None:
    pytest.importorskip("rosbags")
    fields = [field(axis, 4 * i, kind) for i, (axis, kind) in enumerate(zip("xyz", (7, 7, 9), strict=True))]
    with pytest.raises(CloudError, match="field 'z' has datatype 9; 1 to 8 are possible"):
        scan_of_message(message(fields=fields), "bag")


def ros1_bag(path: Path, clouds: Sequence[np.ndarray]) -> None:
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    header, time = store.types["std_msgs/msg/Header"], store.types["builtin_interfaces/msg/Time"]
    with Writer(path) as writer:
        connection = writer.add_connection("/points", CLOUD, typestore=store)
        for i, points in enumerate(clouds):
            head = header(seq=i, stamp=time(sec=1, nanosec=0), frame_id="lidar")
            raw = store.serialize_ros1(cloud_message(store, points, header=head), CLOUD)
            writer.write(connection, 1_000_000_000 * (i + 1), raw)


def test_a_ros1_bag_is_read(tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    path = tmp_path / "old.bag"
    ros1_bag(path, [POINTS, POINTS + 1])
    np.testing.assert_allclose(read_cloud(path, message=-1).points, POINTS + 1, atol=1e-6)
