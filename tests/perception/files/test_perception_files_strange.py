"""Files that read in a wrong way, or were refused in words that did not help: what they are told to be."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cloud_files import write_bag

from perception import CloudError, make_cloud, read_cloud
from perception.files.npz import read_npz
from perception.files.parse import parse_file
from perception.files.ply import read_ply
from perception.files.table import read_text

POINTS = np.round(np.random.default_rng(0).uniform(0.1, 2.0, (40, 3)), 3)
ROWS = [" ".join(map(str, row)) for row in POINTS.tolist()]


def text(lines: list[str]) -> bytes:
    return "".join(f"{line}\n" for line in lines).encode()


@pytest.mark.parametrize(
    "word",
    ["", "NaN", "nan(ind)", "-nan(ind)", "-1.#IND", "1.#QNAN", "1.#INF", "NA", "n/a", "#N/A", "null", "None", "-"],
)
def test_words_for_no_number_are_nan(word: str) -> None:
    scan = read_text(b"x,y,z\n1,2,3\n" + f"4,{word},6\n".encode(), "cloud")
    np.testing.assert_array_equal(scan.points, [[1, 2, 3], [4, np.nan, 6]])


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"x;y;z\n1,5;2,5;3,5\n1.234,5;2;3\n", "line 3: '1.234,5' is not a number"),
        (
            text(["40", *ROWS, "40", *ROWS]),
            "line 42 has 1 columns, the first has 3; if it counts the points of a further scan, give a file for each",
        ),
        (text(["50", *ROWS]), "50 points are announced, 40 lines are there"),
        (text([f"{i} {row}" for i, row in enumerate(ROWS)]), "its first column counts the rows; name all columns in a"),
        (text([f"{i + 1} {row} 7" for i, row in enumerate(ROWS)]), "its first column counts the rows; name all"),
    ],
)
def test_a_table_that_would_be_read_from_wrong_columns_or_in_part_is_refused(content: bytes, says: str) -> None:
    with pytest.raises(CloudError) as raised:
        read_text(content, "cloud")
    assert str(raised.value).startswith(f"cloud: {says}")


@pytest.mark.parametrize("comment", ["# viewpoint 0 0 1.6", "# VIEWPOINT: 0 0 1.6", "// Viewpoint 0 0 1.6 1 0 0 0"])
def test_a_viewpoint_may_be_written_in_capitals_and_with_a_colon(comment: str) -> None:
    assert read_text(text([comment, *ROWS]), "cloud").viewpoint == (0, 0, 1.6, 1, 0, 0, 0)
    content = PLY.format(more=comment.replace("#", "comment").replace("//", "comment") + "\n").encode()
    assert read_ply(content, "cloud").viewpoint == (0, 0, 1.6, 1, 0, 0, 0)


def test_a_table_of_a_spreadsheet_may_tell_its_separator() -> None:
    np.testing.assert_array_equal(read_text(b"sep=;\r\nx;y;z\r\n1,5;2;3\r\n", "cloud").points, [[1.5, 2, 3]])


def test_flags_may_be_words() -> None:
    scan = read_text(b"x,y,z,no_return\n1,2,3,False\n4,5,6,True\n", "cloud")
    np.testing.assert_array_equal(scan.points, [[1, 2, 3]])
    np.testing.assert_array_equal(scan.misses, [[4, 5, 6]])


def test_coordinates_in_different_units_are_refused() -> None:
    with pytest.raises(CloudError, match="the header has x, y, z in m, mm, m; one unit of all three is needed"):
        read_text(b"x [m],y [mm],z [m]\n1,2000,3\n", "cloud")
    assert read_text(b"x [mm],y,z\n1,2,3\n", "cloud").unit == ""


@pytest.mark.parametrize("suffix", [".xyz", ".mcap", ""])
def test_a_name_that_no_file_can_have_is_reported(suffix: str) -> None:
    with pytest.raises(
        CloudError, match=r"x: cannot be read \(File name too long\)|cannot be read \(File name too long"
    ):
        read_cloud("x" * 300 + suffix)


def test_zeros_are_no_ptx(tmp_path: Path) -> None:
    (tmp_path / "a.ptx").write_bytes(bytes(100))
    with pytest.raises(CloudError, match="holds the byte 00 at 0, after 00 00 00 00 at its beginning, and is no text"):
        parse_file(tmp_path / "a.ptx")


def test_a_single_array_of_objects_is_named_without_a_key(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.array([{}], dtype=object), allow_pickle=True)
    with pytest.raises(CloudError, match="array holds pickled objects; plain numbers are needed"):
        parse_file(tmp_path / "a.npy")


def test_colours_before_coordinates_are_reported() -> None:
    scan = read_text(text([f"255 {i} 0 {row}" for i, row in enumerate(ROWS)]), "cloud")
    (note,) = scan.notes
    assert note.startswith("its first three columns hold nothing but whole numbers from 0 to 255, as colours do")


@pytest.mark.parametrize(
    "content",
    [
        text(["30", *ROWS]),
        text([f"{row} 0.5 255 0 0" for row in ROWS]),
        text([f"{i} 5 3" for i in range(40)]),
        text([f"{i // 2} 5 3 1" for i in range(40)]),
        text([f"{i % 7} {i} 3 1 0 0" for i in range(40)]),
    ],
)
def test_tables_of_coordinates_are_read_without_a_word(content: bytes) -> None:
    scan = read_text(content, "cloud")
    assert len(scan.points) == 40
    assert scan.notes == ()


@pytest.mark.parametrize(
    ("content", "name", "says"),
    [
        (
            b"version https://git-lfs.github.com/spec/v1\noid",
            "a.pcd",
            "is a pointer of Git LFS in place of the file; 'git",
        ),
        (
            b"version https://git-lfs.github.com/spec/v1\noid",
            "a.npz",
            "is a pointer of Git LFS in place of the file; 'git",
        ),
        (b"<!doctype html><title>404</title>", "a.csv", "is a web page; one of"),
        (b"\n<HTML>", "a.ply", "is a web page; one of"),
        (b"PK\3\4\x14\0\x06\0\x08\0[Content_Types].xml", "a.xlsx", "is a spreadsheet; save it as CSV; one of"),
        (
            b"PK\3\4\0mimetypeapplication/vnd.oasis.opendocument.spreadsheet",
            "a.ods",
            "is a spreadsheet; save it as CSV",
        ),
        (b"1 2 3\n4 5 6\0\n", "a.xyz", "holds the byte 00 at 11, after 31 20 32 20 at its beginning, and is no text"),
        (
            b"\0\0\x80?",
            "a.bin",
            "has no header that says what its numbers are; if they are KITTI's x y z and",
        ),
        (b"\0\0\x80?", "a.pcd.bin", "has no header"),
        (b"\xd4\xc3\xb2\xa1", "a.pcap", "holds packets of a sensor, not points; give a bag of its driver"),
        (b"\xd0\xcf\x11\xe0", "a.fls", "is a manufacturer's own kind of file; export it as .e57 or .las"),
        (b"\xd0\xcf\x11\xe0", "a.RCP", "is a manufacturer's own kind of file"),
    ],
)
def test_what_is_no_cloud_is_reported_with_what_is_expected(
    tmp_path: Path, content: bytes, name: str, says: str
) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(CloudError) as raised:
        parse_file(path)
    assert str(raised.value).startswith(f"{path}: {says}")


def test_a_kitti_file_is_read_as_its_refusal_says(tmp_path: Path) -> None:
    rows = np.column_stack([POINTS, np.ones(len(POINTS))]).astype("f4")
    rows.tofile(tmp_path / "a.bin")
    np.save(tmp_path / "cloud.npy", np.fromfile(tmp_path / "a.bin", "f4").reshape(-1, 4))
    np.testing.assert_array_equal(parse_file(tmp_path / "cloud.npy").points, rows[:, :3])


AXES = "".join(f"property float {axis}\n" for axis in "xyz")
PLY = "ply\nformat ascii 1.0\n{more}element vertex 1\n" + AXES + "end_header\n1 2 3\n"


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_a_comment_may_speak_of_the_headers_end(end: str) -> None:
    content = PLY.format(more="comment no end_header yet\n").replace("\n", end).encode()
    np.testing.assert_array_equal(read_ply(content, "cloud").points, [[1, 2, 3]])


def test_the_element_that_announces_too_much_is_named() -> None:
    content = PLY.format(more="element stars 3000000000\nproperty int a\n").encode()
    with pytest.raises(CloudError, match="announces 3000000000 rows of element stars before the vertices; at most"):
        read_ply(content, "cloud")


def test_origins_of_another_number_than_points_are_reported() -> None:
    stream = io.BytesIO()
    np.savez(stream, points=POINTS, origin=POINTS[:7])
    with pytest.raises(CloudError, match="40 points but 7 rows of origin; one each, or one x y z, is needed"):
        read_npz(stream.getvalue(), "cloud")


@pytest.mark.parametrize("message", [0, -1, "all"])
def test_a_topic_without_messages_is_reported(tmp_path: Path, message: Any) -> None:
    pytest.importorskip("rosbags")
    write_bag(tmp_path / "bag", {"/points": []})
    with pytest.raises(CloudError, match="topic /points: holds no message; at least one is needed"):
        parse_file(tmp_path / "bag", message=message)


def test_numbers_too_large_to_be_places_are_reported_as_such(tmp_path: Path) -> None:
    path = tmp_path / "cloud.xyz"
    path.write_bytes(text([f"{1.6e9 + 0.1 * i:.1f} {row}" for i, row in enumerate(ROWS)]))
    with pytest.raises(CloudError, match=r"40 of 40 points lie beyond 1e\+09; are x, y, z other columns, or its bytes"):
        read_cloud(path)


@pytest.mark.parametrize(
    ("points", "origin", "says"),
    [
        (
            POINTS,
            [0, 0, 1600.0],
            "rays start at (0, 0, 1600), 1598 m away from the points: is the sensor's position in",
        ),
        (POINTS * [1e-5, 1e-5, 1] + [11.5, 48.1, 0], [0, 0, 1.0], ": are they degrees? metres are needed"),
        (POINTS * 4e8, [0, 0, 1.0], "as metres are taken as read: is it damaged, or are its bytes in another order?"),
    ],
)
def test_numbers_of_another_meaning_are_doubted(points: np.ndarray, origin: list[float], says: str) -> None:
    assert any(says in note for note in make_cloud(points, np.array(origin)).notes)


@pytest.mark.parametrize("origin", [[0, 0, 1.6], [300.0, 0, 1.6]])
def test_numbers_of_a_scan_are_not_doubted(origin: list[float]) -> None:
    pole = POINTS * [0.05, 0.05, 3.0]
    assert make_cloud(pole, np.array(origin)).notes == ()
