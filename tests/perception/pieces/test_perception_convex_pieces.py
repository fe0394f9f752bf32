"""What each piece promises: its points, its evidence, its size; and that the order of the points means nothing."""

from __future__ import annotations

import json

import numpy as np
import pytest
from half_spaces import half_spaces
from hypothesis import given, settings
from hypothesis import strategies as st

from perception import Cloud, Perceived, perceive
from perception.convex.coarse import coarsen
from perception.convex.freespace import carve
from perception.convex.hulls import MAX_VERTICES, make_hull
from perception.convex.pieces import Pieces, make_pieces
from perception.convex.planes import Plane
from perception.convex.slabs import attach_hulls, make_slabs
from perception.convex.split import find_clusters, merge, refine_hulls, split
from perception.simulate import Caster, Pose, Room, Scanner, join_meshes, scan
from perception.simulate.scenes import make_scene

SENSOR = np.array([0.0, 0.0, 1.5])


def cluttered(seed: int) -> np.ndarray:
    """Noisy boards, rods and blobs at random places."""
    rng = np.random.default_rng(seed)
    parts = []
    for _ in range(rng.integers(1, 7)):
        extent = rng.choice([0.01, 0.05, 0.3, 0.8], 3)
        turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        middle = rng.uniform([0.5, -1.0, 0.2], [1.8, 1.0, 1.4])
        parts.append(middle + (rng.uniform(-0.5, 0.5, (rng.integers(3, 600), 3)) * extent) @ turn)
    points = np.concatenate(parts)
    return points + rng.normal(0.0, 0.004, points.shape)


def made(points: np.ndarray, order: np.ndarray | None = None) -> Pieces:
    points = points if order is None else points[order]
    return make_pieces(points, SENSOR, (SENSOR, points), seed=3)


@pytest.fixture(scope="module")
def room() -> Perceived:
    world = Room(wall_x=1.5, pipes=((1.0, 0.6, 0.05),), boxes=(((0.6, -1.0, 0.0), (0.9, -0.6, 0.5)),))
    return perceive(scan(world.meshes(), Pose((0.1, 0.0, 1.6), pitch=0.3), Scanner(n_lines=40), seed=1))


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_pieces_hold_the_points_they_claim_and_share_none(seed: int) -> None:
    points = cluttered(seed)
    pieces = made(points).pieces
    claimed = np.concatenate([piece.points for piece in pieces])
    assert len(np.unique(claimed)) == len(claimed)
    assert len(claimed) > 0.9 * len(points)
    for piece in pieces:
        faces = half_spaces(piece.shape.vertices)
        assert (points[piece.points] @ faces[:, :3].T + faces[:, 3]).max(initial=0.0) <= 0.01 + 1e-6
        assert 4 <= len(piece.shape.vertices) <= MAX_VERTICES


@settings(max_examples=6, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_the_order_of_the_points_does_not_change_the_pieces(seed: int) -> None:
    points = cluttered(seed)
    order = np.random.default_rng(seed).permutation(len(points))
    for one, other in zip(made(points).pieces, made(points, order).pieces, strict=True):
        np.testing.assert_array_equal(one.shape.vertices, other.shape.vertices)
        np.testing.assert_array_equal(one.points, np.sort(order[other.points]))


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_hulls_hold_all_points_and_next_to_nothing_of_what_was_seen_free(seed: int) -> None:
    points = coarsen(cluttered(seed), SENSOR, 0.015).points
    free = carve(SENSOR, points, points, points.min(axis=0) - 0.1, points.max(axis=0) + 0.1)
    parts = [hull for members in find_clusters(points, SENSOR) for hull in split(points, members, free)]
    hulls = merge(parts, free, 0.06)
    assert len(hulls) <= len(parts)
    members = np.concatenate([hull.members for hull in hulls])
    np.testing.assert_array_equal(np.sort(members), np.arange(len(points)))
    for hull in hulls:
        assert hull.is_within(points[hull.members], 1e-9).all()
        if np.ptp(hull.vertices, axis=0).max() > 0.03:
            assert free.count_inside(hull) * free.size**3 <= 2.4e-5 + 1e-9


def test_buttons_that_stand_out_of_a_panel_by_more_than_its_slab_are_covered() -> None:
    scene = make_scene("panel_grid", 3)
    cloud = scene.scan("solid")
    panel = scene.truth[0]
    rays = cloud.points - cloud.starts
    directions = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    hits = Caster(join_meshes(scene.meshes)).hits(cloud.starts, directions).distance
    true = cloud.starts + hits[:, None] * directions
    there = (true - panel.pose_world_object[:3, 3]) @ panel.pose_world_object[:3, :3]
    half = 0.5 * np.array([panel.sizes["width"], panel.sizes["height"]])
    is_button = (np.abs(there[:, :2]) < half).all(axis=1) & (there[:, 2] > 0.01)
    assert is_button.sum() > 1000
    hulls = [piece.hull for piece in perceive(cloud).pieces]
    assert np.any([hull.is_within(true[is_button], 0.01) for hull in hulls], axis=0).mean() > 0.99


def test_voxel_means_do_not_depend_on_the_order_of_their_points() -> None:
    rng = np.random.default_rng(0)
    points, starts = rng.uniform(-0.2, 0.2, (5000, 3)), rng.choice([-1.0, 1.0], (5000, 1)) * np.ones(3)
    order = rng.permutation(5000)
    one, other = coarsen(points, starts, 0.03), coarsen(points[order], starts[order], 0.03)
    np.testing.assert_array_equal(one.points, other.points)
    np.testing.assert_array_equal(one.starts, other.starts)
    np.testing.assert_array_equal(one.voxel[order], other.voxel)


def test_the_points_of_pieces_are_the_view_s_obstacles(room: Perceived) -> None:
    claimed = np.concatenate([piece.points for piece in room.pieces])
    assert len(np.unique(claimed)) == len(claimed) > 0.98 * len(room.view.obstacles)
    pipe = room.view.obstacles[room.pieces[-1].points]
    assert len(pipe)
    assert [piece.shape for piece in room.pieces] == [piece for piece in room.scene.pieces if piece.kind != "floor"]


def test_a_large_upright_slab_is_a_wall_and_a_low_box_is_none(room: Perceived) -> None:
    walls = [piece for piece in room.pieces if piece.kind == "wall"]
    assert walls
    assert all(piece.plane is not None and piece.plane[0] < -0.99 for piece in walls)
    assert max(len(piece.points) for piece in walls) == max(len(piece.points) for piece in room.pieces)
    assert all(np.ptp(piece.shape.vertices[:, 2]) >= 1.2 for piece in walls)


def test_a_wall_borders_seen_free_space_on_one_side(room: Perceived) -> None:
    wall = max(room.pieces, key=lambda piece: len(piece.points))
    assert 0.3 < wall.evidence.open_share < 0.6
    assert wall.evidence.free_share < 0.01


def test_a_piece_s_summary_is_json(room: Perceived) -> None:
    for piece in room.pieces:
        summary = json.loads(json.dumps(piece.summary()))
        assert summary["points"] == len(piece.points)
        assert 0.0 <= summary["open_share"] <= 1.0


def test_a_single_point_is_a_piece_that_holds_it() -> None:
    (piece,) = made(np.array([[1.0, 0.2, 0.4]])).pieces
    assert piece.points.tolist() == [0]
    assert np.ptp(piece.shape.vertices, axis=0).max() <= 0.03


def test_no_points_make_no_pieces() -> None:
    assert make_pieces(np.zeros((0, 3)), SENSOR, (SENSOR, np.zeros((0, 3)))).pieces == ()
    assert Cloud(np.ones((1, 3)), SENSOR).rays[0].shape == (1, 3)


def board(y: tuple[float, float], x: float = 1.0) -> np.ndarray:
    """Points of an upright board that faces the sensor."""
    grid = np.stack(np.meshgrid(np.arange(*y, 0.02), np.arange(1.2, 1.6, 0.02)), axis=-1).reshape(-1, 2)
    return np.column_stack([np.full(len(grid), x), grid])


@pytest.mark.parametrize(("x", "is_gap_seen", "n_left"), [(1.0, False, 0), (1.0, True, 1), (1.05, False, 1)])
def test_a_hull_beside_a_slab_joins_it_in_its_plane_where_nothing_was_seen_free(
    x: float, is_gap_seen: bool, n_left: int
) -> None:
    main, small = board((0.0, 0.6)), board((0.68, 0.74), x)
    ends = np.concatenate([main, small])
    if is_gap_seen:
        through = SENSOR + 1.6 * (board((0.63, 0.66)) - SENSOR)
        ends = np.concatenate([ends, through])
    free = carve(SENSOR, ends, np.concatenate([main, small]), np.array([0.5, -0.2, 1.0]), np.array([1.3, 1.0, 1.8]))
    plane = Plane(np.array([-1.0, 0.0, 0.0]), -1.0, np.arange(len(main)), np.arange(0))
    slabs = [(plane, slab) for slab in make_slabs(plane, main, SENSOR, ends, free)]
    hull = make_hull(small, np.arange(len(small)))
    grown, left = attach_hulls(slabs, [hull], free)
    assert len(slabs) == len(grown) == 1
    assert len(left) == n_left
    faces = half_spaces(grown[0][1].vertices)
    assert bool((small @ faces[:, :3].T + faces[:, 3] <= 1e-6).all()) == (n_left == 0)


@pytest.mark.parametrize(("gaps", "n_left"), [(0.06, 2), ([0.2, 0.2], 1), ([0.2, 0.06], 2)])
def test_hulls_are_neighbours_as_far_as_both_their_gaps_reach(gaps: float | list[float], n_left: int) -> None:
    points = np.concatenate([board((0.0, 0.1)), board((0.2, 0.3))])
    free = carve(SENSOR, points, points, points.min(axis=0) - 0.1, points.max(axis=0) + 0.1)
    hulls = [make_hull(points[members], members) for members in np.split(np.arange(len(points)), 2)]
    assert len(merge(hulls, free, np.array(gaps))) == n_left


@pytest.mark.parametrize("is_gap_seen", [False, True])
def test_pieces_go_on_between_rays_that_lie_far_apart_unless_it_is_open_there(is_gap_seen: bool) -> None:
    grid = np.stack(np.meshgrid(np.arange(-1.0, 1.0, 0.1), np.arange(0.5, 2.0, 0.1)), axis=-1).reshape(-1, 2)
    points = np.column_stack([np.full(len(grid), 4.0), grid])
    ends = points
    if is_gap_seen:
        beside = np.column_stack([np.full(40, 4.0), np.full(40, 0.94), np.linspace(0.4, 2.1, 40)])
        ends = np.concatenate([points, SENSOR + 1.5 * (beside - SENSOR)])
    pieces = make_pieces(points, SENSOR, (SENSOR, ends), seed=3).pieces
    farthest = max(piece.shape.vertices[:, 1].max() for piece in pieces) - points[:, 1].max()
    assert farthest == pytest.approx(0.006 if is_gap_seen else 0.03, abs=1e-6)


@pytest.mark.parametrize("is_seen_through", [True, False])
def test_a_hull_is_split_where_rays_went_through_a_narrow_gap(is_seen_through: bool) -> None:
    height = np.linspace(1.2, 1.6, 40)
    rods = [np.column_stack([np.full(40, x), np.full(40, y), height]) for x in (1.0, 1.04) for y in (0.0, 0.07)]
    points = np.concatenate(rods)
    between = np.concatenate([np.column_stack([np.full(40, 1.0), np.full(40, y), height]) for y in (0.03, 0.035, 0.04)])
    ends = np.concatenate([points, SENSOR + 1.5 * (between - SENSOR)]) if is_seen_through else points
    whole = make_hull(points, np.arange(len(points)))
    hulls = refine_hulls([whole], points, points, (SENSOR, ends), 0.06)
    if is_seen_through:
        assert len(hulls) == 2
        assert not any(hull.is_within(between, 0.0).any() for hull in hulls)
    else:
        assert hulls == [whole]
    held = np.concatenate([hull.members for hull in hulls])
    assert sorted(held.tolist()) == list(range(len(points)))
