"""Mechanisms read from a URDF: the same motion as pinocchio's of the same file, and refusals in one line."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from given_mechanisms import bar, box, cabinet_urdf, drawer_urdf
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from tiny_robots import atlas

from costs.robot import RobotError, UrdfMechanism, read_mechanism, read_mesh_hulls, with_mechanism

POSE = np.eye(4)
POSE[:3, :3] = Rotation.from_rotvec([0.3, -0.2, 0.9]).as_matrix()
POSE[:3, 3] = [0.7, -0.2, 0.4]
numbers = st.floats(-1.0, 1.0)
vectors = st.tuples(numbers, numbers, numbers)


def read(text: str, starts: dict[str, float] | None = None, meshes: Any = None, pose: Any = POSE) -> UrdfMechanism:
    return read_mechanism(text, "urdf", "mechanism", "fixture", pose, starts or {}, meshes or {})


def refuse(text: str, **more: Any) -> str:
    with pytest.raises(RobotError) as caught:
        read(text, **more)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@st.composite
def trees(draw: st.DrawFn) -> str:
    """A random tree of up to eight links with revolute, prismatic, continuous and fixed joints."""
    count = draw(st.integers(2, 8))
    parts = []
    for k in range(count):
        size = tuple(draw(st.floats(0.05, 0.3)) for _ in range(3))
        parts.append(f'<link name="l{k}">{box(size, draw(vectors))}{bar(0.2, draw(vectors), "0.3 0.2 0.1")}</link>')
    for k in range(1, count):
        kind = draw(st.sampled_from(["revolute", "prismatic", "continuous", "fixed"])) if k > 1 else "revolute"
        xyz, rpy = (" ".join(map(repr, draw(vectors))) for _ in range(2))
        axis = draw(vectors.filter(lambda vector: np.linalg.norm(vector) > 0.1))
        parts.append(
            f'<joint name="j{k}" type="{kind}"><parent link="l{draw(st.integers(0, k - 1))}"/><child link="l{k}"/>'
            f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{" ".join(map(repr, axis))}"/>'
            '<limit lower="-1" upper="1.5" velocity="1" effort="1"/></joint>'
        )
    return f'<robot name="tree">{"".join(parts)}</robot>'


@settings(max_examples=40, deadline=None)
@given(text=trees(), seed=st.integers(0, 1000))
def test_every_body_moves_as_pinocchio_moves_the_urdf(text: str, seed: int) -> None:
    found = read(text)
    robot = with_mechanism(atlas(), found.joints)
    values = np.random.default_rng(seed).uniform(-1.0, 1.0, len(found.joints))
    q = np.concatenate([atlas().postures["stand"], values])
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    moved = {}
    for body in robot.bodies[len(atlas().bodies) :]:
        moved[body.name] = body.vertices @ data.oMi[body.joint].rotation.T + data.oMi[body.joint].translation
    moved |= found.still

    # A continuous joint is a revolute one here, so that its angle is a plain number there too.
    model = pin.buildModelFromXML(text.replace('"continuous"', '"revolute"'))
    own = model.createData()
    angles = dict(zip([joint.name for joint in found.joints], values, strict=True))
    pin.framesForwardKinematics(model, own, np.array([angles[name] for name in model.names[1:]]))
    shapes = pin.buildGeomFromUrdfString(model, text.replace('"continuous"', '"revolute"'), pin.GeometryType.COLLISION)
    boxes = {shape.name.rpartition("_")[0]: shape for shape in shapes.geometryObjects if shape.name.endswith("_0")}
    assert len(boxes) == len(found.links)
    for link, place in found.links.items():
        shape = boxes[link]
        pose = own.oMi[shape.parentJoint] * shape.placement
        half = np.array(shape.geometry.halfSide)
        expected = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half
        expected = expected @ pose.rotation.T + pose.translation
        expected = expected @ POSE[:3, :3].T + POSE[:3, 3]
        points = moved[place.bodies[0]]
        assert len(points) == 8
        distance = np.linalg.norm(points[:, None] - expected[None], axis=2)
        assert max(distance.min(axis=0).max(), distance.min(axis=1).max()) < 1e-9


def test_fixed_links_move_with_their_joint_and_what_no_joint_moves_stands_still() -> None:
    found = read(drawer_urdf())
    (joint,) = found.joints
    assert (joint.name, joint.link, joint.kind, joint.parent) == ("slide", "mechanism/drawer", "prismatic", None)
    names = {"mechanism/drawer/drawer", "mechanism/drawer/drawer.1", "mechanism/drawer/handle"}
    assert set(joint.bodies) == names
    assert set(found.still) == {"fixture/cupboard", "fixture/cupboard.1"}
    assert found.links["handle"].link == "mechanism/drawer"
    assert found.links["cupboard"].link is None
    np.testing.assert_allclose(found.links["handle"].pose[:3, 3], POSE[:3, :3] @ [-0.06, 0.0, 0.0], atol=1e-12)
    assert (joint.lower, joint.upper) == pytest.approx((-1e-3, 0.401))


def test_a_start_is_zero_the_nearest_limit_or_what_is_given() -> None:
    away = drawer_urdf().replace('lower="0" upper="0.4"', 'lower="0.1" upper="0.4"')
    assert read(drawer_urdf()).joints[0].start == 0.0
    assert read(away).joints[0].start == 0.1
    assert read(away, {"slide": 0.3}).joints[0].start == 0.3
    spinning = cabinet_urdf().replace('"revolute"', '"continuous"')
    joint = read(spinning, {"hinge": 9.0}).joints[0]
    assert joint.start == 9.0
    assert (joint.lower, joint.upper) == pytest.approx((9.0 - 2 * np.pi - 1e-3, 9.0 + 2 * np.pi + 1e-3))


DOUBLE = '<joint name="again" type="fixed"><parent link="cupboard"/><child link="handle"/></joint></robot>'
LOST = '<joint name="lost" type="fixed"><parent link="cupboard"/><child link="nowhere"/></joint></robot>'


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (drawer_urdf().replace("</robot>", DOUBLE), "urdf: link 'handle' has two parent joints"),
        (drawer_urdf().replace('"cupboard"/><child', '"handle"/><child'), "urdf: link 'drawer' is part of a loop"),
        (drawer_urdf().replace("</robot>", LOST), "urdf: joint 'lost': unknown child link 'nowhere'"),
        (drawer_urdf().replace("prismatic", "fixed"), "urdf: no joint moves"),
        (drawer_urdf().replace("prismatic", "planar"), "urdf: joint 'slide': type 'planar' is not supported"),
        (drawer_urdf().replace("<robot", "<robots", 1).replace("</robot>", "</robots>"), "urdf: the root element is"),
        ("<robot name='r'", "urdf: not well-formed XML"),
        (
            cabinet_urdf().replace(box((0.02, 0.4, 0.5), (0, -0.2, 0)), "").replace(bar(0.16, (0, 0, 0)), ""),
            "urdf: link 'door' has no <collision>",
        ),
        (
            drawer_urdf().replace('<box size="0.02 0.46 0.16"/>', '<mesh filename="front.stl"/>'),
            "urdf: link 'drawer': mesh 'front.stl' is not given",
        ),
    ],
)
def test_a_urdf_that_cannot_be_used_is_refused_in_one_line(text: str, problem: str) -> None:
    assert problem in refuse(text)


def test_a_start_that_is_unknown_or_past_a_limit_is_refused() -> None:
    assert refuse(drawer_urdf(), starts={"slid": 0.0}) == "joints.slid: unknown joint; the mechanism moves slide"
    problem = refuse(drawer_urdf(), starts={"slide": 0.5})
    assert problem == "joints.slide.start: 0.5 m is past the limits of the joint, 0 to 0.4 m"


@settings(max_examples=100, deadline=None)
@given(text=st.text(max_size=60), at=st.integers(0, 2000), cut=st.integers(0, 40))
def test_damaged_text_is_read_or_refused(text: str, at: int, cut: int) -> None:
    whole = drawer_urdf()
    damaged = whole[: at % len(whole)] + text + whole[at % len(whole) + cut :]
    with suppress(RobotError):
        assert read(damaged).joints


def test_a_mesh_counts_as_its_hull_scaled(tmp_path: Path) -> None:
    corners = [(x, y, z) for x in (-10, 10) for y in (-230, 230) for z in (-80, 80)]
    inside = [(0.0, 0.0, 0.0)]
    (tmp_path / "front.obj").write_text("".join(f"v {x} {y} {z}\n" for x, y, z in corners + inside))
    mesh = '<mesh filename="front.obj" scale="0.001 0.001 0.001"/>'
    text = drawer_urdf().replace('<box size="0.02 0.46 0.16"/>', mesh)
    hulls = read_mesh_hulls(text, "drawer.urdf", tmp_path)
    assert list(hulls) == ["front.obj"]
    assert len(hulls["front.obj"]) == 8
    ours, boxes = read(text, meshes=hulls).joints[0].bodies, read(drawer_urdf()).joints[0].bodies
    first, second = (np.sort(bodies["mechanism/drawer/drawer"].round(9), axis=0) for bodies in (ours, boxes))
    np.testing.assert_allclose(first, second, atol=1e-9)
    with pytest.raises(RobotError, match="lies outside the package folders"):
        read_mesh_hulls(text.replace("front.obj", "../front.obj"), "drawer.urdf", tmp_path)
