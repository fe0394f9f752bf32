"""The sensor simulator: points lie on what is there, misses meet nothing, and the scenes' truth is true."""

from __future__ import annotations

import functools

import numpy as np
import pytest

from perception import PerceptionError
from perception.simulate import (
    Caster,
    DepthCamera,
    Pose,
    Scanner,
    Sensor,
    SolidState,
    TimeOfFlight,
    box,
    join_meshes,
    scan,
)
from perception.simulate.scenes import SCENES, VARIANTS, SimulatedScene, make_scene
from perception.simulate.scenes.doors import Door
from perception.solids.primitives import capsule, lathe, pipe

FLOOR = box((-4.0, -4.0, -0.1), (4.0, 4.0, 0.0))
WORLD = [FLOOR, box((1.5, -0.5, 0.0), (1.7, 0.6, 1.8)), box((0.9, 0.1, 0.0), (1.0, 0.4, 1.2))]
POSE = Pose((0.1, 0.0, 1.5), yaw=0.1, pitch=0.3, roll=0.05)
SENSORS: dict[str, Sensor] = {
    "spinning": Scanner(n_lines=30, mixed_share=0.0),
    "solid": SolidState(n_points=30_000, mixed_share=0.0),
    "camera": DepthCamera(width=200, height=150, mixed_share=0.0),
}


made = functools.cache(make_scene)


def deviation(sensor: Sensor, cloud_points: np.ndarray, caster: Caster) -> tuple[np.ndarray, np.ndarray]:
    """Range errors of a scan's points and the standard deviation the sensor promises for each [m]."""
    rays = cloud_points - np.array(POSE.position)
    length = np.linalg.norm(rays, axis=1)
    hits = caster.hits(np.array(POSE.position), rays / length[:, None])
    if isinstance(sensor, DepthCamera):
        forward = (rays / length[:, None]) @ POSE.rotation[:, 0]
        return length - hits.distance, sensor.deviation(hits.distance * forward) / forward
    if isinstance(sensor, SolidState):
        return length - hits.distance, sensor.deviation(hits)
    assert isinstance(sensor, Scanner)
    return length - hits.distance, np.full(len(length), sensor.sigma)


@pytest.mark.parametrize("name", SENSORS)
def test_points_lie_on_the_first_surface_within_the_sensors_noise(name: str) -> None:
    sensor = SENSORS[name]
    caster = Caster(join_meshes(WORLD))
    cloud = scan(WORLD, POSE, sensor, seed=1)
    error, sigma = deviation(sensor, cloud.points, caster)
    # Rays along an edge may end on either side of it once their direction is rounded.
    scaled = (error / sigma)[np.abs(error) < 10.0 * sigma]
    assert len(scaled) > 0.999 * len(error)
    assert 0.9 < scaled.std() < 1.1
    assert abs(scaled.mean()) < 0.1
    assert 0.990 < np.mean(np.abs(scaled) < 3.0) < 0.9999


@pytest.mark.parametrize("name", ["spinning", "solid"])
def test_rays_told_as_misses_meet_nothing(name: str) -> None:
    sensor = SENSORS[name]
    cloud = scan(WORLD, Pose(POSE.position, pitch=-0.1), sensor, seed=1, misses=True)
    assert len(cloud.misses) > 1000
    rays = cloud.misses - cloud.origin
    length = np.linalg.norm(rays, axis=1)
    assert np.allclose(length, sensor.max_range)
    assert np.isinf(Caster(join_meshes(WORLD)).hits(cloud.origin, rays / length[:, None]).distance).all()


def test_a_camera_tells_no_misses_since_a_hole_may_be_a_surface() -> None:
    assert not len(scan(WORLD, Pose(POSE.position, pitch=-0.1), SENSORS["camera"], misses=True).misses)


@pytest.mark.parametrize("name", SENSORS)
def test_what_is_behind_something_is_not_seen(name: str) -> None:
    screen = [FLOOR, box((0.8, -3.0, 0.0), (0.9, 3.0, 3.0)), box((1.5, -0.5, 0.0), (1.7, 0.6, 1.8))]
    cloud = scan(screen, POSE, SENSORS[name], seed=2)
    ahead = np.abs(np.arctan2(cloud.points[:, 1], cloud.points[:, 0] - 0.1)) < 1.0
    assert ahead.sum() > 1000
    assert cloud.points[ahead & (cloud.points[:, 2] > 0.2), 0].max() < 1.0


@pytest.mark.parametrize("name", SENSORS)
def test_equal_seeds_give_equal_scans_and_others_do_not(name: str) -> None:
    first, again, other = (scan(WORLD, POSE, SENSORS[name], seed=seed).points for seed in (3, 3, 4))
    assert np.array_equal(first, again)
    assert first.shape != other.shape or not np.array_equal(first, other)


NOISELESS: list[Sensor] = [
    Scanner(n_lines=40, sigma=1e-4),
    SolidState(n_points=40_000, sigma=1e-4, grazing_gain=0.0),
    DepthCamera(width=300, height=225, matching=1e-3, step=1e-3),
]


@pytest.mark.parametrize("sensor", NOISELESS)
def test_edges_give_mixed_pixels_between_the_surfaces(sensor: Sensor) -> None:
    caster = Caster(join_meshes(WORLD))
    points = scan(WORLD, POSE, sensor, seed=5).points
    in_the_air = caster.distance(points) > 0.08
    assert 0.0001 < in_the_air.mean() < 0.05
    rays = points[in_the_air] - np.array(POSE.position)
    length = np.linalg.norm(rays, axis=1)
    # They lie within a footprint of an edge: turned a little, their ray ends nearer.
    turned = rays / length[:, None] + np.random.default_rng(0).normal(0.0, 0.004, (200, *rays.shape))
    turned /= np.linalg.norm(turned, axis=-1, keepdims=True)
    distance = caster.hits(np.array(POSE.position), turned.reshape(-1, 3)).distance.reshape(200, -1)
    assert np.mean((distance.min(axis=0) < length) & (distance.max(axis=0) > length)) > 0.95


def test_a_camera_loses_surfaces_it_sees_edge_on() -> None:
    camera = DepthCamera(hole_share=0.0, mixed_share=0.0)
    pose = Pose((0.0, 0.0, 0.25))
    direction = camera.directions()
    hits = Caster(FLOOR).hits(np.array(pose.position), direction)
    given = scan([FLOOR], pose, camera).points
    x = 0.25 / np.maximum(-direction[:, 2], 1e-9) * direction[:, 0]
    shares = []
    for low, high in ((0.5, 0.8), (1.2, 1.6), (3.0, 3.5)):
        expected = np.isfinite(hits.distance) & (x > low) & (x < high)
        shares.append(((given[:, 0] > low) & (given[:, 0] < high)).sum() / expected.sum())
    assert shares[0] > 0.95
    assert 0.4 < shares[1] < 0.95
    assert shares[2] < 0.5


def test_the_rosette_fills_its_cone_and_never_leaves_it() -> None:
    directions = SolidState().directions()
    angle = np.degrees(np.arccos(directions[:, 0]))
    assert angle.max() <= 35.2 + 1e-9
    cell = np.round(np.degrees(np.arctan2(directions[:, 1:], directions[:, :1]))).astype(int)
    inside = {(y, z) for y in range(-34, 35) for z in range(-34, 35) if np.hypot(y, z) < 30.0}
    assert inside <= {(int(y), int(z)) for y, z in cell}


def test_a_camera_gives_one_ray_per_pixel_row_by_row() -> None:
    camera = DepthCamera(width=8, height=6)
    directions = camera.directions().reshape(6, 8, 3)
    assert (np.diff(directions[..., 1] / directions[..., 0], axis=1) < 0).all()
    assert (np.diff(directions[..., 2] / directions[..., 0], axis=0) < 0).all()


def test_shapes_have_the_sizes_asked_for() -> None:
    bar = capsule((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 0.1).vertices
    assert np.allclose([bar[:, 2].min(), bar[:, 2].max(), np.abs(bar[:, 0]).max()], [-0.1, 1.1, 0.1])
    tube = Caster(pipe((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), 0.1, 0.01))
    rays = np.array([[0.0, 0.05, 0.0], [0.0, 0.095, 0.0]]) - [0.5, 0.0, 0.0]
    distance = tube.hits(rays, np.tile([1.0, 0.0, 0.0], (2, 1))).distance
    assert np.isinf(distance[0])
    assert distance[1] == pytest.approx(0.5, abs=1e-6)
    cup = lathe([(0.0, 0.0), (0.2, 0.0), (0.2, 0.3)], (1.0, 0.0, 0.0)).vertices
    assert np.allclose(np.hypot(cup[:, 0] - 1.0, cup[:, 1]).max(), 0.2)


def test_unknown_scenes_are_refused_by_name() -> None:
    with pytest.raises(PerceptionError, match=r"unknown scene 'moon'; expected one of .*valve_small"):
        make_scene("moon")


@pytest.mark.parametrize("name", SCENES)
def test_a_scene_is_the_same_each_time_and_another_with_another_seed(name: str) -> None:
    first, again, other = made(name, 0), make_scene(name, 0), made(name, 1)
    vertices = [join_meshes(scene.meshes).vertices for scene in (first, again, other)]
    assert np.array_equal(vertices[0], vertices[1])
    assert vertices[0].shape != vertices[2].shape or not np.array_equal(vertices[0], vertices[2])


@pytest.mark.parametrize("name", ["valve_plain", "door_left_ajar", "debris_one", "car_inside"])
def test_a_scan_of_a_scene_is_the_same_each_time(name: str) -> None:
    assert np.array_equal(*(scene.scan("camera_sparse").points for scene in (made(name, 0), make_scene(name, 0))))


def expected_keys(kind: str, sizes: dict[str, float]) -> set[str]:
    """What common detectors call the sizes of a kind."""
    if kind == "valve":
        wheel, lever = {"outer_radius", "rim_radius", "tube_radius"}, {"lever_length", "lever_radius"}
        return lever if "lever_length" in sizes else wheel
    if kind == "panel":
        known = ("x", "y", "radius", "height")
        buttons = {f"button_{i}_{what}" for i in range(int(sizes["n_buttons"])) for what in known}
        return {"width", "height", "n_buttons"} | buttons
    return {
        "door": {"width", "height", "ajar", "handle_x", "handle_y", "handle_z", "lever_direction", "side"},
        "lever": {"length", "radius"},
        "drill": {"grip_length", "body_length"},
        "beam": {"length", "width", "thickness"},
        "hose": {"radius"},
        "seat": {"width", "depth", "height"},
        "opening": {"width", "height", "sill"},
    }[kind]


@pytest.mark.parametrize("name", SCENES)
def test_truth_is_in_a_right_handed_frame_with_the_sizes_of_its_kind(name: str) -> None:
    for truth in made(name, 0).truth:
        rotation = truth.pose_world_object[:3, :3]
        assert np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
        assert np.linalg.det(rotation) == pytest.approx(1.0)
        assert set(truth.sizes) == expected_keys(truth.kind, dict(truth.sizes))


def test_every_kind_has_a_scene_and_many_have_none() -> None:
    recipes = [name for name in SCENES if not name.startswith("debris")]
    kinds = [{truth.kind for truth in made(name, 0).truth} for name in (*recipes, "debris_one")]
    assert set.union(*kinds) == {"valve", "door", "panel", "lever", "drill", "beam", "hose", "seat", "opening"}
    assert sum(not found for found in kinds) >= 6
    assert len(SCENES) >= 30


def test_an_open_leaf_seen_from_behind_is_told_by_the_face_that_is_seen() -> None:
    truth = make_scene("door_left_wide_open").truth[0]
    door = Door((1.45, 0.45), -np.pi / 2, "left", ajar=np.radians(80.0))
    assert truth.sizes["side"] == 1.0
    assert door.build().truth[0].sizes["side"] == 1.0
    ahead = Door((1.45, 0.45), -np.pi / 2, "left", ajar=np.radians(10.0)).build().truth[0]
    assert ahead.sizes["side"] == -1.0
    behind = door.build().truth[0].pose_world_object
    pin = np.array([1.45, 0.45, 0.0])
    assert np.linalg.norm(behind[:3, 3] - pin) == pytest.approx(door.thickness)


def on_surface(scene: SimulatedScene, pose: np.ndarray, local: list[tuple[float, float, float]]) -> np.ndarray:
    """How far places of an object's own frame are from the scene's surfaces [m]."""
    places = np.array(local) @ pose[:3, :3].T + pose[:3, 3]
    return Caster(join_meshes(scene.meshes)).distance(places)


def surface_places(kind: str, s: dict[str, float]) -> list[tuple[float, float, float]]:
    """Places that must lie on an object's surface, by its kind and sizes, in its own frame."""
    turn = [(np.cos(a), np.sin(a)) for a in np.linspace(0.0, 6.0, 9)]
    if kind == "valve" and "rim_radius" in s:
        ring = [(s["outer_radius"] * c, s["outer_radius"] * d, 0.0) for c, d in turn]
        return ring + [(s["rim_radius"] * c, s["rim_radius"] * d, s["tube_radius"]) for c, d in turn]
    if kind in ("valve", "lever"):
        length, radius = s.get("lever_length", s.get("length", 0.0)), s.get("lever_radius", s.get("radius", 0.0))
        return [(length, 0.0, 0.0), (0.6 * length, 0.0, radius), (0.6 * length, radius, 0.0)]
    if kind == "door":
        low, high = 0.01, s["height"]
        return [(0.001, 0.0, 0.5), (s["width"], 0.0, high), (s["width"], 0.0, 1.5), (0.5 * s["width"], 0.0, low)]
    if kind == "panel":
        w, h = 0.5 * s["width"], 0.5 * s["height"]
        return [(w, h, 0.0), (-w, h, 0.0), (w, -h, 0.0), (-w, -h, 0.0), (0.9 * w, 0.9 * h, 0.0)]
    if kind == "drill":
        return [(-0.02, 0.0, -0.4 * s["grip_length"])]
    if kind == "beam":
        return [tuple(p) for p in 0.5 * np.array([s["length"], s["width"], s["thickness"]]) * np.array(
            [(1, 1, 1), (-1, 1, 1), (1, -1, 1), (1, 1, -1), (0, 0, 1), (0, 1, 0), (1, 0, 0)])]  # fmt: skip
    if kind == "hose":
        return [(s["radius"] * c, s["radius"] * d, 0.0) for c, d in turn]
    if kind == "seat":
        return [(0.5 * s["depth"], 0.5 * s["width"], 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, -s["height"] + 0.0)]
    return [(0.0, 0.0, 0.0), (0.0, 0.0, s["height"])]


@pytest.mark.parametrize("name", SCENES)
def test_the_meshes_are_where_the_truth_says(name: str) -> None:
    scene = made(name, 1)
    for truth in scene.truth:
        apart = on_surface(scene, truth.pose_world_object, surface_places(truth.kind, dict(truth.sizes)))
        assert apart.max() < 0.006, (truth.kind, apart)


@pytest.mark.parametrize("name", SCENES)
def test_what_is_to_be_found_faces_the_sensor_and_is_in_view(name: str) -> None:
    scene = made(name, 0)
    points = {variant: scene.scan(variant).points for variant in ("sparse", "camera_sparse")}
    for truth in scene.truth:
        position, rotation = truth.pose_world_object[:3, 3], truth.pose_world_object[:3, :3]
        towards = np.array(scene.poses[0].position) - position
        if truth.kind in ("valve", "panel", "lever"):
            assert rotation[:, 2] @ towards > 0.0
        if truth.kind == "door":
            assert truth.sizes["side"] * (rotation[:, 1] @ towards) > 0.0
            handle = [truth.sizes[key] for key in ("handle_x", "handle_y", "handle_z")]
            assert truth.sizes["side"] * handle[1] > 0.0
            position = position + rotation @ np.array(handle)
        if truth.kind in ("beam", "seat", "opening"):
            continue
        near = [int((np.linalg.norm(cloud - position, axis=1) < 0.15).sum()) for cloud in points.values()]
        assert min(near) > 12, (truth.kind, near)


def test_variants_hold_dense_and_sparse_of_three_sensors() -> None:
    assert {type(sensor) for sensor in VARIANTS.values()} == {Scanner, SolidState, DepthCamera, TimeOfFlight}
    scene = make_scene("valve_small")
    count = {variant: len(scene.scan(variant).points) for variant in VARIANTS}
    for name in ("solid", "camera"):
        assert count[f"{name}_sparse"] < 0.5 * count[name]
    assert count["sparse"] < 0.6 * count["dense"]
