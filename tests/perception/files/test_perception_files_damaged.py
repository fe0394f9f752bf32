"""Damaged files of every kind either read or are refused in one line, whatever is wrong with them."""

from __future__ import annotations

import io
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import cloud_mutations
import numpy as np
import pytest
from cloud_files import las_bytes, write_bag, write_e57
from hypothesis import given
from hypothesis import strategies as st

from perception import CloudError, write_pcd
from perception.files.npz import read_npy, read_npz
from perception.files.pcd import read_pcd
from perception.files.ply import read_ply
from perception.files.scan import Scan
from perception.files.table import read_text

POINTS = np.round(np.random.default_rng(0).uniform(-5, 5, (60, 3)), 3)
N_LIBRARY_FILES = 60


def pcd(folder: Path, encoding: str) -> bytes:
    write_pcd(folder / "good.pcd", POINTS[:40], encoding=encoding, misses=POINTS[40:])
    return (folder / "good.pcd").read_bytes()


def ply(form: str) -> bytes:
    kinds = "".join(f"property double {axis}\n" for axis in "xyz")
    header = f"ply\nformat {form} 1.0\ncomment viewpoint 0 0 1\nelement vertex 60\n{kinds}end_header\n".encode()
    if form == "ascii":
        return header + "".join(f"{x} {y} {z}\n" for x, y, z in POINTS.tolist()).encode()
    return header + POINTS.astype("<f8" if form.endswith("little_endian") else ">f8").tobytes()


def table() -> bytes:
    return b"# viewpoint 0 0 1\nx,y,z,label\n" + "".join(f"{x},{y},{z},1\n" for x, y, z in POINTS.tolist()).encode()


def archive(is_single: bool) -> bytes:
    stream = io.BytesIO()
    if is_single:
        np.save(stream, POINTS)
    else:
        np.savez_compressed(stream, points=POINTS, origin=np.zeros(3), misses=POINTS[:5])
    return stream.getvalue()


def changes(content: bytes) -> st.SearchStrategy[bytes]:
    """The content with bytes changed, most of them in what stands before the data, a part cut out or put in twice."""
    places = st.one_of(st.integers(0, min(len(content), 300) - 1), st.integers(0, len(content) - 1))
    values = st.one_of(st.sampled_from(b"\0\1\x7f\x80\xff 0-9e,\n"), st.integers(0, 255))

    def apply(edits: list[tuple[int, int]], start: int, stop: int, is_cut: bool) -> bytes:
        changed = bytearray(content)
        for at, value in edits:
            changed[at] = value
        return bytes(changed[:start] + changed[stop:]) if is_cut else bytes(changed[:stop] + changed[start:])

    whole = st.tuples(st.just(0), st.just(0), st.just(True))
    part = st.tuples(places, places, st.booleans())
    return st.tuples(st.lists(st.tuples(places, values), max_size=4), st.one_of(whole, part)).map(
        lambda drawn: apply(drawn[0], *drawn[1])
    )


def check(read: Callable[[bytes, str], Scan], content: bytes) -> None:
    """That the content reads, or is refused in one line."""
    line = ""
    with np.errstate(all="ignore"):
        try:
            scan = read(content, "cloud")
        except CloudError as error:
            line = str(error)
    if line:
        assert line.startswith("cloud: ")
        assert line.isprintable()
    else:
        assert scan.points.ndim == 2
        assert scan.points.shape[1] == 3


@pytest.mark.parametrize("encoding", ["ascii", "binary", "binary_compressed"])
def test_a_damaged_pcd_reads_or_is_refused(tmp_path: Path, encoding: str) -> None:
    given(changes(pcd(tmp_path, encoding)))(lambda content: check(read_pcd, content))()


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_a_damaged_ply_reads_or_is_refused(form: str) -> None:
    given(changes(ply(form)))(lambda content: check(read_ply, content))()


def test_a_damaged_table_reads_or_is_refused() -> None:
    given(changes(table()))(lambda content: check(read_text, content))()


@pytest.mark.parametrize("is_single", [False, True])
def test_a_damaged_array_reads_or_is_refused(is_single: bool) -> None:
    given(changes(archive(is_single)))(lambda content: check(read_npy if is_single else read_npz, content))()


def library_file(folder: Path, kind: str) -> Path:
    path = folder / f"good.{kind}"
    if kind in ("las", "laz"):
        path.write_bytes(las_bytes(POINTS, is_compressed=kind == "laz"))
    elif kind == "e57":
        pytest.importorskip("pye57")
        write_e57(path, [{"points": POINTS, "state": np.repeat([0, 1, 2], 20)}])
    else:
        pytest.importorskip("rosbags")
        write_bag(folder / "good", {"/points": [(POINTS, "lidar")]}, {"mcap": "mcap", "db3": "sqlite3"}[kind])
        path = folder / "good" / f"good.{kind}"
    return path


@pytest.mark.parametrize("kind", ["las", "laz", "e57", "mcap", "db3"])
def test_damaged_files_of_libraries_read_or_are_refused(tmp_path: Path, kind: str) -> None:
    path = library_file(tmp_path, kind)
    outcomes: list[str] = []
    n_crashes = 0
    while len(outcomes) < N_LIBRARY_FILES:
        todo = [str(len(outcomes)), str(N_LIBRARY_FILES - len(outcomes))]
        command = [sys.executable, cloud_mutations.__file__, str(path), *todo]
        done = subprocess.run(command, capture_output=True, text=True, timeout=240, check=False)
        lines = done.stdout.splitlines()
        if done.returncode == 0:
            outcomes += lines[1::2]
            assert len(lines) % 2 == 0
            continue
        # A library may take its process down, which is why files are parsed in one of their own.
        assert done.returncode < 0, done.stderr
        assert len(lines) % 2 == 1, done.stderr
        outcomes += [*lines[1::2], "crashed"]
        n_crashes += 1
    name = str(path.with_name(f"damaged{path.suffix}"))
    assert len(outcomes) == N_LIBRARY_FILES
    assert all(line in ("read", "memory", "crashed") or line.startswith(f"{name}: ") for line in outcomes)
    assert any(line.startswith(name) for line in outcomes)
    assert n_crashes <= 5
