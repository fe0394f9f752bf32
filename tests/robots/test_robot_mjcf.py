"""Models of MuJoCo as robots: where their links are, what they weigh, and what is refused."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from costs.kinematics import KinematicsEngine, locate_links
from costs.robot import RobotError, RobotModel, load_robot
from service import load_request, plan, write_result
from service.replay.replay import verify_result

mujoco = pytest.importorskip("mujoco")

ARM = """<mujoco model="arm">
 <compiler angle="degree" meshdir="meshes"/>
 <default><default class="drawn"><geom contype="0" conaffinity="0"/></default></default>
 <asset><mesh name="shell" file="shell.stl" scale="0.1 0.1 0.1"/></asset>
 <worldbody>
  <geom type="plane" size="1 1 1"/>
  <body name="base" pos="0.1 0 0.2" euler="0 0 30"><geom type="cylinder" size="0.1 0.1"/>
   <body name="upper" pos="0 0 0.15"><joint name="pan" axis="0 0 1" range="-170 170" ref="20"/>
    <geom type="capsule" fromto="0 0 0.05 0 0 0.4" size="0.04"/>
    <body name="lower" pos="0 0 0.45" quat="0.7 0.1 0.2 0">
     <joint name="lift" axis="0 1 0" pos="0 0 -0.03" range="-100 100"/>
     <joint name="roll" axis="1 0 0" pos="0.01 0 -0.02"/>
     <geom type="capsule" fromto="0 0 0.06 0.3 0 0.06" size="0.03"/><geom class="drawn" size="0.05"/>
     <body name="hand" pos="0.5 0 0.06"><joint name="slide" type="slide" axis="1 0 0" range="0 0.2" ref="0.05"/>
      <geom type="mesh" mesh="shell" pos="0 0.01 0" euler="10 20 30"/>
     </body></body></body></body>
  <body name="cube" pos="2 0 0"><freejoint/><geom type="box" size="0.1 0.1 0.1"/></body>
 </worldbody>
 <actuator><motor joint="pan" ctrlrange="-30 30" ctrllimited="true" gear="2"/>
  <position joint="lift" kp="100" forcerange="-50 50"/></actuator>
 <keyframe><key name="home" qpos="0.3 0.2 0.1 0.02 2 0 0 1 0 0 0"/></keyframe>
</mujoco>"""


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with an arm whose joints have anchors and references, and a mesh off its own middle."""
    folder = tmp_path_factory.mktemp("mjcf")
    (folder / "meshes").mkdir()
    mesh = trimesh.creation.box((1.0, 0.6, 0.4))
    mesh.apply_translation((0.3, 0.2, 0.1))
    mesh.export(folder / "meshes" / "shell.stl")
    (folder / "arm.xml").write_text(ARM)
    return folder / "arm.xml"


@pytest.fixture(scope="module")
def robot(model: Path) -> RobotModel:
    return load_robot(urdf=model)


@settings(max_examples=30, deadline=None)
@given(turns=st.lists(st.floats(-1.0, 1.0), min_size=4, max_size=4))
def test_links_are_where_mujoco_has_them(model: Path, robot: RobotModel, turns: list[float]) -> None:
    mj = mujoco.MjModel.from_xml_path(str(model))
    data = mujoco.MjData(mj)
    for name, turn in zip(robot.joint_names, turns, strict=True):
        data.qpos[mj.joint(name).qposadr[0]] = turn
    mujoco.mj_kinematics(mj, data)
    links = ("base", "upper", "lower", "hand")
    poses = locate_links(KinematicsEngine(robot), np.array(turns), links)
    for name in links:
        assert np.allclose(poses[name][:3, 3], data.body(name).xpos, atol=1e-9)
        assert np.allclose(poses[name][:3, :3], data.body(name).xmat.reshape(3, 3), atol=1e-9)


def test_shapes_masses_limits_and_postures_are_the_models(model: Path, robot: RobotModel) -> None:
    mj = mujoco.MjModel.from_xml_path(str(model))
    assert np.isclose(sum(inertia.mass for inertia in robot.model.inertias), mj.body_subtreemass[1])
    assert [body.link for body in robot.bodies] == ["base", "upper", "lower", "hand"]
    assert np.allclose(robot.effort, [60.0, 50.0, np.inf, np.inf])
    assert np.allclose(robot.upper, [np.deg2rad(170.0), np.deg2rad(100.0), np.inf, 0.2])
    assert np.allclose(robot.postures["home"], [0.3, 0.2, 0.1, 0.02])
    assert any("cube" in note and "left out" in note for note in robot.notes)
    # The corners of the mesh, from the geom of a model at its first pose.
    data = mujoco.MjData(mj)
    mujoco.mj_kinematics(mj, data)
    corners = mj.mesh_vert @ data.geom_xmat[mj.ngeom - 2].reshape(3, 3).T + data.geom_xpos[mj.ngeom - 2]
    hand = next(body for body in robot.bodies if body.link == "hand")
    pose = locate_links(KinematicsEngine(robot), mj.qpos0[:4], ["hand"])["hand"]
    frame = robot.model.frames[robot.model.getFrameId("hand")].placement.homogeneous
    placed = hand.vertices @ np.linalg.inv(frame)[:3, :3].T + np.linalg.inv(frame)[:3, 3]
    placed = placed @ pose[:3, :3].T + pose[:3, 3]
    assert np.allclose(np.sort(placed, axis=0), np.sort(np.unique(corners, axis=0), axis=0), atol=1e-5)


def test_a_plan_with_a_model_is_certified_and_replayed(model: Path, tmp_path: Path) -> None:
    request = model.parent / "request.yaml"
    request.write_text(
        "robot: {urdf: arm.xml}\nstart: {posture: home}\nscene: {floor: false}\ngoal: {joints: {pan: 1.0}}\n"
    )
    result = plan(load_request(request))
    assert result.verdict.value == "CERTIFIED"
    write_result(result, tmp_path / "out")
    assert verify_result(tmp_path / "out")["verdict"] == "CERTIFIED"
    assert verify_result(tmp_path / "out", request)["verdict"] == "CERTIFIED"


def _write(folder: Path, body: str, more: str = "") -> Path:
    path = folder / "robot.xml"
    path.write_text(f"<mujoco>{more}<worldbody>{body}</worldbody></mujoco>")
    return path


LINK = '<geom size="0.1"/><body name="b" pos="0 0 1"><joint name="j" range="-1 1"/><geom size="0.1"/></body>'


@pytest.mark.parametrize(
    ("body", "more", "words"),
    [
        (
            '<body><joint name="j" type="ball"/><geom size="0.1"/></body>',
            "",
            "joint 'j' is a ball joint",
        ),
        ('<body><geom size="0.1"/></body>', "", "no joint moves"),
        ('<body><joint/><geom size="0.1" type="what"/></body>', "", "MuJoCo cannot use the model"),
        (LINK, '<include file="../../secret.xml"/>', "outside the package folders"),
        (f"<body>{LINK}</body>", '<asset><mesh file="/etc/passwd"/></asset>', "outside the package folders"),
        (f"<body>{LINK}</body>", '<include file="robot.xml"/>', "does a file include itself"),
    ],
)
def test_what_cannot_be_used_is_refused_in_one_line(tmp_path: Path, body: str, more: str, words: str) -> None:
    (tmp_path / "secret.xml").write_text("<mujoco/>")
    (tmp_path / "a" / "b").mkdir(parents=True)
    with pytest.raises(RobotError, match=words) as caught:
        load_robot(urdf=_write(tmp_path / "a" / "b", body, more))
    assert "\n" not in str(caught.value)


def test_a_floating_model_stands_where_its_keyframe_has_it(tmp_path: Path) -> None:
    key = '<keyframe><key name="up" qpos="1 2 3 0.7071067811865476 0 0 0.7071067811865476 0.2"/></keyframe>'
    path = tmp_path / "robot.xml"
    path.write_text(f'<mujoco><worldbody><body name="pelvis"><freejoint/>{LINK}</body></worldbody>{key}</mujoco>')
    robot = load_robot(urdf=path, root="floating")
    assert np.allclose(robot.postures["up"], [1.0, 2.0, 3.0, np.pi / 2, 0.0, 0.0, 0.2])


def test_without_mujoco_one_line_says_what_to_install(model: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(RobotError, match=r"pip install 'scopt\[sim\]'"):
        load_robot(urdf=model)


def test_what_a_urdf_cannot_say_is_named(tmp_path: Path) -> None:
    joints = "".join(
        f'<joint name="{name}" axis="{axis}" range="-1 1" {more}/>'
        for name, axis, more in (("sprung", "1 0 0", 'stiffness="5"'), ("geared", "0 1 0", 'armature="0.2"'))
    )
    held = '<body name="c" gravcomp="1" pos="0 0 1"><joint name="held" range="-1 1"/><geom size="0.1"/></body>'
    chain = f'<body name="b">{joints}<geom size="0.1"/>{held}</body>'
    body = f'<geom type="box" size="1 1 1"/><body name="a"><freejoint/><geom size="0.1"/>{chain}</body>'
    more = (
        '<option gravity="0 0 -1.6"/><tendon><fixed name="t"><joint joint="sprung" coef="1"/></fixed></tendon>'
        '<equality><joint joint1="held"/></equality>'
    )
    notes = load_robot(urdf=_write(tmp_path, body, more), root="floating").notes
    for words in (
        "springs of joints sprung are left out",
        "inertias of rotors (armature) of joints geared",
        "takes off bodies c (gravcomp)",
        "gravity, 0.0 0.0 -1.6 m/s^2, is not used",
        "tendons are left out",
        "joint 'held' is held in its place by an equality",
        "shapes of the model's world are left out",
    ):
        assert any(words in note for note in notes), (words, notes)
    assert load_robot(urdf=_write(tmp_path, f"<body>{LINK}</body>")).notes == notes[-1:]
