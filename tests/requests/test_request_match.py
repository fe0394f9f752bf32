"""Mesh obstacles that the scan is to show: they stand where it shows them, once, and are refused where it does not."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from perception import write_pcd
from perception.simulate import Pose, Room, Scanner, box, join_meshes, scan
from service.errors import RequestError
from service.request.file import parse_request
from service.setup.prepare import PlanSetup, prepare

# A tool that no turn takes to itself: a long body, a tall end, a handle to one side; each from a corner to the other.
BODIES = (
    ((0.0, 0.0, 0.0), (0.4, 0.1, 0.1)),
    ((0.0, 0.0, 0.05), (0.1, 0.1, 0.3)),  # reaches into the body
    ((0.25, 0.1, 0.0), (0.35, 0.25, 0.06)),
)
TURN = Rotation.from_euler("z", 2.5)
PLACE = np.array([1.45, 0.05, 0.8])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """``tool.urdf``, and ``scan.pcd`` of it on a table 1 m ahead."""
    folder = tmp_path_factory.mktemp("match")
    shapes = "".join(
        f'<collision><origin xyz="{x} {y} {z}"/><geometry><box size="{a} {b} {c}"/></geometry></collision>'
        for (x, y, z), (a, b, c) in (
            (0.5 * np.add(low, high), np.subtract(high, low)) for low, high in BODIES
        )
    )  # fmt: skip
    (folder / "tool.urdf").write_text(f'<robot name="tool"><link name="tool">{shapes}</link></robot>')
    tool = join_meshes([box(low, high) for low, high in BODIES]).move(TURN.as_matrix(), PLACE)
    table = (((0.9, -0.6, 0.75), (1.7, 0.6, 0.8)),)
    cloud = scan([*Room(wall_x=2.2, boxes=table).meshes(), tool], Pose(pitch=0.4), Scanner(n_lines=80), seed=3)
    write_pcd(folder / "scan.pcd", cloud.points, (*np.ravel(cloud.origin).tolist(), 1.0, 0.0, 0.0, 0.0))
    return folder


def _prepared(folder: Path, position: np.ndarray, **obstacle: Any) -> PlanSetup:
    quaternion = (Rotation.from_rotvec([0.1, -0.1, 0.1]) * TURN).as_quat(scalar_first=True)
    place = {"position": position.tolist(), "quaternion_wxyz": quaternion.tolist()}
    tool = {"name": "tool", "type": "mesh", "file": "tool.urdf", **place, **obstacle}
    scene = {"cloud": "scan.pcd", "obstacles": [tool]}
    return prepare(parse_request({"robot": {"name": "atlas"}, "goal": {"posture": "stand"}, "scene": scene}, folder))


def test_a_tool_near_where_it_is_said_to_be_stands_where_the_scan_shows_it(folder: Path) -> None:
    setup = _prepared(folder, PLACE + np.array([0.04, -0.03, 0.02]), match=True)
    own = [piece for piece in setup.scene.pieces if piece.name.startswith("tool")]
    assert len(own) == 3
    # Each body's eight corners, in any order of the bodies.
    corners = np.array([[np.choose(bits, body) for bits in np.ndindex(2, 2, 2)] for body in BODIES])
    truth = TURN.apply(corners.reshape(-1, 3)) + PLACE
    found = np.concatenate([piece.vertices for piece in own])
    assert np.linalg.norm(truth[:, None] - found[None], axis=2).min(axis=1).max() < 0.015
    assert any(note.startswith("tool found at (1.4") for note in setup.notes)
    # Nothing else stands where it does: its middle axes, well over the table.
    inside = TURN.apply([[0.2, 0.05, 0.05], [0.05, 0.05, 0.2], [0.05, 0.05, 0.28], [0.3, 0.05, 0.05]]) + PLACE
    for piece in setup.scene.pieces:
        if piece not in own:
            faces = ConvexHull(piece.vertices).equations
            assert (inside @ faces[:, :3].T + faces[:, 3]).max(axis=1).min() > 0.0, piece.name


def test_a_tool_that_the_scan_does_not_show_is_refused_with_its_place(folder: Path) -> None:
    with pytest.raises(RequestError) as caught:
        _prepared(folder, np.array([0.5, -1.5, 1.8]), match=True)
    (problem,) = caught.value.problems
    assert problem.startswith("scene.obstacles[0].match: the scan does not show tool.urdf near (0.50, -1.50, 1.80): ")


def test_a_file_that_cannot_be_used_is_told_before_the_scan_is_looked_at(folder: Path) -> None:
    with pytest.raises(RequestError) as caught:
        _prepared(folder, PLACE, match=True, file="none.urdf")
    assert caught.value.problems[0].startswith("scene.obstacles[0].file: ")
    assert "is not there" in caught.value.problems[0]
