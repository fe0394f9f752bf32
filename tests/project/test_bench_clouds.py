"""Measures of perception: coverage, false obstacles, matches and errors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.clouds.cases import scene_cases
from benchmarks.clouds.errors import MEASURES, errors, matched, misses_target
from benchmarks.clouds.pieces import Figures, Targets, Union, ray_samples, true_points
from benchmarks.clouds.worker import made_of
from perception import Cloud, Detection, Reach
from perception.simulate import Caster, Scanner, box, join_meshes, scan
from perception.simulate.scenes import Truth, make_scene
from perception.simulate.scenes.scene import pose_of

CUBE = box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)).vertices
DOOR = {
    "width": 0.9, "height": 2.0, "ajar": 0.0, "handle_x": 0.83, "handle_y": 0.05, "handle_z": 1.0,
    "lever_direction": -1.0, "side": 1.0,
}  # fmt: skip


def seen(kind: str, pose: np.ndarray, sizes: dict[str, float], confidence: float = 0.9) -> Detection:
    return Detection(kind, pose, sizes, confidence, {}, np.zeros((0, 3)))


def test_within_measures_the_true_distance_to_the_union_also_at_corners() -> None:
    union = Union([CUBE, CUBE + np.array([2.0, 0.0, 0.0])])
    # 8 mm beyond each of three faces is 14 mm from the corner.
    places = np.array([[1.009, 0.5, 0.5], [1.008, 1.008, 1.008], [0.5, 0.5, 0.5], [1.5, 0.5, 0.5], [2.5, 0.5, 1.002]])
    assert union.within(places, 0.01).tolist() == [True, False, True, False, True]
    assert union.holds(places).tolist() == [False, False, True, False, False]


def test_false_obstacles_are_samples_in_a_piece_and_two_centimetres_from_all_surfaces() -> None:
    places = np.array([[0.5, 0.5, 0.5], [0.5, 0.5, 0.99], [0.5, 0.5, 1.5], [0.2, 0.2, 0.4]])
    assert Union([CUBE]).false_share(places, lambda samples: 1.0 - samples[:, 2]) == 50.0
    assert Union([CUBE]).false_share(places[2:3], lambda samples: 1.0 - samples[:, 2]) == 0.0


def test_true_points_are_the_surface_the_rays_met_without_what_was_mixed_up() -> None:
    wall = Caster(box((2.0, -1.0, 0.0), (2.1, 1.0, 2.0)))
    cloud = Cloud(np.array([[2.03, 0.0, 1.0], [1.5, 0.1, 1.0], [2.0, 5.0, 1.0]]), np.array([0.0, 0.0, 1.0]))
    assert np.allclose(true_points(wall, cloud), [[2.0, 0.0, 1.0]])


def test_samples_stay_on_their_rays_five_centimetres_before_the_end() -> None:
    cloud = Cloud(np.array([[2.0, 0.0, 1.0]]), np.array([0.0, 0.0, 1.0]))
    samples = np.concatenate([ray_samples(cloud, 3.0, np.random.default_rng(k)) for k in range(50)])
    assert np.allclose(samples[:, 1:], [0.0, 1.0])
    assert 0.1 * 1.95 <= samples[:, 0].min() < 0.3
    assert 1.8 < samples[:, 0].max() <= 1.95


def test_a_worker_reports_pieces_time_and_its_own_memory(tmp_path: Path) -> None:
    world = [box((-3.0, -3.0, -0.1), (3.0, 3.0, 0.0)), box((1.0, -0.3, 0.0), (1.4, 0.3, 1.0))]
    ballast = np.ones(60_000_000)
    made = made_of(scan(world, sensor=Scanner(n_lines=20)), Reach(), tmp_path)
    assert ballast.nbytes > 4e8
    assert 30.0 < made.memory < 400.0
    assert made.wall > 0.0
    assert made.cpu > 0.0
    assert Union(made.pieces).within(np.array([[1.0, 0.0, 0.5]]), 0.01).all()


def test_targets_missed_are_named() -> None:
    world = Figures(1000, 99.6, 99.8, 0.2, 151, 64, type("Made", (), {"wall": 1.0, "cpu": 3.0, "memory": 100.0})())
    assert world.missed(Targets()) == "2cm false pieces"


def test_errors_of_a_valve_are_centre_axis_and_radius() -> None:
    truth = Truth("valve", pose_of((1.0, 0.0, 1.0)), {"outer_radius": 0.13, "rim_radius": 0.12, "tube_radius": 0.01})
    found = seen(
        "valve", pose_of((1.003, 0.004, 1.0), roll=np.radians(1.5)), dict(truth.sizes) | {"outer_radius": 0.127}
    )
    assert errors("valve", found, truth) == pytest.approx((5.0, 1.5, 3.0))
    assert not misses_target("valve", (5.0, 1.5, 3.0), "dense")
    assert misses_target("valve", (11.0, 1.5, 3.0), "dense")
    assert not misses_target("valve", (11.0, 1.5, 3.0), "sparse")


def test_a_wheel_found_where_a_lever_is_has_no_right_radius() -> None:
    truth = Truth("valve", np.eye(4), {"lever_length": 0.2, "lever_radius": 0.01})
    found = seen("valve", np.eye(4), {"outer_radius": 0.2, "rim_radius": 0.19, "tube_radius": 0.01})
    assert misses_target("valve", errors("valve", found, truth), "sparse")


def test_errors_of_a_door_are_those_of_its_plane_and_its_handle() -> None:
    truth = Truth("door", pose_of((1.0, 0.4, 0.0), yaw=-np.pi / 2), DOOR)
    found = seen("door", pose_of((1.01, 0.3, 0.0), yaw=-np.pi / 2 + np.radians(0.5)), DOOR | {"ajar": np.radians(2.0)})
    normal, offset, handle, width, ajar, sides = errors("door", found, truth)
    assert (normal, width, sides) == pytest.approx((0.5, 0.0, 0.0))
    assert ajar == pytest.approx(2.0)
    assert offset == pytest.approx(1e3 * (0.01 + 0.35 * np.sin(np.radians(0.5))), abs=0.1)
    assert handle is not None
    assert 100.0 < handle < 103.0


def test_a_door_hinged_on_the_wrong_side_is_that_door_with_an_error() -> None:
    truth = Truth("door", pose_of((1.0, 0.45, 0.0), yaw=-np.pi / 2), DOOR)
    found = seen("door", pose_of((1.0, -0.45, 0.0), yaw=np.pi / 2), DOOR | {"side": -1.0})
    outcome = matched("door", [found], [truth], [])
    assert outcome.pairs[0][1] is found
    assert errors("door", found, truth)[-1] == 1.0


def test_two_detections_of_one_object_count_as_one_and_a_false_one() -> None:
    truth = Truth("hose", pose_of((1.0, 0.0, 1.0)), {"radius": 0.03})
    near, far = seen("hose", pose_of((1.0, 0.05, 1.0)), {}), seen("hose", pose_of((1.0, 0.1, 1.0)), {}, 0.7)
    outcome = matched("hose", [far, near], [truth], [])
    assert outcome.pairs[0][1] is near
    assert outcome.false == (far,)


def test_unsure_finds_of_nothing_and_lookalikes_are_not_false() -> None:
    unsure = seen("lever", pose_of((0.0, 0.0, 0.0)), {}, 0.49)
    alike = seen("lever", pose_of((1.0, 0.1, 1.0)), {})
    outcome = matched("lever", [unsure, alike], [], [("lever", np.array([[1.0, 0.0, 1.0]]))])
    assert outcome.false == ()
    assert matched("lever", [alike], [], [("valve", np.array([[1.0, 0.0, 1.0]]))]).false == (alike,)


@pytest.mark.parametrize("name", ["valve_small", "door_left_shut", "panel_two", "drill_shelf", "car_outside"])
def test_truth_itself_has_no_error(name: str) -> None:
    scene = make_scene(name)
    for truth in scene.truth:
        found = seen(truth.kind, truth.pose_world_object, dict(truth.sizes))
        values = errors(truth.kind, found, truth)
        assert len(values) == len(MEASURES[truth.kind])
        assert max(value for value in values if value is not None) < 1e-2


def test_recorded_truth_lies_on_the_recorded_surfaces(shared_data: Path) -> None:
    cases = {case.name: case for case in scene_cases(shared_data)}
    door = cases["door_a/scan0"].truth[0]
    surface = cases["door_a/scan0"].surface
    assert surface is not None
    places = [(door.pose_world_object @ [x, 0.0, z, 1.0])[:3] for x in (0.1, 0.6) for z in (0.3, 1.6)]
    assert surface().distance(np.array(places)).max() < 0.002
    caster = cases["debris/scan0"].surface
    assert caster is not None
    for beam in cases["debris/scan0"].truth:
        half = 0.5 * np.array([beam.sizes[key] for key in ("length", "width", "thickness")])
        faces = np.concatenate([np.diag(half), -np.diag(half)])[:, :]
        world = faces @ beam.pose_world_object[:3, :3].T + beam.pose_world_object[:3, 3]
        assert caster().distance(world).max() < 0.004


def test_scenes_recorded_twice_judge_each_other(shared_data: Path) -> None:
    cases = {case.name: case for case in scene_cases(shared_data)}
    assert cases["valve_a/scan0"].judge is not None
    assert cases["door_a/scan0"].judge is None
    assert [cases[f"valve_a/scan{k}"].density for k in (0, 2)] == ["dense", "sparse"]


def test_joined_pieces_of_a_scene_keep_their_triangles() -> None:
    both = join_meshes([box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)), box((2.0, 0.0, 0.0), (3.0, 1.0, 1.0))])
    assert Caster(both).distance(np.array([[2.5, 0.5, 1.25], [1.5, 0.5, 0.5]])) == pytest.approx([0.25, 0.5])
