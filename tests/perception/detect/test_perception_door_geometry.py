"""Geometry of detected doors: hinge axis, opening direction and handle, and the doorway without its leaf."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from perception import Detection, Perceived, PerceptionError, choose_opening, detect, make_view, perceive, read_door
from perception.detect.door.bar import EXTENSIONS, Bar, NearRays, expect_extension, fit_bar, rate_extensions
from perception.detect.door.bodies import door_bodies
from perception.detect.door.geometry import DoorGeometry
from perception.detect.door.hang import find_step
from perception.detect.door.model import DoorModel, door_points
from perception.detect.door.profile import Rays
from perception.detect.door.upright import Upright
from perception.simulate import Pose, Scanner, box, join_meshes, scan
from perception.simulate.scenes.doors import Door, truth_geometry
from service.demands.door.demand import SeenDoor, choose_door
from service.request.tasks.door import DoorRequest

_AROUND = [box((-6.0, -6.0, -0.1), (6.0, 6.0, 0.0)), box((3.8, -4.0, 0.0), (3.9, 4.0, 2.6))]
_LEFT = Door(hinge=(0.95, 0.42), along=-1.62, hinge_on="left", width=0.86)
_RIGHT = Door(hinge=(1.05, -0.5), along=1.5, hinge_on="right", width=0.97, backset=0.06, lever_length=0.15)
_TURN = float(np.radians(25.0))
DOORS = {
    "pull shut": _LEFT,
    "pull ajar, lever turned": replace(_RIGHT, ajar=0.35, lever_turn=_TURN),
    "pull shut, pull handle": replace(_RIGHT, furniture="pull", pull_length=0.4, handle_radius=0.0125),
    "push shut, lever turned": replace(_LEFT, side="push", lever_turn=_TURN),
    "push ajar": replace(_RIGHT, side="push", ajar=0.15, gap=0.003, reveal=0.006),
    "push ajar, bar": replace(_LEFT, side="push", ajar=0.3, furniture="bar"),
    "pull shut, deep": replace(_RIGHT, recess=0.07, wall_thickness=0.16),
}
_DOORWAYS = ("pull shut", "push ajar")


def _cloud(door: Door) -> object:
    return scan([*door.build().meshes, *_AROUND], Pose((0.1, 0.0, 1.62), pitch=0.3), Scanner(n_beams=541), 3)


@cache
def _found(name: str) -> Detection:
    if name in _DOORWAYS:
        return _perceived(name).detections[0]
    return detect("door", make_view(_cloud(DOORS[name])))[0]  # type: ignore[arg-type]


@cache
def _perceived(name: str) -> Perceived:
    return perceive(_cloud(DOORS[name]), kinds=("door",))  # type: ignore[arg-type]


def _angle(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.degrees(np.arccos(np.clip(one @ other, -1.0, 1.0))))


@pytest.mark.parametrize("name", DOORS)
def test_a_scan_gives_hinge_axis_width_and_handle(name: str) -> None:
    truth = truth_geometry(DOORS[name])
    found = read_door(_found(name))
    if found.opens is None:
        found = choose_opening(found, truth.opens)  # type: ignore[arg-type]
    assert _found(name).confidence >= 0.5
    assert np.linalg.norm((found.hinge - truth.hinge)[:2]) < 0.01
    assert found.along @ truth.along > 0.9999
    assert _angle(found.normal, truth.normal) < 0.5
    assert abs(found.width - truth.width) < 0.012
    assert abs(found.height - truth.height) < 0.03
    assert abs(found.face - truth.face) < 1e-9
    assert np.degrees(abs(found.ajar - truth.ajar)) < 0.5
    one, other = found.handle, truth.handle
    assert one is not None
    assert other is not None
    assert one.kind == other.kind
    assert np.linalg.norm(one.centre - other.centre) < 0.008
    assert one.direction @ other.direction > 0.999
    assert abs(one.length - other.length) < 0.02
    assert abs(one.radius - other.radius) < 0.004
    assert np.degrees(abs(found.handle_turn - truth.handle_turn)) < 3.0


@pytest.mark.parametrize("name", DOORS)
def test_the_opening_direction_is_right_or_unknown(name: str) -> None:
    opens, share = read_door(_found(name)).opens, _found(name).residuals["opens_share"]
    assert opens == (None if name == "pull shut, deep" else DOORS[name].side)
    assert (share > 0.0) == (opens is not None)
    assert share == 1.0 or DOORS[name].ajar == 0.0


def test_a_stated_hinge_side_completes_a_shut_door_with_a_bar_across() -> None:
    door = Door((0.9, -0.4), 0.5 * np.pi, "right", "push", furniture="bar")
    view, truth = make_view(_cloud(door)), truth_geometry(door)  # type: ignore[arg-type]
    found = {kind: detect(kind, view)[0] for kind in ("door", "door_left", "door_right")}
    assert found["door"].confidence < 0.5
    assert found["door"].residuals["hinge_share"] == 0.0
    for side in ("left", "right"):
        hit = found[f"door_{side}"]
        assert hit.confidence >= 0.5
        assert hit.residuals["hinge_share"] == 0.0
        is_near = bool(np.linalg.norm((read_door(hit).hinge - truth.hinge)[:2]) < 0.01)
        assert is_near == (side == "right")
    seen = {kind: (SeenDoor(read_door(hit), hit.confidence, knows_hinge=False),) for kind, hit in found.items()}
    words = choose_door(DoorRequest(), seen["door"], np.zeros(3))
    assert "say it in task.door.hinge (left or right, as seen by the robot)" in words
    chosen = choose_door(DoorRequest(hinge="right"), seen["door_right"], np.zeros(3))
    assert chosen.along @ truth.along > 0.999
    sure = (SeenDoor(truth, 0.9),)
    assert "on its right; task.door.hinge is left" in choose_door(DoorRequest(hinge="left"), sure, np.zeros(3))


def test_the_hinge_side_of_a_door_that_stands_ajar_is_known_with_a_bar_across() -> None:
    assert _found("push ajar, bar").residuals["hinge_share"] == 1.0


def test_an_open_leaf_seen_from_behind_still_tells_its_hinge_axis() -> None:
    door = Door((1.45, 0.45), -np.pi / 2, "left", ajar=np.radians(80.0))
    truth = truth_geometry(door)
    assert door.build().truth[0].sizes["side"] == 1.0, "its far face is seen"
    found = read_door(detect("door", make_view(_cloud(door)))[0])  # type: ignore[arg-type]
    assert found.opens == "pull"
    assert found.handle is None
    assert np.linalg.norm((found.hinge - truth.hinge)[:2]) < 0.02
    assert _angle(found.normal, truth.normal) < 1.0


def test_only_a_door_has_the_geometry_of_a_door() -> None:
    with pytest.raises(PerceptionError, match="a detected valve has no geometry of a door"):
        read_door(Detection("valve", np.eye(4), {}, 1.0, {}, np.zeros((0, 3))))


def test_choosing_the_opening_moves_the_hinge_axis_to_the_other_face_and_nothing_else() -> None:
    pull = truth_geometry(_LEFT)
    push = choose_opening(pull, "push")
    assert np.allclose(pull.hinge - push.hinge, pull.thickness * pull.normal)
    leaf, moved = (door_bodies(geometry)["door/leaf"]["leaf"] for geometry in (pull, push))
    assert np.allclose(leaf, moved)
    assert np.allclose(push.hinge_axis, -pull.hinge_axis)
    assert np.allclose(choose_opening(push, "pull").hinge, pull.hinge)


def _inside(points: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    planes = ConvexHull(vertices).equations
    return np.asarray((points @ planes[:, :3].T + planes[:, 3]).max(axis=1) < -0.002)


@pytest.mark.parametrize("name", _DOORWAYS)
def test_the_doorway_of_a_detected_door_is_empty_and_its_frame_stays(name: str) -> None:
    seen, geometry = _perceived(name), truth_geometry(DOORS[name])
    u = np.random.default_rng(0).uniform(size=(1500, 3))
    # From behind the leaf to 12 cm before it: the handle goes, too.
    along, out = 0.03 + u[:, 0] * (geometry.width - 0.06), geometry.face - 0.045 + u[:, 1] * 0.165
    doorway = geometry.hinge + along[:, None] * geometry.along + out[:, None] * geometry.normal
    doorway[:, 2] += 0.05 + 1.9 * u[:, 2]
    pieces = [piece for piece in seen.scene.pieces if not piece.name.startswith("floor")]
    blocked = np.any([_inside(doorway, piece.vertices) for piece in pieces], axis=0)
    assert blocked.mean() < 0.002
    for beside in (-0.2, geometry.width + 0.2):
        place = geometry.hinge + beside * geometry.along + [0.0, 0.0, 1.2]
        through = place + np.linspace(-0.2, 0.2, 81)[:, None] * geometry.normal
        assert any(_inside(through, piece.vertices).any() for piece in pieces), "the wall stays"


@settings(max_examples=15, deadline=None)
@given(
    side=st.sampled_from(["pull", "push"]),
    hinge_on=st.sampled_from(["left", "right"]),
    furniture=st.sampled_from(["lever", "pull", "bar", "knob"]),
    ajar=st.floats(0.0, 0.9),
    turn=st.floats(0.0, 0.6),
)
def test_a_doors_points_are_its_own_meshes_as_seen_and_not_its_wall(
    side: str, hinge_on: str, furniture: str, ajar: float, turn: float
) -> None:
    door = replace(_LEFT, side=side, hinge_on=hinge_on, furniture=furniture, ajar=ajar, lever_turn=turn)  # type: ignore[arg-type]
    geometry = truth_geometry(door)
    frame = door._wall_frame() @ door._leaf_in_wall()
    own = [mesh.place(frame) for mesh in [door._leaf()[0], *door._furniture(0.0, 1.0)]]
    assert door_points(geometry, join_meshes(own).vertices).all()
    wall = np.concatenate([mesh.place(door._wall_frame()).vertices for mesh in door._surround()[:6]])
    assert not door_points(
        replace(geometry, ajar=0.0), wall[np.abs((wall - geometry.hinge) @ geometry.along) > 2.0]
    ).any()


@settings(max_examples=20, deadline=None)
@given(
    side=st.sampled_from(["pull", "push"]),
    hinge_on=st.sampled_from(["left", "right"]),
    ajar=st.floats(0.0, 0.9),
    seed=st.integers(0, 1000),
)
def test_every_point_in_the_box_of_a_leaf_is_the_doors_own(side: str, hinge_on: str, ajar: float, seed: int) -> None:
    geometry = truth_geometry(replace(_LEFT, side=side, hinge_on=hinge_on, ajar=ajar))  # type: ignore[arg-type]
    sides = DoorModel(geometry).list_sides()
    points = geometry.hinge + np.random.default_rng(seed).uniform([-1.2, -1.2, -0.2], [1.2, 1.2, 2.3], (4000, 3))
    inside = (points @ sides[:, :3].T + sides[:, 3] <= 0.0).all(axis=1)
    assert inside.any()
    assert door_points(geometry, points)[inside].all()


def test_a_lone_point_just_off_a_densely_seen_leaf_is_a_stray_and_a_small_object_is_not() -> None:
    geometry = replace(truth_geometry(_LEFT), ajar=0.0)
    grid = np.stack(np.meshgrid(np.arange(0.01, geometry.width, 0.012), np.arange(0.01, 2.0, 0.012)), axis=-1)
    along, up = grid.reshape(-1, 2).T

    def off(x: float, out: float, z: float) -> np.ndarray:
        place = geometry.hinge + x * geometry.along + (geometry.face + out) * geometry.normal
        return np.asarray(place + np.array([0.0, 0.0, z]))

    leaf = np.array([off(x, 0.0, z) for x, z in zip(along, up, strict=True)])
    lone, object_ = off(0.4, 0.05, 0.01), [off(0.2 + 0.01 * k, 0.05, 0.01) for k in range(4)]
    seen = np.vstack([leaf, lone, *object_])
    own, _ = DoorModel(geometry).split_off(seen)
    assert own[: len(leaf) + 1].all()
    assert not own[len(leaf) + 1 :].any()
    sparse = np.vstack([leaf[::20], lone])
    assert not DoorModel(geometry).split_off(sparse)[0][-1], "a sparse scan shows no more of a surface"


def test_rays_that_end_on_a_leaf_go_on_to_its_back_and_no_other_ray_changes() -> None:
    geometry = replace(truth_geometry(_LEFT), ajar=0.0)
    middle = geometry.hinge + 0.4 * geometry.along + np.array([0.0, 0.0, 1.2])
    start = middle + 1.5 * geometry.normal
    ends = np.stack([middle + (geometry.face + 0.005) * geometry.normal, middle + 0.3 * geometry.normal,
                     middle - 0.5 * geometry.along + geometry.face * geometry.normal])  # fmt: skip
    moved = DoorModel(geometry).see_past(start, ends)
    back = (moved[0] - geometry.hinge) @ geometry.normal
    assert back == pytest.approx(geometry.face - geometry.thickness)
    assert np.allclose(np.cross(moved[0] - start, ends[0] - start), 0.0)
    assert np.array_equal(moved[1:], ends[1:])


def test_pulling_a_leaf_out_of_its_wall_frees_the_rays_up_to_where_it_shuts() -> None:
    geometry: DoorGeometry = truth_geometry(replace(_LEFT, ajar=0.3))
    axis, far = geometry.hinge, 0.7 * geometry.width
    on_leaf = axis + far * (np.cos(0.3) * geometry.along + np.sin(0.3) * geometry.normal) + [0.0, 0.0, 1.0]
    start = on_leaf + 1.0 * geometry.normal
    moved = DoorModel(geometry).see_past(start, on_leaf[None])[0]
    assert (moved - axis) @ geometry.normal == pytest.approx(-geometry.thickness)


def _rays_on(bar: Bar, rng: np.random.Generator, noise: float) -> NearRays:
    """Rays from above and aside onto a face with a bar before it."""
    start = np.array([0.3, 1.6, 1.1])
    grid = np.stack(np.meshgrid(np.arange(-0.15, 0.15, 0.006), np.arange(0.85, 1.15, 0.006)), axis=-1).reshape(-1, 2)
    to = np.column_stack([grid, np.zeros(len(grid))])
    rays = NearRays.of(np.broadcast_to(start, to.shape), to, 0.008)
    outside, length = bar.reached_by(rays)
    return replace(rays, length=np.where(outside < 0.0, length, rays.length) + rng.normal(0.0, noise, len(grid)))


@settings(max_examples=4, deadline=None)
@given(
    tilt=st.floats(-0.7, 0.7), half=st.floats(0.04, 0.07), radius=st.floats(0.008, 0.013), out=st.floats(0.045, 0.065)
)
def test_a_fitted_bar_is_the_bar_that_the_rays_met(tilt: float, half: float, radius: float, out: float) -> None:
    axis = np.array([np.cos(tilt), np.sin(tilt)])
    true = Bar(np.array([0.01, 1.0]) + np.outer([-half, half], axis), out, radius, 0.0)
    rays = _rays_on(true, np.random.default_rng(1), 0.006)
    found = fit_bar(rays, Bar(np.array([[-0.03, 1.0], [0.03, 1.0]]), 0.05, 0.01, 0.0))
    assert np.abs(found.ends - true.ends).max() < 0.009
    assert abs(found.out - out) < 0.004
    assert abs(found.radius - radius) < 0.004
    assert found.cost < 0.0


def test_an_end_that_no_ray_limits_is_expected_where_the_prior_says() -> None:
    bar = Bar(np.array([[-0.05, 1.0], [0.05, 1.0]]), 0.05, 0.01, 0.0)
    rays = _rays_on(bar, np.random.default_rng(0), 0.004)
    past = (rays.start + rays.length[:, None] * rays.direction)[:, 0] < 0.03
    unseen = replace(rays, start=rays.start[past], direction=rays.direction[past], length=rays.length[past])
    short = replace(bar, ends=np.array([[-0.05, 1.0], [0.02, 1.0]]))
    rated = rate_extensions(unseen, short)[1]
    mean, spread = expect_extension(rated, -0.5 * ((EXTENSIONS - 0.03) / 0.004) ** 2)
    assert mean == pytest.approx(0.03, abs=0.004)
    assert spread < 0.006
    sure, spread = expect_extension(rate_extensions(rays, short)[1], np.zeros(len(EXTENSIONS)))
    assert sure == pytest.approx(0.03, abs=0.006)


def test_a_step_lies_where_rays_begin_to_pass_the_face() -> None:
    plane = Upright(np.array([-1.0, 0.0, 0.0]), -1.0)
    y, z = (grid.ravel() for grid in np.meshgrid(np.arange(-0.3, 0.3, 0.01) + 0.005, np.arange(0.3, 1.7, 0.1)))
    starts = np.column_stack([np.zeros_like(y), y, z])
    for edge, outwards in ((0.12, -1), (-0.08, 1)):
        # Along the plane is -y.
        ends = np.column_stack([np.where((y < edge) == (outwards < 0), 1.0, 1.5), y, z])
        step = find_step(plane, Rays(starts, ends), -edge + 0.02, outwards, 0.0, 0.03)
        assert step == pytest.approx(-edge, abs=1e-9)
    assert np.isnan(find_step(plane, Rays(starts, np.column_stack([np.ones_like(y), y, z])), 0.0, 1, 0.0, 0.03))
