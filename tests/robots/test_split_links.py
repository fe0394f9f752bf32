"""Concave links of a robot split into convex parts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from typer.testing import CliRunner

from costs.robot import RobotModel
from service import load_request, parse_request, plan, write_result
from service.cli.app import app
from service.errors import RequestError
from service.replay.replay import verify_result
from service.start.robot import load_requested_robot

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


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


def _load(urdf: Path, **robot: object) -> RobotModel:
    data = {"robot": {"urdf": urdf.name, **robot}, "goal": {"joints": {"turn": 0.5}}}
    return load_requested_robot(parse_request(data, folder=urdf.parent))


def _corners(robot: RobotModel) -> list[np.ndarray]:
    return [body.vertices for body in robot.bodies if body.link == "grip"]


def test_the_parts_fill_the_mesh_and_leave_its_opening_free(urdf: Path) -> None:
    robot = _load(urdf, decompose=["grip"])
    bodies, (whole,) = _corners(robot), _corners(_load(urdf))
    assert len(bodies) >= 3
    assert any("convex parts" in note for note in robot.notes)
    together = np.concatenate(bodies)
    assert np.allclose(together.min(axis=0), whole.min(axis=0), atol=2e-3)
    assert np.allclose(together.max(axis=0), whole.max(axis=0), atol=2e-3)
    hulls = [trimesh.convex.convex_hull(body) for body in bodies]
    between = np.array([[0.03, 0.0, 0.0]])  # in the middle between the jaws, in the frame of the link
    assert trimesh.convex.convex_hull(whole).contains(between).all()
    assert not any(hull.contains(between).any() for hull in hulls)


def test_meshes_in_millimetres_are_split_as_those_in_metres(urdf: Path) -> None:
    parts = len(_corners(_load(urdf, decompose=["grip"])))
    mesh = trimesh.load(urdf.parent / "meshes" / "grip.stl")
    mesh.apply_scale(1000.0)
    mesh.export(urdf.parent / "meshes" / "grip.stl")
    urdf.write_text(urdf.read_text().replace('scale="1 1 2"', 'scale="0.001 0.001 0.002"'))
    assert len(_corners(_load(urdf, decompose=["grip"]))) == parts


def test_a_start_whose_hulls_overlap_names_the_field_that_makes_it_possible(urdf: Path, tmp_path: Path) -> None:
    pin = (
        '<link name="rail"/><link name="pin"><collision><geometry><box size="0.01 0.01 0.01"/></geometry></collision>'
        '</link><joint name="turn2" type="revolute"><parent link="base"/><child link="rail"/><axis xyz="0 0 1"/>'
        '<limit lower="-1" upper="1" velocity="1" effort="9"/></joint>'
        '<joint name="slide" type="prismatic"><parent link="rail"/><child link="pin"/><axis xyz="1 0 0"/>'
        '<origin xyz="0.03 0 0"/><limit lower="-0.5" upper="0.005" velocity="1" effort="9"/></joint></robot>'
    )
    urdf.write_text(urdf.read_text().replace("</robot>", pin))
    text = "robot: {urdf: arm.urdf}\nscene: {floor: false}\ngoal: {joints: {slide: 0.004}}\noptions: {timed: false}\n"
    (tmp_path / "request.yaml").write_text(text)
    with pytest.raises(RequestError, match=r"concave.*robot\.decompose: \[grip\]"):
        plan(load_request(tmp_path / "request.yaml"))
    (tmp_path / "request.yaml").write_text(text.replace("arm.urdf", "arm.urdf, decompose: [grip]"))
    result = plan(load_request(tmp_path / "request.yaml"))
    assert result.verdict.value == "CERTIFIED", result.explanation
    write_result(result, tmp_path / "out")
    assert verify_result(tmp_path / "out")["verdict"] == result.verdict.value
    assert verify_result(tmp_path / "out", tmp_path / "request.yaml")["verdict"] == result.verdict.value


def test_the_command_writes_the_robot_with_its_parts(urdf: Path, tmp_path: Path) -> None:
    out = tmp_path / "split"
    done = CliRunner().invoke(app, ["robots", str(urdf), "--decompose", "grip", "--out", str(out)])
    assert done.exit_code == 0, done.output
    assert len(_corners(_load(out / "robot.urdf"))) == len(_corners(_load(urdf, decompose=["grip"])))
    again = CliRunner().invoke(app, ["robots", str(urdf), "--decompose", "grip", "--out", str(out)])
    assert again.exit_code != 0
    assert "is there already" in " ".join(again.stderr.split())


def test_links_without_a_mesh_are_refused(urdf: Path) -> None:
    with pytest.raises(RequestError, match=r"decompose: unknown link 'gripp'; expected base, grip"):
        _load(urdf, decompose=["gripp"])
    with pytest.raises(RequestError, match="decompose: link 'base' has no collision mesh"):
        _load(urdf, decompose=["base"])
    with pytest.raises(RequestError, match="belongs to a robot given by urdf"):
        parse_request({"robot": {"name": "atlas", "decompose": ["l_hand"]}, "goal": {"joints": {"l_arm_elx": 0.1}}})
