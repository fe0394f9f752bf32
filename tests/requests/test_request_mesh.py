"""Mesh obstacles: convex ones whole, others split into parts that contain them, broken ones refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from perception.solids import mesh as mesh_module
from service.errors import RequestError
from service.planner import plan
from service.request.file import load_request, parse_request
from service.result.result import Verdict
from service.scan.meshes import read_solid, split_convex

CUBE = [
    (0, 2, 1), (1, 2, 3), (4, 5, 6), (5, 7, 6), (0, 1, 4), (1, 5, 4),
    (2, 6, 3), (3, 6, 7), (0, 4, 2), (2, 4, 6), (1, 3, 5), (3, 7, 5),
]  # fmt: skip


def _cube(low: tuple[float, ...], high: tuple[float, ...]) -> list[tuple[float, ...]]:
    return [
        tuple(high[k] if (corner >> k) & 1 else low[k] for k in range(3))
        for corner in range(8)
    ]  # fmt: skip


def _obj(path: Path, cubes: list[list[tuple[float, ...]]]) -> Path:
    lines = [f"v {x} {y} {z}" for cube in cubes for x, y, z in cube]
    lines += [
        f"f {a + 1 + 8 * k} {b + 1 + 8 * k} {c + 1 + 8 * k}" for k in range(len(cubes)) for a, b, c in CUBE
    ]  # fmt: skip
    path.write_text("\n".join(lines) + "\n")
    return path


def _parts(path: Path) -> list[np.ndarray]:
    return split_convex(read_solid(path, "file"), path.name, "file")


def test_a_convex_mesh_is_one_part(tmp_path: Path) -> None:
    (part,) = _parts(_obj(tmp_path / "cube.obj", [_cube((0, 0, 0), (1, 2, 3))]))
    np.testing.assert_allclose(part.min(axis=0), [0, 0, 0])
    np.testing.assert_allclose(part.max(axis=0), [1, 2, 3])
    assert len(part) == 8


FACTOR = st.floats(0.1, 3.0) | st.floats(-3.0, -0.1)


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.tuples(FACTOR, FACTOR, FACTOR), st.booleans())
def test_factors_of_either_sign_stretch_and_mirror_a_mesh_and_leave_its_outside_outside(
    tmp_path: Path, factors: tuple[float, float, float], in_urdf: bool
) -> None:
    low, high = np.array([0.1, -0.2, 0.3]), np.array([0.4, 0.5, 0.9])
    path = _obj(tmp_path / "cube.obj", [_cube(tuple(low), tuple(high))])
    if in_urdf:
        path = tmp_path / "cube.urdf"
        shape = '<collision><geometry><mesh filename="cube.obj"/></geometry></collision>'
        path.write_text(f'<robot name="cube"><link name="cube">{shape}</link></robot>')
    solid = read_solid(path, "file", 2.0, factors)
    (part,) = solid.closed
    corners = 2.0 * np.array([low, high]) * factors
    np.testing.assert_allclose(part.vertices.min(axis=0), corners.min(axis=0), atol=1e-9)
    np.testing.assert_allclose(part.vertices.max(axis=0), corners.max(axis=0), atol=1e-9)
    assert part.volume == pytest.approx(np.prod(np.ptp(corners, axis=0)))
    assert not solid.notes  # nothing had to be turned


@pytest.mark.parametrize(
    ("given_scale", "words"),
    [
        ({"scale": -1}, r"scale: expected more than 0; scale_xyz: \[1, -1, 1\] mirrors the mesh"),
        ({"scale_xyz": [1, 0, 1]}, r"scale_xyz\[1\]: expected a factor of 0.001 to 1000, or its negative"),
    ],
)
def test_a_scale_that_leaves_no_mesh_is_refused_in_a_sentence(given_scale: dict[str, object], words: str) -> None:
    mesh = {"name": "mug", "type": "mesh", "file": "mug.stl", **given_scale}
    with pytest.raises(RequestError, match=words):
        parse_request({"robot": {"name": "atlas"}, "scene": {"obstacles": [mesh]}, "goal": {"joints": {}}})


def test_separate_solids_are_parts_of_their_own(tmp_path: Path) -> None:
    top, leg = ((0, 0, 0.7), (1, 0.6, 0.75)), ((0.01, 0.01, 0), (0.06, 0.59, 0.7))
    parts = _parts(_obj(tmp_path / "table.obj", [_cube(*top), _cube(*leg)]))
    assert len(parts) == 2
    rng = np.random.default_rng(0)
    inside = np.vstack([rng.uniform(*box, size=(200, 3)) for box in (top, leg)])
    hulls = [ConvexHull(part).equations for part in parts]
    depth = np.min([np.max(inside @ h[:, :3].T + h[:, 3], axis=1) for h in hulls], axis=0)
    assert depth.max() < 1e-6
    knee = np.array([0.6, 0.3, 0.4])
    assert min(np.max(h[:, :3] @ knee + h[:, 3]) for h in hulls) > 0.2


def test_a_hollow_solid_is_split_into_parts_that_contain_its_surface(tmp_path: Path) -> None:
    # An L of two square bars, as one closed surface: the outline's corners, extruded from y = 0 to y = 0.1.
    outline = [(0, 0), (0.5, 0), (0.5, 0.1), (0.1, 0.1), (0.1, 0.5), (0, 0.5)]
    corners = [(x, y, z) for y in (0.0, 0.1) for x, z in outline]
    caps = [(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)]
    faces = caps + [(c + 6, b + 6, a + 6) for a, b, c in caps]
    for k in range(6):
        n = (k + 1) % 6
        faces += [(k, k + 6, n), (n, k + 6, n + 6)]
    path = tmp_path / "angle.obj"
    path.write_text(
        "".join(f"v {x} {y} {z}\n" for x, y, z in corners)
        + "".join(f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in faces)
    )
    parts = _parts(path)
    assert len(parts) >= 2
    hulls = [ConvexHull(part).equations for part in parts]
    depth = np.min([np.max(np.array(corners) @ h[:, :3].T + h[:, 3], axis=1) for h in hulls], axis=0)
    assert depth.max() < 0.01
    gap = np.array([0.3, 0.05, 0.3])
    assert min(np.max(h[:, :3] @ gap + h[:, 3]) for h in hulls) > 0.1


@pytest.mark.parametrize(
    ("name", "content", "problem"),
    [
        (
            "a.fbx",
            b"<x/>",
            "file: a.fbx: format '.fbx' is not read; expected .stl, .obj, .ply, .dae, .glb, .gltf, .urdf",
        ),
        ("a.dae", b"<x/>", "file: a.dae: mesh 'a.dae'"),
        ("a.glb", b"glTF", "file: a.glb: mesh 'a.glb'"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "file: a.obj: lies in a plane or on a line; expected"),
        ("a.obj", b"rubbish\n", "file: a.obj: has 0 triangles"),
        ("a.stl", b"\x00" * 80 + b"\xff\xff\xff\x7f" + b"\x00" * 50, "file: a.stl: "),
        (
            "a.ply",
            b"ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
            b"element face 4\nproperty list uchar int vertex_indices\nend_header\n"
            b"nan 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 1 2\n3 0 1 3\n3 0 2 3\n3 1 2 3\n",
            "file: a.ply: 1 of 4 vertices are not finite",
        ),
    ],
)
def test_a_broken_mesh_is_refused_by_name(tmp_path: Path, name: str, content: bytes, problem: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(RequestError) as caught:
        read_solid(tmp_path / name, "file")
    assert str(caught.value).startswith(problem)


def test_the_example_reaches_through_a_window_frame() -> None:
    result = plan(load_request(Path(__file__).parents[2] / "examples" / "requests" / "mesh.yaml"))
    assert result.verdict is Verdict.CERTIFIED
    frame = [piece for piece in result.scene.pieces if piece.name.startswith("frame/")]
    assert len(frame) >= 4
    assert max(piece.vertices[:, 0].max() for piece in frame) < 0.70  # where the hand ends, beyond the frame


def test_a_missing_mesh_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RequestError, match="is not there; paths start at the request's folder"):
        read_solid(tmp_path / "none.stl", "file")


def _urdf(folder: Path, body: str) -> Path:
    path = folder / "thing.urdf"
    path.write_text(f'<robot name="thing">{body}</robot>')
    return path


def _collision(geometry: str, xyz: str = "0 0 0") -> str:
    return f'<collision><origin xyz="{xyz}"/><geometry>{geometry}</geometry></collision>'


CART = (
    '<link name="deck">' + _collision('<mesh filename="deck.obj" scale="0.001 0.001 0.001"/>') + "</link>"
    '<link name="wheel">' + _collision('<cylinder radius="0.1" length="0.04"/>') + "</link>"
    '<joint name="axle" type="continuous"><parent link="deck"/><child link="wheel"/>'
    '<origin xyz="0.4 0 -0.1" rpy="1.5707963267948966 0 0"/><axis xyz="0 0 1"/></joint>'
)


def test_a_urdf_is_one_object_of_its_bodies_at_zero(tmp_path: Path) -> None:
    _obj(tmp_path / "deck.obj", [_cube((0, 0, 0), (800, 500, 20))])
    solid = read_solid(_urdf(tmp_path, CART), "file")
    assert not solid.open
    assert solid.notes == ()
    deck, wheel = split_convex(solid, "cart", "file")
    np.testing.assert_allclose([deck.min(axis=0), deck.max(axis=0)], [[0, 0, 0], [0.8, 0.5, 0.02]], atol=1e-12)
    np.testing.assert_allclose([wheel[:, 1].min(), wheel[:, 1].max()], [-0.02, 0.02], atol=1e-12)
    assert (wheel[:, [0, 2]].max(axis=0) >= [0.5, 0.0]).all()
    (hull,) = split_convex(solid, "cart", "file", decompose=False)
    np.testing.assert_allclose(hull.max(axis=0), [0.8, 0.5, 0.02], atol=1e-12)
    assert hull[:, 2].min() <= -0.2


def test_scale_is_metres_per_unit_of_all_of_a_urdf(tmp_path: Path) -> None:
    _obj(tmp_path / "deck.obj", [_cube((0, 0, 0), (800, 500, 20))])
    whole = [read_solid(_urdf(tmp_path, CART), "file", scale) for scale in (1.0, 0.5)]
    full, half = (np.concatenate([mesh.vertices for mesh in solid.closed]) for solid in whole)
    np.testing.assert_allclose(half, 0.5 * full, atol=1e-12)


@pytest.mark.parametrize(
    ("body", "problem"),
    [
        ('<link name="a"/>', "file: thing.urdf: no link has a <collision>"),
        ("<!DOCTYPE a>", "file: thing.urdf: "),
        (
            '<link name="a">' + _collision('<mesh filename="line.obj"/>') + "</link>",
            "file: thing.urdf: link 'a': lies in a plane or on a line; expected a solid",
        ),
        (
            '<link name="a">' + _collision('<mesh filename="thing.urdf"/>') + "</link>",
            "file: thing.urdf: format '.urdf' is not read; expected .stl, .obj, .ply",
        ),
        (
            '<link name="a">' + _collision('<mesh filename="../deck.obj"/>') + "</link>",
            "file: thing.urdf: link 'a': mesh '../deck.obj'",
        ),
    ],
)
def test_a_urdf_that_cannot_be_used_is_refused_by_name(tmp_path: Path, body: str, problem: str) -> None:
    _obj(tmp_path / "line.obj", [_cube((0, 0, 0), (1, 0, 0))])
    with pytest.raises(RequestError) as caught:
        read_solid(_urdf(tmp_path, body), "file")
    assert str(caught.value).startswith(problem)
    assert "\n" not in str(caught.value)


def test_many_large_meshes_in_one_urdf_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _obj(tmp_path / "cube.obj", [_cube((0, 0, 0), (1, 1, 1))])
    monkeypatch.setattr(mesh_module, "MAX_TRIANGLES", 30)
    cube = _collision('<mesh filename="cube.obj"/>')
    assert len(read_solid(_urdf(tmp_path, f'<link name="a">{2 * cube}</link>'), "file").closed) == 2
    with pytest.raises(RequestError, match=r"file: thing.urdf: has more than 30 triangles; simplify its meshes"):
        read_solid(_urdf(tmp_path, f'<link name="a">{3 * cube}</link>'), "file")


def test_a_flat_mesh_is_a_wall_with_its_hole_open(tmp_path: Path) -> None:
    """A wall of 3 x 3 m with a window of 1 x 1 m, of eight triangles in the plane y = 2."""
    corners = [(0, 0), (3, 0), (3, 3), (0, 3), (1, 1), (2, 1), (2, 2), (1, 2)]
    faces = [(0, 1, 5), (0, 5, 4), (1, 2, 6), (1, 6, 5), (2, 3, 7), (2, 7, 6), (3, 0, 4), (3, 4, 7)]
    path = tmp_path / "window.obj"
    path.write_text(
        "".join(f"v {x} 2 {z}\n" for x, z in corners) + "".join(f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in faces)
    )
    hulls = [ConvexHull(part).equations for part in _parts(path)]
    inside = lambda point: min(np.max(h[:, :3] @ point + h[:, 3]) for h in hulls)  # noqa: E731
    assert inside(np.array([0.5, 2.0, 0.5])) < 0.0
    assert inside(np.array([1.5, 2.0, 1.5])) > 0.4


@pytest.mark.parametrize("suffix", [".dae", ".glb"])
def test_obstacles_may_be_scenes_of_parts_as_robots_may(tmp_path: Path, suffix: str) -> None:
    import trimesh

    cube = trimesh.creation.box((0.2, 0.4, 0.6))
    content = cube.export(file_type=suffix[1:]) if suffix == ".glb" else COLLADA_CUBE
    (tmp_path / f"cube{suffix}").write_bytes(content if isinstance(content, bytes) else content.encode())
    (part,) = _parts(tmp_path / f"cube{suffix}")
    np.testing.assert_allclose(sorted(np.ptp(part, axis=0)), [0.2, 0.4, 0.6], atol=1e-6)


COLLADA_CUBE = """<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit name="centimeter" meter="0.01"/><up_axis>Z_UP</up_axis></asset>
<library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="pa" count="24">0 0 0 20 0 0 20 40 0 0 40 0 0 0 60 20 0 60 20 40 60 0 40 60</float_array>
<technique_common><accessor source="#pa" count="8" stride="3"/></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="12"><input semantic="VERTEX" source="#v" offset="0"/>
<p>0 2 1 0 3 2 4 5 6 4 6 7 0 1 5 0 5 4 1 2 6 1 6 5 2 3 7 2 7 6 3 0 4 3 4 7</p></triangles></mesh></geometry>
</library_geometries>
<library_visual_scenes><visual_scene id="s"><node><instance_geometry url="#g"/></node></visual_scene>
</library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>"""
