"""Feet stand on mats, boards and boxes as on floors: certified, and refused where these do not carry the whole sole."""

from __future__ import annotations

from typing import Any

import pytest

from service.errors import RequestError
from service.planner import plan
from service.request.file import parse_request
from service.result.result import Verdict
from service.setup.prepare import prepare

STANDING_M = 0.91720092  # height of Atlas's base on a floor at 0


def request(*obstacles: dict[str, Any], raised: float = 0.0) -> Any:
    base = {"position": [0.0, 0.0, STANDING_M + raised], "quaternion_wxyz": [1, 0, 0, 0]}
    goal = {"poses": [{"link": "l_tool", "position": [0.55, 0.25, 1.1 + raised], "position_tolerance_m": 0.01}]}
    scene = {"floor": True, "obstacles": list(obstacles)}
    return parse_request(
        {"robot": {"name": "atlas"}, "start": {"posture": "stand", "base": base}, "scene": scene, "goal": goal}
    )


def box(name: str, size: tuple[float, float, float], top: float, x: float = 0.0, y: float = 0.0) -> dict[str, Any]:
    return {"name": name, "type": "box", "size": list(size), "position": [x, y, top - size[2] / 2.0]}


@pytest.mark.parametrize(
    ("obstacles", "raised"),
    [
        ((box("mat", (1.2, 1.2, 0.01), 0.01),), 0.01),
        ((box("box", (0.8, 0.8, 0.2), 0.2),), 0.2),
        ((box("left", (0.5, 0.3, 0.05), 0.05, y=0.15), box("right", (0.5, 0.3, 0.05), 0.05, y=-0.15)), 0.05),
    ],
)
def test_a_reach_on_something_flat_is_certified(obstacles: tuple[dict[str, Any], ...], raised: float) -> None:
    result = plan(request(*obstacles, raised=raised))
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    assert result.certificate is not None
    touched = {name for exempt in result.certificate.exempt for name in exempt.pair}
    assert {obstacle["name"] for obstacle in obstacles} <= touched


def test_a_foot_that_hangs_over_the_edge_is_refused() -> None:
    with pytest.raises(RequestError, match="below the sole of r_foot"):
        prepare(request(box("box", (0.8, 0.4, 0.2), 0.2, y=0.2), raised=0.2))


def test_a_block_beside_a_foot_is_still_an_obstacle() -> None:
    with pytest.raises(RequestError, match=r"l_foot is .* inside block"):
        prepare(request(box("block", (0.1, 0.1, 0.1), 0.1, x=0.1, y=0.11)))
