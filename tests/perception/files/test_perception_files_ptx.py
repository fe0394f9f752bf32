"""PTX files: scans as grids of cells, each at its pose, with cells that met nothing."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from perception import CloudError, read_cloud
from perception.files import scan as scan_module
from perception.files.parse import parse_file
from perception.files.ptx import read_ptx

LEVEL = (np.eye(3), np.zeros(3))


def rays(n_columns: int, n_rows: int) -> np.ndarray:
    """Directions (C, R, 3) of a scanner: three quarters of a turn, from the floor to half way up."""
    azimuth = np.linspace(-2.3, 2.3, n_columns)[:, None]
    elevation = np.linspace(-1.0, 0.8, n_rows)[None, :]
    flat = np.cos(elevation)
    up = np.broadcast_to(np.sin(elevation), (n_columns, n_rows))
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), up], axis=2)


def ptx(
    cells: np.ndarray,
    pose: tuple[np.ndarray, np.ndarray] = LEVEL,
    more: str = "0.5",
    told: Sequence[float] | None = None,
) -> bytes:
    """One scan of cells (C, R, 3) in the scanner's frame, listed column by column."""
    rotation, position = pose
    rows = [[cells.shape[0]], [cells.shape[1]], position if told is None else told, *rotation.T]
    rows += [[*row, 0] for row in rotation.T] + [[*position, 1]]
    lines = [" ".join(f"{value:.9g}" for value in row) for row in rows]
    lines += [" ".join(f"{value:.9g}" for value in cell) + f" {more}" for cell in cells.reshape(-1, 3)]
    return "\n".join(lines).encode() + b"\n"


def scanned(is_missed: np.ndarray, seed: int = 0) -> np.ndarray:
    """Cells (C, R, 3) of a scan whose rays end 1 to 3 m away, or met nothing."""
    distance = np.random.default_rng(seed).uniform(1, 3, (*is_missed.shape, 1))
    return np.where(is_missed[:, :, None], 0.0, distance * rays(*is_missed.shape))


def hits_of(cells: np.ndarray, pose: tuple[np.ndarray, np.ndarray] = LEVEL) -> np.ndarray:
    """The points of the cells in the file's frame."""
    points = cells.reshape(-1, 3)
    return points[points.any(axis=1)] @ pose[0].T + pose[1]


poses = st.tuples(
    st.tuples(*[st.floats(-3, 3)] * 3).map(lambda turn: Rotation.from_rotvec(turn).as_matrix()),
    st.tuples(*[st.floats(-50, 50)] * 3).map(np.array),
)


@given(
    st.lists(st.tuples(st.integers(1, 9), st.integers(1, 9), poses), min_size=1, max_size=3),
    st.sampled_from(["", "0.5", "0.5 10 20 30"]),
    st.sampled_from(["\n", "\r\n"]),
)
def test_every_scan_stands_at_its_pose(
    scans: list[tuple[int, int, tuple[np.ndarray, np.ndarray]]], more: str, end: str
) -> None:
    parts = [(scanned(np.zeros((columns, rows), dtype=bool), columns), pose) for columns, rows, pose in scans]
    content = b"".join(ptx(cells, pose, more) for cells, pose in parts).replace(b"\n", end.encode())
    scan = read_ptx(content, "cloud")
    np.testing.assert_allclose(scan.points, np.concatenate([hits_of(*part) for part in parts]), atol=1e-6)
    assert not len(scan.misses)
    if len(parts) > 1 and scan.viewpoint is None:
        assert scan.starts is not None
        starts = [np.broadcast_to(pose[1], (cells[:, :, 0].size, 3)) for cells, pose in parts]
        np.testing.assert_allclose(scan.starts, np.concatenate(starts), atol=1e-6)


@given(poses, st.integers(0, 2**31), st.booleans())
def test_cells_without_a_return_are_rays_that_met_nothing(
    pose: tuple[np.ndarray, np.ndarray], seed: int, is_row_by_row: bool
) -> None:
    is_missed = np.random.default_rng(seed).random((24, 13)) < 0.3
    is_missed[9:11] = True  # columns of sky
    is_missed[12, 4] = is_missed[0, 0] = is_missed[-1, -1] = False
    cells = scanned(is_missed, seed)
    content = ptx(cells, pose)
    truth = rays(24, 13)
    if is_row_by_row:
        lines = content.decode().splitlines()
        grid = np.array(lines[10:]).reshape(24, 13)
        content = "\n".join([*lines[:10], *grid.T.ravel()]).encode()
        truth, is_missed = truth.transpose(1, 0, 2), is_missed.T
    scan = read_ptx(content, "cloud")
    assert len(scan.points) + len(scan.misses) == cells[:, :, 0].size
    reach = np.median(np.linalg.norm(cells[cells.any(axis=2)], axis=1))
    np.testing.assert_allclose(scan.misses, reach * truth[is_missed] @ pose[0].T + pose[1], atol=1e-4)
    assert any("without a return count as free" in note for note in scan.notes)


@pytest.mark.parametrize("is_even", [True, False])
def test_rows_of_sky_go_on_from_the_rows_below_where_these_are_even(is_even: bool) -> None:
    is_missed = np.zeros((24, 13), dtype=bool)
    is_missed[:, -4:] = is_missed[:2] = True
    cells = scanned(is_missed)
    if not is_even:
        cells[:, :, 2] += 0.3 * np.sin(np.arange(13)) * np.linalg.norm(cells[:, :, :2], axis=2)
    scan = read_ptx(ptx(cells), "cloud")
    assert len(scan.points) == np.count_nonzero(~is_missed)
    directions = scan.misses / np.linalg.norm(scan.misses, axis=1, keepdims=True)
    if is_even:
        np.testing.assert_allclose(directions, rays(24, 13)[is_missed], atol=1e-6)
    else:  # the columns are even still
        assert len(scan.misses) == 2 * 9


def test_cells_say_nothing_where_no_grid_explains_the_points() -> None:
    rng = np.random.default_rng(0)
    cells = rng.normal(0, 2, (20, 20, 3))
    cells[rng.random((20, 20)) < 0.3] = 0.0
    scan = read_ptx(ptx(cells), "cloud")
    assert len(scan.points) == np.count_nonzero(cells.any(axis=2))
    assert not len(scan.misses)
    assert any("does not follow from the grid" in note for note in scan.notes)


def test_rays_start_where_the_transformation_has_the_scanner(tmp_path: Path) -> None:
    is_missed = np.zeros((30, 20), dtype=bool)
    is_missed[:, -3:-1] = True
    pose = (Rotation.from_euler("z", 0.5).as_matrix(), np.array([1.0, 2.0, 1.6]))
    path = tmp_path / "cloud.ptx"
    path.write_bytes(ptx(scanned(is_missed), pose))
    cloud = read_cloud(path)
    np.testing.assert_allclose(cloud.origin, pose[1], atol=1e-9)
    assert len(cloud.misses) == 60
    assert cloud.notes == ("60 cells without a return count as free up to their scan's median range",)
    path.write_bytes(ptx(scanned(is_missed), pose, told=(0, 0, 0)))
    (note, _) = read_cloud(path).notes
    assert note.startswith("the header of scan 1 has its scanner at (0, 0, 0), its transformation at (1, 2, 1.6)")


def test_a_sensor_may_be_given_for_a_ptx_without_a_pose(tmp_path: Path) -> None:
    path = tmp_path / "cloud.ptx"
    path.write_bytes(ptx(scanned(np.zeros((5, 5), dtype=bool))))
    np.testing.assert_array_equal(read_cloud(path, sensor=(0, 0, 1)).origin, [0, 0, 1])


def test_a_ptx_of_another_name_is_read_as_what_it_is(tmp_path: Path) -> None:
    path = tmp_path / "cloud.txt"
    path.write_bytes(ptx(scanned(np.zeros((5, 5), dtype=bool))))
    scan = parse_file(path)
    assert len(scan.points) == 25
    assert scan.notes == ("holds a PTX file, and is read as one though its name ends in .txt",)


@pytest.mark.parametrize("n_most", [200, 600])
def test_a_thinned_ptx_keeps_points_and_misses_alike(n_most: int, monkeypatch: pytest.MonkeyPatch) -> None:
    is_missed = np.zeros((40, 30), dtype=bool)
    is_missed[:, 20:25] = True
    content = ptx(scanned(is_missed)) + ptx(scanned(is_missed, 1), (np.eye(3), np.array([0, 0, 5.0])))
    whole = read_ptx(content, "cloud")
    monkeypatch.setattr(scan_module, "MAX_POINTS", n_most)
    scan = read_ptx(content, "cloud")
    assert 0.8 * n_most <= len(scan.points) + len(scan.misses) <= n_most
    assert len(scan.misses) == pytest.approx(len(scan.points) / 5, rel=0.1)
    np.testing.assert_allclose(distances(scan.points, whole.points), 0.0, atol=1e-9)
    assert scan.miss_starts is not None
    assert whole.miss_starts is not None
    some, of = ((one.misses - one.miss_starts) for one in (scan, whole))  # how long follows from the points taken
    some, of = (one / np.linalg.norm(one, axis=1, keepdims=True) for one in (some, of))
    np.testing.assert_allclose(distances(some, of), 0.0, atol=1e-6)
    assert scan.notes[0].startswith("took 1 of every ")


def distances(some: np.ndarray, of: np.ndarray) -> np.ndarray:
    """From each row to the nearest of others."""
    nearest: np.ndarray = np.linalg.norm(some[:, None] - of[None], axis=2).min(axis=1)
    return nearest


GOOD = ptx(scanned(np.zeros((4, 3), dtype=bool))).decode().splitlines()


def changed(line: int, words: str) -> bytes:
    """The good file with one line, counted from 1, replaced."""
    return "\n".join([*GOOD[: line - 1], words, *GOOD[line:]]).encode()


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (changed(1, "four"), "line 1: 'four' is not a number of columns or rows, as the header of scan 1 has there"),
        (changed(2, "-3"), "line 2: '-3' is not a number of columns or rows"),
        (changed(1, "5000"), "scan 1 announces 5000 columns of 3 cells, 12 lines follow its header"),
        (changed(1, "100000000"), "its scans announce 300000000 cells; at most 50000000 are read"),
        (changed(1, "0"), f"line 11: '{GOOD[10]}' is not a number of columns or rows, as the header of scan 2 has"),
        (changed(4, "1 0"), "line 4: '1 0' is not 3 numbers"),
        (changed(5, "0 nan 0"), "line 5: '0 nan 0' is not 3 numbers"),
        (changed(8, "0 2 0 0"), "lines 7 to 10 are no rigid transformation; three rows"),
        (changed(10, "0 0 0 0"), "lines 7 to 10 are no rigid transformation"),
        (changed(12, "1 2"), "line 12 has 2 columns, the first has 4"),
        (changed(13, "1 2 abc 0.5"), "line 13: 'abc' is not a number"),
        ("\n".join(GOOD[:7]).encode(), "ends in the header of scan 1, which has 10 lines"),
        ("\n".join([*GOOD, *GOOD[:3]]).encode(), "ends in the header of scan 2"),
        (
            "\n".join([*GOOD[:12], *GOOD]).encode(),
            f"line 23: '{GOOD[10]}' is not a number of columns or rows, as the header of scan 2 has",
        ),
        (b"0\n5\n" + "\n".join(GOOD[2:10]).encode(), "its 1 scans have no cells"),
        (b"\n\n", "holds no scan"),
    ],
)
def test_a_lying_ptx_is_refused_in_one_line(content: bytes, says: str) -> None:
    with pytest.raises(CloudError) as raised:
        read_ptx(content, "cloud")
    assert str(raised.value).startswith(f"cloud: {says}")
    assert "\n" not in str(raised.value)


def test_a_ptx_of_nothing_but_empty_cells_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "cloud.ptx"
    path.write_bytes(ptx(np.zeros((5, 5, 3))))
    with pytest.raises(CloudError, match="no points"):
        read_cloud(path)


@given(st.binary(max_size=200), st.integers(0, 400))
def test_a_damaged_ptx_reads_or_is_refused(junk: bytes, at: int) -> None:
    content = bytearray("\n".join([*GOOD, *GOOD]).encode())
    content[at : at + len(junk)] = junk
    line = ""
    with np.errstate(all="ignore"):
        try:
            scan = read_ptx(bytes(content), "cloud")
        except CloudError as error:
            line = str(error)
    if line:
        assert line.startswith("cloud: ")
        assert line.isprintable()
    else:
        assert scan.points.shape[1] == scan.misses.shape[1] == 3
