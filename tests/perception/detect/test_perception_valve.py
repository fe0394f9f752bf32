"""Valve detection: accuracy on scenes whose truth is known, and silence where there is no valve."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from half_spaces import half_spaces
from scipy.spatial import ConvexHull
from valve_targets import assert_matches

from perception import (
    CONFIDENT,
    ValveDetection,
    detect_valves,
    has_clear_spokes,
    valve_bodies,
    wheel_basis,
    wheel_points,
)
from perception.cloud import Cloud
from perception.detect.shared.nearby import Nearby
from perception.detect.valve.circle_fit import Circles, find_inliers, refit_circles
from perception.detect.valve.evidence import _openings
from perception.detect.valve.inside import Inside
from perception.detect.valve.ring import Ring, linearize_ring, move_ring, pass_ring
from perception.detect.valve.wheel import could_steer, steers
from perception.detect.vehicle.level import Patch
from perception.detect.vehicle.seat import Seat
from perception.sightlines import Sightlines, index_of
from perception.simulate import Mesh, Pose, Room, Scanner, Valve, box, cylinder, scan, torus
from perception.solids.primitives import lathe, pipe

SENSOR = Pose((0.12, 0.0, 1.6), pitch=0.3)
# As dense as a whole turn of the fan, but only ahead: a test needs no more.
SCANNER = Scanner(n_beams=361, fan_deg=90.0, n_lines=110)
ROOM = Room(pipes=((0.8, 0.6, 0.045),), boxes=(((0.5, -0.9, 0.0), (0.8, -0.5, 0.5)),))
SHIPPED = Path(__file__).parents[3] / "examples" / "data"


def tilted(yaw_deg: float, pitch_deg: float) -> tuple[float, float, float]:
    yaw, pitch = np.radians([yaw_deg, pitch_deg])
    return (-np.cos(yaw) * np.cos(pitch), -np.sin(yaw) * np.cos(pitch), np.sin(pitch))


VALVES = {
    "small, three spokes": Valve((0.6, 0.0, 1.1), rim_radius=0.08, tube_radius=0.01, n_spokes=3, hub_radius=0.02),
    "turned aside": Valve((0.7, 0.45, 1.0), tilted(40, 0), rim_radius=0.15, tube_radius=0.02),
    "thin rim": Valve((0.65, -0.35, 1.1), tube_radius=0.006, spoke_radius=0.005),
    "large, six spokes": Valve((0.7, -0.3, 1.2), rim_radius=0.25, tube_radius=0.016, n_spokes=6, spin=0.2),
    "tilted up": Valve((0.6, 0.3, 0.9), tilted(0, 45), rim_radius=0.18, tube_radius=0.014, n_spokes=5),
    "turned and tilted": Valve((0.65, -0.4, 1.2), tilted(-35, 20), n_spokes=3),
    "lying flat": Valve((0.6, 0.05, 0.8), tilted(0, 85), rim_radius=0.2, stem_length=0.3),
    "thick rim": Valve((0.68, 0.45, 1.1), rim_radius=0.15, tube_radius=0.028, n_spokes=5),
    "beyond the hand's reach": Valve((1.2, 0.5, 1.1), rim_radius=0.15, stem_length=0.25),
    "forty centimetres": Valve((1.2, -0.2, 1.1), tilted(-20, 10), 0.385, 0.018, 6, hub_radius=0.07, spoke_radius=0.012),
}
# Wheels that are seen in one scan.
TOGETHER = (
    ("small, three spokes", "turned aside", "thin rim"),
    ("large, six spokes", "tilted up"),
    ("turned and tilted", "lying flat", "thick rim"),
    ("beyond the hand's reach", "forty centimetres"),
)


@cache
def scan_of(names: tuple[str, ...]) -> Cloud:
    room = Room(wall_x=1.5) if VALVES[names[0]].centre[0] > 1.0 else Room()
    return scan([*room.meshes(), *(mesh for name in names for mesh in VALVES[name].meshes())], SENSOR, SCANNER, seed=1)


@cache
def found_in(names: tuple[str, ...]) -> list[ValveDetection]:
    return detect_valves(scan_of(names))


def found_of(name: str) -> ValveDetection:
    (names,) = (some for some in TOGETHER if name in some)
    return min(found_in(names), key=lambda one: float(np.linalg.norm(one.centre - VALVES[name].centre)))


def fake(**changes: object) -> ValveDetection:
    figures: dict[str, object] = {
        "centre": np.array([0.7, 0.1, 1.1]), "axis": np.array([-1.0, 0.0, 0.0]), "rim_radius": 0.12,
        "outer_radius": 0.135, "tube_radius": 0.015, "half_depth": 0.015, "spoke_angles": (0.3, 1.9, 3.4, 5.0),
        "hub_radius": 0.03, "inner_depth": (-0.02, 0.02), "confidence": 1.0, "rms": 0.01, "n_inliers": 500,
        "spoke_half_width": 0.008, "spoke_share": 1.0,
    }  # fmt: skip
    return ValveDetection(**(figures | changes))  # type: ignore[arg-type]


def test_a_wheel_of_five_centimetres_is_believed_where_its_axis_can_be_told() -> None:
    valve = Valve((0.55, 0.0, 1.25), tilted(10, 10), rim_radius=0.05, tube_radius=0.008, n_spokes=3, hub_radius=0.014)
    fine = Scanner(n_beams=241, fan_deg=60.0, n_lines=160, sigma=0.004)
    assert_matches(
        detect_valves(scan(ROOM.meshes() + valve.meshes(), SENSOR, fine, seed=1))[0],
        valve.centre,
        valve.axis,
        valve.outer_radius,
    )
    coarse = Scanner(n_beams=241, fan_deg=60.0, n_lines=40, sigma=0.012)
    blurred = detect_valves(scan(ROOM.meshes() + valve.meshes(), SENSOR, coarse, seed=1))
    assert all(found.confidence < CONFIDENT for found in blurred)


@pytest.mark.parametrize("name", VALVES)
def test_simulated_valves_are_found_within_the_targets(name: str) -> None:
    valve, found = VALVES[name], found_of(name)
    assert_matches(found, valve.centre, valve.axis, valve.outer_radius)
    assert abs(found.rim_radius - valve.rim_radius) <= 0.005


@pytest.mark.parametrize("names", TOGETHER)
def test_nothing_else_is_a_valve_among_valves(names: tuple[str, ...]) -> None:
    assert sum(found.confidence >= CONFIDENT for found in found_in(names)) == len(names)


def beside(y: float, *meshes: Mesh) -> list[Mesh]:
    """So far to the left [m]."""
    aside = np.eye(4)
    aside[1, 3] = y
    return [mesh.place(aside) for mesh in meshes]


def vessel(profile: list[tuple[float, float]], z: float) -> list[Mesh]:
    """Open at the top, on a stool of that height."""
    return [lathe(profile, (0.7, 0.05, z), (0, 0, 1)), box((0.5, -0.15, 0.0), (0.9, 0.25, z))]


def plate_with_hole() -> Mesh:
    """A plate before the wall with a round hole in it."""
    angle = 2 * np.pi * np.arange(60) / 60
    rings = [
        np.column_stack([np.full(60, 0.7), 0.1 + r * np.cos(angle), 1.1 + r * np.sin(angle)])
        for r in (0.12, 0.17, 0.35)
    ]
    i = np.arange(60)
    j = (i + 1) % 60
    quads = [np.stack([i + k, j + k, j + k + 60, i + k, j + k + 60, i + k + 60], axis=-1) for k in (0, 60)]
    return Mesh(np.concatenate(rings), np.concatenate(quads).reshape(-1, 3))


FACING = (-1.0, 0.0, 0.0)
RING = torus((0.7, 0.0, 1.1), FACING, 0.13, 0.015)
EMPTY = {
    "pipes, and boxes": Room(
        pipes=((0.6, 0.2, 0.1), (0.7, -0.1, 0.05), (0.75, 0.5, 0.2), (0.6, -0.5, 0.03)),
        boxes=(((0.5, -0.4, 0.6), (0.8, -0.2, 0.9)), ((0.6, 0.3, 1.0), (0.62, 0.5, 1.3))),
    ).meshes(),
    "a round plate, a dish, and a porthole": [
        *Room().meshes(),
        *beside(-0.4, cylinder((0.7, 0.0, 1.1), (0.72, 0.0, 1.1), 0.13)),
        RING, cylinder((0.7, 0.0, 1.1), (0.71, 0.0, 1.1), 0.13),
        *beside(0.4, torus((0.89, 0.0, 1.3), FACING, 0.13, 0.02)),
    ],
    "a hole in a plate, and a tyre": [
        *Room(wall_x=1.2).meshes(), *beside(0.3, plate_with_hole()),
        *beside(-0.5, torus((0.7, 0.1, 1.1), (-0.9, 0.1, 0.4), 0.16, 0.05)),
    ],
    "a ring in a frame, a coiled hose, and a cart's wheel": [
        *Room().meshes(), *beside(-0.3, RING, *(
            box((0.7, y - a, z - b), (0.72, y + a, z + b)) for y, z, a, b in
            [(0.0, 0.85, 0.3, 0.12), (0.0, 1.35, 0.3, 0.12), (-0.26, 1.1, 0.13, 0.2), (0.26, 1.1, 0.13, 0.2)]
        )),
        *(torus((0.8 - 0.022 * k, 0.45, 1.1), (-1, 0, 0.1), 0.16 + 0.01 * k, 0.012) for k in range(3)),
        *Valve((0.75, 0.1, 0.2), tilted(20, 0), 0.18, 0.018, 5).meshes(),
    ],
    "a pot, and a bucket": [
        *Room(wall_x=1.4).meshes(),
        *beside(0.3, *vessel([(0.0, 0.01), (0.1, 0.01), (0.1, 0.14), (0.105, 0.14), (0.105, 0.0), (0.0, 0.0)], 0.6)),
        *beside(-0.3, *vessel([(0.0, 0.01), (0.1, 0.01), (0.14, 0.3), (0.145, 0.3), (0.105, 0.0), (0.0, 0.0)], 0.4)),
    ],
    "a pipe's end, and a square frame": [
        *Room(wall_x=1.6).meshes(), *beside(0.3, pipe((1.5, 0.1, 1.2), (0.7, 0.05, 1.3), 0.1, 0.006)),
        *beside(-0.4, *(
            box((0.7, y - a, z - b), (0.72, y + a, z + b)) for y, z, a, b in
            [(0.0, 0.97, 0.15, 0.015), (0.0, 1.23, 0.15, 0.015), (-0.2, 1.1, 0.015, 0.15), (0.2, 1.1, 0.015, 0.15)]
        )),
    ],
}  # fmt: skip


@pytest.mark.parametrize("name", EMPTY)
def test_nothing_is_found_with_confidence_where_there_is_no_wheel(name: str) -> None:
    cloud = scan(EMPTY[name], SENSOR, SCANNER, seed=1)
    assert all(found.confidence < CONFIDENT for found in detect_valves(cloud))


OPEN = Inside((0.0, 3.1), 0.01, 1.0, True, 0.3, 0.02, (-0.02, 0.02), 0.4, 20, 1.0)


def test_a_lump_as_large_as_a_rim_is_a_wheel_only_with_clear_openings() -> None:
    clear, few = (replace(OPEN, open_share=share) for share in (0.4, 0.12))
    assert _openings(clear, blur=0.05) == _openings(few, blur=0.05) == 1.0
    assert _openings(clear, blur=0.32) == 1.0
    assert _openings(few, blur=0.32) < 0.5


def test_spokes_are_told_where_they_are_clearly_seen() -> None:
    valve, found = VALVES["large, six spokes"], found_of("large, six spokes")
    assert has_clear_spokes(found)
    true = np.sort(np.mod(valve.spoke_angles, 2 * np.pi))
    np.testing.assert_allclose(found.spoke_angles, true, atol=np.radians(3))
    assert 0.004 < found.spoke_half_width < 0.012
    assert 0.02 < found.hub_radius < 0.045


@pytest.mark.parametrize("name", ["turned aside", "tilted up", "turned and tilted", "lying flat"])
def test_a_hub_is_measured_to_3_mm_also_from_aside(name: str) -> None:
    assert found_of(name).hub_radius == pytest.approx(VALVES[name].hub_radius, abs=0.003)


def test_a_hint_keeps_the_search_near_it() -> None:
    one, two = (VALVES[name] for name in ("forty centimetres", "beyond the hand's reach"))
    hinted = detect_valves(scan_of(TOGETHER[3]), hint=np.array(two.centre) + 0.05)
    assert_matches(hinted[0], two.centre, two.axis, two.outer_radius)
    assert all(np.linalg.norm(found.centre - one.centre) > 0.1 for found in hinted)


def test_a_solid_wheel_is_believed_only_of_who_points_at_it() -> None:
    valve = Valve((0.7, 0.1, 1.1), tilted(10, 10), rim_radius=0.13)
    disc = cylinder((0.7, 0.1, 1.1), tuple(np.array(valve.centre) - 0.008 * np.array(valve.axis)), 0.13)
    cloud = scan([*ROOM.meshes(), *valve.meshes(), disc], SENSOR, SCANNER, seed=2)
    assert all(found.confidence < CONFIDENT for found in detect_valves(cloud))
    hinted = detect_valves(cloud, hint=np.array([0.65, 0.12, 1.1]))[0]
    assert hinted.confidence >= CONFIDENT
    assert np.linalg.norm(hinted.centre - valve.centre) <= 0.010
    assert abs(hinted.outer_radius - valve.outer_radius) <= 0.010


def test_rays_of_a_merged_scan_are_taken_from_where_each_started() -> None:
    valve = VALVES["turned aside"]
    sensors = (SENSOR, Pose((0.0, 0.9, 1.3), yaw=-0.7))
    scanner = Scanner(n_beams=541, fan_deg=135.0, n_lines=40)
    scans = [scan(ROOM.meshes() + valve.meshes(), pose, scanner, seed=i) for i, pose in enumerate(sensors)]
    points = np.concatenate([one.points for one in scans])
    merged = Cloud(points, np.concatenate([one.starts for one in scans]))
    assert_matches(detect_valves(merged)[0], valve.centre, valve.axis, valve.outer_radius)


def test_rays_without_a_return_show_the_air_about_a_wheel() -> None:
    valve = Valve((0.75, 0.0, 2.0), tilted(10, -20), rim_radius=0.14, stem_length=0.06)
    parts = [*valve.meshes(), box((-6, -6, -0.1), (6, 6, 0))]
    cloud = scan(parts, Pose((0.12, 0.0, 1.6), pitch=-0.2), SCANNER, seed=4, misses=True)
    assert_matches(detect_valves(cloud)[0], valve.centre, valve.axis, valve.outer_radius)
    without = Cloud(cloud.points, cloud.origin)
    assert all(found.confidence < CONFIDENT for found in detect_valves(without))


def test_half_a_wheel_out_of_sight_speaks_neither_for_nor_against_it() -> None:
    valve = Valve((0.7, 0.1, 1.1), rim_radius=0.2, n_spokes=5)
    cloud = scan(ROOM.meshes() + valve.meshes(), SENSOR, SCANNER, seed=5)
    seen = cloud.select(cloud.points[:, 1] - cloud.origin[1] < 0.33 * (cloud.points[:, 0] - cloud.origin[0]))
    assert_matches(detect_valves(seen)[0], valve.centre, valve.axis, valve.outer_radius)


def test_detection_is_the_same_for_the_same_seed() -> None:
    other = detect_valves(scan_of(TOGETHER[1]))
    for one, again in zip(found_in(TOGETHER[1]), other, strict=True):
        np.testing.assert_array_equal(one.centre, again.centre)
        assert one.rim_radius == again.rim_radius


def seat_at(confidence: float) -> Seat:
    pose = np.eye(4)
    pose[:3, 3] = 0.2, 0.1, 0.7
    patch = Patch(pose[:3, 3], 0.0, np.array([0.45, 0.5]), 1.0, 0.01, np.zeros((0, 3)))
    return Seat(pose, 0.5, 0.45, 0.3, 1.0, confidence, patch)


def test_what_steers_faces_a_sure_seat_of_a_vehicle_before_its_middle() -> None:
    wheel = Ring(np.array([0.6, 0.12, 1.0]), np.array([-0.8, 0.0, 0.6]), 0.17, 0.012, 0.012)
    seats = [seat_at(0.9)]
    assert could_steer(wheel)
    assert steers(wheel, seats)
    assert not steers(wheel, [seat_at(0.45)])
    assert not steers(replace(wheel, axis=np.array([0.0, 1.0, 0.0])), seats)
    assert not steers(replace(wheel, centre=np.array([1.2, 0.1, 1.0])), seats)
    assert not steers(replace(wheel, centre=np.array([0.6, -0.5, 1.0])), seats)
    assert not could_steer(replace(wheel, radius=0.08))


@pytest.mark.parametrize("axis", [(-1, 0, 0), (0, 0, 1), (0.6, 0.0, 0.8), (0, -1, 0)])
def test_angles_about_the_axis_are_right_handed(axis: tuple[float, ...]) -> None:
    basis = wheel_basis(np.array(axis, dtype=float))
    np.testing.assert_allclose(basis @ basis.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(basis) == pytest.approx(1.0)
    assert abs(basis[0, 2]) < 1e-12


def test_wheel_bodies_contain_the_wheel_and_leave_its_openings() -> None:
    found = fake()
    basis = wheel_basis(found.axis)
    bodies = {name: half_spaces(vertices) for name, vertices in valve_bodies(found, margin=0.0).items()}

    def covered(radius: np.ndarray, angle: np.ndarray, height: np.ndarray) -> np.ndarray:
        local = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])
        points = found.centre + local @ basis
        return np.any([(points @ f[:, :3].T + f[:, 3] <= 1e-9).all(axis=1) for f in bodies.values()], axis=0)

    rng = np.random.default_rng(0)
    angle, around = rng.uniform(0, 2 * np.pi, (2, 3000))
    section = 0.015 * np.sqrt(rng.random(3000))
    assert covered(0.12 + section * np.cos(around), angle, section * np.sin(around)).all()
    assert covered(rng.uniform(0, 0.03, 3000), angle, rng.uniform(-0.02, 0.02, 3000)).all()
    spoke = rng.choice(found.spoke_angles, 3000)
    assert covered(rng.uniform(0.03, 0.12, 3000), spoke, rng.uniform(-0.015, 0.015, 3000)).all()
    middle = np.array(found.spoke_angles) + 0.8
    assert not covered(np.full(4, 0.07), middle, np.zeros(4)).any()
    # A little more than the torus, not much.
    assert not covered(np.full(3000, 0.14), angle, np.zeros(3000)).any()


def test_openings_not_clearly_seen_count_as_solid() -> None:
    for changes in ({"spoke_angles": ()}, {"confidence": 0.4}, {"spoke_share": 0.6}, {"spoke_angles": (0.1,)}):
        bodies = valve_bodies(fake(**changes), n_segments=16)
        assert set(bodies) == {"hub"} | {f"rim/{i}" for i in range(16)}
        distance = np.linalg.norm((bodies["hub"] - [0.7, 0.1, 1.1])[:, 1:], axis=1)
        assert distance.min() >= 0.105


def test_every_wheel_body_is_convex_with_few_vertices() -> None:
    for vertices in valve_bodies(fake()).values():
        assert len(ConvexHull(vertices).vertices) == len(vertices) <= 32


def test_wheel_points_are_those_near_the_wheel_only() -> None:
    points = np.array([[0.7, 0.22, 1.1], [0.7, 0.1, 1.1], [0.9, 0.1, 1.1], [0.7, 0.3, 1.1], [0.6, 0.1, 1.1]])
    assert wheel_points(fake(), points).tolist() == [True, True, False, False, False]


def rays_about(ring: Ring, n: int, rng: np.random.Generator) -> Sightlines:
    """Rays from two sensors that pass within some 6 cm of a rim and end about there."""
    angle, beside, length = rng.uniform(0, 2 * np.pi, n), rng.normal(0.0, 0.02, n), rng.normal(0.0, 0.02, n)
    flat = (ring.radius + beside)[:, None] * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(n)])
    start = np.where(np.arange(n)[:, None] % 2, (0.1, 0.0, 1.6), (0.0, 0.6, 1.2))
    way = flat @ ring.basis + ring.centre - start
    distance = np.linalg.norm(way, axis=1)
    return Sightlines(start, way / distance[:, None], distance + length)


@pytest.mark.parametrize("seed", range(4))
def test_the_derivatives_of_a_rims_residuals_are_their_differences(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ring = Ring(rng.normal([0.8, 0.1, 1.1], 0.1), np.array(tilted(*rng.uniform(-40, 40, 2))), 0.14, 0.013, 0.017)
    rays = rays_about(ring, 300, rng)
    hit = rng.random(300) < 0.6
    _, jacobian = linearize_ring(rays, hit, ring)
    step = 1e-7
    passage = pass_ring(rays, ring)
    # Where the edge is crossed the depth's derivative is bounded on purpose, and which rows there are may change.
    level = passage.level
    wrong = np.where(hit, level > 1.0, level < 1.0)
    smooth = np.concatenate([np.abs(level[hit] - 1.0) > 0.05, np.abs(level[wrong] - 1.0) > 1e-3, [True]])

    def rows(x: np.ndarray) -> np.ndarray:
        moved = move_ring(ring, x)
        met = pass_ring(rays, moved)
        outside = np.where(hit, 1.0, -1.0) * (met.level - 1.0) * moved.half_width / 0.004
        prior = linearize_ring(rays, hit, moved)[0][-1:]
        return np.concatenate([((met.depth - rays.length) / 0.01)[hit], outside[wrong], prior])

    differences = [(rows(step * axis) - rows(-step * axis)) / (2 * step) for axis in np.eye(8)]
    np.testing.assert_allclose(jacobian[:, smooth], np.array(differences)[:, smooth], rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("seed", range(3))
def test_a_rough_circle_is_drawn_onto_the_noisy_points_about_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    centre, radius, angle = rng.normal(0.0, 3.0, 3), 0.05 + 0.1 * seed, rng.uniform(0, 2 * np.pi, 300)
    rim = radius * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(300)])
    points = np.concatenate([centre + rim @ wheel_basis(axis), centre + rng.uniform(0.6, 1.0, (200, 3))])
    points += rng.normal(0.0, 0.003, points.shape)
    lean = axis + rng.normal(0.0, 0.1, 3)
    circles = Circles((centre + 0.005)[None], (lean / np.linalg.norm(lean))[None], np.array([1.05 * radius]))
    nearby = Nearby.of(points)
    for _ in range(2):
        circles = refit_circles(circles, find_inliers(circles, nearby))
    assert np.linalg.norm(circles.centres[0] - centre) < 0.002
    assert abs(circles.axes[0] @ axis) > np.cos(np.radians(3.0))
    assert abs(circles.radii[0] - radius) < 0.002
    assert find_inliers(circles, nearby).count[0] > 280


@pytest.mark.parametrize("n_starts", [1, 3, 40])
def test_rays_that_pass_a_place_are_those_that_come_near_it(n_starts: int) -> None:
    rng = np.random.default_rng(n_starts)
    start = rng.normal(0.0, 0.3, (n_starts, 3))[rng.integers(n_starts, size=4000)]
    direction = rng.normal(size=(4000, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    index = index_of(Sightlines(start, direction, rng.uniform(0.5, 6.0, 4000)))
    places = np.array([2.0, 0.3, 0.5]) + np.linspace(0.0, 0.5, 4)[:, None] * [0.0, 0.6, 0.8]
    rays, ends = index.rays, index.rays.ends
    offset = places - start[:, None]
    along = (offset * direction[:, None]).sum(axis=2)
    apart = np.linalg.norm(offset - along[:, :, None] * direction[:, None], axis=2)
    passes = ((along > 0.0) & (apart < 0.2) & (along < rays.length[:, None])).any(axis=1)
    found = index.passing(places, 0.2)
    assert {tuple(end) for end in ends[passes]} <= {tuple(end) for end in found.ends}
    nearest = np.linalg.norm(np.cross(found.direction[:, None], places - found.start[:, None]), axis=2).min(axis=1)
    assert (nearest < 0.21).all()
