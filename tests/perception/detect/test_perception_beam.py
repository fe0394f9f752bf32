"""Beams in debris: pose and size against the truth, honesty where there is none."""

from __future__ import annotations

import json
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perception import CONFIDENT, Cloud, Detection, View, make_view, read_cloud
from perception.detect.beam.detector import _continues, detect_beam, loose_points
from perception.detect.beam.strips import _in_walls, find_strips
from perception.detect.shared import bar_fit, bar_starts
from perception.detect.shared.bar_fit import BarFit, _linearize, _move, _State, spread_between_edges
from perception.detect.shared.bars import Bar, BarCrossing, Section, SurroundingRays, cross_bar, sort_rays
from perception.detect.shared.slender import is_slender
from perception.detect.valve.lines import find_lines
from perception.sightlines import Sightlines
from perception.simulate import Mesh, Pose, Scanner, box, cylinder, scan
from perception.simulate.scenes import make_scene

SENSOR = Pose((0.1, 0.0, 1.6), pitch=0.6)
SCANNER = Scanner(n_beams=541, fan_deg=160.0, n_lines=60)


def posed(centre: object, yaw: float, pitch: float, roll: float) -> np.ndarray:
    """x along the beam, turned by yaw, pitch, roll [deg]."""
    pose = np.eye(4)
    pose[:3, :3] = Pose(yaw=np.radians(yaw), pitch=np.radians(pitch), roll=np.radians(roll)).rotation
    pose[:3, 3] = np.asarray(centre)
    return pose


def timber(pose: np.ndarray, length: float, width: float, thickness: float) -> Mesh:
    half = 0.5 * np.array([length, width, thickness])
    return box((-half).tolist(), half.tolist()).move(pose[:3, :3], pose[:3, 3])


def view_of(*meshes: Mesh, seed: int = 0) -> View:
    room = [box((-5.0, -5.0, -0.1), (5.0, 5.0, 0.0)), box((2.2, -3.0, 0.0), (2.3, 3.0, 2.5))]
    return make_view(scan([*room, *meshes], SENSOR, SCANNER, seed))


LEANING = posed((1.0, 0.1, 0.45), 40.0, -30.0, 70.0)
LYING = posed((1.0, -0.35, 0.045), 70.0, 0.0, 0.0)


def misses(found: Detection, pose: np.ndarray) -> tuple[float, float]:
    """Angle between the axes [deg] and distance of the centre from the true axis [m]."""
    axis, offset = pose[:3, 0], found.pose_world_object[:3, 3] - pose[:3, 3]
    angle = np.degrees(np.arccos(min(1.0, abs(float(found.pose_world_object[:3, 0] @ axis)))))
    return float(angle), float(np.linalg.norm(offset - (offset @ axis) * axis))


def test_a_leaning_two_by_four_is_found_within_the_targets() -> None:
    view = view_of(timber(LEANING, 1.1, 0.089, 0.038))
    found = detect_beam(view)[0]
    angle, off = misses(found, LEANING)
    assert found.confidence >= CONFIDENT
    assert angle <= 2.0
    assert off <= 0.010
    assert abs(found.sizes["length"] - 1.1) <= 0.05
    assert found.residuals["n_ends_seen"] == 2.0
    assert np.allclose(found.pose_world_object[:3, :3] @ found.pose_world_object[:3, :3].T, np.eye(3), atol=1e-9)
    again = detect_beam(view)[0]
    assert np.array_equal(found.pose_world_object, again.pose_world_object)


def test_rounding_errors_of_the_fits_do_not_change_the_hits_in_a_heap(monkeypatch: pytest.MonkeyPatch) -> None:
    cloud = make_scene("debris_large_heap", 0).scan("solid")
    view = make_view(cloud.select(cloud.points[:, 1] > 0.0))  # a half of it
    linearize, measure = bar_fit._linearize, bar_starts.cross_sections
    expected = detect_beam(view)
    rng = np.random.default_rng(1)

    def blur(values: np.ndarray) -> np.ndarray:
        return np.asarray(values * (1.0 + 2e-15 * rng.standard_normal(values.shape)))

    def linearize_roughly(*given: Any) -> tuple[np.ndarray, ...]:
        return tuple(blur(part) for part in linearize(*given))

    def measure_roughly(*given: Any) -> BarCrossing:
        measured = measure(*given)
        return BarCrossing(*(blur(getattr(measured, field.name)) for field in fields(BarCrossing)))

    monkeypatch.setattr(bar_fit, "_linearize", linearize_roughly)
    monkeypatch.setattr(bar_starts, "cross_sections", measure_roughly)
    found = detect_beam(view)
    assert len(found) == len(expected) > 2
    for hit, other in zip(found, expected, strict=True):
        assert np.allclose(hit.pose_world_object, other.pose_world_object, rtol=0.0, atol=1e-7)
        assert hit.confidence == pytest.approx(other.confidence, abs=1e-6)


def test_a_beam_whose_end_is_hidden_says_that_its_length_is_unknown() -> None:
    pose = posed((1.1, 0.0, 0.3), 90.0, 0.0, 0.0)
    beam = timber(pose, 1.2, 0.089, 0.038)
    whole = detect_beam(view_of(beam))[0]
    assert whole.confidence >= CONFIDENT
    assert whole.residuals["hidden_length"] < 0.05
    screen = box((0.7, 0.3, 0.0), (0.72, 1.2, 1.0))
    near = [one for one in detect_beam(view_of(beam, screen)) if misses(one, pose)[1] < 0.03]
    assert near[0].sizes["length"] < 1.1
    assert near[0].residuals["hidden_length"] > 0.08
    assert near[0].confidence < CONFIDENT


def test_a_four_by_four_on_the_floor_is_found_and_not_mistaken_for_a_plank() -> None:
    found = detect_beam(view_of(timber(LYING, 1.2, 0.089, 0.089)))[0]
    angle, off = misses(found, LYING)
    assert found.confidence >= CONFIDENT
    assert angle <= 2.0
    assert off <= 0.015
    assert found.sizes["thickness"] > 0.06


def test_crossed_beams_are_told_apart() -> None:
    under, over = posed((1.0, 0.0, 0.045), 60.0, 0.0, 0.0), posed((1.0, 0.0, 0.13), -20.0, 0.0, 0.0)
    view = view_of(timber(under, 1.2, 0.089, 0.089), timber(over, 0.9, 0.089, 0.038))
    found = [one for one in detect_beam(view) if one.confidence >= CONFIDENT]
    assert len(found) == 2
    for pose in (under, over):
        angle, off = min(misses(one, pose) for one in found)
        assert angle <= 2.0
        assert off <= 0.015


@pytest.mark.parametrize("radius", [0.025, 0.045])
def test_a_pipe_is_no_beam(radius: float) -> None:
    view = view_of(cylinder((0.9, -0.4, 0.3), (1.1, 0.5, 0.9), radius))
    assert all(one.confidence < CONFIDENT for one in detect_beam(view))


def test_a_pipe_with_flanges_is_no_beam() -> None:
    flanges = [cylinder((1.0, y, 0.9), (1.0, y + 0.05, 0.9), 0.085) for y in (-0.5, 0.0, 0.4)]
    view = view_of(cylinder((1.0, -1.0, 0.9), (1.0, 1.0, 0.9), 0.045), *flanges)
    assert all(one.confidence < CONFIDENT for one in detect_beam(view))


def test_beams_side_by_side_are_looked_at_though_they_pass_for_a_step() -> None:
    beams = [timber(posed((x, 0.1, 0.0445), 80.0, 0.0, 0.0), 1.2, 0.14, 0.089) for x in (0.8, 1.0, 1.2)]
    view = view_of(*beams)
    tops = np.abs(view.near.points[:, 2] - 0.089) < 0.02
    looked_at = np.abs(loose_points(view)[:, 2] - 0.089) < 0.02
    assert looked_at.sum() > 0.9 * tops.sum()


def test_walls_cartons_and_their_edges_are_no_beams() -> None:
    view = view_of(box((0.9, -0.5, 0.0), (1.3, 0.0, 0.4)), box((1.0, 0.3, 0.0), (1.3, 0.7, 0.9)))
    assert all(one.confidence < CONFIDENT for one in detect_beam(view))


def test_a_hint_leaves_out_what_is_far_from_it() -> None:
    far = posed((1.3, 1.2, 0.3), 60.0, -20.0, 0.0)
    view = view_of(timber(LEANING, 1.1, 0.089, 0.038), timber(far, 0.9, 0.089, 0.038))
    found = detect_beam(view, hint=far[:3, 3])
    assert misses(found[0], far)[1] <= 0.015
    assert all(np.linalg.norm(one.pose_world_object[:3, 3] - LEANING[:3, 3]) > 0.5 for one in found)


def test_a_view_without_obstacles_holds_no_beam() -> None:
    points = np.random.default_rng(0).uniform((-2.0, -2.0, 0.0), (2.0, 2.0, 0.0), (5000, 3))
    assert detect_beam(make_view(Cloud(points, np.array([0.0, 0.0, 1.5])))) == []


def test_beams_of_the_debris_scan_are_found_with_their_length_or_a_low_confidence(shared_data: Path) -> None:
    folder = shared_data / "scenes" / "debris"
    truth = json.loads((folder / "gt.json").read_text())["beams"]
    found = detect_beam(make_view(read_cloud(folder / "scan0.pcd")))
    n_sure, n_cut_short = 0, 0
    for beam in truth:
        pose = np.eye(4)
        pose[:3, 0], pose[:3, 3] = beam["axis"], beam["centre"]
        for one in found:
            angle, off = misses(one, pose)
            if angle <= 2.0 and off <= 0.012:
                n_sure += one.confidence >= CONFIDENT
                n_cut_short += one.confidence < CONFIDENT and one.residuals["hidden_length"] > 0.08
                assert one.confidence < CONFIDENT or abs(one.sizes["length"] - beam["extents"][0]) < 0.05
    assert n_sure >= 3
    assert n_sure + n_cut_short >= 4


def rays_into(bar: Bar, rng: np.random.Generator) -> Sightlines:
    """Rays well inside its outline: moved to its edge, others have derivatives that are only nearly right."""
    start = np.zeros((60, 3))
    target = np.array([1.0, 0.0, 1.0]) + rng.uniform(-0.3, 0.3, (60, 1)) * np.array([0.0, 1.0, 0.0])
    target = target + rng.uniform(-0.02, 0.02, (60, 3))
    length = np.linalg.norm(target, axis=1)
    rays = Sightlines(start, target / length[:, None], length)
    return rays.select(cross_bar(rays, bar).outside < -0.004)


@settings(max_examples=10)
@pytest.mark.parametrize(("section", "n"), [("box", 7), ("round", 5)])
@given(seed=st.integers(0, 1000))
def test_the_fits_derivatives_are_those_of_central_differences(section: Section, n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    frame = Pose(yaw=float(rng.uniform(1.2, 1.9)), pitch=float(rng.uniform(-0.3, 0.3))).rotation.T
    bar = Bar(frame, np.array([1.0, 0.0, 1.0]), (0.045, 0.045 if section == "round" else 0.019), -0.5, 0.5, section)
    rays = rays_into(bar, rng)
    half = np.array([bar.half])
    state = _State(frame[None], bar.centre[None], half)
    hit = rng.random((1, len(rays))) < 0.6
    here, jacobian = _linearize(rays, hit, np.ones_like(hit), state, half, section)
    for i in range(n):
        change = np.zeros((1, n))
        change[0, i] = 1e-6
        ahead, behind = (
            _linearize(rays, hit, np.ones_like(hit), _move(state, sign * change, section), half, section)[0]
            for sign in (1.0, -1.0)
        )
        numeric = (ahead - behind)[0] / 2e-6
        # Edges and corners of the outline have no derivative: there the two sides differ.
        smooth = np.abs(ahead + behind - 2.0 * here)[0] < 1e-7
        assert smooth.mean() > 0.8
        assert np.allclose(numeric[smooth], jacobian[0, i][smooth], rtol=1e-3, atol=2e-2)


def test_a_ray_through_a_box_enters_where_the_box_begins() -> None:
    bar = Bar(np.eye(3), np.array([0.0, 0.0, 0.0]), (0.1, 0.05), -1.0, 1.0)
    rays = Sightlines(
        np.array([[0.3, -1.0, 0.0], [0.3, -1.0, 0.12]]), np.array([[0.0, 1.0, 0.0], [0.0, 1.0, 0.0]]), np.ones(2)
    )
    crossing = cross_bar(rays, bar)
    assert crossing.depth[0] == pytest.approx(0.9)
    assert crossing.along[0] == pytest.approx(0.3)
    assert crossing.outside == pytest.approx([-0.05, 0.07])


def test_a_wall_is_not_slender_and_a_board_is() -> None:
    rng = np.random.default_rng(0)
    wall = rng.uniform((0.0, -1.0, 0.0), (0.0, 1.0, 2.0), (20_000, 3))
    board = rng.uniform((1.0, -0.6, 0.0), (1.04, 0.6, 0.09), (900, 3))
    slender = is_slender(np.concatenate([wall, board]))
    middle = (np.abs(wall[:, 1]) < 0.7) & (np.abs(wall[:, 2] - 1.0) < 0.7)
    assert not slender[:20_000][middle].any()
    assert slender[20_000:].mean() > 0.9


def test_a_line_of_points_is_found_with_its_ends() -> None:
    rng = np.random.default_rng(1)
    along = rng.uniform(-0.5, 0.5, (300, 1)) * np.array([0.6, 0.0, 0.8]) + rng.normal(0.0, 0.01, (300, 3))
    noise = rng.uniform(-1.0, 1.0, (300, 3))
    line = find_lines(np.concatenate([along, noise]), rng, (0.035,), 0.3)[0]
    assert abs(line.axis @ np.array([0.6, 0.0, 0.8])) > 0.999
    assert line.last - line.first == pytest.approx(1.0, abs=0.1)


def test_a_face_in_a_heap_is_found_as_a_strip_whatever_lies_about_it() -> None:
    rng = np.random.default_rng(2)
    face = rng.uniform((-0.5, -0.045, 0.0), (0.5, 0.045, 0.0), (700, 3))
    below = rng.uniform((-0.5, -0.4, -0.06), (0.5, 0.4, -0.06), (4000, 3))
    below = below[np.abs(below[:, 1]) > 0.06]
    points = np.concatenate([face, below]) + rng.normal(0.0, 0.005, (len(face) + len(below), 3))
    strip = find_strips(points, np.array([0.0, 0.0, 2.0]), rng)[0]
    assert abs(strip.axis[0]) > 0.999
    assert strip.normal[2] > 0.99
    assert 2.0 * strip.half == pytest.approx(0.09, abs=0.015)
    assert strip.last - strip.first == pytest.approx(1.0, abs=0.1)
    assert np.abs(strip.members[:, 1]).max() < 0.07


def test_a_wall_holds_no_strip() -> None:
    rng = np.random.default_rng(3)
    wall = rng.uniform((1.0, -1.0, 0.0), (1.0, 1.0, 2.0), (8000, 3)) + rng.normal(0.0, 0.008, (8000, 3))
    inner = [one for one in find_strips(wall, np.zeros(3), rng) if np.abs(one.place[1:] - (0.0, 1.0)).max() < 0.8]
    assert inner == []


def test_a_beam_that_something_lies_across_is_found_in_one_piece() -> None:
    pose = posed((1.0, 0.0, 0.045), 90.0, 0.0, 0.0)
    across = box((0.7, -0.16, 0.1), (1.4, 0.16, 0.13))
    found = detect_beam(view_of(timber(pose, 1.2, 0.089, 0.089), across))
    angle, off = misses(found[0], pose)
    assert angle <= 2.0
    assert off <= 0.02
    assert found[0].sizes["length"] == pytest.approx(1.2, abs=0.05)


def test_what_ended_on_a_known_bar_says_nothing_of_one_it_touches() -> None:
    bar = Bar(np.eye(3), np.zeros(3), (0.045, 0.019), -0.5, 0.5)
    starts, way = np.array([[0.0, 0.0, 1.0], [0.2, 0.0, 1.0]]), np.array([[0.0, 0.0, -1.0]] * 2)
    rays = SurroundingRays(starts, way, np.full(2, 0.98), np.zeros(2, dtype=bool), np.array([True, False]))
    told = sort_rays(rays, cross_bar(rays, bar))
    assert told.hit.tolist() == [False, True]
    assert told.before.tolist() == [True, False]


def test_a_board_flat_on_the_floor_that_all_its_rays_agree_with_is_held_by_those_beside_its_edges() -> None:
    bar = Bar(np.eye(3), np.zeros(3), (0.07, 0.019), -0.45, 0.45)
    x, y = (one.ravel() for one in np.meshgrid(np.linspace(-0.44, 0.44, 45), np.linspace(-0.115, 0.115, 24)))
    ends = np.column_stack([x, y, np.where(np.abs(y) < 0.07, 0.019, -0.5)])
    straight_down = np.tile([0.0, 0.0, -1.0], (len(x), 1))
    rays = SurroundingRays(
        ends + np.array([0.0, 0.0, 2.0]), straight_down, np.full(len(x), 2.0), np.zeros(len(x), dtype=bool)
    )
    beside = rays.select(np.abs(y) < 0.06)
    fit = BarFit(bar, (0.07, 0.019), (np.inf, np.inf))
    assert spread_between_edges(rays, fit, 2000)[0] < 0.01
    assert spread_between_edges(beside.select(np.abs(beside.ends[:, 1]) < 0.03), fit, 2000)[0] > 1.0


def test_parts_of_a_beam_on_both_sides_of_what_hides_its_middle_are_one() -> None:
    whole = Bar(np.eye(3), np.zeros(3), (0.045, 0.019), -0.6, 0.6)
    left, right = replace(whole, last=-0.15), replace(whole, first=0.1)
    askew = replace(right, frame=Pose(yaw=np.radians(12.0)).rotation.T)
    beside = replace(right, centre=np.array([0.0, 0.1, 0.0]))
    far = replace(right, first=0.4, last=0.6)
    assert _continues(left, right)
    assert _continues(right, left)
    assert not any(_continues(left, other) for other in (askew, beside, far))


def test_a_wall_seen_with_much_noise_is_one_though_things_stand_close_before_it() -> None:
    rng = np.random.default_rng(4)
    wall = rng.uniform((2.0, -2.0, 0.0), (2.0, 2.0, 2.0), (34_000, 3)) + rng.normal(0.0, 0.021, (34_000, 3))
    things = rng.uniform((1.75, -2.0, 0.0), (1.85, 2.0, 2.0), (3_000, 3))
    in_wall = _in_walls(np.concatenate([wall, things]))
    middle = (np.abs(wall[:, 1]) < 1.6) & (np.abs(wall[:, 2] - 1.0) < 0.8)
    assert in_wall[:34_000][middle].mean() > 0.5
    assert not in_wall[34_000:].any()
