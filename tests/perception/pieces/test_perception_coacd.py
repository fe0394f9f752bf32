"""CoACD for clouds, in a process that can be killed, with results kept by content."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from costs.stopping import Stopped, stops_when
from perception import Cloud, make_view, sandbox
from perception.convex.pieces import Pieces
from perception.errors import MeshError
from perception.simulate import Pose, Room, Scanner, box, scan, torus
from perception.solids import decompose
from perception.solids.cache import PartsCache
from perception.solids.decompose import CoacdResources, CoacdSettings
from perception.solids.mesh import Mesh, is_closed, make_solid
from perception.solids.pieces import make_coacd_pieces
from perception.solids.process import COACD_LIMITS, run_coacd
from perception.solids.voxels import wrap_cells
from perception.view import View

OUTLINE = np.array([(0, 0), (0.5, 0), (0.5, 0.1), (0.1, 0.1), (0.1, 0.5), (0, 0.5)])
CAPS = np.array([(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)])
SIDES = np.array([t for k in range(6) for n in [(k + 1) % 6] for t in ((k, k + 6, n), (n, k + 6, n + 6))])
# An angle of two square bars: the outline's corners at y = 0 and at y = 0.1.
ANGLE = make_solid(
    Mesh(np.insert(np.tile(OUTLINE, (2, 1)), 1, np.repeat([0.0, 0.1], 6), axis=1), np.vstack([CAPS, CAPS + 6, SIDES]))
).closed[0]
FAST = CoacdSettings(0.02, iterations=20, nodes=5, depth=1)


@pytest.fixture(scope="module")
def view() -> View:
    """A desk before a wall: a top on two sides, open in front."""
    desk = (
        ((0.8, -0.4, 0.7), (1.3, 0.4, 0.74)),
        ((0.8, -0.4, 0), (1.3, -0.36, 0.7)),
        ((0.8, 0.36, 0), (1.3, 0.4, 0.7)),
    )
    return make_view(scan(Room(wall_x=1.6, boxes=desk).meshes(), Pose(pitch=0.3), Scanner(n_lines=60, sigma=0.005)))


def _pieces_of(view: View) -> Pieces:
    """Pieces of its obstacles, nothing of them taken from a cache."""
    return make_coacd_pieces(view.obstacles, view.starts, view.cloud.rays, CoacdResources(cache=None))


def _depth(points: np.ndarray, parts: list[np.ndarray]) -> np.ndarray:
    """How far outside of all parts each point lies, negative inside."""
    hulls = [ConvexHull(part).equations for part in parts]
    return np.asarray(np.min([(points @ h[:, :3].T + h[:, 3]).max(axis=1) for h in hulls], axis=0))


@pytest.fixture(scope="module")
def made(view: View) -> Pieces:
    return _pieces_of(view)


def test_pieces_cover_what_was_seen_and_leave_the_way_of_the_rays(view: View, made: Pieces) -> None:
    parts = [piece.shape.vertices for piece in made.pieces]
    assert max(len(part) for part in parts) <= 64
    assert (_depth(view.obstacles, parts) <= 0.01).mean() > 0.995
    starts, ends = view.cloud.rays
    along = np.random.default_rng(0).uniform(0.1, 0.9, size=(len(ends), 1))
    samples = (starts + along * (ends - starts))[np.hypot(*ends.T[:2]) < 2.5]
    assert (_depth(samples, parts) < -0.02).mean() < 0.004
    knees = np.array([[1.0, 0.0, 0.4], [1.0, 0.2, 0.4], [0.9, 0.0, 0.55]])
    assert _depth(knees, parts).min() > 0.0


def test_every_piece_knows_its_points_and_its_evidence(view: View, made: Pieces) -> None:
    pieces = made.pieces
    assert [piece.name for piece in pieces] == [f"coacd/{i}" for i in range(len(pieces))]
    owned = np.concatenate([piece.points for piece in pieces])
    assert len(np.unique(owned)) == len(owned) > 0.99 * len(view.obstacles)
    assert max(piece.evidence.open_share for piece in pieces) > 0.2


def test_the_noise_of_a_wall_is_no_part_of_it() -> None:
    rng = np.random.default_rng(0)
    wall = np.column_stack([np.ones(15_000), rng.uniform(-0.5, 0.5, (15_000, 2))])
    points = wall * (1.0 + rng.normal(0.0, 0.01, (15_000, 1)))
    starts = np.zeros((15_000, 3))
    made = make_coacd_pieces(points, starts, (starts, points), resources=CoacdResources(cache=None))
    assert min(piece.shape.vertices[:, 0].min() for piece in made.pieces) > 0.96


def test_the_same_scan_gives_the_same_pieces(view: View, made: Pieces) -> None:
    first, second = made.pieces, _pieces_of(view).pieces
    assert len(first) == len(second)
    for one, other in zip(first, second, strict=True):
        np.testing.assert_array_equal(one.shape.vertices, other.shape.vertices)


def test_a_scan_without_obstacles_has_no_pieces(view: View) -> None:
    floor = view.near.points[view.near.points[:, 2] < 0.01]
    assert _pieces_of(make_view(Cloud(floor, view.cloud.origin))).pieces == ()


@pytest.mark.parametrize("seed", range(5))
def test_the_surface_of_any_cells_is_closed_and_wound_outwards(seed: int) -> None:
    rng = np.random.default_rng(seed)
    occupied = rng.random((6, 7, 8)) < 0.3
    mesh = wrap_cells(occupied, np.array([1.0, 2.0, 3.0]), 0.1)
    assert is_closed(mesh)
    assert mesh.volume > 0.0
    cells = np.argwhere(occupied)
    assert (mesh.vertices.min(axis=0) >= cells.min(axis=0) * 0.1 + [1.0, 2.0, 3.0] - 0.01).all()
    assert (mesh.vertices.max(axis=0) <= (cells.max(axis=0) + 1) * 0.1 + [1.0, 2.0, 3.0] + 0.01).all()


def _no_process(*_: object, **__: object) -> None:
    raise AssertionError("a process was started")


def test_what_is_known_starts_no_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    resources = CoacdResources(PartsCache(tmp_path))
    (first,) = decompose.decompose([ANGLE], FAST, resources)
    monkeypatch.setattr(decompose, "run_coacd", _no_process)
    (second,) = decompose.decompose([ANGLE], FAST, resources)
    for one, other in zip(first, second, strict=True):
        np.testing.assert_array_equal(one, other)
    with pytest.raises(AssertionError, match="a process was started"):
        decompose.decompose([ANGLE], CoacdSettings(0.03), resources)


@pytest.mark.parametrize(
    "damage", [lambda data: data[:-40], lambda data: b"", lambda data: data.replace(data[90:94], b"oops")]
)
def test_a_damaged_entry_is_dropped_and_made_anew(tmp_path: Path, damage: Callable[[bytes], bytes]) -> None:
    cache = PartsCache(tmp_path)
    (first,) = decompose.decompose([ANGLE], FAST, CoacdResources(cache))
    (entry,) = tmp_path.glob("*.npz")
    entry.write_bytes(damage(entry.read_bytes()))
    assert cache.get(entry.stem) is None
    assert not entry.exists()
    (second,) = decompose.decompose([ANGLE], FAST, CoacdResources(cache))
    assert len(second) == len(first)
    assert entry.exists()


def test_the_cache_drops_what_was_used_least_recently(tmp_path: Path) -> None:
    part = np.random.default_rng(0).random((50, 3))
    PartsCache(tmp_path).put("probe", [part])
    size = (tmp_path / "probe.npz").stat().st_size
    (tmp_path / "probe.npz").unlink()
    cache = PartsCache(tmp_path, max_bytes=int(2.5 * size))
    now = time.time()
    for age, key in ((30, "old"), (20, "older than it looks")):
        cache.put(key, [part])
        os.utime(tmp_path / f"{key}.npz", (now - age, now - age))
    assert cache.get("old") is not None  # used again just now
    cache.put("new", [part])
    assert sorted(path.stem for path in tmp_path.glob("*.npz")) == ["new", "old"]


def test_many_may_write_the_same_entry(tmp_path: Path) -> None:
    cache, part = PartsCache(tmp_path, max_bytes=20_000), np.random.default_rng(0).random((200, 3))

    def use(i: int) -> bool:
        cache.put(str(i % 5), [part])
        found = cache.get(str(i % 5))
        return found is None or np.array_equal(found[0], part)

    with ThreadPoolExecutor(8) as pool:
        assert all(pool.map(use, range(80)))
    assert not list(tmp_path.glob(".*"))


def test_a_folder_that_cannot_be_written_keeps_nothing_and_breaks_nothing(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    cache = PartsCache(tmp_path / "file" / "cache")
    cache.put("a", [ANGLE.vertices])
    assert cache.get("a") is None


def _running(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_cancelling_kills_the_process(monkeypatch: pytest.MonkeyPatch) -> None:
    pids: list[int] = []
    popen = sandbox.subprocess.Popen

    def noted(*args: object, **kwargs: object) -> object:
        started = popen(*args, **kwargs)  # type: ignore[call-overload]
        pids.append(started.pid)
        return started

    monkeypatch.setattr(sandbox.subprocess, "Popen", noted)
    fine = make_solid(torus((0, 0, 0), (0, 0, 1), 0.15, 0.03, 80, 40)).closed[0]
    asked = iter([False, False, False])
    with pytest.raises(Stopped), stops_when(lambda: next(asked, True)):
        run_coacd([fine], CoacdSettings(0.001).options(), COACD_LIMITS, "ring")
    assert len(pids) == 1
    assert not _running(pids[0])


def test_too_long_and_too_much_memory_are_reported() -> None:
    fine = make_solid(torus((0, 0, 0), (0, 0, 1), 0.15, 0.03, 80, 40)).closed[0]
    with pytest.raises(MeshError, match=r"ring: .* takes longer than 0.2 s; simplify it"):
        run_coacd([fine], CoacdSettings(0.001).options(), replace(COACD_LIMITS, max_wall_s=0.2), name="ring")
    with pytest.raises(MeshError, match="ring: splitting into convex parts needs more than 1 MB; simplify it"):
        run_coacd([ANGLE], FAST.options(), replace(COACD_LIMITS, max_bytes=2**20), name="ring")


UNDER_A_LIMIT = """
import resource, sys
resource.setrlimit(resource.RLIMIT_AS, (int(sys.argv[1]), int(sys.argv[1])))
import numpy as np
from perception.solids.mesh import Mesh
from perception.solids.process import run_coacd
mesh = Mesh(np.array(eval(sys.argv[2])), np.array(eval(sys.argv[3])))
options = {"threshold": 0.02, "real_metric": True, "preprocess_mode": "off", "mcts_iterations": 20}
print(len(run_coacd([mesh], options)[0]))
"""


def test_a_lower_limit_of_the_system_does_not_keep_coacd_from_working() -> None:
    mesh = repr(ANGLE.vertices.tolist()), repr(ANGLE.triangles.tolist())
    command = [sys.executable, "-c", UNDER_A_LIMIT, str(3 * 2**30), *mesh]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert int(done.stdout) >= 2


def test_what_crashes_coacd_is_an_error_here() -> None:
    wild = Mesh(ANGLE.vertices, ANGLE.triangles + 10**8)
    with pytest.raises(MeshError, match=r"ring: cannot be split into convex parts \(CoACD ended with"):
        run_coacd([wild], FAST.options(), replace(COACD_LIMITS, max_wall_s=20.0), name="ring")


def test_a_convex_mesh_needs_no_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(decompose, "run_coacd", _no_process)
    (part,) = decompose.split_solid(make_solid(box((0, 0, 0), (1, 2, 3))), resources=CoacdResources(cache=None))
    assert ConvexHull(part).volume == pytest.approx(6.0)
