"""Objects described by a URDF: where their shapes are with every joint at zero, and which files are refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from robot_files import CUBE_OBJ, LIMIT, joint, link, robot, two_links, write_urdf

from costs.robot import RobotError, StillShape, read_object_shapes

BOX = '<box size="1 1 1"/>'
TURNED = BOX + '</geometry><origin xyz="0.5 0 0" rpy="0 0 1.5707963267948966"/><geometry>'


def _refusal(urdf: Path) -> str:
    with pytest.raises(RobotError) as refusal:
        read_object_shapes(urdf)
    message = str(refusal.value)
    assert "\n" not in message
    return message


def test_shapes_stand_where_the_joints_at_zero_put_them(tmp_path: Path) -> None:
    text = robot(
        link("base", BOX),
        link("arm"),
        link("tip", '<cylinder radius="0.1" length="0.4"/>'),
        joint("turn", "base", "arm", xyz="0 0 2"),
        joint("slide", "arm", "tip", "prismatic", xyz="3 0 0"),
    )
    box, tip = read_object_shapes(write_urdf(tmp_path, text))
    np.testing.assert_allclose(box.pose_object_shape, np.eye(4))
    assert box.points is not None
    np.testing.assert_allclose(np.ptp(box.points, axis=0), 1.0)
    np.testing.assert_allclose(tip.pose_object_shape[:3, 3], [3.0, 0.0, 2.0])
    assert tip.points is not None
    assert np.ptp(tip.points[:, 2]) == pytest.approx(0.4)
    assert box.where == "robot.urdf: link 'base'"


def test_a_joint_that_mimics_is_where_the_other_at_zero_puts_it(tmp_path: Path) -> None:
    follower = f'{LIMIT}<mimic joint="turn" multiplier="2" offset="1.5707963267948966"/>'
    text = robot(
        link("base"), link("a"), link("b", '<box size="1 2 3"/>'), joint("turn", "base", "a"),
        joint("follow", "a", "b", inside=follower),
    )  # fmt: skip
    (shape,) = read_object_shapes(write_urdf(tmp_path, text))
    np.testing.assert_allclose(shape.pose_object_shape[:3, 0], [0.0, 1.0, 0.0], atol=1e-12)


def test_a_mesh_comes_with_its_file_and_scale(tmp_path: Path) -> None:
    (tmp_path / "cube.obj").write_text(CUBE_OBJ)
    urdf = write_urdf(tmp_path, robot(link("crate", '<mesh filename="cube.obj" scale="0.001 0.002 0.003"/>')))
    (shape,) = read_object_shapes(urdf)
    assert shape.points is None
    assert shape.mesh == (tmp_path / "cube.obj").resolve()
    np.testing.assert_allclose(shape.scale, [0.001, 0.002, 0.003])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('<!DOCTYPE r [<!ENTITY s SYSTEM "file:///etc/hostname">]>' + robot(link("a", BOX)), "DOCTYPE is refused"),
        ("<sdf/>", "root element is <sdf>"),
        (robot(link("a")), "no link has a <collision>; an object needs one"),
        (robot(link("a", *[BOX] * 257)), "257 collision shapes; at most 256 are read"),
        (robot(link("a", BOX), link("b", BOX)), "one root link is needed"),
        (robot(link("a", '<box size="1 nan 1"/>')), "'nan' is not a finite"),
        (robot(link("a", '<mesh filename="file:///etc/passwd"/>')), "lies outside the package folders"),
        (robot(link("a", '<mesh filename="../a.obj"/>')), "outside the package folders"),
        (robot(link("a", '<mesh filename="package://a/../../a.obj"/>')), "'..' is refused"),
        (robot(link("a", '<mesh filename="none.obj"/>')), "not found in the package folders"),
        (
            two_links('<limit lower="0.5" upper="1" velocity="1" effort="1"/>'),
            "joint 'turn' moves from 0.5 to 1 and is never at 0; describe the object with its joints fixed",
        ),
        (two_links(kind="planar"), "type 'planar' is not supported"),
    ],
)
def test_what_a_robot_would_be_refused_for_is_refused(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "a.obj").write_text(CUBE_OBJ)
    (tmp_path / "object").mkdir()
    assert message in _refusal(write_urdf(tmp_path / "object", text))


@given(st.integers(0, 10_000), st.binary(min_size=1, max_size=8))
def test_damaged_files_are_read_or_refused(tmp_path_factory: pytest.TempPathFactory, at: int, junk: bytes) -> None:
    whole = two_links(geometry=TURNED).encode()
    path = tmp_path_factory.getbasetemp() / "damaged.urdf"
    at %= len(whole)
    path.write_bytes(whole[:at] + junk + whole[at + len(junk) :])
    assert all(np.isfinite(shape.pose_object_shape).all() for shape in _read_or_refused(path))


def _read_or_refused(path: Path) -> tuple[StillShape, ...]:
    try:
        return read_object_shapes(path)
    except RobotError:
        return ()
