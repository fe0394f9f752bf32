"""Closed meshes: read, repaired or refused by name, split into parts that contain them, found in a scan."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from little_scan import little_scan
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from perception import Cloud, make_view, perceive
from perception.errors import MeshError
from perception.perceived import drop_explained
from perception.simulate import Pose, Room, Scanner, box, join_meshes, scan, torus
from perception.solids.cache import PartsCache
from perception.solids.decompose import CoacdResources, CoacdSettings, split_solid
from perception.solids.fit import MeshPose, Region, Surface, fit_pose
from perception.solids.match import KnownMesh, locate, match_mesh
from perception.solids.mesh import Mesh, is_closed, make_solid, unite_solids
from perception.solids.rating import CONFIDENT, MeshMatch
from perception.solids.read import read_mesh
from perception.view import View

RING = torus((0, 0, 0), (0, 0, 1), 0.15, 0.03, 16, 8)
# A tool that no turn takes to itself: a long body, a tall end, a handle to one side.
TOOL = join_meshes([
    box((0, 0, 0), (0.4, 0.1, 0.1)), box((0, 0, 0.1), (0.1, 0.1, 0.3)), box((0.25, 0.1, 0), (0.35, 0.25, 0.06)),
])  # fmt: skip
MIDDLE = np.array([0.2, 0.1, 0.12])


def _text_stl(mesh: Mesh) -> bytes:
    facets = "".join(
        "facet normal 0 0 0\nouter loop\n"
        + "".join(f"vertex {x} {y} {z}\n" for x, y, z in corners)
        + "endloop\nendfacet\n"
        for corners in mesh.vertices[mesh.triangles]
    )
    return f"solid ring\n{facets}endsolid\n".encode()


def _binary_stl(mesh: Mesh) -> bytes:
    facets = np.zeros(len(mesh.triangles), np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("a", "<u2")]))
    facets["corners"] = mesh.vertices[mesh.triangles]
    return b"solid in name only".ljust(80) + np.uint32(len(facets)).tobytes() + facets.tobytes()


def _obj(mesh: Mesh) -> bytes:
    lines = [f"v {x} {y} {z}" for x, y, z in mesh.vertices] + [
        f"f {a + 1}//1 {b + 1}//1 {c + 1}//1" for a, b, c in mesh.triangles
    ]
    return ("mtllib none.mtl\nvn 0 0 1\n" + "\n".join(lines) + "\n").encode()


def _ply(mesh: Mesh) -> bytes:
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(mesh.vertices)}\n"
    head += "property double x\nproperty double y\nproperty double z\n"
    head += f"element face {len(mesh.triangles)}\nproperty list uchar int vertex_indices\nend_header\n"
    faces = np.zeros(len(mesh.triangles), np.dtype([("n", "u1"), ("corners", "<i4", 3)]))
    faces["n"], faces["corners"] = 3, mesh.triangles
    return head.encode() + mesh.vertices.astype("<f8").tobytes() + faces.tobytes()


@pytest.mark.parametrize(
    ("name", "written"), [("a.stl", _text_stl), ("b.STL", _binary_stl), ("c.obj", _obj), ("d.ply", _ply)]
)
def test_every_format_gives_the_same_solid(tmp_path: Path, name: str, written: object) -> None:
    (tmp_path / name).write_bytes(written(RING))  # type: ignore[operator]
    solid = make_solid(read_mesh(tmp_path / name, scale=2.0))
    assert (len(solid.closed), len(solid.open)) == (1, 0)
    assert solid.closed[0].volume == pytest.approx(8.0 * abs(RING.volume), rel=1e-4)


@pytest.mark.parametrize(
    ("name", "content", "problem"),
    [
        ("a.dae", b"<x/>", "a.dae: format '.dae' is not read; expected .stl, .obj, .ply"),
        ("a.obj", b"rubbish\n", "a.obj: has 0 triangles; expected 1 to"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 999999999\n", "a.obj: is no readable OBJ file ("),
        ("a.stl", b"", "a.stl: "),
        ("a.stl", b"\x00" * 80 + b"\xff\xff\xff\x7f" + b"\x00" * 50, "a.stl: "),
        ("a.ply", b"ply\nformat binary_little_endian 1.0\nelement vertex 4000000000\nproperty float x\n"
                  b"property float y\nproperty float z\nend_header\n", "a.ply: is no readable PLY file ("),
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n"
                  b"end_header\n0 0 0\n", "a.ply: "),
    ],
)  # fmt: skip
def test_a_broken_file_is_refused_by_name(tmp_path: Path, name: str, content: bytes, problem: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(MeshError) as caught:
        read_mesh(tmp_path / name)
    assert str(caught.value).startswith(problem)
    assert "\n" not in str(caught.value)


@given(st.binary(max_size=400), st.sampled_from(["stl", "obj", "ply"]))
def test_no_bytes_do_worse_than_a_mesh_error(tmp_path_factory: pytest.TempPathFactory, data: bytes, kind: str) -> None:
    path = tmp_path_factory.mktemp("odd") / f"odd.{kind}"
    path.write_bytes((b"ply\nformat ascii 1.0\n" if kind == "ply" else b"") + data)
    with pytest.raises(MeshError):
        read_mesh(path)


def test_millimetres_are_reported(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_bytes(_obj(Mesh(1000.0 * RING.vertices, RING.triangles)))
    with pytest.raises(MeshError, match=r"spans 360 m; is it in millimetres\? with scale 0.001 it would be 0.36 m"):
        read_mesh(tmp_path / "a.obj")
    assert np.ptp(read_mesh(tmp_path / "a.obj", 0.001).vertices) == pytest.approx(0.36)


def test_a_vertex_that_is_not_a_number_is_refused() -> None:
    vertices = RING.vertices.copy()
    vertices[3] = np.nan
    with pytest.raises(MeshError, match="ring: 1 of 128 vertices are not finite; repair it"):
        make_solid(Mesh(vertices, RING.triangles), "ring")


def test_an_empty_and_a_flat_mesh_are_refused() -> None:
    with pytest.raises(MeshError, match="ring: has no triangles"):
        make_solid(Mesh(RING.vertices, RING.triangles[:0]), "ring")
    with pytest.raises(MeshError, match="ring: lies in a plane"):
        make_solid(Mesh(RING.vertices * [1, 1, 0], RING.triangles), "ring")


def test_a_corner_that_is_not_there_is_refused() -> None:
    with pytest.raises(MeshError, match="a triangle names vertex 500, and there are 128"):
        make_solid(Mesh(RING.vertices, np.vstack([RING.triangles, [[0, 1, 500]]])), "ring")


@pytest.mark.parametrize("turned", [slice(None), slice(None, None, 3)], ids=["all", "a third"])
def test_triangles_wound_inside_out_are_turned_and_noted(turned: slice) -> None:
    right = make_solid(RING).closed[0]
    triangles = right.triangles.copy()
    triangles[turned] = triangles[turned, ::-1]
    solid = make_solid(Mesh(right.vertices, triangles), "ring")
    assert solid.closed[0].volume == pytest.approx(right.volume)
    n = len(triangles[turned])
    assert solid.notes == (f"ring: turned {n} of {len(triangles)} triangles that were wound inside out",)


def test_a_small_hole_is_filled_and_noted() -> None:
    right = make_solid(torus((0, 0, 0), (0, 0, 1), 0.15, 0.03, 32, 12)).closed[0]
    solid = make_solid(Mesh(right.vertices, right.triangles[1:]), "ring")
    assert is_closed(solid.closed[0])
    assert "ring: filled 1 small holes" in solid.notes


def test_a_box_without_a_lid_is_a_shell_that_can_be_reached_into(tmp_path: Path) -> None:
    whole = box((0, 0, 0), (0.4, 0.3, 0.2))
    lid = (np.abs(whole.vertices[whole.triangles][:, :, 2] - 0.2) < 1e-9).all(axis=1)
    solid = make_solid(Mesh(whole.vertices, whole.triangles[~lid]), "bin")
    assert "1 of 1 parts are not closed (4 open edges)" in solid.notes[-1]
    parts = split_solid(
        solid, CoacdSettings(0.04, iterations=10, nodes=3, depth=1), CoacdResources(PartsCache(tmp_path))
    )
    hulls = [ConvexHull(part).equations for part in parts]
    inside = np.array([[0.2, 0.15, 0.1], [0.2, 0.15, 0.19], [0.05, 0.05, 0.1]])
    assert min((inside @ h[:, :3].T + h[:, 3]).max(axis=1).min() for h in hulls) > 0.0
    corners = np.min([(whole.vertices @ h[:, :3].T + h[:, 3]).max(axis=1) for h in hulls], axis=0)
    assert corners.max() < 1e-3


def test_boxes_that_share_an_edge_are_two_solids() -> None:
    pair = join_meshes([box((0, 0, 0), (1, 1, 1)), box((1, 1, 0), (2, 2, 1))])
    solid = make_solid(pair)
    assert [mesh.volume for mesh in solid.closed] == pytest.approx([1.0, 1.0])
    assert not solid.open


def test_parts_contain_the_surface_and_leave_the_hole(tmp_path: Path) -> None:
    parts = split_solid(make_solid(RING), resources=CoacdResources(PartsCache(tmp_path)))
    assert max(len(part) for part in parts) <= 64
    hulls = [ConvexHull(part).equations for part in parts]
    surface = np.concatenate([RING.vertices, RING.vertices[RING.triangles].mean(axis=1)])
    assert np.min([(surface @ h[:, :3].T + h[:, 3]).max(axis=1) for h in hulls], axis=0).max() < 1e-3
    hole = 0.09 * np.array([[0, 0, 0], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
    assert min((hole @ h[:, :3].T + h[:, 3]).max(axis=1).min() for h in hulls) > 0.0


def _seen(thing: Mesh, rotation: np.ndarray, middle: np.ndarray, on_table: bool) -> View:
    table = (((0.9, -0.6, 0.75), (1.7, 0.6, 0.8)),) if on_table else ()
    placed = thing.move(rotation, middle - rotation @ MIDDLE)
    return make_view(scan([*Room(wall_x=2.2, boxes=table).meshes(), placed], Pose(pitch=0.4), Scanner(n_lines=120), 3))


@pytest.fixture(scope="module")
def tool_on_a_table() -> tuple[View, np.ndarray, np.ndarray]:
    rotation, middle = Rotation.from_euler("z", 2.5).as_matrix(), np.array([1.25, 0.1, 0.92])
    return _seen(TOOL, rotation, middle, on_table=True), rotation, middle


def _errors(found: MeshMatch, rotation: np.ndarray, middle: np.ndarray) -> tuple[float, float]:
    pose = found.pose_world_mesh
    angle = Rotation.from_matrix(pose[:3, :3].T @ rotation).magnitude()
    return float(np.linalg.norm(pose[:3, :3] @ MIDDLE + pose[:3, 3] - middle)), float(np.degrees(angle))


def test_a_tool_on_a_table_is_found_from_a_point_near_it(tool_on_a_table: tuple[View, np.ndarray, np.ndarray]) -> None:
    view, rotation, middle = tool_on_a_table
    found = match_mesh(TOOL, view, hint=middle + np.array([0.04, -0.03, 0.02]))
    shift, angle = _errors(found, rotation, middle)
    assert shift <= 0.010
    assert angle <= 2.0
    assert found.confidence >= CONFIDENT
    assert found.residuals["rms"] < 0.012
    on_mesh = view.obstacles[found.explains(view.obstacles)]
    assert np.linalg.norm(on_mesh - middle, axis=1).max() < 0.35


def test_a_tool_in_any_posture_is_found_near_its_expected_pose() -> None:
    rotation, middle = Rotation.from_rotvec([0.7, -0.4, 1.9]).as_matrix(), np.array([1.3, -0.2, 1.1])
    view = _seen(TOOL, rotation, middle, on_table=False)
    initial = np.eye(4)
    initial[:3, :3] = Rotation.from_rotvec([0.15, -0.15, 0.15]).as_matrix() @ rotation
    initial[:3, 3] = middle + np.array([0.05, -0.05, 0.05]) - initial[:3, :3] @ MIDDLE
    found = match_mesh(TOOL, view, initial=initial)
    shift, angle = _errors(found, rotation, middle)
    assert shift <= 0.010
    assert angle <= 2.0
    assert found.confidence >= CONFIDENT


@pytest.mark.parametrize(
    "other",
    [RING, Mesh(TOOL.vertices * [1, -1, 1], TOOL.triangles)],
    ids=["ring", "mirrored"],
)
def test_another_object_gets_a_low_confidence(
    tool_on_a_table: tuple[View, np.ndarray, np.ndarray], other: Mesh
) -> None:
    view, _, middle = tool_on_a_table
    assert match_mesh(other, view, hint=middle).confidence < CONFIDENT


def test_a_tool_on_a_table_is_found_without_a_hint(
    tool_on_a_table: tuple[View, np.ndarray, np.ndarray],
) -> None:
    view, rotation, middle = tool_on_a_table
    found = match_mesh(TOOL, view)
    shift, angle = _errors(found, rotation, middle)
    assert shift <= 0.010
    assert angle <= 2.0
    assert found.confidence >= CONFIDENT


def test_a_wall_is_no_evidence_of_an_object_whose_side_would_lie_in_it() -> None:
    view = make_view(scan(Room(wall_x=2.2).meshes(), Pose(pitch=0.4), Scanner(n_lines=120, sigma=0.003), seed=3))
    flush = np.eye(4)
    flush[:3, :3], flush[:3, 3] = Rotation.from_euler("z", -np.pi / 2).as_matrix(), (2.2, 0.2, 1.0)
    placed = locate(KnownMesh("tool", make_solid(TOOL), flush, is_placed=True), view)
    assert placed.confidence < CONFIDENT


def test_a_placed_mesh_stays_and_the_scan_says_how_well_it_agrees(
    tool_on_a_table: tuple[View, np.ndarray, np.ndarray],
) -> None:
    view, rotation, middle = tool_on_a_table
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, middle - rotation @ MIDDLE
    there = locate(KnownMesh("tool", make_solid(TOOL), pose, is_placed=True), view)
    np.testing.assert_array_equal(there.pose_world_mesh, pose)
    assert there.confidence >= CONFIDENT
    assert "rival" not in there.residuals
    beside = pose.copy()
    beside[1, 3] -= 0.5
    elsewhere = locate(KnownMesh("tool", make_solid(TOOL), beside, is_placed=True), view)
    np.testing.assert_array_equal(elsewhere.pose_world_mesh, beside)
    assert elsewhere.confidence < CONFIDENT
    assert elsewhere.residuals["seen_through"] > 0.5


def test_a_mesh_placed_where_no_point_is_has_no_confidence(
    tool_on_a_table: tuple[View, np.ndarray, np.ndarray],
) -> None:
    pose = np.eye(4)
    pose[:3, 3] = -1.5, -1.5, 1.8
    assert locate(KnownMesh("tool", make_solid(TOOL), pose, is_placed=True), tool_on_a_table[0]).confidence == 0.0


def test_where_nothing_is_nothing_is_found(tool_on_a_table: tuple[View, np.ndarray, np.ndarray]) -> None:
    found = match_mesh(TOOL, tool_on_a_table[0], hint=np.array([-1.5, -1.5, 1.8]))
    assert found.confidence == 0.0
    assert not found.explains(tool_on_a_table[0].obstacles).any()


def test_a_tool_that_is_found_makes_no_pieces_of_its_own(tool_on_a_table: tuple[View, np.ndarray, np.ndarray]) -> None:
    view, rotation, middle = tool_on_a_table
    expected = np.eye(4)
    expected[:3, :3], expected[:3, 3] = rotation, middle + np.array([0.03, -0.02, 0.01]) - rotation @ MIDDLE
    known = KnownMesh("tool", make_solid(TOOL), expected)
    seen, without = perceive(view.cloud, known=[known]), perceive(view.cloud)
    match = seen.matches["tool"]
    assert match.confidence >= CONFIDENT
    on_tool = match.explains(seen.view.obstacles)
    assert on_tool.sum() > 200
    owned = np.zeros(len(on_tool), dtype=bool)
    for piece in seen.pieces:
        owned[piece.points] = True
    assert not (owned & on_tool).any()
    assert owned[~on_tool].mean() > 0.99
    # Its body and its tall end, well over the table.
    inside = middle + (np.array([[0.2, 0.05, 0.05], [0.05, 0.05, 0.2], [0.05, 0.05, 0.28]]) - MIDDLE) @ rotation.T
    for perceived, is_held in ((seen, False), (without, True)):
        hulls = [ConvexHull(piece.shape.vertices).equations for piece in perceived.pieces]
        depth = np.min([(inside @ h[:, :3].T + h[:, 3]).max(axis=1) for h in hulls], axis=0)
        assert (depth <= 0.0).any() == is_held


def test_a_mesh_found_with_little_confidence_takes_no_points() -> None:
    points, kept = np.array([[0.15, 0, 0], [0, 0, 0], [0.185, 0, 0]]), np.array([0, 2])
    for confidence, left in ((CONFIDENT - 0.01, [0, 2]), (CONFIDENT, [])):
        match = MeshMatch(np.eye(4), confidence, {}, make_solid(RING), 0.01)
        np.testing.assert_array_equal(drop_explained(points, kept, {"ring": match}), left)


def test_noise_about_a_mesh_is_explained_unless_something_is_near_to_it() -> None:
    match = MeshMatch(np.eye(4), 1.0, {}, make_solid(RING), 0.012)
    fringe, beside_it = [0.198, 0, 0], [0.22, 0, 0]
    for others, left in (([], []), ([beside_it], [0, 1])):
        points = np.array([fringe, *others])
        np.testing.assert_array_equal(drop_explained(points, np.arange(len(points)), {"ring": match}), left)


def test_points_inside_a_closed_mesh_are_explained_and_those_in_a_ring_s_hole_are_not() -> None:
    match = MeshMatch(np.eye(4), 1.0, {}, make_solid(RING), 0.01)
    inside, hole, near, far = [0.15, 0, 0], [0, 0, 0], [0.185, 0, 0], [0.2, 0, 0]
    np.testing.assert_array_equal(match.explains(np.array([inside, hole, near, far])), [True, False, True, False])


def test_bodies_that_overlap_have_their_inside_in_common() -> None:
    pair = unite_solids([make_solid(box((0, 0, 0), (2, 1, 1))), make_solid(box((1, 0, 0), (3, 1, 1)))])
    points = np.array([[0.5, 0.5, 0.5], [1.5, 0.5, 0.5], [2.5, 0.5, 0.5], [3.5, 0.5, 0.5]])
    explained = MeshMatch(np.eye(4), 1.0, {}, pair, 0.01).explains(points)
    np.testing.assert_array_equal(explained, [True, True, True, False])


def test_points_all_nearest_to_one_corner_leave_the_mesh_turned_as_it_is() -> None:
    corner = -np.abs(np.random.default_rng(0).normal(0.0, 0.004, (200, 3))) - 5e-4
    surface = Surface(make_solid(box((0, 0, 0), (0.3, 0.5, 0.6))).closed[0])
    start = MeshPose(np.eye(3), np.zeros(3))
    found = fit_pose(surface, Region(corner, np.full((200, 3), -1.0)), start, [0.1])
    np.testing.assert_allclose(found.rotation, np.eye(3), atol=1e-12)
    assert np.isfinite(found.shift).all()


@pytest.mark.parametrize("unit_m", [0.01, 0.001])
def test_a_scan_much_smaller_than_a_mesh_that_it_is_to_show_is_refused(unit_m: float) -> None:
    cloud = little_scan()
    tiny = Cloud(unit_m * cloud.points, unit_m * np.asarray(cloud.origin))
    crate = KnownMesh("crate", make_solid(box((0, 0, 0), (0.3, 0.5, 0.6))))
    with pytest.raises(MeshError, match=r"spans only 0\.\d+ m, and crate, which it is to show, 0.6 m; is its unit"):
        perceive(tiny, known=[crate])
    placed = KnownMesh("crate", crate.solid, np.eye(4), is_placed=True)
    assert "crate" in perceive(tiny, known=[placed]).matches
