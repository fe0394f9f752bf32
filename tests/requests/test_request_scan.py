"""How a request's scan becomes a world: the same choices as on the command line, with the same meaning."""

from __future__ import annotations

import json
from pathlib import Path
from typing import get_args, get_type_hints

import numpy as np
import pytest
from typer.testing import CliRunner

from perception import Cloud, perceive, write_pcd
from service.cli.app import app
from service.errors import RequestError
from service.request.choices import Method, Unknown
from service.request.file import parse_request
from service.setup.prepare import prepare

ROBOT = {"robot": {"name": "atlas"}, "goal": {"posture": "stand"}}


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A floor and a crate on it, 1.2 m ahead of the robot."""
    rng = np.random.default_rng(0)
    floor = np.column_stack([rng.uniform(-0.5, 2.0, 2000), rng.uniform(-1.0, 1.0, 2000), rng.normal(0, 0.003, 2000)])
    crate = np.column_stack([rng.normal(1.2, 0.003, 600), rng.uniform(-0.2, 0.3, 600), rng.uniform(0.0, 0.5, 600)])
    hidden = (floor[:, 0] > 1.2) & (np.abs(floor[:, 1] - 0.05) < 0.4)
    cloud = Cloud(np.concatenate([floor[~hidden], crate]), np.array([0.6, 0.0, 1.8]))
    path = tmp_path_factory.mktemp("scan") / "crate.pcd"
    write_pcd(path, cloud.points, (*cloud.origin.tolist(), 1.0, 0.0, 0.0, 0.0))
    return path


def test_the_choices_are_those_of_perception() -> None:
    hints = get_type_hints(perceive)
    assert get_args(Method) == get_args(hints["method"])
    assert get_args(Unknown) == get_args(hints["unknown"])


def test_a_request_and_the_command_line_make_the_same_world(scan: Path, tmp_path: Path) -> None:
    scene = {"cloud": scan.name, "method": "coacd", "unknown": "occupied"}  # neither is the default
    asked = prepare(parse_request({**ROBOT, "scene": scene}, scan.parent)).scene.pieces
    out = tmp_path / "scene.json"
    options = ["--robot", "atlas", "--reach", "3", "--method", "coacd", "--unknown", "occupied", "--out", str(out)]
    result = CliRunner().invoke(app, ["scene", str(scan), *options])
    assert result.exit_code == 0, result.output
    written = json.loads(out.read_text())["pieces"]
    assert [piece.name for piece in asked] == [piece["name"] for piece in written]
    for piece, other in zip(asked, written, strict=True):
        np.testing.assert_allclose(piece.vertices, other["vertices"], atol=1e-9)
    made = {piece.name.split("/")[0] for piece in asked}
    assert {"coacd", "unknown"} <= made


@pytest.mark.parametrize(
    ("scene", "problem"),
    [
        ({"cloud": "a.pcd", "method": "magic"}, "scene.method: expected 'planes' or 'coacd', got 'magic'"),
        ({"cloud": "a.pcd", "unknown": "maybe"}, "scene.unknown: expected 'free' or 'occupied', got 'maybe'"),
        ({"unknown": "occupied"}, "scene: unknown: occupied needs a scan that says what was seen; give cloud"),
    ],
)
def test_other_choices_are_refused(scene: dict[str, object], problem: str) -> None:
    with pytest.raises(RequestError) as caught:
        parse_request({**ROBOT, "scene": scene})
    assert caught.value.problems == (problem,)
