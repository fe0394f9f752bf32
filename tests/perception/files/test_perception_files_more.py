"""VTK files, lists of differing lengths, depth images, and bags with transforms; also damaged ones."""

from __future__ import annotations

import base64
import json
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cloud_files import CLOUD, cloud_message
from hypothesis import given, settings
from hypothesis import strategies as st

from perception import CloudError, read_cloud
from perception.files.depth import parse_intrinsics, read_depth_png
from perception.files.parse import parse_file
from perception.files.pcd import read_pcd
from perception.files.ply import read_ply
from perception.files.scan import Scan
from perception.files.vtk import read_vtk, read_vtk_xml

POINTS = np.round(np.random.default_rng(0).uniform(-5, 5, (40, 3)), 3)


def legacy(is_binary: bool) -> bytes:
    head = (
        f"# vtk DataFile Version 3.0\nFile created by a tool\n{'BINARY' if is_binary else 'ASCII'}\nDATASET POLYDATA\n"
    )
    rows = (
        POINTS.astype(">f8").tobytes() if is_binary else "\n".join(" ".join(map(str, row)) for row in POINTS).encode()
    )
    return f"{head}POINTS {len(POINTS)} double\n".encode() + rows + b"\nVERTICES 1 2\n1 0\n"


def xml(form: str, packed: bool = False) -> bytes:
    """A .vtp with its points as ascii, binary (base64) or appended (raw)."""
    raw = POINTS.astype("<f4").tobytes()
    if packed:
        half = len(raw) // 2
        blocks = [zlib.compress(raw[:half]), zlib.compress(raw[half:])]
        lead = struct.pack("<5I", 2, half, len(raw) - half, *map(len, blocks))
        text, data = base64.b64encode(lead) + base64.b64encode(b"".join(blocks)), lead + b"".join(blocks)
    else:
        data = struct.pack("<I", len(raw)) + raw
        text = base64.b64encode(data)
    inline = {"ascii": " ".join(map(str, POINTS.ravel())).encode(), "binary": text, "appended": b""}[form]
    compressor = b' compressor="vtkZLibDataCompressor"' if packed else b""
    offset = b' offset="0"' if form == "appended" else b""
    tail = b'<AppendedData encoding="raw">\n_' + data + b"</AppendedData>" if form == "appended" else b""
    return b"".join(
        [
            b'<?xml version="1.0"?>\n<VTKFile type="PolyData" byte_order="LittleEndian" header_type="UInt32"'
            + compressor,
            b'>\n<PolyData>\n<Piece NumberOfPoints="40">\n<Points>\n<DataArray type="Float32" Name="Points" ',
            b'NumberOfComponents="3" format="' + form.encode() + b'"' + offset + b">" + inline + b"</DataArray>\n",
            b"</Points>\n</Piece>\n</PolyData>\n" + tail + b"</VTKFile>\n",
        ]
    )


def ragged(form: str) -> bytes:
    """A PLY with faces of three and four corners before its vertices, which have lists of differing lengths."""
    head = (
        f"ply\nformat {form} 1.0\nelement face 2\nproperty list uchar int vertex_indices\nelement vertex 40\n"
        "property float x\nproperty list uchar short seen\nproperty float y\nproperty float z\nend_header\n"
    ).encode()
    order = ">" if form.endswith("big_endian") else "<"
    body = b""
    if form == "ascii":
        body = b"3 0 1 2\n4 0 1 2 0\n"
        for i, (x, y, z) in enumerate(POINTS):
            body += f"{x} {i % 3} {'7 ' * (i % 3)}{y} {z}\n".encode()
        return head + body
    for n in (3, 4):
        body += struct.pack(f"{order}B{n}i", n, *range(n))
    for i, (x, y, z) in enumerate(POINTS):
        body += struct.pack(f"{order}fB{i % 3}hff", x, i % 3, *[7] * (i % 3), y, z)
    return head + body


@pytest.mark.parametrize("is_binary", [False, True])
def test_points_of_a_legacy_vtk_are_read(tmp_path: Path, is_binary: bool) -> None:
    path = tmp_path / "cloud.vtk"
    path.write_bytes(legacy(is_binary))
    np.testing.assert_allclose(read_cloud(path).points, POINTS, atol=1e-12)


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("form", ["ascii", "binary", "appended"])
def test_points_of_an_xml_vtk_are_read(tmp_path: Path, form: str, packed: bool) -> None:
    path = tmp_path / "cloud.vtp"
    path.write_bytes(xml(form, packed))
    np.testing.assert_allclose(read_cloud(path).points, POINTS, atol=1e-6)


def test_a_vtk_grid_is_refused() -> None:
    with pytest.raises(CloudError, match="holds a grid of cells"):
        read_vtk(legacy(False).replace(b"POLYDATA", b"STRUCTURED_POINTS"), "grid.vtk")


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_ply_lists_may_differ_in_length(form: str) -> None:
    np.testing.assert_allclose(read_ply(ragged(form), "a.ply").points, POINTS, atol=1e-6)


def test_pcd_types_may_be_lower_case() -> None:
    head = b"VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE f f f\nCOUNT 1 1 1\nWIDTH 2\nHEIGHT 1\nPOINTS 2\nDATA ascii\n"
    np.testing.assert_array_equal(read_pcd(head + b"1 2 3\n4 5 6\n", "a.pcd").points, [[1, 2, 3], [4, 5, 6]])


def png(image: np.ndarray, kind: int = 0) -> bytes:
    """A grey PNG of 16 bits whose rows have a filter, which is applied to them."""
    rows = image.astype(">u2").view(np.uint8).reshape(len(image), -1).astype(int)
    body = b""
    for i, row in enumerate(rows):
        above = rows[i - 1] if i else np.zeros_like(row)
        left = np.concatenate([[0, 0], row[:-2]])
        corner = np.concatenate([[0, 0], above[:-2]])
        p = left + above - corner
        far = [np.abs(p - one) for one in (left, above, corner)]
        paeth = np.where((far[0] <= far[1]) & (far[0] <= far[2]), left, np.where(far[1] <= far[2], above, corner))
        guess = [np.zeros_like(row), left, above, (left + above) // 2, paeth][kind]
        body += bytes([kind]) + ((row - guess) % 256).astype(np.uint8).tobytes()

    def chunk(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    size = struct.pack(">IIBBBBB", image.shape[1], image.shape[0], 16, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", size) + chunk(b"IDAT", zlib.compress(body)) + chunk(b"IEND", b"")


CAMERA = {"fx": 50.0, "fy": 40.0, "cx": 3.0, "cy": 2.0, "depth_scale": 1000}
DEPTH = np.random.default_rng(1).integers(500, 3000, (6, 8))


@pytest.mark.parametrize("kind", range(5))
def test_a_depth_image_with_intrinsics_is_a_cloud(tmp_path: Path, kind: int) -> None:
    image = DEPTH.copy()
    image[0, 0] = 0
    (tmp_path / "depth.png").write_bytes(png(image, kind))
    (tmp_path / "depth.json").write_text(json.dumps(CAMERA))
    cloud = read_cloud(tmp_path / "depth.png")
    assert len(cloud.points) == image.size - 1
    np.testing.assert_allclose(
        cloud.points[-1], [4 / 50 * image[5, 7] / 1e3, 3 / 40 * image[5, 7] / 1e3, image[5, 7] / 1e3]
    )
    assert any("1 of 48 pixels have no depth" in note for note in cloud.notes)


def test_intrinsics_are_read_as_cameras_write_them() -> None:
    rows = [50.0, 0, 3, 0, 40, 2, 0, 0, 1]
    columns = [50.0, 0, 0, 0, 40, 0, 3, 2, 1]
    for values in ({"K": rows}, {"intrinsic_matrix": columns}, {"camera_matrix": {"data": rows}}, CAMERA,
                   {"intrinsics": {"fx": 50, "fy": 40, "ppx": 3, "ppy": 2}, "depth_scale": 0.001}):  # fmt: skip
        camera = parse_intrinsics(values, "a")
        assert (camera.fx, camera.fy, camera.cx, camera.cy) == (50.0, 40.0, 3.0, 2.0)
        assert camera.per_metre == pytest.approx(1000.0)


def test_a_picture_without_intrinsics_says_what_it_needs(tmp_path: Path) -> None:
    (tmp_path / "depth.png").write_bytes(png(DEPTH))
    with pytest.raises(CloudError, match=r"needs fx, fy, cx, cy and depth_scale in depth.json"):
        read_cloud(tmp_path / "depth.png")


def write_tf_bag(folder: Path, transforms: dict[str, tuple[str, tuple[float, ...]]], clouds: dict[str, str]) -> Path:
    """A bag with static transforms (child: parent, x y z qw qx qy qz) and the points on each topic in a frame."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    types = store.types
    stamp = types["builtin_interfaces/msg/Time"](sec=1, nanosec=0)
    entries = []
    for child, (parent, (x, y, z, *wxyz)) in transforms.items():
        turn = types["geometry_msgs/msg/Quaternion"](x=wxyz[1], y=wxyz[2], z=wxyz[3], w=wxyz[0])
        pose = types["geometry_msgs/msg/Transform"](
            translation=types["geometry_msgs/msg/Vector3"](x=x, y=y, z=z), rotation=turn
        )
        header = types["std_msgs/msg/Header"](stamp=stamp, frame_id=parent)
        entries.append(types["geometry_msgs/msg/TransformStamped"](header=header, child_frame_id=child, transform=pose))
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        tf = "tf2_msgs/msg/TFMessage"
        connection = writer.add_connection("/tf_static", tf, typestore=store)
        writer.write(connection, 1, store.serialize_cdr(types[tf](transforms=entries), tf))
        for topic, frame in clouds.items():
            connection = writer.add_connection(topic, CLOUD, typestore=store)
            raw = store.serialize_cdr(cloud_message(store, POINTS, frame), CLOUD)
            writer.write(connection, 1_000_000_000, raw)
    return folder


def test_clouds_of_several_sensors_come_in_one_frame(tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    half = float(np.sqrt(0.5))
    transforms: dict[str, tuple[str, tuple[float, ...]]] = {
        "left": ("body", (0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0)),
        "right": ("body", (0.0, -1.0, 0.0, half, 0.0, 0.0, half)),
        "body": ("odom", (0.0, 0.0, 0.9, 1.0, 0.0, 0.0, 0.0)),
    }
    cloud = read_cloud(write_tf_bag(tmp_path / "bag", transforms, {"/left": "left", "/right": "right"}))
    turned = np.column_stack([-POINTS[:, 1], POINTS[:, 0], POINTS[:, 2]])
    expected = np.concatenate([POINTS + np.array([0.0, 1.0, 0.9]), turned + np.array([0.0, -1.0, 0.9])])
    np.testing.assert_allclose(cloud.points, expected, atol=1e-6)
    np.testing.assert_allclose(cloud.starts[[0, -1]], [[0.0, 1.0, 0.9], [0.0, -1.0, 0.9]])
    assert "moved from the frame 'left' to 'odom' by the bag's transforms" in cloud.notes


def test_transforms_in_a_circle_are_refused(tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    still = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
    path = write_tf_bag(tmp_path / "bag", {"a": ("b", still), "b": ("a", still)}, {"/points": "a"})
    with pytest.raises(CloudError, match="turn in a circle"):
        parse_file(path)


def check(read: Callable[[bytes], Scan], content: bytes) -> None:
    """That the content reads, or is refused in one line."""
    with np.errstate(all="ignore"):
        line, scan = "", Scan(np.zeros((0, 3)))
        try:
            scan = read(content)
        except CloudError as error:
            line = str(error)
    assert line == "" or line.isprintable()
    assert scan.points.ndim == 2
    assert scan.points.shape[1] == 3


def edits(content: bytes) -> st.SearchStrategy[bytes]:
    """The content with a few bytes changed, and perhaps cut off."""
    place = st.one_of(st.integers(0, min(500, len(content) - 1)), st.integers(0, len(content) - 1))
    values = st.one_of(st.sampled_from(b'\0\x7f\xff 0-9e,\n<>"'), st.integers(0, 255))

    def apply(drawn: tuple[list[tuple[int, int]], int]) -> bytes:
        changed = bytearray(content)
        for at, value in drawn[0]:
            changed[at] = value
        return bytes(changed[: len(changed) - drawn[1]])

    cut = st.one_of(st.just(0), st.integers(0, len(content)))
    return st.tuples(st.lists(st.tuples(place, values), max_size=4), cut).map(apply)


READERS: dict[str, tuple[Callable[[bytes], Scan], Callable[[], bytes]]] = {
    "vtk ascii": (lambda data: read_vtk(data, "a"), lambda: legacy(False)),
    "vtk binary": (lambda data: read_vtk(data, "a"), lambda: legacy(True)),
    "xml ascii": (lambda data: read_vtk_xml(data, "a"), lambda: xml("ascii")),
    "xml packed": (lambda data: read_vtk_xml(data, "a"), lambda: xml("binary", True)),
    "xml raw": (lambda data: read_vtk_xml(data, "a"), lambda: xml("appended", True)),
    "ply ascii": (lambda data: read_ply(data, "a"), lambda: ragged("ascii")),
    "ply little": (lambda data: read_ply(data, "a"), lambda: ragged("binary_little_endian")),
}


@pytest.mark.parametrize("kind", list(READERS))
def test_damaged_files_read_or_are_refused(kind: str) -> None:
    read, make = READERS[kind]
    settings(max_examples=60, deadline=None)(given(edits(make()))(lambda content: check(read, content)))()


def test_damaged_depth_images_read_or_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "depth.png"

    def read(content: bytes) -> Scan:
        path.write_bytes(content)
        return read_depth_png(path, "a")

    path.with_suffix(".json").write_text(json.dumps(CAMERA))
    settings(max_examples=60, deadline=None)(given(edits(png(DEPTH, 4)))(lambda content: check(read, content)))()


@given(
    st.dictionaries(
        st.sampled_from(["K", "fx", "fy", "cx", "cy", "depth_scale", "pose", "intrinsics"]),
        st.recursive(st.none() | st.floats() | st.text(max_size=3), lambda x: st.lists(x, max_size=9)),
    )
)
def test_damaged_intrinsics_read_or_are_refused(values: dict[str, Any]) -> None:
    line, focal = "", 1.0
    try:
        focal = parse_intrinsics(values, "a").fx
    except CloudError as error:
        line = str(error)
    assert line == "" or line.isprintable()
    assert focal > 0.0
