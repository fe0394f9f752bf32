"""Doors in simulated and recorded scans: leaf, hinge side, handle and opening, and no door where there is none."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from perception import Detection, View, detect, make_view, read_cloud
from perception.detect.door.edges import side_edge, unevenness
from perception.detect.door.handle import find_handle
from perception.detect.door.profile import BIN, Profile, Rays, straight_stretches, take_profile
from perception.detect.door.upright import Upright, find_uprights
from perception.simulate import DepthCamera, Mesh, Pose, Scanner, box, cylinder, scan
from perception.simulate.scenes import make_scene
from perception.simulate.scenes.doors import Door
from perception.simulate.scenes.scene import Truth

_FLOOR = box((-6.0, -6.0, -0.1), (6.0, 6.0, 0.0))
_BACK = box((3.8, -4.0, 0.0), (3.9, 4.0, 2.6))
_SENSOR = Scanner(n_beams=541)
_SPARSE = Scanner(n_beams=541, n_lines=60, sigma=0.015)


def _door(hinge_on: str, distance: float = 1.0, turned_deg: float = 0.0, **kind: object) -> Door:
    """A door whose middle is ahead of the robot."""
    along = (-0.5 if hinge_on == "left" else 0.5) * np.pi + np.radians(turned_deg)
    hinge = np.array([distance, 0.0]) - 0.45 * np.array([np.cos(along), np.sin(along)])
    return Door((hinge[0], hinge[1]), along, hinge_on, **kind)  # type: ignore[arg-type]


def _view(door: Door, sensor: Scanner | DepthCamera | None = None, seed: int = 1) -> tuple[View, Truth]:
    placed = door.build()
    cloud = scan([*placed.meshes, _FLOOR, _BACK], Pose(pitch=0.3), sensor or _SENSOR, seed)
    return make_view(cloud), placed.truth[0]


def _without(meshes: list[Mesh], seed: int = 1) -> list[Detection]:
    return detect("door", make_view(scan([*meshes, _FLOOR], Pose(pitch=0.3), _SENSOR, seed)))


def _normal(pose: np.ndarray, side: float) -> np.ndarray:
    return np.asarray(pose[:3, 1] * side)


def _handle(pose: np.ndarray, sizes: dict[str, float]) -> np.ndarray:
    return np.asarray((pose @ [sizes["handle_x"], sizes["handle_y"], sizes["handle_z"], 1.0])[:3])


def _check(found: Detection, truth: Truth, scale: float = 1.0) -> None:
    """Leaf, hinge side, width, handle and angle, within the targets times ``scale``."""
    pose, true = found.pose_world_object, truth.pose_world_object
    normal = _normal(true, truth.sizes["side"])
    assert np.degrees(np.arccos(np.clip(_normal(pose, found.sizes["side"]) @ normal, -1.0, 1.0))) < 1.0 * scale
    assert abs(normal @ (pose[:3, 3] - true[:3, 3])) < 0.005 * scale
    assert pose[:3, 0] @ true[:3, 0] > 0.99, "hinge side"
    assert np.linalg.norm(pose[:2, 3] - true[:2, 3]) < 0.05 * scale
    assert abs(found.sizes["width"] - truth.sizes["width"]) < 0.04 * scale
    assert abs(found.sizes["height"] - truth.sizes["height"]) < 0.05 * scale
    assert abs(np.degrees(found.sizes["ajar"] - truth.sizes["ajar"])) < 1.0 * scale
    assert np.linalg.norm(_handle(pose, dict(found.sizes)) - _handle(true, dict(truth.sizes))) < 0.02 * scale
    # The middle line of its bar, not the near side that rays from above meet.
    assert abs(found.sizes["handle_z"] - truth.sizes["handle_z"]) < 0.01 * scale
    assert abs(abs(found.sizes["handle_y"]) - abs(truth.sizes["handle_y"])) < 0.01 * scale
    assert found.sizes["lever_direction"] == truth.sizes["lever_direction"]


@pytest.mark.parametrize(
    "door",
    [
        _door("left"),
        _door("right", 1.6, 35.0, side="push"),
        _door("left", 1.5, -30.0, ajar=0.4, handle_z=1.08),
        _door("right", 1.3, side="push", ajar=0.5, furniture="knob"),
    ],
    ids=["left", "right push oblique", "left ajar", "right push ajar knob"],
)
def test_a_dense_scan_gives_leaf_hinge_handle_and_angle(door: Door) -> None:
    view, truth = _view(door, Scanner())
    found = detect("door", view)
    assert found[0].confidence >= 0.5
    assert not any(other.confidence >= 0.5 for other in found[1:])
    _check(found[0], truth)


def test_a_sparse_scan_is_within_twice_that_or_not_confident() -> None:
    for seed in range(3):
        view, truth = _view(_door("left", 1.2, 10.0 * seed), _SPARSE, seed)
        for found in detect("door", view):
            if found.confidence >= 0.5:
                _check(found, truth, 2.0)


def test_a_depth_camera_that_sees_neither_top_nor_bottom_still_finds_the_door() -> None:
    view, truth = _view(_door("right", 1.5), DepthCamera())
    found = detect("door", view)[0]
    assert found.confidence >= 0.5
    assert found.pose_world_object[:3, 0] @ truth.pose_world_object[:3, 0] > 0.99


def test_the_hinge_side_of_a_shut_door_with_a_bar_across_is_not_claimed_even_with_a_hint() -> None:
    view, truth = _view(_door("left", side="push", furniture="bar"))
    found = detect("door", view, (truth.pose_world_object @ [0.4, 0.0, 1.0, 1.0])[:3])
    assert found, "the leaf is there"
    assert found[0].confidence < 0.5


def test_an_open_leaf_tells_its_hinge_side_without_a_handle() -> None:
    view, truth = _view(_door("left", 1.4, side="push", furniture="bar", ajar=0.6))
    found = detect("door", view)[0]
    assert found.confidence >= 0.5
    assert found.pose_world_object[:3, 0] @ truth.pose_world_object[:3, 0] > 0.99


def test_a_leaf_seen_along_its_face_so_that_no_handle_is_seen_is_not_one_to_act_on() -> None:
    scene = make_scene("door_left_wide_open", 1)
    found = detect("door", make_view(scene.scan("dense")))[0]
    assert abs(found.pose_world_object[:3, 1] @ scene.truth[0].pose_world_object[:3, 1]) > 0.999
    assert "handle_x" not in found.sizes
    assert 0.1 < found.confidence < 0.5


def test_a_lever_before_the_far_edge_of_an_open_leaf_ends_where_rays_went_past_the_leaf() -> None:
    scene = make_scene("door_left_push_half_open", 51)
    found = detect("door", make_view(scene.scan("dense")))[0]
    assert found.confidence > 0.5
    _check(found, scene.truth[0])


def test_where_no_floor_was_seen_a_door_stands_at_zero_height() -> None:
    view, truth = _view(_door("left"), DepthCamera(), seed=2)
    lifted = view.near.points[:, 2] > 0.3
    found = detect("door", replace(view, floors=(), near=view.near.select(lifted)))[0]
    assert found.pose_world_object[2, 3] == 0.0
    assert found.sizes["handle_z"] == pytest.approx(truth.sizes["handle_z"], abs=0.02)


def test_a_bar_that_goes_on_above_and_below_is_no_handle() -> None:
    up, across = (grid.ravel() for grid in np.meshgrid(np.linspace(0.2, 1.9, 340), np.linspace(-0.5, 0.5, 200)))
    plane = Upright(np.array([-1.0, 0.0, 0.0]), -1.0)
    starts = np.column_stack([np.zeros_like(up), across, up])
    quality = {}
    for name, low, high in (("pull", 0.85, 1.25), ("pipe", 0.0, 2.0)):
        on_bar = (np.abs(across - 0.4) < 0.02) & (up > low) & (up < high)
        ends = np.column_stack([np.where(on_bar, 0.95, 1.0), across, up])
        handle = find_handle(plane, -0.5, 0.5, 0.004, 0.0, Rays(starts, ends))
        assert handle is not None
        assert handle.is_pull
        quality[name] = handle.quality
    assert quality["pull"] > 0.8
    assert quality["pipe"] == 0.0


def test_what_stands_out_of_a_face_no_more_than_its_noise_dents_it_is_no_handle() -> None:
    up, across = (grid.ravel() for grid in np.meshgrid(np.linspace(0.2, 1.9, 340), np.linspace(-0.5, 0.5, 200)))
    plane = Upright(np.array([-1.0, 0.0, 0.0]), -1.0)
    starts = np.column_stack([np.zeros_like(up), across, up])
    bulge = (np.abs(across - 0.4) < 0.03) & (np.abs(up - 1.0) < 0.05)
    dent = (np.abs(across + 0.4) < 0.03) & (np.abs(up - 1.0) < 0.05)
    noisy, clear = (
        find_handle(plane, -0.5, 0.5, 0.017, 0.0, Rays(starts, np.column_stack([at, across, up])))
        for at in (1.0 - 0.05 * bulge + 0.05 * dent, 1.0 - 0.05 * bulge)
    )
    assert noisy is None
    assert clear is not None
    assert clear.quality > 0.8


def test_a_step_no_larger_than_the_face_is_uneven_ends_no_face() -> None:
    depth = np.concatenate([0.014 * np.sin(np.arange(40) / 2.0), [0.014, 0.02, 0.02, 0.014], np.zeros(16)])
    counts = np.full(60, 15)
    profile = Profile(0.0, depth, np.full(60, 0.001), counts, np.zeros(60, dtype=int))
    uneven = unevenness(profile, 0, 40)
    assert 0.008 < uneven < 0.016
    assert side_edge(profile, 40, 1, np.zeros((0, 3)), 0.0).strength == 1.0
    assert side_edge(profile, 40, 1, np.zeros((0, 3)), 0.0, uneven).strength == 0.0
    noise = np.random.default_rng(0).normal(0.0, 0.01, 60)
    assert unevenness(replace(profile, depth=noise, sigma=np.full(60, 0.012)), 0, 40) == 0.0


@pytest.mark.parametrize(("sigma", "is_sure"), [(0.001, True), (0.02, False)])
def test_a_casing_five_centimetres_wide_ends_a_face_where_noise_cannot_explain_it(sigma: float, is_sure: bool) -> None:
    depth = np.zeros(60)
    depth[40:43] = [0.008, 0.016, 0.012]
    counts = np.full(60, 15)
    profile = Profile(0.0, depth, np.full(60, sigma), counts, np.zeros(60, dtype=int))
    edge = side_edge(profile, 40, 1, np.zeros((0, 3)), 0.0)
    assert (edge.strength > 0.9) == is_sure
    assert side_edge(profile, 20, 1, np.zeros((0, 3)), 0.0).strength == 0.0


def test_a_hint_leaves_only_what_is_near_it_and_raises_confidence() -> None:
    view, truth = _view(_door("left", 2.2), _SPARSE, 3)
    place = _handle(truth.pose_world_object, dict(truth.sizes))
    blind, led = detect("door", view)[0], detect("door", view, place)[0]
    assert np.allclose(blind.pose_world_object, led.pose_world_object)
    assert led.confidence > blind.confidence or led.confidence == pytest.approx(1.0)
    assert not detect("door", view, place + np.array([-1.5, 2.0, 0.0]))


def test_the_same_view_gives_the_same_doors() -> None:
    view, _ = _view(_door("left", ajar=0.3))
    first, second = detect("door", view)[0], detect("door", view)[0]
    assert np.array_equal(first.pose_world_object, second.pose_world_object)
    assert first.sizes == second.sizes


_WALL = box((1.5, -2.0, 0.0), (1.6, 2.0, 2.6))
_NO_DOORS = {
    "bare wall": [_WALL],
    "board on a wall": [_WALL, box((1.47, -0.45, 0.7), (1.5, 0.45, 1.9))],
    "cupboard with handles": [
        _WALL,
        box((1.1, -0.45, 0.0), (1.5, 0.45, 1.95)),
        cylinder((1.06, 0.38, 0.9), (1.06, 0.38, 1.15), 0.008, 12),
    ],
    "wall between pipes": [
        _WALL,
        *(cylinder((1.38, y, 0.0), (1.38, y, 2.4), 0.04) for y in (-0.5, 0.5)),
        cylinder((1.4, 0.4, 0.8), (1.4, 0.4, 1.2), 0.01, 12),
    ],
    "niche": [
        box((1.5, -2.0, 0.0), (1.9, -0.45, 2.6)),
        box((1.5, 0.45, 0.0), (1.9, 2.0, 2.6)),
        box((1.6, -0.45, 0.0), (1.9, 0.45, 2.6)),
        box((1.5, -0.45, 2.1), (1.9, 0.45, 2.6)),
    ],
    "doorway without a leaf": [
        box((1.5, -2.0, 0.0), (1.6, -0.45, 2.6)),
        box((1.5, 0.45, 0.0), (1.6, 2.0, 2.6)),
        box((1.5, -0.45, 2.1), (1.6, 0.45, 2.6)),
        _BACK,
    ],
    "window": [
        box((1.5, -2.0, 0.0), (1.65, -0.45, 2.6)),
        box((1.5, 0.45, 0.0), (1.65, 2.0, 2.6)),
        box((1.5, -0.45, 0.0), (1.65, 0.45, 0.9)),
        box((1.58, -0.45, 0.9), (1.6, 0.45, 2.6)),
        cylinder((1.58, 0.38, 1.2), (1.52, 0.38, 1.2), 0.012, 12),
    ],
}


@pytest.mark.parametrize("name", _NO_DOORS)
def test_where_there_is_no_door_none_is_confident(name: str) -> None:
    assert not any(found.confidence >= 0.5 for found in _without(_NO_DOORS[name]))


def test_the_recorded_door_is_found(shared_data: Path) -> None:
    view = make_view(read_cloud(shared_data / "scenes" / "door_a" / "scan0.pcd"))
    found = detect("door", view)[0]
    assert found.confidence >= 0.5
    pose = found.pose_world_object
    assert np.degrees(np.arccos(_normal(pose, found.sizes["side"]) @ [-1.0, 0.0, 0.0])) < 1.0
    assert abs(pose[0, 3] - 0.762737) < 0.005
    assert pose[1, 3] < 0.0, "hinges are on the right"
    assert found.sizes["lever_direction"] == -1.0
    # The lever's neck, of the mesh: its spindle lies at y = 0.342, z = 1.05.
    handle = _handle(pose, dict(found.sizes))
    assert np.hypot(handle[1] - 0.342, handle[2] - 1.05) < 0.02


def test_planes_are_found_by_how_tall_they_stand() -> None:
    rng = np.random.default_rng(0)
    along, up = rng.uniform(-1.0, 1.0, 4000), rng.uniform(0.0, 2.0, 4000)
    wall = np.column_stack([1.0 + 0.5 * along, along, up])
    low = np.column_stack([rng.uniform(0.0, 1.0, 4000), rng.uniform(0.0, 1.0, 4000), rng.uniform(0.0, 0.1, 4000)])
    plane = find_uprights(np.concatenate([wall, low]), np.zeros(3))[0]
    assert np.allclose(plane.normal, np.array([-1.0, 0.5, 0.0]) / np.sqrt(1.25), atol=1e-3)
    assert plane.offset == pytest.approx(-1.0 / np.sqrt(1.25), abs=1e-3)


def test_a_profile_is_cut_where_its_depth_steps() -> None:
    depth = np.concatenate([np.zeros(20), np.full(30, -0.03), np.full(5, np.nan), np.full(20, -0.03)])
    storeys = np.where(np.isnan(depth), 0, 10)
    profile = Profile(0.0, depth, np.full(75, 0.002), storeys, 10 - storeys)
    stretches = straight_stretches(profile)
    assert [(one.first, one.last) for one in stretches] == [(0, 20), (20, 50), (50, 55), (55, 75)]
    assert np.isnan(stretches[2].slope)
    assert stretches[1].slope * 35 * BIN + stretches[1].intercept == pytest.approx(-0.03)


def _wavy_wall(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Starts and ends of the rays of a depth camera at a wall 1 m ahead: 2 cm of error that 5 cm about share."""
    up, across = np.meshgrid(np.arange(0.2, 1.9, 0.005), np.arange(-0.6, 0.6, 0.005), indexing="ij")
    error = gaussian_filter(np.random.default_rng(seed).normal(size=up.shape), 3.0)
    ends = np.column_stack([1.0 + (0.02 * error / error.std()).ravel(), across.ravel(), up.ravel()])
    return ends * [0.0, 1.0, 1.0], ends


def test_a_flat_face_stays_one_stretch_where_neighbouring_pixels_err_together() -> None:
    plane = Upright(np.array([-1.0, 0.0, 0.0]), -1.0)
    starts, ends = _wavy_wall(0)
    profile = take_profile(plane, ends, Rays(starts, ends), 0.25, 1.8)
    mine = np.flatnonzero(profile.is_solid)[1:-1]
    error = float(np.std(profile.depth[mine]))
    assert 0.5 * error < float(np.median(profile.sigma[mine])) < 1.5 * error
    assert sum(not np.isnan(one.slope) and one.last - one.first > 4 for one in straight_stretches(profile)) == 1
    alone = ends + np.random.default_rng(1).normal(0.0, 0.02, len(ends))[:, None] * [1.0, 0.0, 0.0]
    alone[:, 0] += 1.0 - ends[:, 0]
    clean = take_profile(plane, alone, Rays(starts, alone), 0.25, 1.8)
    assert float(np.median(clean.sigma[mine])) < 0.002


def test_a_bulge_of_a_face_is_no_handle_but_a_bar_with_air_behind_it_is() -> None:
    up, across = (grid.ravel() for grid in np.meshgrid(np.linspace(0.2, 1.9, 340), np.linspace(-0.5, 0.5, 200)))
    plane = Upright(np.array([-1.0, 0.0, 0.0]), -1.0)
    starts = np.column_stack([np.zeros_like(up), across, up])
    aside = np.hypot((across - 0.36) / 2.0, up - 1.0)
    bulge = 0.045 * np.exp(-0.5 * (aside / 0.02) ** 2)
    bar = 0.055 * ((np.abs(across - 0.36) < 0.06) & (np.abs(up - 1.0) < 0.01))
    none, lever = (
        find_handle(plane, -0.5, 0.5, 0.012, 0.0, Rays(starts, np.column_stack([1.0 - out, across, up])))
        for out in (bulge, bar)
    )
    assert none is None or none.quality < 0.1
    assert lever is not None
    assert lever.quality > 0.8


def test_rays_cross_a_plane_where_the_straight_line_does() -> None:
    plane = Upright(np.array([-1.0, 0.0, 0.0]), -1.0)
    rays = Rays(np.zeros((3, 3)), np.array([[2.0, 1.0, 1.0], [0.5, 0.0, 0.2], [-1.0, 0.0, 0.0]]))
    at, end, heading = rays.crossing(plane)
    assert np.allclose(at[0], plane.local(np.array([[1.0, 0.5, 0.5]]))[0, :2])
    assert np.allclose(end[:2], [-1.0, 0.5])
    assert heading.tolist() == [True, True, False]
