"""What a result says beside its motion: every statement is compared, and an honest one is never refused."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from given_mechanisms import drawer_request
from shared_plans import copy_undrawn, plan_once, write_once

from service.demands.held_motion import compare_phase
from service.errors import DamagedResultError
from service.replay.replay import verify_result
from service.request.file import parse_request
from service.result.result import PlanResult

REQUEST = parse_request(drawer_request(to=0.1))


@pytest.fixture(scope="module")
def pulled() -> PlanResult:
    return plan_once(REQUEST)


def _widen(data: dict[str, Any]) -> None:
    data["phases"][2]["pushes"][0]["friction"] = [0.5, 0.6]


def _stiffen(data: dict[str, Any]) -> None:
    data["servo"]["sag_m"] *= 0.1


def _omit(data: dict[str, Any]) -> None:
    for phase in data["phases"]:
        phase["pressed"] = None


def _repeat(data: dict[str, Any]) -> None:
    bodies = data["movables"][0]["bodies"]
    bodies.append(bodies[-1])


def _rename(data: dict[str, Any]) -> None:
    for record in (data, data["certificate"]):
        record["checks"][0]["unit"] = "mm"


def _hide(data: dict[str, Any]) -> None:
    data["robot"]["links_without_shape"] = []


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (_widen, "pushes of phase"),
        (_stiffen, "servo is not"),
        (_omit, "does not say what is pressed"),
        (_repeat, "movables are not written as they are read"),
        (_rename, "checks are not those"),
        (_hide, "links_without_shape"),
    ],
)
def test_a_statement_that_is_not_true_damages_a_result(
    tmp_path: Path, change: Callable[[dict[str, Any]], None], words: str
) -> None:
    folder = copy_undrawn(write_once(REQUEST), tmp_path / "out")
    (folder / "manifest.json").unlink()
    path = folder / "result.json"
    data = json.loads(path.read_text())
    change(data)
    path.write_text(json.dumps(data))
    with pytest.raises(DamagedResultError, match=words):
        verify_result(folder)


def test_a_support_polygon_may_begin_with_any_corner_and_have_corners_on_its_edges(pulled: PlanResult) -> None:
    assert pulled.motion is not None
    own = pulled.motion.phases[0]
    assert own.support is not None
    corners = own.support.polygon
    between = np.insert(corners, 1, 0.5 * (corners[0] + corners[1]), axis=0)
    for polygon in (np.roll(corners, 2, axis=0), between):
        recorded = replace(own, support=replace(own.support, polygon=polygon))
        assert not list(compare_phase(recorded, own, has_own_targets=False))
    for polygon in (corners[::-1], 1.01 * corners, np.concatenate([corners, corners[-1:]]), corners[:2]):
        recorded = replace(own, support=replace(own.support, polygon=polygon))
        assert any("support" in line for line in compare_phase(recorded, own, has_own_targets=False))
