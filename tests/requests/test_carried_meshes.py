"""Meshes that links carry and hands take: read once into the request, as convex parts or as the hull."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from shared_plans import write_undrawn
from tiny_robots import SPATIAL, chain_urdf

from benchmarks.attack.gantry_files import pick_place_request, write_gantry
from service.errors import RequestError
from service.planner import plan
from service.replay.replay import verify_result
from service.request.file import list_mesh_files, parse_request, replace_mesh_files, to_json
from service.setup.carried_meshes import inline_carried
from service.setup.prepare import prepare
from service.wire.requests import request_from_message, request_to_message

FACES = [
    (0, 2, 1), (1, 2, 3), (4, 5, 6), (5, 7, 6), (0, 1, 4), (1, 5, 4),
    (2, 6, 3), (3, 6, 7), (0, 4, 2), (2, 4, 6), (1, 3, 5), (3, 7, 5),
]  # fmt: skip
PALM = ((-0.1, -0.02, 0.0), (0.1, 0.02, 0.02))
PRONGS = (((-0.1, -0.02, 0.02), (-0.08, 0.02, 0.2)), ((0.08, -0.02, 0.02), (0.1, 0.02, 0.2)))
BLOCK = ((-0.02, -0.02, -0.04), (0.02, 0.02, 0.04))


def _write(path: Path, *boxes: tuple[tuple[float, ...], tuple[float, ...]]) -> None:
    lines = []
    for box in boxes:
        lines += [
            "v " + " ".join(str(1000.0 * box[(corner >> k) & 1][k]) for k in range(3)) for corner in range(8)
        ]  # in millimetres
    lines += [f"f {a + 1 + 8 * k} {b + 1 + 8 * k} {c + 1 + 8 * k}" for k in range(len(boxes)) for a, b, c in FACES]
    path.write_text("\n".join(lines) + "\n")


def _fork(folder: Path, **changes: Any) -> dict[str, Any]:
    """Return a request for an arm that carries a fork, with a bar between the prongs of the fork."""
    _write(folder / "fork.obj", PALM, *PRONGS)
    (folder / "arm.urdf").write_text(chain_urdf(SPATIAL))
    fork = {"type": "mesh", "name": "fork", "link": "tip", "file": "fork.obj", "scale": 1e-3, "mass_kg": 0.3, **changes}
    start = {"robot": {"urdf": "arm.urdf"}, "attached": [fork], "scene": {"floor": False}, "goal": {"joints": {}}}
    return {**start, "goal": {"joints": {"joint4": 0.05}}, "options": {"timed": False}}


def _bar_in_the_fork(request: dict[str, Any], folder: Path) -> dict[str, Any]:
    from service.verify import place_frames

    setup = prepare(parse_request(request, folder))
    pose = place_frames(setup.robot, setup.start, ["fork"])["fork"]
    place = (pose @ np.array([0.0, 0.0, 0.12, 1.0]))[:3].tolist()
    return {**request, "scene": {"floor": False, "obstacles": [
        {"type": "sphere", "name": "bar", "radius": 0.02, "position": place},
    ]}}  # fmt: skip


def test_a_fork_is_carried_about_a_bar_and_its_record_needs_no_mesh(tmp_path: Path) -> None:
    request = _bar_in_the_fork(_fork(tmp_path), tmp_path)
    result = plan(parse_request(request, tmp_path))
    assert result.verdict.value == "CERTIFIED", result.explanation
    folder = write_undrawn(result, tmp_path / "out")
    (tmp_path / "fork.obj").unlink()
    (tmp_path / "arm.urdf").unlink()
    assert verify_result(folder)["verdict"] == "CERTIFIED"


def test_as_a_hull_the_fork_is_full(tmp_path: Path) -> None:
    request = _bar_in_the_fork(_fork(tmp_path), tmp_path)
    request["attached"][0]["decompose"] = False
    with pytest.raises(RequestError, match=r"fork is .* inside bar"):
        prepare(parse_request(request, tmp_path))


def test_parts_are_in_the_request_and_on_the_wire(tmp_path: Path) -> None:
    request = parse_request(_fork(tmp_path), tmp_path)
    assert list(list_mesh_files(request)) == [("attached[0].file", "fork.obj")]
    assert replace_mesh_files(request, lambda name: f"sha256:{name}").attached[0].file == "sha256:fork.obj"
    read = inline_carried(request)
    (fork,) = read.attached
    assert len(fork.parts) == 3
    points = np.concatenate([np.array(part.points) for part in fork.parts])
    np.testing.assert_allclose([points.min(axis=0), points.max(axis=0)], [[-0.1, -0.02, 0.0], [0.1, 0.02, 0.2]])
    assert to_json(request_from_message(request_to_message(read), tmp_path)) == to_json(read)
    (tmp_path / "fork.obj").unlink()
    assert inline_carried(read) is read
    with pytest.raises(RequestError, match=r"attached\[0\].file: .*fork.obj is not there"):
        inline_carried(request)


def test_hands_take_a_convex_mesh_and_others_are_refused_with_the_remedy(tmp_path: Path) -> None:
    _write(tmp_path / "block.obj", BLOCK)
    _write(tmp_path / "fork.obj", PALM, *PRONGS)
    urdf = write_gantry(tmp_path)
    block = {"type": "mesh", "file": "block.obj", "scale": 1e-3}
    data = pick_place_request(urdf)
    kept = {key: value for key, value in data["scene"]["objects"][0].items() if key != "size"}
    data["scene"]["objects"] = [{**kept, **block}]
    read = inline_carried(parse_request(data, tmp_path))
    np.testing.assert_allclose(np.ptp(np.array(read.scene.objects[0].points), axis=0), [0.04, 0.04, 0.08])
    assert to_json(request_from_message(request_to_message(read), tmp_path)) == to_json(read)
    data["scene"]["objects"][0]["file"] = "fork.obj"
    with pytest.raises(RequestError, match=r"objects\[0\].file: fork.obj fills 28 % of its convex hull; fingers hold"):
        inline_carried(parse_request(data, tmp_path))
