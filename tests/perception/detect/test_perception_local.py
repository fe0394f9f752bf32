"""Detections depend on what is near an object alone: not on the seed, the crop, or what else the scan shows."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import perception.view as view_module
from perception import CONFIDENT, Detection, Reach, detect, make_view, settle_overlaps
from perception.detect.shared.local import best_about, pick_per_cell
from perception.detect.shared.nearby import Nearby
from perception.detect.valve.circles import find_circles
from perception.detect.valve.foreground import Foreground
from perception.simulate import Pose, Room, Scanner, Valve, box, scan
from perception.view import widen

SCANNER = Scanner(n_beams=361, fan_deg=90.0, n_lines=90)
SENSOR = Pose((0.12, 0.0, 1.6), pitch=0.3)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 1000), st.integers(1, 4))
def test_a_cells_sample_depends_on_its_points_alone(seed: int, most: int) -> None:
    rng = np.random.default_rng(seed)
    here, elsewhere = rng.uniform(0.0, 0.2, (30, 3)), rng.uniform(0.5, 3.0, (60, 3))
    alone = here[pick_per_cell(here, 0.25, most)]
    both = np.concatenate([elsewhere, here])[rng.permutation(90)]
    picked = both[pick_per_cell(both, 0.25, most)]
    near = picked[(picked < 0.25).all(axis=1)]
    assert len(alone) == most
    assert {tuple(point) for point in near} == {tuple(point) for point in alone}


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 1000))
def test_a_limit_about_each_place_keeps_what_is_elsewhere(seed: int) -> None:
    rng = np.random.default_rng(seed)
    crowd, lone = rng.uniform(0.0, 0.1, (20, 3)), np.array([[5.0, 0.0, 0.0]])
    assert best_about(np.concatenate([crowd, lone]), 0.5, 3).tolist() == [0, 1, 2, 20]


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 1000))
def test_all_points_near_a_place_are_listed_and_none_far_from_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points, places, radii = rng.uniform(-1.0, 1.0, (400, 3)), rng.uniform(-1.2, 1.2, (30, 3)), rng.uniform(0.0, 0.5, 30)
    for near in Nearby.of(points).list_near(places, radii):
        ends = np.cumsum(near.counts)
        for k, place in enumerate(places[near.first : near.last]):
            listed = near.points[ends[k] - near.counts[k] : ends[k]]
            apart = np.linalg.norm(points - place, axis=1)
            assert set(np.flatnonzero(apart < radii[near.first + k])) <= set(listed.tolist())
            assert (apart[listed] < radii[near.first + k] + 0.18).all()


def test_a_circle_drawn_about_a_seed_depends_on_the_points_near_it_alone() -> None:
    rng = np.random.default_rng(0)
    wheel, elsewhere = _wheel(0.09, 0.01), rng.uniform(2.0, 3.0, (3000, 3))
    mixed = np.concatenate([elsewhere, wheel])[rng.permutation(len(elsewhere) + len(wheel))]
    alone, both = find_circles(wheel), find_circles(mixed)
    there = [circle for circle in both if np.linalg.norm(circle.centre - [0.8, 0.0, 1.1]) < 0.3]
    assert len(alone) == len(there)
    for one, other in zip(alone, there, strict=True):
        np.testing.assert_allclose(one.centre, other.centre, atol=1e-9)
        assert one.score == pytest.approx(other.score, abs=1e-9)


def _wheel(rim: float, half_width: float) -> np.ndarray:
    """Points of a flat ring before the robot, 1.5 cm apart."""
    grid = np.stack(np.meshgrid(*2 * [np.arange(-0.45, 0.45, 0.015)]), axis=-1).reshape(-1, 2)
    on = np.abs(np.hypot(*grid.T) - rim) < half_width
    points = np.column_stack([np.full(int(on.sum()), 0.8), grid[on] + [0.0, 1.1]])
    return points + np.random.default_rng(0).normal(0.0, 0.003, points.shape)


@pytest.mark.parametrize(("rim", "half_width"), [(0.09, 0.01), (0.2, 0.035), (0.3, 0.05), (0.36, 0.02)])
def test_a_ring_is_proposed_for_thin_and_wide_rims_of_any_size(rim: float, half_width: float) -> None:
    circles = find_circles(_wheel(rim, half_width))
    apart = [np.linalg.norm(circle.centre - [0.8, 0.0, 1.1]) + abs(circle.radius - rim) for circle in circles]
    assert min(apart) < 0.02 + half_width


@pytest.fixture(scope="module")
def room() -> list:
    valve = Valve((0.7, 0.1, 1.1), rim_radius=0.16)
    far = [box((1.0, y, 0.0), (1.4, y + 0.3, 0.8)) for y in (-3.4, 3.2)]
    return [*Room(wall_x=None).meshes(), *valve.meshes(), box((-3.6, -0.2, 0.0), (-3.2, 0.2, 0.5)), *far]


def test_hits_are_the_same_for_any_seed_and_crop(room: list) -> None:
    cloud = scan(room, SENSOR, SCANNER, seed=2)
    hits = [
        detect("valve", make_view(cloud, reach=Reach(radius=radius), seed=seed))
        for radius, seed in ((3.0, 0), (3.0, 7), (4.5, 0))
    ]
    assert hits[0][0].confidence >= CONFIDENT
    for other in hits[1:]:
        assert [hit.confidence for hit in other] == [hit.confidence for hit in hits[0]]
        assert np.array_equal(other[0].pose_world_object, hits[0][0].pose_world_object)


def test_a_crop_decides_which_hits_are_reported(room: list) -> None:
    cloud = scan(room, SENSOR, SCANNER, seed=2)
    assert detect("valve", make_view(cloud, reach=Reach(x=1.0, y=-1.2, radius=0.9))) == []


def _hit(kind: str, confidence: float, points: np.ndarray) -> Detection:
    return Detection(kind, np.eye(4), {}, confidence, {}, points)


def _bar(first: float, last: float) -> np.ndarray:
    return np.column_stack([np.arange(first, last, 0.01), np.zeros((len(np.arange(first, last, 0.01)), 2))])


def test_of_two_hits_of_a_kind_on_the_same_points_the_surer_stands() -> None:
    sure, other, beside = (
        _hit("drill", c, _bar(*ends)) for c, *ends in ((0.9, 0, 0.3), (0.6, 0.1, 0.3), (0.6, 1, 1.3))
    )
    assert settle_overlaps([other, sure, beside]) == [sure, beside]


def test_hits_of_two_kinds_on_the_same_points_are_rivals_and_a_part_of_another_is_none() -> None:
    valve, beam = _hit("valve", 0.9, _bar(0.0, 0.3)), _hit("beam", 0.7, _bar(0.0, 0.32))
    door, handle = _hit("door", 1.0, _bar(0.0, 1.0)), _hit("lever", 0.7, _bar(0.4, 0.5))
    assert [hit.confidence < CONFIDENT for hit in settle_overlaps([valve, beam])] == [False, True]
    assert settle_overlaps([door, handle]) == [door, handle]


def test_rivals_that_are_nearly_as_sure_both_stand() -> None:
    both = [_hit("valve", 1.0, _bar(0.0, 0.3)), _hit("lever", 0.95, _bar(0.0, 0.3))]
    assert settle_overlaps(both) == both


def test_a_wide_wheel_in_one_plane_with_a_board_is_no_wall() -> None:
    valve = Valve((0.9, -0.2, 1.1), rim_radius=0.2, tube_radius=0.03)
    board = box((0.87, 0.1, 0.6), (0.9, 0.9, 1.6))
    view = make_view(scan([*Room(wall_x=1.6).meshes(), *valve.meshes(), board], SENSOR, SCANNER, seed=1))
    kept = Foreground.of(view).points
    on_rim, left = (
        (np.abs(np.hypot(points[:, 1] + 0.2, points[:, 2] - 1.1) - 0.2) < 0.03) & (points[:, 0] < 0.96)
        for points in (view.obstacles, kept)
    )
    assert left.sum() > 0.8 * on_rim.sum()


def test_a_wide_wheel_is_found_with_its_outer_radius() -> None:
    valve = Valve((0.8, 0.1, 1.1), rim_radius=0.22, tube_radius=0.03, n_spokes=5)
    hit = detect("valve", make_view(scan([*Room(wall_x=1.3).meshes(), *valve.meshes()], SENSOR, SCANNER, seed=1)))[0]
    assert hit.confidence >= CONFIDENT
    assert hit.sizes["outer_radius"] == pytest.approx(0.25, abs=0.01)
    assert np.linalg.norm(hit.pose_world_object[:3, 3] - [0.8, 0.1, 1.1]) < 0.015


@pytest.mark.parametrize(("far", "is_cleaned_again"), [(2.5, False), (4.0, True)])
def test_a_wider_view_of_the_same_points_is_not_cleaned_again(
    far: float, is_cleaned_again: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    wall = box((far, -0.6, 0.0), (far + 0.1, 0.6, 1.6))
    view = make_view(scan([wall, box((0.8, -0.3, 0.0), (1.2, 0.3, 0.9))], SENSOR, SCANNER, 0))
    expected = make_view(view.cloud, reach=Reach(radius=5.0)).obstacles
    calls = []
    clean = view_module.surface_points
    monkeypatch.setattr(view_module, "surface_points", lambda *args: calls.append(args) or clean(*args))
    np.testing.assert_array_equal(widen(view).obstacles, expected)
    assert bool(calls) == is_cleaned_again
