"""Drills on boards and tables: pose against the truth, and no sure hit on what merely stands there."""

from __future__ import annotations

import numpy as np
import pytest

from perception import CONFIDENT, KINDS, Cloud, View, detect, detect_kinds, make_view
from perception.detect.engine.supports import level_heights
from perception.simulate import Mesh, Pose, Scanner, box, cylinder, scan
from perception.simulate.scenes import make_scene
from perception.simulate.scenes.loose import Drill, can, pot
from perception.solids.primitives import hull

SENSOR = Pose((0.1, 0.0, 1.5), pitch=0.7)
SCANNER = Scanner(n_beams=541, fan_deg=160.0, n_lines=70)
THIN = Scanner(n_beams=541, fan_deg=160.0, n_lines=44, sigma=0.015)
TOP = 0.8


def view_of(*meshes: Mesh, seed: int = 0, scanner: Scanner = SCANNER) -> View:
    room = [box((-5.0, -5.0, -0.1), (5.0, 5.0, 0.0)), box((1.6, -3.0, 0.0), (1.7, 3.0, 2.5))]
    table = [box((0.5, -0.6, TOP - 0.03), (1.2, 0.6, TOP)), box((1.1, -0.5, 0.0), (1.15, -0.45, TOP - 0.03))]
    return make_view(scan([*room, *table, *meshes], SENSOR, scanner, seed))


def test_a_drill_seen_from_the_side_is_found_within_the_targets() -> None:
    drill = Drill((0.8, 0.1, TOP), np.radians(140.0), grip_length=0.12, body_length=0.19).build()
    found = detect("drill", view_of(*drill.meshes))[0]
    truth = drill.truth[0].pose_world_object
    assert found.confidence >= CONFIDENT
    assert np.linalg.norm(found.pose_world_object[:3, 3] - truth[:3, 3]) <= 0.020
    assert found.pose_world_object[:3, 0] @ truth[:3, 0] >= np.cos(np.radians(10.0))
    assert found.pose_world_object[2, 2] >= np.cos(np.radians(5.0))


def test_a_drill_seen_from_behind_is_found_by_what_lies_deeper_than_its_outline() -> None:
    drill = Drill((0.7, 0.1, TOP), np.radians(195.0)).build()
    found, truth = detect("drill", view_of(*drill.meshes))[0], drill.truth[0].pose_world_object
    assert found.confidence >= CONFIDENT
    assert np.linalg.norm(found.pose_world_object[:3, 3] - truth[:3, 3]) <= 0.020


def test_a_block_of_a_drills_outline_seen_from_behind_is_none() -> None:
    outline = [(-0.07, 0.055), (-0.05, 0.0), (0.07, 0.0), (0.13, 0.19), (0.11, 0.245), (-0.07, 0.245)]
    yaw = np.radians(195.0)
    along, across = np.array([np.cos(yaw), np.sin(yaw), 0.0]), np.array([-np.sin(yaw), np.cos(yaw), 0.0])
    corners = [np.array([0.7, 0.1, TOP + z]) + x * along + y * across for x, z in outline for y in (-0.03, 0.03)]
    assert all(one.confidence < CONFIDENT for one in detect("drill", view_of(hull(np.array(corners)))))


def test_a_drill_a_hand_from_a_carton_is_found_in_a_thin_noisy_scan() -> None:
    drill = Drill((0.75, 0.1, TOP), np.radians(60.0)).build()
    carton = box((0.9, -0.15, TOP), (1.1, 0.3, TOP + 0.2))
    found = detect("drill", view_of(*drill.meshes, carton, scanner=THIN))
    assert found[0].confidence >= CONFIDENT
    assert np.linalg.norm(found[0].pose_world_object[:3, 3] - drill.truth[0].pose_world_object[:3, 3]) <= 0.030


def test_a_bend_of_pipe_that_stands_on_no_board_is_no_drill() -> None:
    view = make_view(make_scene("empty_pipes", 1).scan("solid"))
    assert all(one.confidence < CONFIDENT for one in detect("drill", view))


def test_bottles_boxes_mugs_and_tins_are_no_drills() -> None:
    bottle = [
        cylinder((0.7, -0.3, TOP), (0.7, -0.3, TOP + 0.18), 0.04),
        cylinder((0.7, -0.3, TOP), (0.7, -0.3, TOP + 0.27), 0.015),
    ]
    carton = box((0.75, -0.05, TOP), (0.85, 0.1, TOP + 0.22))
    mug = [*pot((0.7, 0.3, TOP), 0.045, 0.17).meshes, *can((0.9, 0.4, TOP), 0.05, 0.2).meshes]
    assert all(one.confidence < CONFIDENT for one in detect("drill", view_of(*bottle, carton, *mug)))


def test_an_empty_table_and_an_empty_floor_hold_no_drill() -> None:
    assert all(one.confidence < CONFIDENT for one in detect("drill", view_of()))
    points = np.random.default_rng(0).uniform((-2.0, -2.0, 0.0), (2.0, 2.0, 0.0), (5000, 3))
    assert detect("drill", make_view(Cloud(points, np.array([0.0, 0.0, 1.5])))) == []


def test_a_hint_elsewhere_leaves_the_drill_out() -> None:
    view = view_of(*Drill((0.8, 0.1, TOP), np.radians(70.0)).build().meshes)
    assert detect("drill", view, hint=np.array([0.8, -0.5, TOP])) == []


def test_boards_are_told_by_their_heights() -> None:
    view = view_of(box((0.7, -0.3, TOP), (0.8, -0.2, TOP + 0.2)), box((0.7, 0.1, TOP), (0.8, 0.2, TOP + 0.15)))
    assert any(abs(height - TOP) < 0.01 for height in level_heights(view.obstacles))


@pytest.mark.parametrize("thickness", [0.0, 0.02, 0.05, 0.1])
def test_what_is_lower_than_the_layers_that_a_board_is_held_against_has_its_height_found(thickness: float) -> None:
    rng = np.random.default_rng(0)
    flat = np.column_stack([rng.uniform(0.5, 1.2, 4000), rng.uniform(-0.5, 0.5, 4000), rng.normal(TOP, 0.004, 4000)])
    flat[:40, 2] += rng.uniform(0.0, thickness, 40)
    (height,) = level_heights(flat)
    assert height == pytest.approx(TOP, abs=0.01)


@pytest.mark.parametrize("has_floor", [False, True])
def test_every_detector_looks_at_a_flat_scene(has_floor: bool) -> None:
    rng = np.random.default_rng(0)
    top = np.column_stack([rng.uniform(0.6, 1.4, 3000), rng.uniform(-0.5, 0.5, 3000), rng.normal(TOP, 0.002, 3000)])
    floor = np.column_stack([rng.uniform(-2.0, 2.0, (8000, 2)), rng.normal(0.0, 0.002, 8000)])
    view = make_view(Cloud(np.concatenate([top, floor] if has_floor else [top]), np.array([0.0, 0.0, 1.6])))
    assert all(hit.confidence < CONFIDENT for hit in detect_kinds(KINDS, view))


def test_a_drill_seen_end_on_points_the_right_way_or_has_a_low_confidence() -> None:
    drill = Drill((0.8, 0.1, TOP), 0.05).build()
    hits = [hit for hit in detect("drill", view_of(*drill.meshes)) if hit.confidence >= CONFIDENT]
    assert all(hit.pose_world_object[:3, 0] @ drill.truth[0].pose_world_object[:3, 0] > 0.9 for hit in hits)
