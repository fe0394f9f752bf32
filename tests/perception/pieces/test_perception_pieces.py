"""Convex pieces: they cover what is there, leave what was seen free, stay small, and come out the same again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from half_spaces import half_spaces
from scipy.spatial import ConvexHull

from costs.scene import ConvexPiece
from perception import Cloud, CloudError, Perceived, perceive, read_cloud
from perception.convex.freespace import carve
from perception.convex.hulls import MAX_VERTICES, limit_vertices
from perception.simulate import Mesh, Pose, Room, Scanner, Valve, box, cast, cylinder, join_meshes, scan

SENSOR = Pose((0.1, 0.0, 1.6), pitch=0.3)
ROOM = Room(
    wall_x=1.2,
    pipes=((1.0, 0.6, 0.05),),
    boxes=(((0.6, -1.0, 0.0), (0.9, -0.6, 0.5)), ((0.9, -0.2, 0.7), (1.2, 0.3, 0.75))),
)


def inside(points: np.ndarray, pieces: tuple[ConvexPiece, ...], margin: float = 0.0) -> np.ndarray:
    """Which points lie within ``margin`` of a piece's face planes."""
    mask = np.zeros(len(points), dtype=bool)
    for piece in pieces:
        faces = half_spaces(piece.vertices)
        mask |= (points @ faces[:, :3].T + faces[:, 3] <= margin).all(axis=1)
    return mask


def true_surface(meshes: list[Mesh], cloud: Cloud) -> np.ndarray:
    """Where the true surfaces stop the measured rays, floor and mixed pixels left out."""
    length = np.linalg.norm(cloud.points - cloud.origin, axis=1)
    direction = (cloud.points - cloud.origin) / length[:, None]
    hit = cast(join_meshes(meshes), cloud.origin, direction)
    points = cloud.origin + hit[:, None] * direction
    keep = (np.abs(hit - length) < 0.05) & (points[:, 2] > 0.03) & (np.hypot(points[:, 0], points[:, 1]) < 2.9)
    return points[keep]


def free_samples(cloud: Cloud, rng: np.random.Generator) -> np.ndarray:
    """Places along the rays up to 10 cm before their ends, 5 cm and more over the floor."""
    rays = cloud.points - cloud.origin
    length = np.linalg.norm(rays, axis=1, keepdims=True)
    samples = cloud.origin + rng.uniform(0.1, 1.0, (len(rays), 4))[:, :, None] * (rays * (1 - 0.1 / length))[:, None]
    samples = samples.reshape(-1, 3)
    return samples[(samples[:, 2] > 0.05) & (np.hypot(samples[:, 0], samples[:, 1]) < 2.9)]


@pytest.fixture(scope="module")
def room() -> tuple[Cloud, Perceived]:
    cloud = scan(ROOM.meshes(), SENSOR, Scanner(n_lines=60), seed=4)
    return cloud, perceive(cloud)


def test_pieces_cover_the_true_surfaces(room: tuple[Cloud, Perceived]) -> None:
    cloud, perceived = room
    assert inside(true_surface(ROOM.meshes(), cloud), perceived.scene.pieces, 0.01).mean() > 0.995


def test_pieces_leave_what_another_scan_sees_free(room: tuple[Cloud, Perceived]) -> None:
    _, perceived = room
    other = scan(ROOM.meshes(), Pose((0.05, 0.08, 1.65), pitch=0.25, roll=0.02), Scanner(n_lines=30), seed=9)
    samples = free_samples(other, np.random.default_rng(0))
    assert len(samples) > 20_000
    assert inside(samples, perceived.scene.pieces).mean() < 0.001


def test_pieces_are_few_small_convex_and_named_by_kind(room: tuple[Cloud, Perceived]) -> None:
    pieces = room[1].scene.pieces
    assert 4 <= len(pieces) <= 60
    for piece in pieces:
        assert len(piece.vertices) <= MAX_VERTICES
        assert len(ConvexHull(piece.vertices).vertices) == len(piece.vertices)
        assert piece.name.split("/")[0] == piece.kind
    assert {piece.kind for piece in pieces} >= {"floor", "plane"}


def test_the_same_seed_gives_the_same_pieces(room: tuple[Cloud, Perceived]) -> None:
    cloud, perceived = room
    again = perceive(cloud)
    assert [piece.name for piece in again.scene.pieces] == [piece.name for piece in perceived.scene.pieces]
    for one, other in zip(again.scene.pieces, perceived.scene.pieces, strict=True):
        np.testing.assert_array_equal(one.vertices, other.vertices)


def test_a_window_in_a_wall_stays_open() -> None:
    frame = [
        box((1.0, -1.5, 0.0), (1.1, -0.3, 2.0)), box((1.0, 0.3, 0.0), (1.1, 1.5, 2.0)),
        box((1.0, -0.3, 0.0), (1.1, 0.3, 0.9)), box((1.0, -0.3, 1.4), (1.1, 0.3, 2.0)),
    ]  # fmt: skip
    meshes = [*frame, box((2.0, -2.0, 0.0), (2.1, 2.0, 2.5)), box((-3, -3, -0.1), (3, 3, 0))]
    cloud = scan(meshes, SENSOR, Scanner(n_lines=60), seed=2)
    pieces = perceive(cloud).scene.pieces
    grid = np.array([[1.0, y, z] for y in np.linspace(-0.22, 0.22, 12) for z in np.linspace(1.0, 1.3, 9)])
    assert not inside(grid, pieces).any()
    assert inside(true_surface(meshes, cloud), pieces, 0.01).mean() > 0.99


def test_thin_bars_do_not_fill_the_space_between_them() -> None:
    bars = [cylinder((0.8, -0.4, 0.6), (0.8, 0.4, 0.6), 0.02), cylinder((0.8, 0.0, 0.6), (0.9, 0.3, 1.4), 0.02)]
    bars.append(cylinder((0.8, 0.4, 0.6), (1.1, -0.2, 1.3), 0.02))
    meshes = [*Room(wall_x=2.0).meshes(), *bars]
    cloud = scan(meshes, SENSOR, Scanner(n_lines=60), seed=6)
    perceived = perceive(cloud)
    other = scan(meshes, Pose((0.05, 0.1, 1.5), pitch=0.3), Scanner(n_lines=30), seed=8)
    assert inside(free_samples(other, np.random.default_rng(1)), perceived.scene.pieces).mean() < 0.001
    assert inside(true_surface(meshes, cloud), perceived.scene.pieces, 0.01).mean() > 0.99


def test_rays_carve_what_they_pass_and_nothing_else() -> None:
    ends = np.array([[1.0, 0.0, 0.0], [0.0, 2.0, 0.0]])
    free = carve(np.zeros(3), ends, ends, np.full(3, -0.5), np.full(3, 2.5))
    cells = free.list_cells(np.full(3, -0.5), np.full(3, 2.5))
    along_x = cells[np.abs(cells[:, 1:]).max(axis=1) < 0.03]
    assert along_x[:, 0].max() < 0.96
    assert along_x[:, 0].max() > 0.9
    assert (np.minimum(np.abs(cells[:, 0]), np.abs(cells[:, 1])) < 0.03).all()
    assert np.abs(cells[:, 2]).max() < 0.03


def test_a_hull_of_many_vertices_is_replaced_by_one_that_contains_it() -> None:
    rng = np.random.default_rng(1)
    for scale in ([1, 1, 1], [1, 0.2, 0.02]):
        points = rng.normal(size=(3000, 3))
        points = points / np.linalg.norm(points, axis=1, keepdims=True) * scale
        coarse = limit_vertices(points)
        assert len(coarse) <= MAX_VERTICES
        faces = half_spaces(coarse)
        assert (points @ faces[:, :3].T + faces[:, 3]).max() < 1e-6
        assert ConvexHull(coarse).volume < 1.6 * ConvexHull(points).volume


def test_a_hand_can_reach_around_a_wheel() -> None:
    valve = Valve((0.7, 0.1, 1.1))
    cloud = scan(Room(wall_x=0.9).meshes() + valve.meshes(), SENSOR, Scanner(n_lines=60), seed=3)
    perceived = perceive(cloud, kinds=("wheel",))
    angle = np.linspace(0, 2 * np.pi, 40)
    for radius in (0.05, 0.09, 0.16, 0.2):
        for x in (0.62, 0.66, 0.7, 0.76, 0.8):
            ring = np.column_stack([np.full(40, x), 0.1 + radius * np.cos(angle), 1.1 + radius * np.sin(angle)])
            assert not inside(ring, perceived.scene.pieces).any(), (radius, x)
    stem = next(piece for piece in perceived.scene.pieces if piece.kind == "stem")
    assert inside(np.array([[0.75, 0.1, 1.1], [0.85, 0.1, 1.1]]), (stem,)).all()


def test_a_cloud_out_of_reach_is_refused() -> None:
    with pytest.raises(CloudError, match="none of 50 points lie within"):
        perceive(Cloud(np.full((50, 3), 100.0), np.zeros(3)))


def test_few_points_make_no_trouble() -> None:
    rng = np.random.default_rng(0)
    for n in (1, 2, 3, 7, 30):
        perceived = perceive(Cloud(rng.uniform(0.5, 0.6, (n, 3)), np.zeros(3)), kinds=("wheel",))
        assert perceived.floor is None
        assert perceived.detections == ()


@pytest.mark.parametrize(("scene", "cover", "most"), [("valve_a", 0.995, 40), ("door_a", 0.995, 60)])
def test_shared_scenes_are_covered_by_few_pieces(shared_data: Path, scene: str, cover: float, most: int) -> None:
    cloud = read_cloud(shared_data / "scenes" / scene / "scan0.pcd")
    perceived = perceive(cloud)
    assert len(perceived.scene.pieces) <= most
    near = perceived.shown[perceived.shown[:, 2] > 0.03]
    assert inside(near, perceived.scene.pieces, 0.02).mean() > cover - 0.01
