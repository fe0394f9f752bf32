"""What the loader does with files that lie, bomb or wander."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from robot_files import CUBE_OBJ, LIMIT, joint, link, robot, two_links, write_urdf

from costs.robot import RobotError, load_robot

BOX = '<box size="1 1 1"/>'


def _refusal(urdf: Path, **options: object) -> str:
    with pytest.raises(RobotError) as refusal:
        load_robot(urdf=urdf, **options)  # type: ignore[arg-type]
    message = str(refusal.value)
    assert "\n" not in message
    assert len(message) < 400
    return message


def _chain(count: int) -> str:
    links = [link(f"l{k}") for k in range(count)]
    return robot(*links, *(joint(f"j{k}", f"l{k}", f"l{k + 1}") for k in range(count - 1)))


def _star(count: int) -> str:
    links = [link(f"l{k}") for k in range(count)]
    return robot(*links, *(joint(f"j{k}", "l0", f"l{k}") for k in range(1, count)))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "not well-formed XML"),
        ("<robot", "not well-formed XML"),
        ("<sdf/>", "root element is <sdf>"),
        (robot(), "no <link>"),
        (robot(link("a")), "no joint moves (joints: none)"),
        (robot(link("a"), link("a")), "link name 'a' is used twice"),
        (robot(link("a"), link("b"), link("c"), joint("j", "a", "b"), joint("j", "b", "c")), "joint name 'j' is used"),
        (robot(link("a"), link("universe"), joint("j", "a", "universe")), "'universe' is reserved"),
        (robot(link("a"), link("b"), joint("j", "a", "bb")), "unknown child link 'bb'; expected a, b"),
        (robot(link("a"), link("b")), "one root link is needed, found 'a', 'b'"),
        (robot(link("a"), link("b"), joint("j", "a", "b"), joint("k", "b", "a")), "form a loop"),
        (
            robot(link("r"), link("a"), link("b"), joint("j", "a", "b"), joint("k", "b", "a")),
            "link 'a' is part of a loop",
        ),
        (
            robot(link("a"), link("b"), link("c"), joint("j", "a", "c"), joint("k", "b", "c")),
            "'c' has two parent joints",
        ),
        (_chain(130), "deeper than 128"),
        (_star(513), "513 links; at most 512"),
        (two_links(kind="ball"), "type 'ball' is not supported"),
        (
            robot(link("a"), link("b"), link("c"), joint("j", "a", "b"), joint("k", "b", "c", "floating")),
            "a floating joint is read only between a bare root link and the robot",
        ),
        (two_links(inside=""), "without <limit>"),
        (two_links('<limit lower="1" upper="-1" velocity="1" effort="1"/>'), "lower 1 exceeds upper -1"),
        (two_links('<limit lower="nan" upper="1" velocity="1" effort="1"/>'), "limit lower: 'nan' is not a finite"),
        (two_links('<limit lower="0" upper="nan" velocity="1" effort="1"/>'), "limit upper: 'nan' is not a finite"),
        (two_links('<limit lower="0" upper="1" velocity="-1" effort="1"/>'), "velocity and effort must not be neg"),
        (two_links().replace('xyz="0 0 1" rpy', 'xyz="0 NaN 1" rpy'), "origin xyz: 'NaN' is not a finite"),
        (two_links().replace('xyz="0 0 1" rpy', 'xyz="0 1" rpy'), "'0 1' holds 2 numbers; 3"),
        (two_links().replace('<axis xyz="0 0 1"/>', '<axis xyz="0 0 0"/>'), "axis is zero"),
        (two_links().replace('<axis xyz="0 0 1"/>', '<axis xyz="0 0 1e400"/>'), "'1e400' is not a finite"),
        (two_links(geometry='<box size="1 -1 1"/>'), "every length must be positive"),
        (two_links(geometry='<cylinder radius="x" length="1"/>'), "'x' is not a number"),
        (two_links(geometry='<cone radius="1"/>'), "shape <cone> is not known"),
        (two_links(geometry='<mesh filename="a.obj" scale="1 0 1"/>'), "flattens the mesh"),
        (two_links(geometry=""), "needs a <geometry> with one shape"),
    ],
)
def test_urdf_that_cannot_be_right_is_refused_in_one_line(tmp_path: Path, text: str, message: str) -> None:
    assert message in _refusal(write_urdf(tmp_path, text))


def test_joint_named_like_a_base_coordinate_is_refused_on_a_floating_base(tmp_path: Path) -> None:
    urdf = write_urdf(tmp_path, two_links().replace('name="turn"', 'name="base_yaw"'))
    assert load_robot(urdf=urdf).joint_names == ("base_yaw",)
    assert "'base_yaw' is reserved for the floating base" in _refusal(urdf, root="floating")


def test_chain_of_128_joints_loads(tmp_path: Path) -> None:
    assert load_robot(urdf=write_urdf(tmp_path, _chain(129))).n == 128


HIDDEN = '<?xml version="1.0" encoding="UTF-7"?>+ADwAIQ-DOCTYPE robot+AD4-'


@pytest.mark.parametrize(
    "head",
    [
        '<!DOCTYPE r [<!ENTITY a "xxxxxxxxxxxxxxxx"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;&a;">]>',
        '<!DOCTYPE r [<!ENTITY s SYSTEM "file:///etc/hostname">]>',
        '<?xml version="1.0"?>\n<!DOCTYPE robot>',
        HIDDEN,
    ],
)
def test_doctype_is_refused(tmp_path: Path, head: str) -> None:
    assert "DOCTYPE is refused" in _refusal(write_urdf(tmp_path, head + two_links()))


def test_entities_in_attributes_are_refused_before_they_expand(tmp_path: Path) -> None:
    head = '<!DOCTYPE r [<!ENTITY a "0"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;&a;">]>'
    urdf = write_urdf(tmp_path, head + two_links().replace('xyz="0 0 1" rpy', 'xyz="&c; 0 1" rpy'))
    assert "DOCTYPE is refused" in _refusal(urdf)


def test_deep_and_large_xml_are_refused(tmp_path: Path) -> None:
    deep = '<robot name="a">' + "<b>" * 200_000 + "</b>" * 200_000 + "</robot>"
    assert "nested too deeply" in _refusal(write_urdf(tmp_path, deep))
    large = two_links().replace("</robot>", " " * 4_200_000 + "</robot>")
    assert "larger than 4 MB" in _refusal(write_urdf(tmp_path, large))


def test_bytes_that_are_not_utf8_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    path.write_bytes(b"\xff\xfe<robot/>")
    assert "not UTF-8" in _refusal(path)


def test_effort_of_huge_size_does_not_overflow(tmp_path: Path) -> None:
    text = two_links('<limit lower="-1e16" upper="1e16" velocity="1e16" effort="1e300"/>')
    assert load_robot(urdf=write_urdf(tmp_path, text)).lower[0] == -np.inf


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """Folder ``packages/arm`` with a cube, a secret mesh beside ``packages`` and a link that leads to it."""
    meshes = tmp_path / "packages" / "arm"
    meshes.mkdir(parents=True)
    (meshes / "cube.obj").write_text(CUBE_OBJ)
    (tmp_path / "secret.obj").write_text(CUBE_OBJ)
    (meshes / "link.obj").symlink_to(tmp_path / "secret.obj")
    return tmp_path / "packages"


@pytest.mark.parametrize(
    ("uri", "message"),
    [
        ("file:///etc/passwd", "outside the package folders"),
        ("file:///{folder}/secret.obj", "outside the package folders"),
        ("https://example.org/a.obj", "https:// is refused"),
        ("{folder}/secret.obj", "outside the package folders"),
        ("package:///{folder}/secret.obj", "has an absolute path in package://"),
        ("package://../secret.obj", "'..' is refused"),
        ("package://arm/../../secret.obj", "'..' is refused"),
        ("../secret.obj", "outside the package folders"),
        ("arm/../../secret.obj", "outside the package folders"),
        ("package://arm/link.obj", "outside the package folders"),
        ("..\\secret.obj", "write paths with '/'"),
        ("$(find arm)/link.obj", "is an expression of xacro"),
        ("package://arm/none.obj", "not found in the package folders"),
        ("package://arm", "not found in the package folders"),
    ],
)
def test_meshes_outside_the_package_folders_are_not_read(tmp_path: Path, package: Path, uri: str, message: str) -> None:
    mesh = f'<mesh filename="{uri.format(folder=tmp_path)}"/>'
    urdf = write_urdf(tmp_path, two_links(geometry=mesh))
    assert message in _refusal(urdf, package_dirs=[package])


@pytest.mark.parametrize(
    ("uri", "root", "key"),
    [
        ("package://arm/cube.obj", "packages", "arm/cube.obj"),
        ("package://arm/cube.obj", "packages/arm", "arm/cube.obj"),
        ("arm/cube.obj", "packages", "arm/cube.obj"),
        ("arm/../arm/cube.obj", "packages", "arm/cube.obj"),
        ("{folder}/packages/arm/cube.obj", "packages", "arm/cube.obj"),
        ("file://{folder}/packages/arm/cube.obj", "packages", "arm/cube.obj"),
    ],
)
def test_meshes_inside_the_package_folders_are_found(
    tmp_path: Path, package: Path, uri: str, root: str, key: str
) -> None:
    urdf = write_urdf(tmp_path, two_links(geometry=f'<mesh filename="{uri.format(folder=tmp_path)}"/>'))
    found = load_robot(urdf=urdf, package_dirs=[tmp_path / root])
    assert found.source.files == {key: (package / "arm" / "cube.obj").resolve()}
    assert uri.startswith("package://") or f'filename="{key}"' in found.source.urdf


def _stl(count: int, claimed: int) -> bytes:
    corners = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    facets = b"".join(
        struct.pack("<12fH", 0, 0, 1, *corners[k % 4], *corners[(k + 1) % 4], *corners[(k + 2) % 4], 0)
        for k in range(count)
    )
    return b"binary".ljust(80, b" ") + struct.pack("<I", claimed) + facets


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        ("m.ply", b"ply", "format '.ply' is not read; convert it to .obj, .stl, .dae or .glb"),
        ("m.dae", b"<COLLADA/>", "no mesh in its scene"),
        ("m.dae", b'<!DOCTYPE x [<!ENTITY a "b">]><COLLADA/>', "DOCTYPE is refused"),
        ("m.stl", _stl(4, 2_000_000_000), "neither text STL nor a binary one of the length its header claims"),
        ("m.stl", b"", "neither text STL"),
        ("m.stl", b"solid x\nvertex 0 0\nendsolid", "does not hold three numbers"),
        ("m.obj", b"", "has 0 vertices"),
        ("m.obj", b"v 0 0 0\nv 1 0 0\n", "has 2 vertices"),
        ("m.obj", CUBE_OBJ.encode() + b"v nan 0 0\n", "not finite"),
        ("m.obj", CUBE_OBJ.encode() + b"v 0 0\n", "does not hold three numbers"),
        ("m.obj", CUBE_OBJ.encode() + b"v a b c\n", "does not hold three numbers"),
    ],
)
def test_mesh_that_cannot_be_right_is_refused(tmp_path: Path, name: str, data: bytes, message: str) -> None:
    (tmp_path / name).write_bytes(data)
    urdf = write_urdf(tmp_path, two_links(geometry=f'<mesh filename="{name}"/>'))
    assert message in _refusal(urdf)


def test_mesh_that_is_too_large_is_refused_unread(tmp_path: Path) -> None:
    with (tmp_path / "m.obj").open("wb") as stream:
        stream.truncate(33 * 2**20)
    urdf = write_urdf(tmp_path, two_links(geometry='<mesh filename="m.obj"/>'))
    assert "at most 33554432 are read" in _refusal(urdf)


def test_text_and_binary_stl_give_the_same_body(tmp_path: Path) -> None:
    (tmp_path / "a.stl").write_bytes(_stl(4, 4))
    (tmp_path / "b.stl").write_text("solid b\n" + "".join(
        f" vertex {v}\n" for v in ("0 0 0", "1 0 0", "0 1 0", "0 0 1")) + "endsolid b\n")  # fmt: skip
    bodies = []
    for name in ("a.stl", "b.stl"):
        urdf = write_urdf(tmp_path, two_links(geometry=f'<mesh filename="{name}"/>'))
        bodies.append({tuple(vertex) for vertex in load_robot(urdf=urdf).bodies[0].vertices})
    assert bodies[0] == bodies[1]


def test_second_body_named_like_another_link_is_refused(tmp_path: Path) -> None:
    text = robot(link("a", BOX, BOX), link("a/1", BOX), joint("j", "a", "a/1", inside=LIMIT))
    assert "two bodies have the name 'a/1'" in _refusal(write_urdf(tmp_path, text))
