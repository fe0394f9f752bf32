"""Cloud files: every format round trip, and what each hostile file is told."""

from __future__ import annotations

import io
import os
import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest
from cloud_files import las_bytes
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from perception import Cloud, CloudError, make_cloud, read_cloud, write_pcd
from perception.files.lzf import compress, decompress
from perception.files.npz import read_npz
from perception.files.parse import parse_file
from perception.files.pcd import read_pcd
from perception.files.ply import read_ply
from perception.files.table import read_text

COORDINATES = arrays(np.float32, st.tuples(st.integers(1, 40), st.just(3)), elements=st.floats(-50, 50, width=32))
VIEWPOINT = (0.5, -0.25, 1.5, 1.0, 0.0, 0.0, 0.0)


@given(st.binary(max_size=3000))
def test_lzf_unpacks_what_it_packed(data: bytes) -> None:
    assert decompress(compress(data), len(data)) == data


@given(st.lists(st.sampled_from([b"abc", b"\0\0\0\0", b"x" * 300, b"q"]), max_size=60))
def test_lzf_unpacks_repetitive_data_and_packs_it_smaller(parts: list[bytes]) -> None:
    data = b"".join(parts)
    packed = compress(data)
    assert decompress(packed, len(data)) == data
    assert len(packed) <= len(data) + len(data) // 32 + 1


@pytest.mark.parametrize(
    ("packed", "plain"),
    [
        (b"\x04hello", b"hello"),
        (b"\x00a\x20\x00", b"aaaa"),  # copy of 3 from distance 1 repeats the byte
        (b"\x02abc\x80\x02", b"abcabcabc"),  # copy of 6 from distance 3 overlaps itself
        (b"\x01ab\xe0\x01\x01", b"ab" + b"ab" * 5),  # length 7 + 1 + 2 = 10 from distance 2
    ],
)
def test_lzf_unpacks_streams_worked_out_by_hand(packed: bytes, plain: bytes) -> None:
    assert decompress(packed, len(plain)) == plain


@pytest.mark.parametrize("packed", [b"\x05ab", b"\x20", b"\xe0", b"\x00a\x20\x05", b"\x00a"])
def test_lzf_refuses_damaged_streams(packed: bytes) -> None:
    with pytest.raises(ValueError, match=r"literal|cut off|beginning|announced"):
        decompress(packed, 5)


@given(COORDINATES, st.sampled_from(["ascii", "binary", "binary_compressed"]))
def test_pcd_round_trip_keeps_points_and_viewpoint(tmp_path_factory, points, encoding) -> None:
    path = tmp_path_factory.mktemp("pcd") / "cloud.pcd"
    write_pcd(path, points, VIEWPOINT, encoding)
    scan = read_pcd(path.read_bytes(), "cloud.pcd")
    np.testing.assert_array_equal(scan.points.astype(np.float32), points)
    assert scan.viewpoint == VIEWPOINT


@given(
    COORDINATES, st.permutations(["x", "y", "z", "intensity", "_", "_"]), st.sampled_from(["f4", "f8"]), st.booleans()
)
def test_pcd_fields_may_come_in_any_order_and_width(points, fields, kind, compressed) -> None:
    size = int(kind[1])
    types = {"x": kind, "y": kind, "z": kind, "intensity": "u2", "_": "u1"}
    dtype = np.dtype([(str(i), "<" + types[field]) for i, field in enumerate(fields)])
    table = np.zeros(len(points), dtype)
    for axis, name in enumerate("xyz"):
        table[str(fields.index(name))] = points[:, axis]
    sizes = [{"intensity": 2, "_": 1}.get(field, size) for field in fields]
    kinds = ["U" if field in ("intensity", "_") else "F" for field in fields]
    raw = b"".join(table[str(i)].tobytes() for i in range(len(fields))) if compressed else table.tobytes()
    body = struct.pack("<II", len(compress(raw)), len(raw)) + compress(raw) if compressed else raw
    header = pcd_header(
        FIELDS=" ".join(fields), SIZE=" ".join(map(str, sizes)), TYPE=" ".join(kinds), COUNT="1 1 1 1 1 1",
        WIDTH=len(points), POINTS=len(points), DATA="binary_compressed" if compressed else "binary",
    )  # fmt: skip
    scan = read_pcd(header + body, "cloud.pcd")
    np.testing.assert_array_equal(scan.points.astype(np.float32), points)


def pcd_header(**changes: object) -> bytes:
    entries: dict[str, object] = {
        "VERSION": "0.7", "FIELDS": "x y z", "SIZE": "4 4 4", "TYPE": "F F F", "COUNT": "1 1 1", "WIDTH": 2,
        "HEIGHT": 1, "VIEWPOINT": "0 0 0 1 0 0 0", "POINTS": 2, "DATA": "binary",
    } | changes  # fmt: skip
    return "".join(f"{key} {value}\n" for key, value in entries.items() if value is not None).encode()


@pytest.mark.parametrize(
    ("changes", "body", "says"),
    [
        ({"WIDTH": 2_000_000_000, "POINTS": 2_000_000_000}, b"\0" * 24, "at most 50000000"),
        ({"WIDTH": 1000, "POINTS": 1000}, b"\0" * 24, "1000 points of 12 bytes are announced, but only 24"),
        ({"WIDTH": -2, "POINTS": -2}, b"\0" * 24, "WIDTH '-2' is not a whole number"),
        ({"SIZE": "0 4 4"}, b"\0" * 24, "field 'x' has TYPE F SIZE 0"),
        ({"SIZE": "4 4"}, b"\0" * 24, "3 FIELDS but 2 SIZE"),
        ({"TYPE": "F Q F"}, b"\0" * 24, "field 'y' has TYPE Q"),
        ({"COUNT": "1 -1 1"}, b"\0" * 24, "COUNT -1"),
        ({"FIELDS": "x y w"}, b"\0" * 24, "has no 'z'"),
        ({"WIDTH": 0, "POINTS": 0}, b"", "announces no points"),
        ({"POINTS": 3}, b"\0" * 36, "WIDTH x HEIGHT is 2 but POINTS is 3"),
        ({"VIEWPOINT": "0 0 0 0 0 0 0"}, b"\0" * 24, "viewpoint '0 0 0 0 0 0 0' is not"),
        ({"VIEWPOINT": "nan 0 0 1 0 0 0"}, b"\0" * 24, "viewpoint 'nan 0 0 1 0 0 0' is not"),
        ({"WIDTH": "²", "POINTS": "9" * 5000}, b"\0" * 24, "WIDTH '.+' is not a whole number"),
        ({"COUNT": "1 1 65537"}, b"\0" * 24, "COUNT 65537"),
        ({"DATA": "zip"}, b"\0" * 24, "DATA 'zip' is unknown"),
        ({"DATA": None}, b"\0" * 24, "no DATA line"),
        ({"DATA": "ascii"}, b"1 2 3\n4 5\n", "line 12 has 2 columns, 3 are announced"),
        ({"DATA": "ascii"}, b"1 2 3\n4 five 6\n", "five"),
        ({"DATA": "binary_compressed"}, b"\1\0", "ends before the sizes"),
        ({"DATA": "binary_compressed"}, struct.pack("<II", 9, 2**31), "announce 2147483648 bytes"),
        (
            {
                "FIELDS": "x y z rest",
                "SIZE": "4 4 4 8",
                "TYPE": "F F F U",
                "COUNT": "1 1 1 65536",
                "WIDTH": 600,
                "POINTS": 600,
                "DATA": "binary_compressed",
            },
            struct.pack("<II", 9, 600 * (12 + 8 * 65536)),
            "unpacks to 314580000 bytes; at most 268435456",
        ),
        (
            {"FIELDS": None, "SIZE": None, "TYPE": None, "COUNT": None},
            b"",
            "header has no FIELDS; x, y and z are needed",
        ),
        ({"DATA": "binary_compressed"}, struct.pack("<II", 900, 24) + b"\0" * 20, "900 compressed bytes"),
        ({"DATA": "binary_compressed"}, struct.pack("<II", 4, 24) + b"\x20\0\0\0", "damaged"),
    ],
)
def test_a_lying_pcd_is_refused_in_one_line(changes, body, says, tmp_path: Path) -> None:
    path = tmp_path / "liar.pcd"
    path.write_bytes(pcd_header(**changes) + body)
    with pytest.raises(CloudError, match=says) as caught:
        parse_file(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


@given(
    COORDINATES, st.sampled_from(["ascii", "binary_little_endian", "binary_big_endian"]), st.sampled_from(["f4", "f8"])
)
def test_ply_round_trip(points, form, kind) -> None:
    header = (
        f"ply\nformat {form} 1.0\ncomment viewpoint 0.5 -0.25 1.5 1 0 0 0\nelement camera 1\nproperty uchar id\n"
        f"element vertex {len(points)}\nproperty {'float' if kind == 'f4' else 'double'} y\nproperty uchar red\n"
        f"property {'float' if kind == 'f4' else 'double'} x\nproperty {'float' if kind == 'f4' else 'double'} z\n"
        "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    ).encode()
    order = ">" if form.endswith("big_endian") else "<"
    if form == "ascii":
        body = b"7\n" + "".join(f"{y!r} 9 {x!r} {z!r}\n" for x, y, z in points.tolist()).encode() + b"3 0 0 0\n"
    else:
        table = np.zeros(len(points), [("y", order + kind), ("r", "u1"), ("x", order + kind), ("z", order + kind)])
        for axis, name in enumerate("xyz"):
            table[name] = points[:, axis]
        body = b"\7" + table.tobytes() + b"\3" + np.zeros(3, order + "i4").tobytes()
    scan = read_ply(header + body, "cloud.ply")
    np.testing.assert_array_equal(scan.points.astype(np.float32), points)
    assert scan.viewpoint == VIEWPOINT


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_ply_lists_may_stand_before_the_vertices_and_in_them(form: str) -> None:
    header = (
        f"ply\nformat {form} 1.0\nelement nothing 0\nelement face 2\nproperty list uchar int vertex_indices\n"
        "element vertex 3\nproperty float x\nproperty list uchar short seen\nproperty float y\n"
        "property float z\nend_header\n"
    ).encode()
    points = np.arange(9.0).reshape(3, 3)
    if form == "ascii":
        body = b"3 0 1 2\n4 0 1 2 0\n" + "".join(f"{x} 2 7 8 {y} {z}\n" for x, y, z in points).encode()
    else:
        order = ">" if form.endswith("big_endian") else "<"
        faces = np.zeros(2, [("n", "u1"), ("i", order + "i4", (3,))])
        faces["n"] = 3
        rows = np.zeros(3, [("x", order + "f4"), ("n", "u1"), ("s", order + "i2", (2,)), ("yz", order + "f4", (2,))])
        rows["x"], rows["n"], rows["yz"] = points[:, 0], 2, points[:, 1:]
        body = faces.tobytes() + rows.tobytes()
        rows["n"][1] = 200
        with pytest.raises(CloudError, match="ends within the 3 rows of element vertex"):
            read_ply(header + faces.tobytes() + rows.tobytes(), "a.ply")
        rows["n"][1] = 2
    np.testing.assert_array_equal(read_ply(header + body, "a.ply").points, points)


def test_lines_may_end_in_carriage_returns_alone() -> None:
    ply = PLY.format(form="ascii", n=2, kind="float z").encode() + b"1 2 3\n4 5 6\n"
    pcd = pcd_header(DATA="ascii") + b"1 2 3\n4 5 6\n"
    for read, content in ((read_ply, ply), (read_pcd, pcd), (read_text, b"x,y,z\n1,2,3\n4,5,6\n")):
        np.testing.assert_array_equal(read(content.replace(b"\n", b"\r"), "a").points, [[1, 2, 3], [4, 5, 6]])


def test_a_binary_ply_may_have_a_header_with_carriage_returns_alone() -> None:
    header = PLY.format(form="binary_little_endian", n=2, kind="float z")
    rows = np.array([[1, 2, 3], [4, 5, 6]], "<f4")
    for end in ("\r", "\r\n"):
        scan = read_ply(header.replace("\n", end).encode() + rows.tobytes(), "a.ply")
        np.testing.assert_array_equal(scan.points, rows)


@pytest.mark.parametrize("form", ["ascii", "binary_big_endian"])
def test_a_mesh_that_is_read_as_a_cloud_is_reported(form: str) -> None:
    header = PLY.format(form=form, n=1, kind="float z").replace(
        "end_header", "element face 12\nproperty list uchar int vertex_indices\nend_header"
    )
    row = b"1 2 3\n" if form == "ascii" else np.array([1, 2, 3], ">f4").tobytes()
    notes = read_ply(header.encode() + row, "a.ply").notes
    assert notes == ("holds a mesh, of whose 12 faces only the corners are read; give a known object as a mesh",)


PLY = "ply\nformat {form} 1.0\nelement vertex {n}\nproperty float x\nproperty float y\nproperty {kind}\nend_header\n"


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"ply\nformat ascii 1.0\n", "no end_header"),
        (b"obj\n", "does not begin with 'ply'"),
        (PLY.format(form="ascii", n=4_000_000_000, kind="float z").encode(), "at most 50000000"),
        (PLY.format(form="ascii", n=-1, kind="float z").encode(), "not an element"),
        (PLY.format(form="ascii", n=0, kind="float z").encode(), "announces no vertices"),
        (PLY.format(form="ascii", n=2, kind="float z").encode() + b"1 2 3\n", "2 vertices are announced, 1 lines"),
        (PLY.format(form="ascii", n=1, kind="float z").encode() + b"1 2\n", "line 8 has 2 columns, 3 are announced"),
        (PLY.format(form="ascii", n=1, kind="float z").encode() + b"1 2 z\n", "line 8: 'z' is not a number"),
        (PLY.format(form="binary_little_endian", n=9, kind="float z").encode() + b"\0" * 12, "only 12 bytes"),
        (PLY.format(form="binary_middle_endian", n=1, kind="float z").encode(), "format 'binary_middle_endian'"),
        (PLY.format(form="ascii", n=1, kind="quad z").encode(), "not a property of a known type"),
        (PLY.format(form="ascii", n=1, kind="list uchar int").encode(), "not a property of a known type"),
        (PLY.format(form="ascii", n=1, kind="list float int z").encode(), "not a property of a known type"),
        (PLY.format(form="binary_little_endian", n=1, kind="list uint int z").encode() + b"\xff" * 12, "more than it"),
        (PLY.format(form="ascii", n=1, kind="float w").encode(), "no property 'z'"),
        (b"ply\nformat ascii 1.0\nelement face 1\nproperty int a\nend_header\n", "no element vertex"),
    ],
)
def test_a_lying_ply_is_refused_in_one_line(content, says, tmp_path: Path) -> None:
    path = tmp_path / "liar.ply"
    path.write_bytes(content)
    with pytest.raises(CloudError, match=says) as caught:
        parse_file(path)
    assert "\n" not in str(caught.value)


@given(
    COORDINATES,
    st.sampled_from([" ", ",", ";", "\t", " , "]),
    st.sampled_from(["", "x{0}y{0}z\n", '"X"{0}"Y"{0}"Z"\n']),
)
def test_text_round_trip_with_any_separator_and_header(points, mark, header) -> None:
    rows = "".join(mark.join(repr(v) for v in row) + "\n" for row in points.tolist())
    scan = read_text((header.format(mark) + rows).encode(), "cloud.csv")
    np.testing.assert_array_equal(scan.points.astype(np.float32), points)
    assert scan.viewpoint is None


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("# viewpoint 0 0 1\n1 2 3\n", [[1, 2, 3]]),
        ("i,z,y,x\n7,3,2,1\n", [[1, 2, 3]]),
        ('"rgb:0","z","Points:0","Points:1","Points:2"\n0,9,1,2,3\n', [[1, 2, 3]]),
        ("//X Y Z\n1 2 3\n\n4 5 6\n", [[1, 2, 3], [4, 5, 6]]),
        ("1,5;2,5;3\n", [[1.5, 2.5, 3]]),
        ("1,2,3,\n", [[1, 2, 3]]),
        ("1,2,3,\n4,5,6\n7,8,9,1\n", [[1, 2, 3], [4, 5, 6], [7, 8, 9]]),
        ("1,2,3\n4,5,\n,,\n", [[1, 2, 3], [4, 5, np.nan], [np.nan] * 3]),
        ("1,2,\n4,5,6\n", [[1, 2, np.nan], [4, 5, 6]]),
        ("x,y,z,i\n1,2,3,\n4,5,6,7\n", [[1, 2, 3], [4, 5, 6]]),
        ("x,y,z,\n1,2,3,\n4,5,\n7,8,9\n", [[1, 2, 3], [4, 5, np.nan], [7, 8, 9]]),
        ("1\t2\t\n4\t5\t6\n", [[1, 2, np.nan], [4, 5, 6]]),
        ("\t1\t2\t3\n \n4\t5\t6\n", [[1, 2, 3], [4, 5, 6]]),
        ("2\n1 2 3 9\n4 5 6 9\n", [[1, 2, 3], [4, 5, 6]]),
        ("field.y,field.x,field.z\n1,2,3\n", [[2, 1, 3]]),
        ('"intensity","Points_m_XYZ:0","Points_m_XYZ:1","Points_m_XYZ:2"\n0,1,2,3\n', [[1, 2, 3]]),
        ("X [m] Y [m] Z [m] I\n1 2 3 4\n", [[1, 2, 3]]),
        ("1,5\t2\t3,25\n", [[1.5, 2, 3.25]]),
        ("-1,5 2,5 3,25e1\n4 5 6\n", [[-1.5, 2.5, 32.5], [4, 5, 6]]),
        ("x,y,z,r,g,b\n1,2,3,4,5,6\n", [[1, 2, 3]]),
        ("1,2,3,4,5,6.5\n1,2,3,4,5,6\n", [[1, 2, 3], [1, 2, 3]]),
        ("1,2,3\n4,,6\n7,8,9\n", [[1, 2, 3], [4, np.nan, 6], [7, 8, 9]]),
        ("x;y;z;what\n1,5;2;3;car\n", [[1.5, 2, 3]]),
        ("//X Y Z Original cloud index\n1 2 3 0\n", [[1, 2, 3]]),
        ("x;y;z;;\n1;2;3;;;\n4;5;6;;;\n", [[1, 2, 3], [4, 5, 6]]),
        ("X [m],Y [m],Z (m)\r\n1,2,3\r\n", [[1, 2, 3]]),
        ("\ufeff1\t2\t3\n", [[1, 2, 3]]),
        ("1 2 3\r4 5 6\r", [[1, 2, 3], [4, 5, 6]]),
        ("1 2 3\n# between\n4 5 6\n", [[1, 2, 3], [4, 5, 6]]),
        ('"1.0","2.0","3.0"\n', [[1, 2, 3]]),
        ("1e0 2E0 +3\n", [[1, 2, 3]]),
    ],
)
def test_text_of_the_field_is_understood(text: str, expected: list[list[float]]) -> None:
    np.testing.assert_array_equal(read_text(text.encode(), "cloud.csv").points, expected)


@given(
    st.permutations(["x", "y", "z", "gps time", "i", "cloud index"]),
    st.integers(3, 6),
    st.integers(0, 2),
    st.sampled_from([",", ";", "\t", " "]),
)
def test_columns_are_those_that_the_header_names_or_the_table_is_refused(
    names: list[str], n_named: int, n_more: int, mark: str
) -> None:
    named = names[:n_named]
    # A name of two words and a column without a name make up for each other between blanks.
    assume(mark != " " or not n_more or not any(" " in name for name in named))
    rows = [[100 * row + column for column in range(n_named)] + [7] * n_more for row in (1, 2)]
    text = "\n".join([mark.join(named), *(mark.join(map(str, row)) for row in rows)]) + "\n"
    try:
        points = read_text(text.encode(), "a.csv").points
    except CloudError:
        return
    expected = [[row[named.index(axis)] for axis in "xyz"] for row in rows]
    np.testing.assert_array_equal(points, expected)


@pytest.mark.parametrize("header", ["X [mm],Y [mm],Z [mm]", "x_mm,y_mm,z_mm", "x (millimetres);y (millimetres);z (MM)"])
def test_a_unit_in_the_header_is_noted_when_another_is_taken(header: str, tmp_path: Path) -> None:
    path = tmp_path / "cloud.csv"
    path.write_text(f"{header}\n1000{';' if ';' in header else ','}2000{';' if ';' in header else ','}3000\n")
    (note,) = [note for note in read_cloud(path).notes if "header" in note]
    assert note == "its header says mm, but it was read as m: give the unit mm"
    cloud = read_cloud(path, unit="mm")
    np.testing.assert_allclose(cloud.points, [[1, 2, 3]])
    assert not any("header" in note for note in cloud.notes)


def test_decimal_commas_are_reported() -> None:
    assert read_text(b"1,5\t2\t3,25\n", "cloud.csv").notes == ("commas are read as decimal points",)


@pytest.mark.parametrize("encoding", ["utf-16", "utf-8-sig"])
def test_a_table_may_begin_with_a_byte_order_mark(encoding: str) -> None:
    np.testing.assert_array_equal(read_text("x,y,z\n1,2,3\n".encode(encoding), "cloud.csv").points, [[1, 2, 3]])


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("x,y,z\n", "has a header but no points"),
        ("# nothing\n", "holds no points"),
        ("1 2\n3 4\n", "line 1 has 2 columns; at least 3"),
        ("1 2 3\n4 5\n", "line 2 has 2 columns, the first has 3"),
        ("# a\n\n1 2 3\n4 5 6 7\n", "line 4 has 4 columns, the first has 3"),
        ("1 " * 40_000, "line 1 is longer than 65536 bytes; one row a line is needed"),
        ("1,2,3\n4,abc,6\n", "line 2: 'abc' is not a number"),
        ("a,b,c\n1,2,3\n", "line 1: the header names no x, y, z; it has a, b, c"),
        ("Easting;Northing;Height\n1;2;3\n", "the header names no x, y, z; it has Easting, Northing, Height"),
        ("1,2,3,\n4,5\n", "line 2 has 2 columns, the first has 3"),
        ("0,2796,-1,02,1,5\n1,1,2,2,3,3\n", "line 1 has 6 whole numbers between commas; if commas are decimal"),
        ("x,y,z\n0,2796,-1,02,1,5\n", "line 2 has 6 whole numbers between commas; if commas are decimal"),
        ("1 2 3\n1,5 2 3\n", "line 2: '1,5' is not a number; is the comma a decimal point"),
        ("5\n6\n", "line 2 has 1 columns; at least 3"),
        ("1,2,\ufffd\x07\ufffd\ufffd\n", "line 1: '.' is not a number"),
        ("# viewpoint a b\n1 2 3\n", "viewpoint 'a b'"),
        ("x y z\n1 0.1 0.2 0.3\n", "line 2 has 4 columns, the header names 3; give one name for each"),
        ('x,y,z\n"1,017.5","2.5","3.5"\n', "line 2 has 4 columns, the header names 3"),
        ("GPS time X Y Z I\n0 1 2 3 4\n", "line 2 has 5 columns, the header names 6"),
    ],
)
def test_a_wrong_table_is_refused_naming_the_line(text: str, says: str, tmp_path: Path) -> None:
    path = tmp_path / "cloud.csv"
    path.write_text(text)
    with pytest.raises(CloudError, match=says):
        parse_file(path)


@given(COORDINATES, st.sampled_from(["points", "xyz", "arr_0"]), st.sampled_from([np.float32, np.float64]))
def test_npz_round_trip(points, key, dtype) -> None:
    stream = io.BytesIO()
    np.savez_compressed(stream, **{key: points.astype(dtype), "viewpoint": np.array(VIEWPOINT)})
    scan = read_npz(stream.getvalue(), "cloud.npz")
    np.testing.assert_array_equal(scan.points.astype(np.float32), points)
    assert scan.viewpoint == VIEWPOINT


def npz(**arrays_by_name: object) -> bytes:
    stream = io.BytesIO()
    np.savez(stream, **arrays_by_name)  # type: ignore[arg-type]
    return stream.getvalue()


@pytest.mark.parametrize("order", ["C", "F"])
def test_arrays_of_depth_cameras_and_named_columns_are_read(tmp_path: Path, order: str) -> None:
    grid = np.random.default_rng(0).normal(size=(4, 5, 3))
    rows = grid.reshape(-1, 3)
    named = np.zeros((4, 5), [("i", "u1"), ("Z", "f8"), ("x", "f8"), ("y", "f8"), ("no_return", "u1")])
    for column, axis in zip("xyZ", range(3), strict=True):
        named[column] = grid[..., axis]
    for array in (np.asarray(grid, order=order), np.asarray(rows, order=order), named):  # type: ignore[call-overload]
        np.save(tmp_path / "a.npy", array)
        np.testing.assert_array_equal(parse_file(tmp_path / "a.npy").points, rows)
    x, y, z = (np.asarray(grid[..., axis], order=order) for axis in range(3))  # type: ignore[call-overload]
    for members in ({"points": grid}, {"X": x, "Y": y, "Z": z}, {"x": rows[:, 0], "y": rows[:, 1], "z": rows[:, 2]}):
        np.savez(tmp_path / "a.npz", viewpoint=VIEWPOINT, **members)
        scan = parse_file(tmp_path / "a.npz")
        np.testing.assert_array_equal(scan.points, rows)
        assert scan.viewpoint == VIEWPOINT
    named["no_return"][1] = 1
    np.savez(tmp_path / "a.npz", points=named)
    scan = parse_file(tmp_path / "a.npz")
    np.testing.assert_array_equal(scan.points, np.delete(rows, np.s_[5:10], axis=0))
    np.testing.assert_array_equal(scan.misses, rows[5:10])


@pytest.mark.parametrize("shape", [(480, 640), (3, 48, 64), (48, 64, 1)])
def test_a_picture_is_no_cloud(tmp_path: Path, shape: tuple[int, ...]) -> None:
    np.save(tmp_path / "a.npy", np.zeros(shape))
    with pytest.raises(CloudError, match=r"numbers \(N, 3\) or \(H, W, 3\) are needed"):
        parse_file(tmp_path / "a.npy")


def test_a_turned_array_is_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.zeros((3, 2000)))
    with pytest.raises(
        CloudError, match=r"a.npy: array has shape \(3, 2000\), which looks turned; save its transpose \(2000, 3\)"
    ):
        parse_file(tmp_path / "a.npy")


def boastful_npz() -> bytes:
    """An archive whose array says it has 700 million doubles."""
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (240000000, 3), }".ljust(117) + b"\n"
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr("points.npy", b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + b"\0" * 100)
    return stream.getvalue()


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (boastful_npz(), "claims 5760000000 bytes"),
        (npz(points=np.array([{}], dtype=object)), "pickled objects"),
        (npz(other=np.zeros((2, 3))), "holds other; an array 'points'"),
        (npz(points=np.zeros(5)), r"shape \(5,\)"),
        (npz(points=np.zeros((5, 3), dtype=complex)), "complex128"),
        (npz(points=np.zeros((3, 500))), r"shape \(3, 500\), which looks turned; save its transpose \(500, 3\)"),
        (npz(points=np.zeros((2, 2, 2, 3))), r"shape \(2, 2, 2, 3\); numbers \(N, 3\) or \(H, W, 3\)"),
        (npz(x=np.zeros(5), y=np.zeros(5), z=np.zeros(4)), r"x, y, z columns are float64 \(5,\), float64 \(5,\), "),
        (npz(points=np.zeros(5, [("x", "f4"), ("y", "f4")])), "has columns x, y, and no 'z'"),
        (b"PK\3\4 this is no archive", "not a readable npz"),
        (npz(points=np.zeros((50, 3)))[:-40], "not a readable npz"),
    ],
)
def test_a_hostile_npz_is_refused(content: bytes, says: str, tmp_path: Path) -> None:
    path = tmp_path / "cloud.npz"
    path.write_bytes(content)
    with pytest.raises(CloudError, match=says):
        parse_file(path)


@pytest.mark.parametrize("suffix", [".pcd", ".ply", ".xyz", ".csv", ".npz"])
@given(junk=st.binary(max_size=400))
def test_junk_is_refused_and_never_crashes(tmp_path_factory, suffix: str, junk: bytes) -> None:
    path = tmp_path_factory.mktemp("junk") / f"junk{suffix}"
    path.write_bytes(junk)
    try:
        n_points = len(parse_file(path).points)
    except CloudError as error:
        n_points, message = 1, str(error)
    else:
        message = ""
    assert n_points
    assert "\n" not in message


def test_files_that_are_none_are_refused(tmp_path: Path) -> None:
    (tmp_path / "empty.pcd").touch()
    (tmp_path / "folder.ply").mkdir()
    (tmp_path / "cloud.obj").write_bytes(b"v 1 2 3")
    (tmp_path / "cloud.dat").write_bytes(b"1 2 3")
    (tmp_path / "cloud").write_bytes(b"1 2 3")
    for name, says in [
        ("empty.pcd", "is empty"),
        ("folder.ply", "is a folder"),
        ("cloud.obj", "suffix '.obj' is that of a mesh, no cloud; one of .pcd, .ply"),
        ("cloud.dat", "suffix '.dat' is unknown; one of .pcd, .ply"),
        ("cloud", "has no suffix; one of .pcd, .ply"),
        ("absent.dat", "No such file"),
        ("absent.pcd", "No such file"),
    ]:
        with pytest.raises(CloudError, match=says):
            parse_file(tmp_path / name)


def test_a_file_is_read_as_what_it_holds_whatever_its_name_says(tmp_path: Path) -> None:
    points = np.arange(9.0).reshape(3, 3)
    write_pcd(tmp_path / "a.pcd", points)
    pcd = (tmp_path / "a.pcd").read_bytes()
    ply = PLY.format(form="ascii", n=1, kind="float z").encode() + b"1 2 3\n"
    for content, suffix, kind, n_points in [
        (pcd, ".ply", "PCD", 3),
        (pcd.partition(b"\n")[2], ".csv", "PCD", 3),
        (ply, ".csv", "PLY", 1),
        (las_bytes(points), ".xyz", "LAS", 3),
        (npz(points=points), ".npy", "NPZ", 3),
        (npz(points=points), ".txt", "NPZ", 3),
        (pcd, ".dat", "PCD", 3),
    ]:
        path = tmp_path / f"named{suffix}"
        path.write_bytes(content)
        scan = parse_file(path)
        assert len(scan.points) == n_points
        assert scan.notes == (
            f"holds {'an' if kind == 'NPZ' else 'a'} {kind} file, and is read as one though its name ends in {suffix}",
        )
    assert parse_file(tmp_path / "a.pcd").notes == ()
    (tmp_path / "a.laz").write_bytes(las_bytes(points))
    assert parse_file(tmp_path / "a.laz").notes == ()


@pytest.mark.parametrize(
    ("content", "suffix", "says"),
    [
        (b"\xff\xd8\xff\xe0\0\x10JFIF", ".csv", "is a JPEG picture; one of .pcd"),
        (b"\x89PNG\r\n\x1a\n\0", ".pcd", "a picture; as a depth image it needs"),
        (b"\x1f\x8b\x08\0", ".xyz", "is a gzip archive; unpack it; one of"),
        (b"\x89MCAP0\r\n\0", ".csv", "holds a bag; give it a name that ends in .mcap"),
        (b"\x1f\x8b\x08\0", ".gz", "is a gzip archive; unpack it; one of"),
        (b"\x1f\x8b\x08\0", ".mcap", "is a gzip archive; unpack it; one of .mcap"),
        (b"\x28\xb5\x2f\xfd", ".zstd", "is a zstd archive; unpack it; one of"),
        (b"#ROSBAG V2.0\n", ".active", "holds a bag; give it a name that ends in .bag"),
        (b"\x89MCAP0\r\n\0", ".bag", "holds an MCAP file; give it a name that ends in .mcap"),
        (b"#ROSBAG V2.0\n", ".db3", "holds a BAG file; give it a name that ends in .bag"),
        (b"\x07\0\x01\x02\x03", ".txt", "holds the byte 00 at 1, after 07 00 01 02 at its beginning, and is no text"),
    ],
)
def test_what_holds_no_cloud_is_named(tmp_path: Path, content: bytes, suffix: str, says: str) -> None:
    path = tmp_path / f"named{suffix}"
    path.write_bytes(content)
    with pytest.raises(CloudError, match=says):
        parse_file(path)


@pytest.mark.parametrize("suffix", ["asc", "pts", "xyzn", "xyzi", "xyzrgb"])
def test_text_of_other_names_is_read(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"cloud.{suffix}"
    path.write_text("2\n1 2 3 0 0 1\n4 5 6 0 0 1\n")
    np.testing.assert_array_equal(parse_file(path).points, [[1, 2, 3], [4, 5, 6]])


def test_a_pipe_is_refused_instead_of_waited_for(tmp_path: Path) -> None:
    path = tmp_path / "pipe.xyz"
    os.mkfifo(path)
    with pytest.raises(CloudError, match="is no regular file"):
        read_cloud(path)


def test_a_huge_file_is_refused_by_its_size_alone(tmp_path: Path) -> None:
    path = tmp_path / "huge.pcd"
    with path.open("wb") as file:
        file.truncate(513 * 2**20)
    with pytest.raises(CloudError, match="at most 536870912"):
        read_cloud(path)


def test_invalid_points_are_dropped_and_counted() -> None:
    points = np.ones((10, 3))
    points[:3, 1] = [np.nan, np.inf, -np.inf]
    cloud = make_cloud(points, np.zeros(3))
    assert len(cloud.points) == 7
    assert "dropped 3 NaN or infinite points of 10" in cloud.notes[0]
    with pytest.raises(CloudError, match="100 of 100 points are NaN"):
        make_cloud(np.full((100, 3), np.nan), np.zeros(3))


def test_a_cloud_cannot_be_made_of_nonsense() -> None:
    for points, origin in [
        (np.zeros((0, 3)), np.zeros(3)),
        (np.zeros((4, 2)), np.zeros(3)),
        (np.full((4, 3), np.nan), np.zeros(3)),
        (np.zeros((4, 3)), np.array([np.nan, 0, 0])),
    ]:
        with pytest.raises(CloudError):
            Cloud(points, origin)


def test_unit_and_frame_oddities_earn_a_note() -> None:
    rng = np.random.default_rng(0)
    room = rng.uniform([-2, -2, 0], [2, 2, 2], (1000, 3))
    origin = np.array([0.0, 0.0, 1.6])
    assert make_cloud(room, origin).notes == ()
    assert "unit mm" in make_cloud(1000 * room, 1000 * origin).notes[0]
    assert "map coordinates" in make_cloud(room + np.array([4e5, 5e6, 0]), origin).notes[0]
    (note,) = make_cloud(room + np.array([500.0, 0, 0.75]), origin).notes
    assert "500 m from the origin" in note
    assert "; -500 0 -0.78 0 0 0 would" in note


def test_the_viewpoint_is_ray_origin_and_moves_points_only_on_request(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    sensor = np.column_stack([rng.uniform(0.3, 2, 4000), rng.uniform(-1, 1, 4000), np.full(4000, -1.6)])
    half = np.sqrt(0.5)
    path = tmp_path / "sensor.pcd"
    # The sensor looks along its own y, so a quarter turn about x brings its z to the world's -y.
    turned = sensor[:, [0, 2, 1]] * [1, 1, -1]
    write_pcd(path, turned, (0.1, 0.2, 1.6, half, half, 0.0, 0.0))
    as_they_stand = read_cloud(path)
    np.testing.assert_allclose(as_they_stand.points, turned, atol=1e-6)
    np.testing.assert_allclose(as_they_stand.origin, [0.1, 0.2, 1.6], atol=1e-6)
    assert any("sensor-framed" in note for note in as_they_stand.notes)
    moved = read_cloud(path, apply_viewpoint=True)
    np.testing.assert_allclose(moved.points, sensor + np.array([0.1, 0.2, 1.6]), atol=1e-6)
    assert moved.notes == ()


def test_a_viewpoint_that_is_missing_cannot_be_applied(tmp_path: Path) -> None:
    path = tmp_path / "cloud.xyz"
    path.write_text("1 2 3\n4 5 6\n")
    assert "no sensor position" in read_cloud(path).notes[0]
    with pytest.raises(CloudError, match="no viewpoint to apply"):
        read_cloud(path, apply_viewpoint=True)


def test_the_same_scan_reads_the_same_in_every_format(shared_data: Path) -> None:
    clouds = [read_cloud(shared_data / "scenes" / "valve_a" / f"scan0.{kind}") for kind in ("pcd", "ply", "xyz")]
    for other in clouds[1:]:
        np.testing.assert_allclose(other.points, clouds[0].points, atol=1e-4)
        np.testing.assert_allclose(other.origin, clouds[0].origin, atol=1e-6)


def test_third_party_clouds_are_read(shared_data: Path) -> None:
    folder = shared_data / "clouds"
    kinect = read_cloud(folder / "kinect_office_capture0001.pcd")
    assert len(kinect.points) == 249_647
    assert any("dropped 57553" in note for note in kinect.notes)
    voxels = read_cloud(folder / "mit_octomap_scene1.csv")
    np.testing.assert_allclose(voxels.points[0], [0.475, 0.845, -0.005])
    assert len(read_cloud(folder / "eth_car_cloud400.csv").points) > 20_000
