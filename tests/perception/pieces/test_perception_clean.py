"""Cleaning: reach, copies, voxels, strays, mixed pixels and the robot's own points."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from little_scan import little_scan

from perception import (
    Cloud,
    PerceptionError,
    Reach,
    inliers,
    inside_hulls,
    make_view,
    voxel_downsample,
)
from perception.cleaning.outliers import on_grazed_surface, surface_points
from perception.simulate import box, cylinder
from perception.simulate.cast import cast
from perception.solids.primitives import Mesh, join_meshes

CUBE = np.array([[x, y, z] for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (-0.1, 0.1)])


def test_reach_is_a_cylinder_with_lids() -> None:
    reach = Reach(x=1.0, radius=2.0, top=2.0, bottom=-0.1)
    points = np.array([[2.9, 0, 0], [3.1, 0, 0], [1, 1.9, 1.9], [1, 0, 2.1], [1, 0, -0.2]])
    assert reach.contains(points).tolist() == [True, False, True, False, False]
    with pytest.raises(PerceptionError, match="radius"):
        Reach(radius=0.0)
    with pytest.raises(PerceptionError, match=r"reach\.top"):
        Reach(top=-1.0)


@given(st.integers(1, 300), st.floats(0.02, 0.5), st.integers(0, 9))
def test_every_point_lies_within_a_voxel_of_its_mean_and_none_is_lost(n: int, size: float, seed: int) -> None:
    points = np.random.default_rng(seed).uniform(-1, 1, (n, 3))
    means, counts = voxel_downsample(points, size)
    assert counts.sum() == n
    np.testing.assert_allclose(counts @ means, points.sum(axis=0), atol=1e-9)
    nearest = np.linalg.norm(points[:, None] - means, axis=2).min(axis=1)
    assert nearest.max() <= np.sqrt(3) * size


def test_outliers_are_judged_by_a_radius_that_grows_with_range() -> None:
    rng = np.random.default_rng(0)
    near = rng.uniform(-0.04, 0.04, (80, 3)) + np.array([1, 0, 0])
    far = rng.uniform(-0.2, 0.2, (60, 3)) + np.array([8, 0, 0])
    stray = np.array([[1.5, 0.5, 0.0], [4.0, 1.0, 0.0]])
    keep = inliers(np.concatenate([near, far, stray]), np.zeros(3))
    assert keep[:80].all()
    assert keep[80:140].mean() > 0.9
    assert not keep[140:].any()
    # The far cluster's spacing, near by, is no cluster.
    assert not inliers(far - np.array([7, 0, 0]), np.zeros(3)).all()


@given(st.integers(0, 30))
def test_robot_points_are_those_within_the_margin_of_a_hull(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.3, 0.3, (400, 3))
    distance = np.linalg.norm(np.maximum(np.abs(points) - 0.1, 0.0), axis=1)
    own = inside_hulls(points, [CUBE + np.array([2, 0, 0]), CUBE], margin=0.025)
    assert own[distance <= 0.025 - 1e-9].all()
    assert not own[distance > 0.025 * 1.21].any()
    n_outside = np.count_nonzero(np.abs(points) > 0.1, axis=1)
    assert not own[(n_outside == 2) & (distance > 0.025 * 1.083)].any()


def test_without_hulls_no_point_is_the_robots() -> None:
    assert not inside_hulls(np.zeros((5, 3)), []).any()


def test_a_flat_hull_is_refused() -> None:
    with pytest.raises(PerceptionError, match="spans no volume"):
        inside_hulls(np.zeros((5, 3)), [CUBE * [1, 1, 0]])


def test_a_sharp_wedge_has_no_spike_beyond_its_edge() -> None:
    wedge = np.array([[0, y, z] for y in (-0.1, 0.1) for z in (-0.01, 0.01)] + [[0.3, y, 0] for y in (-0.1, 0.1)])
    beyond = np.array([[0.3 + x, 0.0, 0.0] for x in (0.02, 0.03, 0.05, 0.1)])
    assert inside_hulls(beyond, [wedge], margin=0.025).tolist() == [True, False, False, False]


@settings(max_examples=30)
@given(st.integers(1, 60), st.integers(0, 9))
def test_exact_copies_are_dropped_and_counted(n_copies: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1, 1, (40, 3))
    copied = rng.integers(40, size=n_copies)
    view = make_view(Cloud(np.concatenate([points, points[copied]]), np.zeros(3)))
    np.testing.assert_array_equal(view.cloud.points, points)
    assert any(note.startswith(f"dropped {n_copies} exact copies among {40 + n_copies} points") for note in view.notes)


def test_the_same_point_seen_from_two_places_is_no_copy() -> None:
    points = np.repeat(np.array([[1.0, 0.0, 0.5], [1.0, 0.1, 0.5]]), 2, axis=0)
    starts = np.array([[0.0, 0, 1], [0, 1, 1], [0, 0, 1], [0, 0, 1]])
    view = make_view(Cloud(points, starts))
    assert len(view.cloud.points) == 3


def test_zero_and_minus_zero_are_one_place() -> None:
    assert len(make_view(Cloud(np.array([[1.0, 0.0, 0.5], [1.0, -0.0, 0.5]]), np.zeros(3))).cloud.points) == 1


@pytest.mark.parametrize(("height", "is_told"), [(1.6, False), (0.15, False), (0.0, True), (-0.4, True)])
def test_rays_that_start_on_the_floor_or_under_it_are_doubted(height: float, is_told: bool) -> None:
    view = make_view(Cloud(little_scan().points, np.array([0.25, 0.0, height])))
    told = f"rays start at (0.25, 0, {height:g}), no higher than the floor"
    assert len(view.floors) == 1
    assert any(note.startswith(told) and "give the sensor's position" in note for note in view.notes) is is_told


@pytest.mark.parametrize(("height", "unit"), [(1.6, ""), (3.0, ""), (5.2, "ft"), (1500.0, "mm")])
def test_rays_that_start_as_high_as_a_sensor_in_another_unit_are_doubted(height: float, unit: str) -> None:
    view = make_view(Cloud(little_scan().points, np.array([0.25, 0.0, height])))
    said = [note for note in view.notes if "above the floor: is its unit" in note]
    assert [unit in note for note in said] == ([True] if unit else [])


def beside_the_sensor(aside: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Lines of a lidar at the origin, a degree apart: a board along the rays, so far aside, and a wall behind."""
    turn, lift = np.radians(np.arange(-12.0, 20.0, 0.25)), np.radians(np.arange(-12.0, 12.0, 1.0))
    angles = np.stack(np.meshgrid(turn, lift), axis=-1).reshape(-1, 2)
    direction = np.column_stack([np.ones(len(angles)), np.tan(angles[:, 0]), np.tan(angles[:, 1])])
    depth = aside / np.maximum(direction[:, 1], 1e-9)
    is_board = (depth > 0.6) & (depth < 1.6)
    points = np.where(is_board, depth, 2.0)[:, None] * direction
    ranges = np.linalg.norm(points, axis=1, keepdims=True)
    return points * (1.0 + rng.normal(0.0, 0.01, ranges.shape) / ranges), is_board


def test_most_of_a_board_stays_that_rays_graze() -> None:
    points, is_board = beside_the_sensor(0.06, np.random.default_rng(0))
    assert is_board.sum() > 300
    assert surface_points(points, np.zeros_like(points))[is_board].mean() > 0.75


def test_what_lies_in_a_plane_with_the_sensor_is_no_surface_that_rays_graze() -> None:
    rng = np.random.default_rng(0)
    for aside, is_kept in ((0.05, True), (0.01, False)):
        surface = np.column_stack([rng.uniform(0.6, 1.6, 2000), np.full(2000, aside), rng.uniform(-0.3, 0.3, 2000)])
        asked = np.array([[0.8, aside, 0.0], [1.2, aside, 0.1]])
        far = np.full(len(asked), 0.1)
        assert on_grazed_surface(asked, asked, surface, far).tolist() == [is_kept] * 2
        assert not on_grazed_surface(asked + np.array([0.0, 0.01, 0.0]), asked, surface, far).any()


def test_a_surface_that_rays_graze_is_followed_to_its_far_end() -> None:
    rng = np.random.default_rng(0)
    surface = np.column_stack([rng.uniform(0.6, 0.9, 500), np.full(500, 0.05), rng.uniform(-0.3, 0.3, 500)])
    x, z = (one.ravel() for one in np.meshgrid(np.arange(0.95, 1.9, 0.08), np.arange(-0.3, 0.31, 0.08)))
    row = np.column_stack([x, np.full(len(x), 0.05), z])
    beyond = row[-1:] + np.array([[0.5, 0.0, 0.0]])
    asked = np.concatenate([row, beyond])
    found = on_grazed_surface(asked, asked, surface, np.full(len(asked), 0.12))
    assert found[:-1].mean() > 0.9
    assert found[:-1][row[:, 0] > 1.8].any()
    assert not found[-1]


def depth_picture(meshes: list[Mesh], rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points of a depth camera at the origin that looks along x, which are mixed pixels, and how deep those float."""
    pixel = np.stack(np.meshgrid(np.arange(160) - 80.0, np.arange(120) - 60.0), axis=-1).reshape(-1, 2) / 140.0
    direction = np.column_stack([np.ones(len(pixel)), pixel])
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    aside = direction + rng.normal(0, 0.006, direction.shape)
    world, eye = join_meshes(meshes), np.zeros(3)
    first = cast(world, eye, direction)
    second = cast(world, eye, aside / np.linalg.norm(aside, axis=1, keepdims=True))
    gap = second - first
    share = rng.random(len(gap))
    floats = np.abs(gap) * np.minimum(share, 1.0 - share)
    is_mixed = (np.abs(gap) > 0.1) & (rng.random(len(gap)) < 0.5)
    ranges = np.where(is_mixed, first + share * gap, first) + rng.normal(0, 0.004, len(first))
    return direction * ranges[:, None], is_mixed, np.where(is_mixed, floats, 0.0)


def test_mixed_pixels_go_and_what_is_there_stays() -> None:
    rng = np.random.default_rng(1)
    meshes = [box((2.5, -3, -3), (2.6, 3, 3)), box((1.5, -0.3, -0.4), (1.7, 0.2, 0.3))]
    points, is_mixed, floats = depth_picture(meshes, rng)
    kept = surface_points(points, np.zeros_like(points))
    assert (floats > 0.08).sum() > 60
    assert kept[floats > 0.08].mean() < 0.1
    assert kept[~is_mixed].mean() > 0.995


@pytest.mark.parametrize("radius", [0.006, 0.01, 0.025])
def test_wires_and_pipes_before_a_wall_stay(radius: float) -> None:
    rng = np.random.default_rng(2)
    wire = cylinder((1.4, -0.1, -0.5), (1.6, 0.1, 0.5), radius)
    points, is_mixed, _ = depth_picture([box((2.5, -3, -3), (2.6, 3, 3)), wire], rng)
    on_wire = (points[:, 0] < 1.8) & ~is_mixed
    kept = surface_points(points, np.zeros_like(points))
    assert on_wire.sum() > 40
    assert kept[on_wire].mean() > 0.95


def test_a_wire_that_few_scan_lines_cross_stays_and_a_lone_stray_goes() -> None:
    # Lines 2 degrees apart, one or two beams of each on the wire: fewer neighbours than any radius asks for.
    turn, beam = np.meshgrid(np.radians(np.arange(-30, 31, 2.0)), np.radians(np.arange(-40, 40.1, 0.25)))
    direction = np.column_stack([np.ones(turn.size), np.tan(beam).ravel(), np.tan(turn).ravel()])
    ranges = np.full(turn.size, 4.0)
    on_wire = np.abs(beam.ravel()) < np.radians(0.3)
    ranges[on_wire] = 2.0
    stray = np.flatnonzero(~on_wire)[1234]
    ranges[stray] = 1.3
    points = direction * ranges[:, None]
    kept = surface_points(points, np.zeros_like(points))
    assert kept[on_wire].mean() > 0.9
    assert not kept[stray]


def test_the_far_ends_of_a_wall_stay_that_few_scan_lines_cross() -> None:
    # Lines six degrees apart run along a wall 0.9 m away; at its ends rays meet it at 15 degrees.
    turn, tilt = np.meshgrid(np.radians(np.arange(-75, 75.1, 0.25)), np.radians(np.arange(-30, 31, 6.0)))
    points = 0.9 * np.column_stack([np.ones(turn.size), np.tan(turn).ravel(), (np.tan(tilt) / np.cos(turn)).ravel()])
    ranges = np.linalg.norm(points, axis=1, keepdims=True)
    points *= 1.0 + np.random.default_rng(0).normal(0, 0.01, ranges.shape) / ranges
    is_end = np.abs(points[:, 1]) > 2.4
    assert is_end.sum() > 200
    kept = surface_points(points, np.zeros_like(points))
    assert kept[is_end].mean() > 0.98
    assert kept.mean() > 0.995


@settings(max_examples=20, deadline=None)
@given(st.floats(0, 68), st.floats(0, 360), st.floats(1.0, 6.0), st.integers(0, 9))
def test_a_wall_that_few_rays_meet_stays_however_it_slants(
    slant_deg: float, towards_deg: float, distance: float, seed: int
) -> None:
    # One ray a degree: up to a third of a metre apart on a wall that slants away.  At 70 degrees, where the outermost
    # rays graze it at 8, as little as 94 % stays.
    turn, tilt = np.meshgrid(np.radians(np.arange(-12, 12.5)), np.radians(np.arange(-12, 12.5)))
    direction = np.column_stack([np.ones(turn.size), np.tan(turn).ravel(), np.tan(tilt).ravel()])
    towards = np.array([np.cos(np.radians(towards_deg)), np.sin(np.radians(towards_deg))])
    depth = distance / (1.0 - np.tan(np.radians(slant_deg)) * direction[:, 1:] @ towards)
    points = direction * depth[:, None]
    ranges = np.linalg.norm(points, axis=1, keepdims=True)
    points *= 1.0 + np.random.default_rng(seed).normal(0, 0.008, ranges.shape) / ranges
    assert surface_points(points, np.zeros_like(points)).mean() > 0.97


def test_mixed_pixels_of_a_coarse_scan_go() -> None:
    turn, tilt = np.meshgrid(np.radians(np.arange(-30, 30.5)), np.radians(np.arange(-30, 30.5)))
    direction = np.column_stack([np.ones(turn.size), np.tan(turn).ravel(), np.tan(tilt).ravel()])
    rng = np.random.default_rng(4)
    before = np.abs(turn.ravel()) < np.radians(10)
    edge = (np.abs(np.abs(turn.ravel()) - np.radians(10)) < np.radians(0.6)) & (rng.random(turn.size) < 0.3)
    depth = np.where(before, 1.5, 3.5)
    depth[edge] = rng.uniform(1.8, 3.2, edge.sum())
    points = direction * depth[:, None]
    kept = surface_points(points, np.zeros_like(points))
    assert edge.sum() > 20
    assert kept[edge].mean() < 0.35
    assert kept[~edge].mean() > 0.99


@pytest.mark.parametrize("range_m", [0.5, 1.0, 4.0])
@pytest.mark.parametrize(("n_others", "share", "is_kept"), [(5, 0.98, True), (5, 1.02, False), (4, 0.5, False)])
def test_a_point_stays_with_five_others_within_3_cm_and_2_percent_of_its_range(
    range_m: float, n_others: int, share: float, is_kept: bool
) -> None:
    # around it, not beside it: those on opposite sides of it are too far from one another to be kept by themselves
    around = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1]])[:n_others]
    place = np.array([range_m, 0.0, 0.0])
    points = np.vstack([place, place + share * (0.03 + 0.02 * range_m) * around])
    far = place + [[0.0, 50.0 + k, 0.0] for k in range(6)]
    assert inliers(np.vstack([points, far]), np.zeros(3)).tolist() == [is_kept] + [False] * (n_others + 6)
