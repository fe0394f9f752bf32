"""The compiled library answers as coal and numpy do, and is left out where it is not what the sources say."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from compiled_oracle import compare_with_coal
from swept_scenes import checker_of, keys, random_motion, random_scene
from tiny_robots import SPATIAL, atlas, chain

from costs.collision.sweep import share_gradient
from costs.kinematics import KinematicsEngine
from costs.native import build, call, find_library, library, without_library
from costs.robot import RobotModel

needs_library = pytest.mark.skipif(
    find_library() is None and "SCOPT_NEEDS_LIBRARY" not in os.environ,
    reason="the library is not built: python costs/native/build.py",
)


@needs_library
@pytest.mark.parametrize("seed", range(3))
def test_distances_are_those_of_coal_and_what_is_left_is_near(seed: int) -> None:
    answered, left, faults = compare_with_coal(np.random.default_rng(seed), 80)
    assert answered > 40
    assert left > 1
    assert not faults


@needs_library
@pytest.mark.parametrize("make", [lambda: chain(SPATIAL, "floating"), atlas])
def test_swept_contacts_are_the_same_without_the_library(make: Callable[[], RobotModel]) -> None:
    robot, engine, depths = make(), None, []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        checker = checker_of(robot, random_scene(rng, 6, 0.6), 0.03)
        engine = engine or KinematicsEngine(robot)
        kinematics = engine(random_motion(robot, rng, 4, 0.1))
        compiled = checker(kinematics)
        with without_library():
            plain = checker(kinematics)
        ours, theirs = ({key: k for k, key in enumerate(keys(contacts))} for contacts in (compiled, plain))
        for key in ours.keys() ^ theirs.keys():  # within the resolution of the query
            contacts, row = (compiled, ours[key]) if key in ours else (plain, theirs[key])
            assert contacts.distance[row] > contacts.margin[row] + checker.buffer - 2e-6
        for key in ours.keys() & theirs.keys():
            depths.append(plain.distance[theirs[key]])
            assert compiled.distance[ours[key]] == pytest.approx(depths[-1], abs=2e-6)
        with without_library():
            poses = [rng.normal(size=(40, 9, 3)) for _ in range(2)]
            towards = rng.normal(size=(40, 3))
            poses[1][:10], towards[:20, :2] = poses[0][:10], 0.0
            towards /= np.linalg.norm(towards, axis=1)[:, None]
            poses[0][5:15, :4, 2] = -2.0  # several vertices support
            given = (*poses, towards, rng.normal(size=(40, 3)))
            shares = share_gradient(*given)
        for made, wanted in zip(share_gradient(*given), shares, strict=True):
            assert made == pytest.approx(wanted, abs=1e-12)
    assert min(depths) < 0.0 < max(depths)


def test_a_library_of_other_sources_is_not_called(monkeypatch: pytest.MonkeyPatch) -> None:
    library._load.cache_clear()
    monkeypatch.setattr(library, "find_digest", lambda: "of other sources")
    try:
        assert find_library() is None
        assert "make setup" in library.describe_missing()
    finally:
        library._load.cache_clear()


def test_a_missing_compiler_is_told_and_leaves_the_old_library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    target = tmp_path / "kernel.so"
    target.write_bytes(b"old")
    monkeypatch.setattr(build, "_list_system_compilers", lambda: iter(()))
    monkeypatch.setattr(build, "_list_zig", lambda: iter(()))
    assert "no C compiler" in build.build(target)
    assert not build.has_compiler()
    assert target.read_bytes() == b"old"


@needs_library
def test_arrays_that_the_library_cannot_read_are_refused() -> None:
    loaded = find_library()
    assert loaded is not None
    for wrong in (np.zeros((3, 3), dtype=np.float32), np.zeros((4, 4))[:, ::2], np.zeros(3, dtype=np.int32)):
        with pytest.raises(TypeError, match="the library reads no"):
            call(loaded.scopt_digest, wrong)
    assert isinstance(loaded, ctypes.CDLL)
