"""Robot files as others publish them: what is read, how, and with which note."""

from __future__ import annotations

from pathlib import Path

import coal
import numpy as np
import pytest
import trimesh
from robot_files import CUBE_OBJ, joint, link, robot, two_links, write_urdf

from costs.kinematics import KinematicsEngine, locate_frame, locate_links
from costs.robot import RobotError, RobotModel, load_robot, read_robot_visuals
from costs.robot.mesh import DerivedCache, read_mesh, read_vertices
from costs.robot.mesh.visual import simplify_mesh

BOX = '<box size="0.1 0.1 0.1"/>'
TETRAHEDRON = ("0 0 0 1 0 0 0 1 0 0 0 1", "0 2 1 0 1 3 0 3 2 1 2 3")


def _many_nodes() -> str:
    """Nodes that each hold the next one ten times."""
    nodes = "".join(f'<node id="a{k}">' + 10 * f'<instance_node url="#a{k + 1}"/>' + "</node>" for k in range(9))
    return f'<library_nodes>{nodes}<node id="a9"><instance_geometry url="#tet"/></node></library_nodes>'


def _load(folder: Path, text: str, **settings: object) -> RobotModel:
    return load_robot(urdf=write_urdf(folder, text), **settings)  # type: ignore[arg-type]


def _collada(nodes: str, unit: float = 1.0, library: str = "") -> str:
    points, corners = TETRAHEDRON
    return (
        '<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">'
        f'<asset><unit meter="{unit}"/><up_axis>Z_UP</up_axis></asset>'
        '<library_geometries><geometry id="tet"><mesh>'
        f'<source id="p"><float_array id="pa" count="12">{points}</float_array><technique_common>'
        '<accessor source="#pa" count="4" stride="3"><param name="X" type="float"/><param name="Y" type="float"/>'
        '<param name="Z" type="float"/></accessor></technique_common></source>'
        '<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>'
        f'<triangles count="4"><input semantic="VERTEX" source="#v" offset="0"/><p>{corners}</p></triangles>'
        f'</mesh></geometry></library_geometries>{library}<library_visual_scenes><visual_scene id="s">{nodes}'
        '</visual_scene></library_visual_scenes><scene><instance_visual_scene url="#s"/></scene></COLLADA>'
    )


def test_a_robot_without_a_name_is_called_as_its_file(tmp_path: Path) -> None:
    model = _load(tmp_path, two_links().replace('<robot name="sample">', "<robot>"))
    assert model.name == "robot"
    assert model.notes == ("the file does not name the robot; it is called 'robot'",)
    assert 'name="robot"' in model.source.urdf


@pytest.mark.parametrize(
    "opening",
    [
        '<robot name="sample" xmlns="http://drake.mit.edu">',
        '<robot name="sample" xmlns:g="http://gazebo.org"><g:joint/><g:link name="base"/>',
    ],
)
def test_namespaces_of_others_do_not_matter(tmp_path: Path, opening: str) -> None:
    assert _load(tmp_path, two_links().replace('<robot name="sample">', opening)).joint_names == ("turn",)


def test_a_xacro_file_is_refused_with_the_command_that_expands_it(tmp_path: Path) -> None:
    text = '<robot name="a" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:property name="x" value="1"/></robot>'
    path = tmp_path / "arm.urdf.xacro"
    path.write_text(text)
    with pytest.raises(RobotError, match=r"expand it first: xacro .*arm\.urdf\.xacro > arm\.urdf"):
        load_robot(urdf=path)
    path = write_urdf(tmp_path, text)
    with pytest.raises(RobotError, match=r"xacro .*robot\.urdf > robot\.expanded\.urdf"):
        load_robot(urdf=path)
    with pytest.raises(RobotError, match="the file is a xacro template"):
        _load(tmp_path, two_links().replace('xyz="0 0 1" rpy', 'xyz="0 0 ${h}" rpy'))


def test_a_link_and_a_joint_may_have_one_name(tmp_path: Path) -> None:
    text = robot(link("base", BOX), link("arm", BOX), link("tip", BOX), joint("arm", "base", "arm"),
                 joint("tip", "arm", "tip", "fixed", "", "0.5 0 0"))  # fmt: skip
    model = _load(tmp_path, text)
    assert model.joint_names == ("arm",)
    assert [body.link for body in model.bodies] == ["base", "arm", "tip"]
    carried, pose = locate_frame(model, "tip")
    assert carried == model.model.getJointId("arm")
    np.testing.assert_allclose(pose[:3, 3], [0.5, 0.0, 0.0])


def test_a_planar_joint_slides_along_its_plane_and_turns_about_its_normal(tmp_path: Path) -> None:
    base = joint("drive", "floor", "base", "planar", "", "0 0 0.2")
    model = _load(
        tmp_path, robot(link("floor"), link("base", BOX), link("arm", BOX), base, joint("turn", "base", "arm"))
    )
    assert model.joint_names == ("drive_x", "drive_y", "drive_yaw", "turn")
    np.testing.assert_allclose(model.lower[:3], [-10.0, -10.0, -np.inf])
    assert model.notes == ("the planar joint 'drive' is read as drive_x, drive_y (within 10 m) and drive_yaw",)
    pose = locate_links(KinematicsEngine(model), np.array([1.0, 2.0, np.pi / 2, 0.0]), ["arm"])["arm"]
    np.testing.assert_allclose(pose[:3, 3], [1.0, 2.0, 1.2], atol=1e-12)
    np.testing.assert_allclose(pose[:3, 0], [0.0, 1.0, 0.0], atol=1e-12)


def test_a_floating_joint_at_the_root_leaves_the_base_to_the_request(tmp_path: Path) -> None:
    free = joint("free", "world", "base", "floating", "")
    text = robot(link("world"), link("base", BOX), link("arm", BOX), free, joint("turn", "base", "arm"))
    assert _load(tmp_path, text).joint_names == ("turn",)
    assert _load(tmp_path, text, root="floating").n == 7


@pytest.mark.parametrize(
    ("limit", "velocity", "note"),
    [
        ('<limit lower="-1" upper="1" effort="1"/>', np.inf, "no velocity limit is given; it counts as unlimited"),
        ('<limit lower="-1" upper="1" effort="1" velocity="0"/>', 1.0, "all velocity limits are 0"),
    ],
)
def test_speeds_that_are_not_stated_are_named(tmp_path: Path, limit: str, velocity: float, note: str) -> None:
    model = _load(tmp_path, two_links(limit))
    assert model.velocity[0] == velocity
    assert note in model.notes[0]


def test_a_joint_with_a_velocity_limit_of_0_is_fixed(tmp_path: Path) -> None:
    still = '<limit lower="0.5" upper="1" effort="1" velocity="0"/>'
    text = robot(link("base"), link("a", BOX), link("b", BOX), joint("ja", "base", "a", inside=still),
                 joint("jb", "base", "b"))  # fmt: skip
    model = _load(tmp_path, text)
    assert model.joint_names == ("jb",)
    assert model.notes == ("joint 'ja' has a velocity limit of 0: fixed at 0.5",)


def test_shapes_without_extent_are_left_out_and_flat_meshes_get_a_thickness(tmp_path: Path) -> None:
    (tmp_path / "flat.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\n")
    text = robot(link("base", '<sphere radius="0"/>'), link("arm", '<mesh filename="flat.obj"/>'),
                 joint("turn", "base", "arm"))  # fmt: skip
    model = _load(tmp_path, text)
    assert [body.link for body in model.bodies] == ["arm"]
    assert 0.0 < np.ptp(model.bodies[0].vertices[:, 2]) < 2e-3


def test_an_inertial_without_mass_counts_as_none(tmp_path: Path) -> None:
    text = two_links().replace('<link name="base">', '<link name="base"><inertial><mass value="1"/></inertial>')
    assert _load(tmp_path, text).notes == ("link 'base': <inertial> lacks <inertia>; the link counts as massless",)


def test_collada_is_read_as_another_reader_does(tmp_path: Path) -> None:
    nodes = (
        "<node><translate>1 2 3</translate><rotate>0 0 1 90</rotate><scale>1 2 3</scale>"
        '<instance_geometry url="#tet"/><node><matrix>1 0 0 5 0 0 -1 0 0 1 0 0 0 0 0 1</matrix>'
        '<instance_geometry url="#tet"/></node></node>'
    )
    path = tmp_path / "m.dae"
    path.write_text(_collada(nodes))
    mesh = read_mesh(path, "link")
    theirs = coal.MeshLoader().load(str(path), np.ones(3))
    expected = np.array(theirs.vertices()).reshape(-1, 3)
    assert len(mesh.faces) == 8
    for point in expected:
        assert np.linalg.norm(mesh.vertices - point, axis=1).min() < 1e-6
    for point in mesh.vertices:
        assert np.linalg.norm(expected - point, axis=1).min() < 1e-6
    path.write_text(_collada(nodes, unit=0.01))
    np.testing.assert_allclose(read_vertices(path, "link"), 0.01 * mesh.vertices)


@pytest.mark.parametrize(
    ("nodes", "library", "message"),
    [
        ('<node><instance_geometry url="#no"/></node>', "", "refers to the geometry 'no', which is not there"),
        ("<node><translate>1 nan 0</translate></node>", "", "not finite"),
        ("<node><rotate>1 0 0</rotate></node>", "", "too short"),
        (
            '<node><instance_node url="#a"/></node>',
            '<library_nodes><node id="a"><instance_node url="#a"/></node></library_nodes>',
            "its nodes hold each other too deeply",
        ),
        (
            '<node><instance_node url="#a0"/></node>',
            _many_nodes(),
            "its nodes hold each other too deeply or too often",
        ),
    ],
)
def test_hostile_collada_is_refused_in_one_line(tmp_path: Path, nodes: str, library: str, message: str) -> None:
    path = tmp_path / "m.dae"
    path.write_text(_collada(nodes, library=library))
    with pytest.raises(RobotError, match=message) as refusal:
        read_vertices(path, "link 'a'")
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("kind", ["glb", "gltf"])
def test_gltf_is_turned_so_that_z_is_up(tmp_path: Path, kind: str) -> None:
    scene = trimesh.Scene()
    for place in ([1.0, 2.0, 3.0], [0.0, 0.0, -1.0]):
        scene.add_geometry(
            trimesh.creation.box((0.2, 0.4, 0.6)), transform=trimesh.transformations.translation_matrix(place)
        )
    path = tmp_path / f"m.{kind}"
    if kind == "glb":
        path.write_bytes(scene.export(file_type="glb"))
    else:
        path.write_bytes(next(iter(trimesh.exchange.gltf.export_gltf(scene, embed_buffers=True).values())))
    mesh = read_mesh(path, "link")
    assert len(mesh.faces) == 24
    # y of the file is up: boxes of 0.2 x 0.6 x 0.4 m at (1, -3, 2) and (0, 1, 0)
    np.testing.assert_allclose(mesh.vertices.min(axis=0), [-0.1, -3.3, -0.2], atol=1e-6)
    np.testing.assert_allclose(mesh.vertices.max(axis=0), [1.1, 1.3, 2.2], atol=1e-6)
    np.testing.assert_array_equal(read_vertices(path, "link"), mesh.vertices)
    urdf = write_urdf(tmp_path, two_links(geometry=f'<mesh filename="m.{kind}"/>'))
    heights = [float(np.ptp(body.vertices[:, 2])) for body in load_robot(urdf=urdf).bodies]
    assert max(heights) == pytest.approx(2.4, abs=1e-6)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"glTF", "without its description"),
        (b"{", "neither binary nor text glTF"),
        (b"[]", "no JSON object"),
        (b'{"buffers": [{"uri": "../../etc/passwd", "byteLength": 4}]}', "is another file; export it as .glb"),
        (b'{"accessors": [{"count": 4000000000}]}', "more than 1000000 vertices"),
        (b'{"nodes": [{"children": [1]}, {"children": [1]}]}', "no tree"),
        (b'{"extensionsRequired": ["KHR_draco_mesh_compression"]}', "needs the extensions KHR_draco"),
        (b'{"asset": {"version": "2.0"}}', "glTF|no mesh"),
    ],
)
def test_hostile_gltf_is_refused_in_one_line(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "m.gltf"
    path.write_bytes(content)
    with pytest.raises(RobotError, match=message) as refusal:
        read_vertices(path, "link 'a'")
    assert "\n" not in str(refusal.value)


def _make_package(folder: Path, name: str) -> None:
    (folder / "meshes").mkdir(parents=True)
    (folder / "package.xml").write_text(f"<package><name>{name}</name></package>")
    (folder / "meshes" / "cube.obj").write_text(CUBE_OBJ)


def test_a_package_is_found_by_the_name_in_its_package_xml(tmp_path: Path) -> None:
    _make_package(tmp_path / "src" / "arm-master", "arm_description")
    text = two_links(geometry='<mesh filename="package://arm_description/meshes/cube.obj"/>')
    (tmp_path / "urdf").mkdir()
    model = load_robot(urdf=write_urdf(tmp_path / "urdf", text), package_dirs=[tmp_path / "src"])
    assert list(model.source.files) == ["arm_description/meshes/cube.obj"]


def test_a_symlinked_package_is_read_inside_the_folders_and_refused_outside(tmp_path: Path) -> None:
    _make_package(tmp_path / "real" / "arm_description", "arm_description")
    (tmp_path / "share").mkdir()
    (tmp_path / "share" / "arm_description").symlink_to(tmp_path / "real" / "arm_description")
    text = two_links(geometry='<mesh filename="package:///arm_description/meshes/cube.obj"/>')
    urdf = write_urdf(tmp_path, text)
    assert load_robot(urdf=urdf, package_dirs=[tmp_path / "share", tmp_path / "real"]).bodies
    with pytest.raises(RobotError, match="lies outside the package folders"):
        load_robot(urdf=urdf, package_dirs=[tmp_path / "share"])


def test_a_robot_from_the_cache_is_the_robot_from_its_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    rng = np.random.default_rng(0)
    lines = "".join(f"v {x} {y} {z}\n" for x, y, z in rng.normal(size=(400, 3)).tolist())
    (tmp_path / "ball.obj").write_text(lines)
    text = two_links(geometry='<mesh filename="ball.obj" scale="0.1 0.1 0.1"/>')
    first, second = _load(tmp_path, text), _load(tmp_path, text)
    (file,) = DerivedCache.of_user().folder.glob("*.npz")
    for body, again in zip(first.bodies, second.bodies, strict=True):
        np.testing.assert_array_equal(body.vertices, again.vertices)
        np.testing.assert_array_equal(body.outer, again.outer)
    assert first.ignored_reasons == second.ignored_reasons
    file.write_bytes(file.read_bytes()[:200])
    np.testing.assert_array_equal(_load(tmp_path, text).bodies[0].outer, first.bodies[0].outer)
    (tmp_path / "ball.obj").write_text(lines + "v 9 0 0\n")
    assert _load(tmp_path, text).bodies[0].vertices[:, 0].max() == pytest.approx(0.9)


def test_a_simplified_mesh_keeps_its_outline_and_its_budget() -> None:
    angle, height = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 200, endpoint=False), np.linspace(0.0, 1.0, 100))
    vertices = np.stack([np.cos(angle), np.sin(angle), height], axis=-1).reshape(-1, 3)
    k, j = (index.ravel() for index in np.meshgrid(np.arange(99), np.arange(200), indexing="ij"))
    a, b = 200 * k + j, 200 * k + (j + 1) % 200
    triangles = np.concatenate([np.stack([a, b, a + 200], axis=1), np.stack([b, b + 200, a + 200], axis=1)])
    simple, faces = simplify_mesh(vertices, triangles, 1000)
    assert 300 < len(faces) <= 1000
    assert np.abs(np.linalg.norm(simple[:, :2], axis=1) - 1.0).max() < 0.05
    assert np.ptp(simple[:, 2]) > 0.9


def test_what_a_robot_looks_like_is_read_and_broken_parts_are_left_out(tmp_path: Path) -> None:
    faces = "".join(f"f {a} {b} {c}\n" for a, b, c in ((1, 2, 3), (2, 4, 3), (5, 6, 7)))
    (tmp_path / "look.obj").write_text(CUBE_OBJ + faces)
    (tmp_path / "broken.obj").write_text(CUBE_OBJ + "f 1 2 99\n")
    visuals = "".join(
        f'<visual><origin xyz="0 0 1"/><geometry><mesh filename="{name}" scale="0.5 0.5 0.5"/></geometry></visual>'
        for name in ("look.obj", "broken.obj", "missing.obj", "../../etc/passwd")
    )
    text = two_links().replace('<link name="arm">', f'<link name="arm">{visuals}<visual/>')
    (look,) = read_robot_visuals(_load(tmp_path, text))
    assert look.link == "arm"
    assert len(look.triangles) == 3
    np.testing.assert_allclose([look.vertices[:, 2].min(), look.vertices[:, 2].max()], [1.0, 1.5])
    solid = two_links(geometry='<mesh filename="look.obj"/>').replace(
        '<link name="arm">', '<link name="arm"><visual><geometry><mesh filename="look.obj"/></geometry></visual>'
    )
    assert read_robot_visuals(_load(tmp_path, solid)) == ()


def test_a_continuous_joint_needs_no_limit(tmp_path: Path) -> None:
    model = _load(tmp_path, two_links(inside="", kind="continuous"))
    assert model.lower[0] == -np.inf
    assert model.upper[0] == np.inf
