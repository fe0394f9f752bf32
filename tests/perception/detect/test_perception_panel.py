"""Button panels: face and buttons where they are, and nothing claimed of what does not stand out."""

from __future__ import annotations

import numpy as np
import pytest

from perception import CONFIDENT, Detection, PerceptionError, View, detect, detect_kinds, make_view
from perception.detect.panel.relief import find_discs
from perception.simulate import Pose, Room, Scanner, box, cylinder, scan
from perception.simulate.scenes import make_scene
from perception.simulate.scenes.fixtures import BoxLever, Panel
from perception.solids.primitives import Mesh

SENSOR = Pose((0.12, 0.0, 1.6), pitch=0.4)
SCANNER = Scanner(n_beams=541, fan_deg=135.0, n_lines=90)
ROOM = Room(wall_x=0.85)
BUTTONS = ((0.0, 0.07, 0.03), (0.05, -0.06, 0.025), (-0.05, -0.06, 0.025))


def seen(meshes: list[Mesh], seed: int = 1, scanner: Scanner = SCANNER) -> View:
    return make_view(scan([*ROOM.meshes(), *meshes], SENSOR, scanner, seed=seed))


def button_places(found: Detection) -> np.ndarray:
    n = int(found.sizes["n_buttons"])
    local = np.array([[found.sizes[f"button_{i}_x"], found.sizes[f"button_{i}_y"], 0.0, 1.0] for i in range(n)])
    return np.asarray((local @ found.pose_world_object.T)[:, :3])


@pytest.mark.parametrize("turned_deg", [-25.0, 0.0, 25.0])
def test_a_panel_is_found_with_its_buttons(turned_deg: float) -> None:
    angle = np.radians(turned_deg)
    panel = Panel((0.72, 0.05, 1.25), (-np.cos(angle), -np.sin(angle), 0.0), buttons=BUTTONS)
    placed = panel.build()
    truth = placed.truth[0]
    found = detect("panel", seen(list(placed.meshes)))[0]
    assert found.confidence >= CONFIDENT
    assert np.linalg.norm((found.pose_world_object - truth.pose_world_object)[:3, 3]) < 0.015
    assert found.pose_world_object[:3, 2] @ truth.pose_world_object[:3, 2] > np.cos(np.radians(2.0))
    assert abs(found.sizes["width"] - panel.width) < 0.02
    assert abs(found.sizes["height"] - panel.height) < 0.02
    true = (np.array([[x, y, 0.0, 1.0] for x, y, _ in BUTTONS]) @ truth.pose_world_object.T)[:, :3]
    apart = np.linalg.norm(button_places(found)[:, None] - true[None], axis=-1)
    assert found.sizes["n_buttons"] == len(BUTTONS)
    assert (apart.min(axis=0) < 0.01).all()


def test_a_button_that_fills_a_small_face_moves_neither_the_face_nor_its_edges() -> None:
    panel = Panel((0.72, 0.05, 1.25), width=0.15, height=0.15, buttons=((0.0, 0.0, 0.045),))
    placed = panel.build()
    pose = placed.truth[0].pose_world_object
    found = detect("panel", seen(list(placed.meshes)))[0]
    assert found.confidence >= CONFIDENT
    assert np.linalg.norm((found.pose_world_object - pose)[:3, 3]) < 0.01
    assert found.pose_world_object[:3, 2] @ pose[:3, 2] > np.cos(np.radians(3.0))
    assert np.linalg.norm(button_places(found)[0] - panel.centre) < 0.01


def test_a_lever_between_whose_parts_no_ray_met_the_face_is_no_row_of_buttons() -> None:
    scene = make_scene("lever_box_down", 51)
    view = make_view(scene.scan("sparse"))
    assert all(found.confidence < CONFIDENT for found in detect("panel", view))
    (pivot,) = [one.pose_world_object[:3, 3] for one in scene.truth if one.kind == "lever"]
    sure = [found for found in detect("lever", view) if found.confidence >= CONFIDENT]
    assert all(np.linalg.norm(found.pose_world_object[:3, 3] - pivot) < 0.04 for found in sure)


def test_a_plane_through_parts_with_air_between_them_is_no_panel() -> None:
    view = make_view(make_scene("drill_shelf_two").scan("dense"))
    assert all(found.confidence < CONFIDENT for found in detect("panel", view))


def test_a_grazed_side_of_a_box_with_a_lever_before_its_edge_is_no_panel() -> None:
    view = make_view(make_scene("lever_box_oblique", 3).scan("dense"))
    assert all(found.confidence < CONFIDENT for found in detect("panel", view))


def test_buttons_that_do_not_stand_out_are_not_claimed() -> None:
    panel = Panel((0.72, 0.05, 1.25), buttons=BUTTONS, proud=0.0015)
    assert all(found.confidence < CONFIDENT for found in detect("panel", seen(list(panel.build().meshes))))


@pytest.mark.parametrize(
    "meshes",
    [
        list(BoxLever((0.65, 0.0, 1.2)).build().meshes),
        [box((0.7, -0.15, 1.0), (0.85, 0.15, 1.4))],
        [cylinder((0.7, 0.0, 0.8), (0.7, 0.0, 1.5), 0.05)],
        [box((0.7, -0.15, 1.0), (0.85, 0.15, 1.4)), box((0.65, -0.02, 1.0), (0.7, 0.02, 1.4))],
    ],
    ids=["a box with a lever", "a bare box", "a pipe", "a box with a strip"],
)
def test_no_panel_is_believed_where_there_is_none(meshes: list[Mesh]) -> None:
    assert all(found.confidence < CONFIDENT for found in detect("panel", seen(meshes)))


def test_a_raised_disc_is_found_where_points_are_unevenly_dense() -> None:
    rng = np.random.default_rng(0)
    flat = np.column_stack([0.3 * rng.random(20_000), 0.3 * rng.random(20_000) ** 2])
    height = np.where(np.linalg.norm(flat - [0.14, 0.1], axis=1) < 0.03, 0.01, 0.0) + rng.normal(0.0, 0.004, 20_000)
    discs = find_discs(np.column_stack([flat, height]), np.zeros(2), np.full(2, 0.3), 0.004, 13.0)
    assert len(discs) == 1
    np.testing.assert_allclose(discs[0].centre, [0.14, 0.1], atol=0.002)
    assert discs[0].radius == pytest.approx(0.03, abs=0.003)
    assert discs[0].height == pytest.approx(0.01, abs=0.001)


def test_several_kinds_looked_for_at_once_are_found_as_each_alone() -> None:
    view = make_view(make_scene("lever_box", seed=1).scan("sparse"))
    told: list[str] = []
    both = detect_kinds(("panel", "lever"), view, on_kind=told.append)
    alone = [*detect("panel", view), *detect("lever", view)]
    assert told == ["panel", "lever"]
    assert [one.kind for one in both] == [one.kind for one in alone]
    assert any(one.kind == "lever" for one in both)
    for one, other in zip(both, alone, strict=True):
        assert one.confidence == other.confidence
        np.testing.assert_array_equal(one.pose_world_object, other.pose_world_object)
    with pytest.raises(PerceptionError, match="unknown kind 'handle'"):
        detect_kinds(("lever", "handle"), view)
