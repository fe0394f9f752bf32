"""Files with more points than are used, or larger than fits in memory: what is taken of them, and what is not."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from cloud_files import las_bytes, write_e57
from hypothesis import given
from hypothesis import strategies as st

from perception import Cloud, CloudError, read_cloud, write_npz, write_pcd
from perception.files import content, pcd, text
from perception.files import scan as scan_module
from perception.files.parse import parse_file
from perception.files.pcd import read_pcd
from perception.files.scan import pick_rows
from perception.files.table import read_text

N, STEP = 1003, 11
POINTS = np.round(np.random.default_rng(0).uniform(-2, 2, (N, 3)), 3).astype(np.float32)
NOTE = f"took 1 of every {STEP} of its {N} points, since at most 100 are used"


def rows(separator: str) -> str:
    return "".join(separator.join(f"{value:.3f}" for value in row) + "\n" for row in POINTS)


def ply(form: str) -> bytes:
    head = f"ply\nformat {form} 1.0\nelement vertex {N}\n" + "".join(f"property float {axis}\n" for axis in "xyz")
    body = rows(" ").encode() if form == "ascii" else POINTS.astype("<f4").tobytes()
    return head.encode() + b"end_header\n" + body


def saved(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


WRITERS: dict[str, Callable[[Path], object]] = {
    "binary.pcd": lambda path: write_pcd(path, POINTS, encoding="binary"),
    "ascii.pcd": lambda path: write_pcd(path, POINTS, encoding="ascii"),
    "packed.pcd": lambda path: write_pcd(path, POINTS, encoding="binary_compressed"),
    "binary.ply": lambda path: path.write_bytes(ply("binary_little_endian")),
    "ascii.ply": lambda path: path.write_bytes(ply("ascii")),
    "plain.xyz": lambda path: path.write_text(rows(" ")),
    "header.csv": lambda path: path.write_text("x;y;z\n# made by hand\n\n" + rows(";").replace(".", ",")),
    "a.npy": lambda path: path.write_bytes(saved(POINTS)),
    "columns.npy": lambda path: path.write_bytes(saved(np.asfortranarray(POINTS))),
    "a.npz": lambda path: write_npz(path, Cloud(POINTS.astype(float), np.zeros(3))),
    "a.las": lambda path: path.write_bytes(las_bytes(POINTS.astype(float))),
    "a.laz": lambda path: path.write_bytes(las_bytes(POINTS.astype(float), is_compressed=True)),
    "a.e57": lambda path: write_e57(path, [{"points": POINTS}]),
}


def written(folder: Path, kind: str) -> Path:
    if kind.endswith("e57"):
        pytest.importorskip("pye57")
    path = folder / kind
    WRITERS[kind](path)
    return path


@pytest.mark.parametrize("kind", WRITERS)
def test_all_kinds_are_thinned_to_the_same_rows(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written(tmp_path, kind)
    np.testing.assert_allclose(parse_file(path).points, POINTS, atol=1e-6)
    monkeypatch.setattr(scan_module, "MAX_POINTS", 100)
    scan = parse_file(path)
    assert len(scan.points) <= 100
    np.testing.assert_allclose(scan.points, POINTS[pick_rows(N, STEP)], atol=1e-6)
    assert scan.notes == (NOTE,)


@pytest.mark.parametrize("kind", WRITERS)
def test_a_file_that_is_mapped_or_read_in_blocks_reads_the_same(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = written(tmp_path, kind)
    monkeypatch.setattr(scan_module, "MAX_POINTS", 100)
    whole = parse_file(path)
    monkeypatch.setattr(content, "MAX_WHOLE_BYTES", 10)
    for module in ("text", "npz", "e57"):
        monkeypatch.setattr(f"perception.files.{module}._BLOCK", 257)
    monkeypatch.setattr("perception.files.las._CHUNK", 100)
    np.testing.assert_array_equal(parse_file(path).points, whole.points)


@given(st.integers(0, 400), st.integers(1, 50), st.integers(1, 60))
def test_blocks_of_rows_give_what_all_rows_at_once_give(n_rows: int, step: int, block: int) -> None:
    numbers = np.arange(n_rows)
    whole = numbers[pick_rows(n_rows, step)]
    starts = range(0, n_rows, block)
    parts = [numbers[first : first + block][pick_rows(min(block, n_rows - first), step, first)] for first in starts]
    np.testing.assert_array_equal(np.concatenate([numbers[:0], *parts]), whole)
    assert np.unique(whole // step).size == len(whole) >= n_rows // step


def test_all_rings_of_a_scanner_stay() -> None:
    ring = np.arange(16_000) % 16
    counts = np.bincount(ring[pick_rows(len(ring), 16)], minlength=16)
    assert counts.min() > 0.8 * counts.mean()


def test_starts_and_misses_are_thinned_with_their_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.npz"
    numbers = POINTS.astype(float)
    write_npz(path, Cloud(numbers, numbers + 1.0, (), numbers[:900] + 2.0, numbers[:900] + 3.0))
    monkeypatch.setattr(scan_module, "MAX_POINTS", 100)
    scan = parse_file(path)
    assert scan.starts is not None
    assert scan.miss_starts is not None
    assert 80 <= len(scan.points) + len(scan.misses) <= 100
    np.testing.assert_allclose(scan.starts, scan.points + 1.0)
    np.testing.assert_allclose(scan.miss_starts, scan.misses + 1.0)


def test_a_table_of_no_more_rows_than_are_used_is_read_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scan_module, "MAX_POINTS", N)
    for ending in (rows(" "), rows(" ").rstrip("\n")):
        assert len(read_text(ending.encode(), "a.xyz").points) == N


def test_text_that_is_too_long_for_memory_is_thinned_further(monkeypatch: pytest.MonkeyPatch) -> None:
    body = rows(" ").encode()
    monkeypatch.setattr(text, "MAX_WHOLE_BYTES", len(body) // 3)
    scan = read_text(body, "a.xyz")
    np.testing.assert_allclose(scan.points, POINTS[pick_rows(N, 4)], atol=1e-6)
    assert scan.notes == (f"took 1 of every 4 of its {N} points, since at most 2000000 are used",)


def test_a_word_in_a_row_that_is_taken_is_reported_with_its_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scan_module, "MAX_POINTS", 100)
    lines = rows(" ").splitlines()
    row = int(np.arange(N)[pick_rows(N, STEP)][7])
    lines[row] = "1 2 here"
    with pytest.raises(CloudError, match=rf"line {row + 2}: 'here' is not a number"):
        read_text("\n".join(["x y z", *lines]).encode(), "a.xyz")


@pytest.mark.parametrize("kind", ["ascii.pcd", "ascii.ply"])
def test_text_that_ends_early_is_refused_though_thinned(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = written(tmp_path, kind)
    path.write_bytes(path.read_bytes().rpartition(b"\n")[0].rpartition(b"\n")[0])
    monkeypatch.setattr(scan_module, "MAX_POINTS", 100)
    with pytest.raises(CloudError, match=f"{N} (points|vertices) are announced, {N - 1} lines are there"):
        parse_file(path)


def test_what_is_packed_as_a_whole_is_refused_when_too_large(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written(tmp_path, "packed.pcd")
    monkeypatch.setattr(pcd, "MAX_WHOLE_BYTES", 100)
    with pytest.raises(CloudError, match=r"compressed bytes, which are unpacked as a whole; .* save it as DATA binary"):
        read_pcd(path.read_bytes(), "a.pcd")


def test_large_utf_16_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.csv"
    path.write_text("x,y,z\n1,2,3\n4,5,6\n", encoding="utf-16")
    assert len(parse_file(path).points) == 2
    monkeypatch.setattr(content, "MAX_WHOLE_BYTES", 10)
    with pytest.raises(CloudError, match="is UTF-16 text of 38 bytes; save so large a file as UTF-8"):
        parse_file(path)


@pytest.mark.parametrize("kind", ["plain.xyz", "a.npy", "a.las", "a.e57", "binary.pcd", "binary.ply"])
def test_more_points_than_can_be_thinned_are_refused(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = written(tmp_path, kind)
    for module in ("text", "npz", "las", "e57", "pcd", "ply"):
        monkeypatch.setattr(f"perception.files.{module}.MAX_FILE_POINTS", N - 1)
    with pytest.raises(CloudError, match=f"at most {N - 1} are read|more than {N - 1} rows"):
        parse_file(path)


def test_two_million_rows_and_more_come_through_the_worker(tmp_path: Path) -> None:
    path = tmp_path / "a.npy"
    places = np.random.default_rng(0).uniform(-2, 2, (2_400_000, 3)).astype(np.float32)
    path.write_bytes(saved(places))
    cloud = read_cloud(path)
    np.testing.assert_array_equal(cloud.points, places[pick_rows(len(places), 2)])
    assert "took 1 of every 2 of its 2400000 points, since at most 2000000 are used" in cloud.notes
