"""A plan that is to stop while its scene is made: what it has started ends with it, and it says where it was."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from planar_arm import write_planar_arm
from shared_plans import write_undrawn

from perception import Cloud, sandbox, write_pcd
from perception.simulate import torus
from perception.solids import process
from service.body.monitor import Monitor
from service.planner import plan
from service.request.file import parse_request
from service.request.schema import PlanRequest
from service.result.folder import read_result
from service.result.result import PlanResult, Verdict

ROBOT = {"robot": {"name": "atlas"}, "goal": {"posture": "stand"}}


@pytest.fixture
def children(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Process numbers of all that ran CoACD; files are read in processes too."""
    pids: list[int] = []
    popen, run = sandbox.subprocess.Popen, process.run_in_sandbox

    def note_pid(*args: object, **kwargs: object) -> object:
        started = popen(*args, **kwargs)  # type: ignore[call-overload]
        pids.append(started.pid)
        return started

    def run_noted(*args: Any, **kwargs: Any) -> dict[str, Any]:
        with monkeypatch.context() as patch:
            patch.setattr(sandbox.subprocess, "Popen", note_pid)
            return run(*args, **kwargs)

    monkeypatch.setattr(process, "run_in_sandbox", run_noted)
    return pids


@pytest.fixture
def with_a_ring(tmp_path: Path) -> Callable[..., PlanRequest]:
    """Makes requests with a ring that CoACD is to split."""
    ring = torus((0, 0, 0), (0, 0, 1), 0.5, 0.1, 90, 50)
    lines = [f"v {x} {y} {z}\n" for x, y, z in ring.vertices]
    lines += [f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in ring.triangles]
    (tmp_path / "ring.obj").write_text("".join(lines))
    obstacle = {"name": "ring", "type": "mesh", "file": "ring.obj", "position": [2.0, 0.0, 1.0]}
    return lambda **options: parse_request({**ROBOT, "scene": {"obstacles": [obstacle]}, "options": options}, tmp_path)


def _is_running(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def _check_written(result: PlanResult, folder: Path) -> None:
    write_undrawn(result, folder)
    assert read_result(folder)["verdict"] == result.verdict.value


def test_a_cancel_kills_the_process_that_splits_a_mesh(
    with_a_ring: Callable[..., PlanRequest], children: list[int], tmp_path: Path
) -> None:
    result = plan(with_a_ring(), should_stop=lambda: bool(children))
    assert result.verdict is Verdict.CANCELLED
    assert result.explanation == ("cancelled during 'build_scene'",)
    assert result.motion is None
    (pid,) = children
    assert not _is_running(pid)
    _check_written(result, tmp_path / "out")


def test_the_time_limit_ends_the_splitting_of_a_mesh(
    with_a_ring: Callable[..., PlanRequest], children: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Monitor, "remaining_s", lambda _: -1.0 if children else 60.0)
    result = plan(with_a_ring(time_limit_s=20.0))
    assert result.verdict is Verdict.TIME_LIMIT
    assert result.explanation == ("the time limit of 20 s was reached during 'build_scene'",)
    assert not any(_is_running(pid) for pid in children)


def test_a_cancel_kills_the_process_that_splits_a_scan(children: list[int], tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    bin_walls = [np.column_stack([np.full(400, x), rng.uniform(-0.5, 0.5, 400), rng.uniform(0.3, 0.8, 400)])
                 for x in (1.2, 1.6)]  # fmt: skip
    rows = np.column_stack([rng.uniform(1.2, 1.6, 800), np.full(800, 0.5), rng.uniform(0.3, 0.8, 800)])
    write_pcd(
        tmp_path / "bin.pcd", Cloud(np.concatenate([*bin_walls, rows]), np.zeros(3)).points, (0, 0, 2, 1, 0, 0, 0)
    )
    scene = {"cloud": "bin.pcd", "method": "coacd"}
    result = plan(parse_request({**ROBOT, "scene": scene}, tmp_path), should_stop=lambda: bool(children))
    assert result.verdict is Verdict.CANCELLED
    assert result.explanation == ("cancelled during 'perceive'",)
    (pid,) = children
    assert not _is_running(pid)


def test_a_cancel_while_its_failure_is_explained_is_no_verdict(tmp_path: Path) -> None:
    arm = {"urdf": str(write_planar_arm(tmp_path, 3, 0.3, 0.04, limit=3.0))}
    wall = {"type": "box", "name": "wall", "size": [0.02, 3.0, 1.0], "position": [0.5, 0.0, 0.0]}
    goal = {"poses": [{"link": "l2", "position": [0.55, 0.0, 0.0]}]}
    steps: list[str] = []
    result = plan(
        parse_request({"robot": arm, "start": {"joints": {"j0": 1.6}}, "goal": goal, "scene": {"obstacles": [wall]}}),
        on_progress=lambda step, _: steps.append(step),
        should_stop=lambda: "explain" in steps,
    )
    assert "explain" in steps
    assert result.verdict is Verdict.CANCELLED
