"""The process that files are parsed in: what it hands back, and what becomes of it when a file is bad for it."""

from __future__ import annotations

import contextlib
import sqlite3
import struct
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cloud_files import las_bytes, write_bag

from perception import Cloud, CloudError, read_cloud, write_npz, write_pcd
from perception.files import parse
from perception.files.parse import parse_file
from perception.files.read import PARSER_LIMITS, parse_in_sandbox

POINTS = np.round(np.random.default_rng(0).uniform(-2, 2, (200, 3)), 3)


def full(folder: Path) -> Path:
    """A file that uses all that a scan can hold."""
    path = folder / "full.npz"
    write_npz(path, Cloud(POINTS, POINTS[::-1].copy(), (), POINTS[:7], POINTS[7:14]))
    return path


def impostor(folder: Path, monkeypatch: pytest.MonkeyPatch, code: str) -> Path:
    """A LAS file, and in the place of the library that reads it a module of this code."""
    library = folder / "library"
    library.mkdir()
    (library / "laspy.py").write_text(code)
    monkeypatch.setattr(sys, "path", [str(library), *sys.path])
    path = folder / "scan.las"
    path.write_bytes(b"LASF" + bytes(400))
    return path


def test_a_scan_comes_back_whole(tmp_path: Path) -> None:
    path = full(tmp_path)
    here, there = parse_file(path), parse_in_sandbox(path)
    for name in ("points", "misses", "starts", "miss_starts"):
        np.testing.assert_array_equal(getattr(there, name), getattr(here, name))
    assert (there.viewpoint, there.notes) == (here.viewpoint, here.notes)


def test_viewpoint_and_notes_come_back(tmp_path: Path) -> None:
    path = tmp_path / "scan.pcd"
    write_pcd(path, POINTS, (1, 2, 3, 1, 0, 0, 0))
    assert parse_in_sandbox(path).viewpoint == (1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0)
    path = tmp_path / "scan.laz"
    path.write_bytes(las_bytes(POINTS, is_compressed=True, withheld=np.arange(200) < 3))
    assert parse_in_sandbox(path).notes == ("left out 3 points marked as withheld or noise",)


def test_what_is_wrong_with_a_file_comes_back_in_its_words(tmp_path: Path) -> None:
    path = tmp_path / "scan.csv"
    path.write_text("x,y,z\n1,2,here\n")
    with pytest.raises(CloudError) as caught:
        read_cloud(path)
    assert str(caught.value) == f"{path}: line 2: 'here' is not a number"


@pytest.mark.parametrize(
    ("code", "says"),
    [
        ("import ctypes\nctypes.string_at(0)", r"made its reader stop \(SIGSEGV\); is it damaged\?"),
        ("import os\nos.abort()", r"made its reader stop \(SIGABRT\); is it damaged\? or it needs more than 1024 MB"),
        ("import os\nos._exit(3)", r"made its reader stop \(exit 3\); is it damaged\?"),
        ("bytes(2**31)", "needs more than 1024 MB to read; is it damaged, or much larger than it looks"),
        ("def open(*a, **k):\n  raise BaseException('of\\nno kind')", r"is damaged, or no las file \("),
    ],
)
def test_a_crash_of_a_reader_is_one_clear_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: str, says: str
) -> None:
    path = impostor(tmp_path, monkeypatch, code)
    with pytest.raises(CloudError, match=says) as caught:
        read_cloud(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def test_a_laz_that_announces_billions_of_chunks_is_refused(tmp_path: Path) -> None:
    content = bytearray(las_bytes(POINTS, is_compressed=True))
    (first_point,) = struct.unpack_from("<I", content, 96)
    (chunk_table,) = struct.unpack_from("<q", content, first_point)
    struct.pack_into("<I", content, chunk_table + 4, 2**31)
    path = tmp_path / "scan.laz"
    path.write_bytes(content)
    with pytest.raises(CloudError, match="needs more than 1024 MB to read"):
        read_cloud(path)


def zeros_packed(n_bytes: int) -> bytes:
    """So many zeros in a few kilobytes."""
    zstd = pytest.importorskip("backports.zstd")
    packer, block = zstd.ZstdCompressor(), bytes(2**24)
    return b"".join([*(packer.compress(block) for _ in range(n_bytes // len(block))), packer.flush()])


@pytest.mark.parametrize(("mode", "says"), [("MESSAGE", "needs more than 384 MB"), ("FILE", "File too large")])
def test_a_bomb_in_a_bag_is_refused(tmp_path: Path, mode: str, says: str) -> None:
    rosbag2 = pytest.importorskip("rosbags.rosbag2")
    folder = tmp_path / "bag"
    write_bag(folder, {"/points": [(POINTS, "lidar")]}, "sqlite3", rosbag2.CompressionMode[mode])
    assert len(parse_in_sandbox(folder).points) == 200
    if mode == "FILE":
        (folder / "bag.db3.zstd").write_bytes(zeros_packed(2**29))
    else:
        with contextlib.closing(sqlite3.connect(folder / "bag.db3")) as database, database:
            database.execute("UPDATE messages SET data = ?", (zeros_packed(2**29),))
    with pytest.raises(CloudError, match=says):
        parse_in_sandbox(folder, limits=replace(PARSER_LIMITS, max_bytes=384 * 2**20))


def test_a_reader_that_works_without_end_is_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = impostor(tmp_path, monkeypatch, "while True: pass")
    with pytest.raises(CloudError, match="took more than 1 s to read; is it damaged, or much larger"):
        parse_in_sandbox(path, limits=replace(PARSER_LIMITS, max_cpu_s=1))


def test_a_reader_that_sleeps_is_killed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = impostor(
        tmp_path, monkeypatch, "import signal, time\nsignal.setitimer(signal.ITIMER_REAL, 0)\ntime.sleep(600)"
    )
    started: list[subprocess.Popen[bytes]] = []

    class Watched(subprocess.Popen[bytes]):
        def __init__(self, *args: Any, **kwargs: Any) -> None:
            super().__init__(*args, **kwargs)
            started.append(self)

    monkeypatch.setattr(subprocess, "Popen", Watched)
    with pytest.raises(CloudError, match=r"took more than 0\.5 s to read; is it damaged, or the machine busy"):
        parse_in_sandbox(path, limits=replace(PARSER_LIMITS, max_wall_s=0.5))
    assert started[0].returncode == -9


def test_a_library_that_is_missing_is_named_with_what_installs_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module, name, extra in (
        ("pye57", "a.e57", "e57"),
        ("rosbags", "a.mcap", "rosbag"),
        ("rosbags", "a.bag", "rosbag"),
    ):
        for loaded in [key for key in sys.modules if key.partition(".")[0] == module]:
            monkeypatch.setitem(sys.modules, loaded, None)
        monkeypatch.setitem(sys.modules, module, None)
        (tmp_path / name).write_bytes(b"anything")
        with pytest.raises(CloudError) as caught:
            parse.parse_file(tmp_path / name)
        install = f"reading this kind of file needs a further library: pip install 'scopt[{extra}]'"
        assert str(caught.value) == f"{tmp_path / name}: {install}"


def test_many_threads_read_at_once(tmp_path: Path) -> None:
    paths = []
    for i in range(6):
        paths.append(tmp_path / f"{i}.pcd")
        write_pcd(paths[-1], POINTS[i:])
    with ThreadPoolExecutor(3) as pool:
        scans = list(pool.map(parse_in_sandbox, paths))
    assert [len(scan.points) for scan in scans] == [200, 199, 198, 197, 196, 195]


def test_nothing_but_the_readers_is_imported_to_parse(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = tmp_path / "modules.txt"
    code = f"import pathlib, sys\npathlib.Path({str(seen)!r}).write_text(' '.join(sys.modules))"
    with pytest.raises(CloudError, match="is damaged"):
        parse_in_sandbox(impostor(tmp_path, monkeypatch, code))
    modules = seen.read_text().split()
    assert "perception.files.las" in modules
    assert not {"scipy", "open3d", "jaxtyping", "perception.cloud", "costs", "pye57", "rosbags"} & set(modules)
