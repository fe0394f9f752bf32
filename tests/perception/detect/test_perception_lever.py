"""Levers before faces: where they pivot and point, and none where a bar is not held at one end."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from perception import CONFIDENT, Cloud, View, detect, make_view, read_cloud
from perception.detect.shared.bar_pivot import face_behind
from perception.detect.shared.faces import Face, FaceRays
from perception.sightlines import Sightlines
from perception.simulate import Pose, Room, Scanner, box, cylinder, scan
from perception.simulate.scenes import make_scene
from perception.simulate.scenes.fixtures import BoxLever, Panel
from perception.solids.primitives import Mesh, bent_bar

SENSOR = Pose((0.12, 0.0, 1.6), pitch=0.4)
SCANNER = Scanner(n_beams=541, fan_deg=135.0, n_lines=90)
ROOM = Room(wall_x=0.85)


def seen(meshes: list[Mesh], seed: int = 1) -> View:
    return make_view(scan([*ROOM.meshes(), *meshes], SENSOR, SCANNER, seed=seed))


@pytest.mark.parametrize("angle", [0.3, 1.5, 3.0])
def test_a_lever_on_a_box_is_found_with_its_pivot_and_direction(angle: float) -> None:
    truth = BoxLever((0.65, 0.0, 1.2), angle=angle).build()
    found = detect("lever", seen(list(truth.meshes)))[0]
    true_pose = truth.truth[0].pose_world_object
    assert found.confidence >= CONFIDENT
    assert np.linalg.norm((found.pose_world_object - true_pose)[:3, 3]) < 0.02
    assert found.pose_world_object[:3, 2] @ true_pose[:3, 2] > np.cos(np.radians(2.0))
    assert found.pose_world_object[:3, 0] @ true_pose[:3, 0] > np.cos(np.radians(5.0))
    assert abs(found.sizes["length"] - 0.2) < 0.025
    assert np.linalg.det(found.pose_world_object[:3, :3]) == pytest.approx(1.0)


def test_the_neck_at_the_top_of_a_lever_is_told_though_rays_pass_over_it() -> None:
    view = make_view(make_scene("lever_box_down", 0).scan("dense"))
    lever = next(one for one in make_scene("lever_box_down", 0).truth if one.kind == "lever")
    found = detect("lever", view)[0]
    assert found.confidence >= CONFIDENT
    # Held at its top, not at its other end.
    assert found.pose_world_object[:3, 0] @ lever.pose_world_object[:3, 0] > np.cos(np.radians(5.0))
    assert np.linalg.norm((found.pose_world_object - lever.pose_world_object)[:3, 3]) < 0.03


def test_which_end_is_held_is_not_claimed_where_the_bar_hides_it() -> None:
    lever = BoxLever((0.65, 0.0, 1.2), angle=-1.4)
    for found in detect("lever", seen(list(lever.build().meshes))):
        assert found.confidence < CONFIDENT or np.linalg.norm(found.pose_world_object[:3, 3] - lever.pivot) < 0.02


@pytest.mark.parametrize(
    "meshes",
    [
        [],
        [box((0.65, -0.15, 1.0), (0.85, 0.15, 1.4))],
        list(Panel((0.72, 0.05, 1.25)).build().meshes),
        [cylinder((0.78, 0.1, 0.0), (0.78, 0.1, 2.4), 0.02)],
        [bent_bar([(0.85, 0.0, 1.05), (0.78, 0.0, 1.05), (0.78, 0.0, 1.35), (0.85, 0.0, 1.35)], 0.012)],
        [box((0.7, -0.1, 1.1), (0.85, 0.1, 1.13))],
    ],
    ids=["a bare wall", "a box", "a panel", "a pipe", "a grip held at both ends", "a ledge"],
)
def test_no_lever_is_believed_where_there_is_none(meshes: list[Mesh]) -> None:
    assert all(found.confidence < CONFIDENT for found in detect("lever", seen(meshes)))


def test_a_shelfs_edge_that_goes_on_unseen_is_no_lever() -> None:
    view = make_view(make_scene("drill_shelf", 51).scan("sparse"))
    assert all(found.confidence < CONFIDENT for found in detect("lever", view))


@pytest.mark.parametrize(("seed", "variant"), [(0, "sparse"), (3, "solid_sparse")], ids=["over a face", "before one"])
def test_the_rim_of_a_level_wheel_is_no_lever(seed: int, variant: str) -> None:
    view = make_view(make_scene("valve_upright", seed).scan(variant))
    assert all(found.confidence < CONFIDENT for found in detect("lever", view))


def test_a_length_of_a_large_wheel_s_rim_is_no_lever() -> None:
    view = make_view(make_scene("valve_large", 2).scan("camera"))
    assert all(one.confidence < CONFIDENT for one in detect("lever", view))


def test_a_recorded_lever_is_found_in_any_order_of_the_points(shared_data: Path) -> None:
    path = shared_data / "real" / "door_iphone_4.ply"
    if not path.exists():
        pytest.skip(f"no recorded cloud {path}")
    cloud = read_cloud(path)
    order = np.random.default_rng(0).permutation(len(cloud.points))
    found = detect("lever", make_view(Cloud(cloud.points[order], cloud.origin)))[0]
    assert found.confidence >= CONFIDENT
    assert np.linalg.norm(found.pose_world_object[:3, 3] - [0.545, 0.06, 1.045]) < 0.02


def test_a_face_goes_on_behind_a_place_within_its_region_where_rays_end_on_it() -> None:
    rng = np.random.default_rng(0)
    at = rng.uniform(-0.4, 0.4, (4000, 2))
    face = Face(np.eye(3), np.zeros(3), np.full(2, -0.2), np.full(2, 0.2), 0.005)
    start = np.array([0.0, 0.0, 2.0])
    ends = np.column_stack([at, np.where(at[:, 0] > 0.0, -1.0, 0.0)])
    way = np.column_stack([at, np.zeros(len(at))]) - start
    length = np.linalg.norm(way, axis=1)
    rays = FaceRays(Sightlines(np.tile(start, (len(at), 1)), way / length[:, None], length), at, ends)
    assert face_behind(face, rays, np.array([-0.1, 0.0, 0.05])) == 1.0
    assert face_behind(face, rays, np.array([0.1, 0.0, 0.05])) == 0.0
    assert face_behind(face, rays, np.array([-0.32, 0.0, 0.05])) == 0.0


def test_a_hint_keeps_the_search_near_it() -> None:
    one, other = BoxLever((0.65, 0.45, 1.2)), BoxLever((0.65, -0.45, 1.2), angle=0.4)
    view = seen([*one.build().meshes, *other.build().meshes])
    hinted = detect("lever", view, np.array([0.65, -0.4, 1.25]))
    assert np.linalg.norm(hinted[0].pose_world_object[:3, 3] - other.pivot) < 0.02
    assert all(np.linalg.norm(found.pose_world_object[:3, 3] - one.pivot) > 0.3 for found in hinted)
