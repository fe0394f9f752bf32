"""Poses of an egress solved side by side in processes of their own: the same motion, and a stop that is heard."""

from __future__ import annotations

import multiprocessing
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from egress_car import REQUEST

from service.planner import plan
from service.request.file import load_request
from service.request.schema import PlanRequest
from service.result.result import Verdict


@pytest.fixture(scope="module")
def pool() -> Iterator[ProcessPoolExecutor]:
    with ProcessPoolExecutor(2, multiprocessing.get_context("spawn")) as executor:
        yield executor


def first_step(samples: int) -> PlanRequest:
    """The shipped request until the right foot is out."""
    request = load_request(REQUEST)
    assert request.task is not None
    assert request.task.egress is not None
    egress = replace(request.task.egress, until="right foot out", samples=samples)
    return replace(request, task=replace(request.task, egress=egress))


def test_poses_of_other_processes_make_the_same_motion(pool: ProcessPoolExecutor) -> None:
    request = first_step(2)
    there, here = plan(request, map=pool.map), plan(request)
    assert there.verdict is here.verdict is Verdict.CERTIFIED
    assert there.motion is not None
    assert here.motion is not None
    np.testing.assert_allclose(there.motion.curve.positions, here.motion.curve.positions, atol=1e-9)


def test_a_plan_is_cancelled_while_other_processes_solve_its_poses(pool: ProcessPoolExecutor) -> None:
    seen: list[str] = []
    result = plan(
        first_step(200),
        on_progress=lambda step, _: seen.append(step),
        should_stop=lambda: sum("hold" in step for step in seen) > 3,
        map=pool.map,
    )
    assert result.verdict is Verdict.CANCELLED
    assert sum("hold" in step for step in seen) < 20
