"""All rays are evidence: each from where it started, and those that met nothing as well."""

from __future__ import annotations

import numpy as np
import pytest
from half_spaces import half_spaces
from hypothesis import given, settings
from hypothesis import strategies as st

from costs.scene import ConvexPiece
from perception import Cloud, perceive
from perception.convex.coarse import coarsen
from perception.convex.freespace import FreeSpace, carve
from perception.convex.planes import Plane, find_planes
from perception.convex.slabs import make_slabs
from perception.simulate import Mesh, box, cast, join_meshes

LOWER, UPPER = np.full(3, -0.2), np.full(3, 1.2)
NOWHERE = np.full((1, 3), 9.0)
FRAME = [
    box((1.0, -1.5, 0.0), (1.1, -0.3, 2.0)), box((1.0, 0.3, 0.0), (1.1, 1.5, 2.0)),
    box((1.0, -0.3, 0.0), (1.1, 0.3, 0.9)), box((1.0, -0.3, 1.4), (1.1, 0.3, 2.0)),
    box((-3.0, -3.0, -0.1), (3.0, 3.0, 0.0)),
]  # fmt: skip
WINDOW = np.array([[1.0, y, z] for y in np.linspace(-0.22, 0.22, 12) for z in np.linspace(1.0, 1.3, 9)])


def scanned(meshes: list[Mesh], origin: tuple[float, float, float], n: int = 150, seed: int = 0) -> Cloud:
    """A scan in directions that are even in azimuth and elevation, with its rays that met nothing, 1 cm of noise."""
    azimuth = np.linspace(-np.pi, np.pi, 2 * n, endpoint=False)
    elevation = np.linspace(-1.3, 1.3, n)
    azimuth, elevation = (grid.ravel() for grid in np.meshgrid(azimuth, elevation))
    direction = np.column_stack([
        np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)
    ])  # fmt: skip
    start = np.array(origin)
    distance = cast(join_meshes(meshes), start, direction)
    hit = np.isfinite(distance)
    noisy = distance[hit] + np.random.default_rng(seed).normal(0.0, 0.01, int(hit.sum()))
    return Cloud(start + noisy[:, None] * direction[hit], start, misses=start + 8.0 * direction[~hit])


def merged(one: Cloud, other: Cloud) -> Cloud:
    """Two scans as one cloud with an origin for each point."""
    return Cloud(
        np.concatenate([one.points, other.points]),
        np.concatenate([one.starts, other.starts]),
        misses=np.concatenate([one.misses, other.misses]),
        miss_origin=np.concatenate([np.broadcast_to(c.origin, c.misses.shape) for c in (one, other)]),
    )


def inside(points: np.ndarray, pieces: tuple[ConvexPiece, ...]) -> np.ndarray:
    mask = np.zeros(len(points), dtype=bool)
    for piece in pieces:
        faces = half_spaces(piece.vertices)
        mask |= (points @ faces[:, :3].T + faces[:, 3] <= 0.0).all(axis=1)
    return mask


def test_rays_of_two_sensors_carve_what_each_would_carve() -> None:
    rng = np.random.default_rng(0)
    one, other = np.array([0.1, 0.0, 0.9]), np.array([1.1, 1.0, 0.2])
    ends = rng.uniform(-0.2, 1.2, (200, 3))
    each = [carve(start, ends[k::2], NOWHERE, LOWER, UPPER).free for k, start in enumerate((one, other))]
    starts = np.where(np.arange(200)[:, None] % 2 == 0, one, other)
    both = carve(starts, ends, NOWHERE, LOWER, UPPER).free
    np.testing.assert_array_equal(both, each[0] | each[1])


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.booleans())
def test_every_cell_that_is_carved_has_a_ray_through_it_or_beside_it(seed: int, same_start: bool) -> None:
    rng = np.random.default_rng(seed)
    starts = rng.uniform(-1.0, 2.0, (1, 3) if same_start else (40, 3))
    starts = np.broadcast_to(starts, (40, 3))
    ends = rng.uniform(-1.0, 2.0, (40, 3))
    free = carve(starts, ends, NOWHERE, LOWER, UPPER, size=0.05)
    cells = free.list_cells(LOWER, UPPER)
    rays = ends - starts
    t = ((cells[:, None] - starts) * rays).sum(axis=2) / (rays**2).sum(axis=1)
    closest = starts + np.clip(t, 0.0, 1.0)[:, :, None] * rays
    distance = np.linalg.norm(cells[:, None] - closest, axis=2)
    if len(cells):
        assert (distance.min(axis=1) <= 0.05 * np.sqrt(3) / 2 + 1e-3).all()


def test_many_rays_side_by_side_leave_no_gap_in_what_they_carve() -> None:
    origin = np.array([0.5, 0.5, 2.0])
    grid = np.linspace(0.0, 1.0, 400)
    ends = np.column_stack([*(axis.ravel() for axis in np.meshgrid(grid, grid)), np.full(160_000, -0.3)])
    free = carve(origin, ends, NOWHERE, LOWER, UPPER)
    # Between sensor and square: the pyramid of the rays.
    z = free.list_cells(LOWER, UPPER)[:, 2]
    for height in (0.1, 0.6, 1.1):
        layer = np.abs(z - height) < 0.011
        width = (2.0 - height) / 2.3
        assert layer.sum() >= 0.97 * (width / free.size) ** 2


def test_a_ray_that_met_nothing_opens_a_window_before_the_sky() -> None:
    cloud = scanned(FRAME, (0.0, 0.0, 1.15))
    assert not inside(WINDOW, perceive(cloud).scene.pieces).any()
    # Without those rays the hull of what is beside the window would do.
    blind = Cloud(cloud.points, cloud.origin)
    assert inside(WINDOW, perceive(blind).scene.pieces).any()


def test_a_sensor_behind_a_wall_opens_the_window_that_the_one_before_it_cannot_look_through() -> None:
    world = [*FRAME, box((0.5, -0.5, 0.0), (0.52, 0.5, 1.8))]
    both = merged(scanned(world, (0.0, 0.0, 1.15), seed=1), scanned(world, (2.2, 0.0, 1.15), seed=2))
    assert not inside(WINDOW, perceive(both).scene.pieces).any()


def test_rays_through_an_opening_cut_a_slab_whichever_side_they_come_from() -> None:
    grid = np.arange(-1.0, 1.0, 0.015)
    y, z = (axis.ravel() for axis in np.meshgrid(grid, grid))
    frame = np.maximum(np.abs(y), np.abs(z)) > 0.3
    points = np.column_stack([np.full(frame.sum(), 1.0), y[frame], z[frame]])
    plane = Plane(np.array([-1.0, 0.0, 0.0]), -1.0, np.arange(len(points)), np.arange(0))
    holes = np.column_stack([np.full((~frame).sum(), 1.0), 0.9 * y[~frame], 0.9 * z[~frame]])
    nothing = FreeSpace(np.full(3, -2.0), 0.02, np.zeros((1, 1, 1), dtype=bool))
    before, behind = np.array([0.0, 0.0, 0.1]), np.array([2.0, 0.1, 0.0])
    assert len(make_slabs(plane, points, before, points, nothing)) == 1
    for origin in (before, behind):
        ends = origin + 2.0 * (holes - origin)
        assert len(make_slabs(plane, points, origin, ends, nothing)) >= 4
    starts = np.concatenate([np.broadcast_to(before, points.shape), np.broadcast_to(behind, ends.shape)])
    assert len(make_slabs(plane, points, starts, np.concatenate([points, ends]), nothing)) >= 4


def test_both_faces_of_a_thin_wall_are_planes_that_face_their_sensors() -> None:
    wall = [box((1.0, -1.0, 0.0), (1.12, 1.0, 2.0))]
    cloud = merged(scanned(wall, (0.0, 0.0, 1.0), seed=1), scanned(wall, (2.2, 0.0, 1.0), seed=2))
    coarse = coarsen(cloud.points, cloud.starts, 0.015)
    planes = find_planes(coarse.points, coarse.counts, coarse.starts, np.random.default_rng(0))
    facing = sorted((round(float(plane.normal[0])), round(plane.offset, 2)) for plane in planes[:2])
    assert facing == [(-1, pytest.approx(-1.0, abs=0.01)), (1, pytest.approx(1.12, abs=0.01))]
