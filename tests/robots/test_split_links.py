"""Concave links of a robot split into convex parts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from typer.testing import CliRunner

from costs.robot import load_robot
from service.cli.app import app
from service.errors import RequestError
from service.scan.split_links import URDF_NAME, write_split_robot

URDF = """<robot name="arm"><link name="base"/>
<link name="grip"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><origin xyz="0.1 0 0" rpy="0 0 1.5707963267948966"/>
<geometry><mesh filename="meshes/grip.stl" scale="1 1 2"/></geometry></collision></link>
<joint name="turn" type="revolute"><parent link="base"/><child link="grip"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" velocity="1" effort="9"/></joint></robot>"""


@pytest.fixture
def urdf(tmp_path: Path) -> Path:
    """A robot whose hand is a U, 100 mm wide, with jaws 20 mm thick; its mesh is shifted, turned and scaled."""
    jaws = [trimesh.creation.box((0.02, 0.1, 0.02)), trimesh.creation.box((0.02, 0.1, 0.02))]
    jaws[0].apply_translation((-0.04, 0.05, 0.0))
    jaws[1].apply_translation((0.04, 0.05, 0.0))
    palm = trimesh.creation.box((0.1, 0.02, 0.02))
    (tmp_path / "meshes").mkdir()
    trimesh.util.concatenate([palm, *jaws]).export(tmp_path / "meshes" / "grip.stl")
    (tmp_path / "arm.urdf").write_text(URDF)
    return tmp_path / "arm.urdf"


def _corners(robot_file: Path, folder: Path) -> list[np.ndarray]:
    robot = load_robot(urdf=robot_file, package_dirs=(folder,))
    return [body.vertices for body in robot.bodies if body.link == "grip"]


def test_the_parts_fill_the_mesh_and_leave_its_opening_free(urdf: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    parts = write_split_robot(load_robot(urdf=urdf, package_dirs=(tmp_path,)), ["grip"], out)
    bodies, (whole,) = _corners(out / URDF_NAME, out), _corners(urdf, tmp_path)
    assert len(bodies) == parts["grip"] >= 3
    together = np.concatenate(bodies)
    assert np.allclose(together.min(axis=0), whole.min(axis=0), atol=2e-3)
    assert np.allclose(together.max(axis=0), whole.max(axis=0), atol=2e-3)
    hulls = [trimesh.convex.convex_hull(body) for body in bodies]
    between = np.array([[0.03, 0.0, 0.0]])  # in the middle between the jaws, in the frame of the link
    assert trimesh.convex.convex_hull(whole).contains(between).all()
    assert not any(hull.contains(between).any() for hull in hulls)


def test_links_without_a_mesh_and_half_of_the_options_are_refused(urdf: Path, tmp_path: Path) -> None:
    robot = load_robot(urdf=urdf, package_dirs=(tmp_path,))
    with pytest.raises(RequestError, match=r"--decompose: no link 'gripp'; .*grip"):
        write_split_robot(robot, ["gripp"], tmp_path / "out")
    with pytest.raises(RequestError, match="--decompose: base has no collision mesh"):
        write_split_robot(robot, ["base"], tmp_path / "out")
    alone = CliRunner().invoke(app, ["robots", str(urdf), "--decompose", "grip"])
    assert alone.exit_code == 2
    assert "come together" in alone.stderr
