"""Bodies contain the shapes they stand for, and not much more."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from costs.collision.shapes import make_convex, make_swept_convex
from costs.primitive import make_round_shape
from costs.robot import RobotError, load_robot, shapes
from costs.robot.mesh.hull import find_hull_vertices, make_outer_hull
from service.start.overlaps import penetration_depth

LENGTH = st.floats(1e-3, 2.0)
RADIUS = st.floats(1e-3, 50.0)
SEED = st.integers(0, 10_000)


def _overhang(hull: np.ndarray, points: np.ndarray) -> float:
    """How far the farthest of ``points`` lies outside the hull [m]."""
    equations = ConvexHull(hull).equations
    return float((points @ equations[:, :3].T + equations[:, 3]).max())


def _directions(seed: int) -> np.ndarray:
    vectors = np.random.default_rng(seed).normal(size=(2000, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


@given(radius=RADIUS, seed=SEED)
@settings(max_examples=40)
def test_sphere_polytope_contains_the_sphere_within_2_mm_or_1_percent(radius: float, seed: int) -> None:
    hull = shapes.sphere(radius)
    assert _overhang(hull, radius * _directions(seed)) < 1e-9 * max(radius, 1.0)
    assert np.linalg.norm(hull, axis=1).max() - radius <= max(0.002, 0.01 * radius) + 1e-12


@given(radius=RADIUS, length=LENGTH, seed=SEED)
@settings(max_examples=40)
def test_capsule_polytope_contains_the_capsule_within_2_mm_or_1_percent(
    radius: float, length: float, seed: int
) -> None:
    hull = shapes.capsule(radius, length)
    points = radius * _directions(seed)
    points[:, 2] += np.sign(points[:, 2]) * 0.5 * length
    assert _overhang(hull, points) < 1e-9 * max(radius, 1.0)
    past_the_axis = hull - np.array([0.0, 0.0, 1.0]) * np.clip(hull[:, 2:], -0.5 * length, 0.5 * length)
    assert np.linalg.norm(past_the_axis, axis=1).max() - radius <= max(0.002, 0.01 * radius) + 1e-12


@given(radius=RADIUS, length=LENGTH, seed=SEED)
@settings(max_examples=40)
def test_cylinder_prism_contains_the_cylinder_within_2_mm_or_1_percent(radius: float, length: float, seed: int) -> None:
    hull = shapes.cylinder(radius, length)
    angle = 2.0 * np.pi * np.random.default_rng(seed).uniform(size=2000)
    ring = radius * np.column_stack([np.cos(angle), np.sin(angle)])
    points = np.column_stack([ring, np.where(np.arange(2000) % 2 == 0, 0.5, -0.5) * length])
    assert _overhang(hull, points) < 1e-9 * max(radius, 1.0)
    assert np.linalg.norm(hull[:, :2], axis=1).max() - radius <= max(0.002, 0.01 * radius) + 1e-12
    assert np.abs(hull[:, 2]).max() == 0.5 * length


def test_small_round_shapes_have_few_vertices_and_none_has_many() -> None:
    assert [len(shapes.sphere(radius)) for radius in (0.02, 0.05, 0.2, 50.0)] == [32, 92, 272, 272]
    assert [len(shapes.capsule(radius, 0.3)) for radius in (0.02, 0.05, 0.2, 50.0)] == [32, 104, 296, 296]
    assert [len(shapes.cylinder(radius, 0.3)) for radius in (0.02, 0.05, 0.2, 50.0)] == [32, 32, 46, 46]


def test_box_has_its_eight_corners() -> None:
    corners = shapes.box(np.array([2.0, 4.0, 6.0]))
    assert {tuple(corner) for corner in corners} == {(x, y, z) for x in (-1, 1) for y in (-2, 2) for z in (-3, 3)}


@given(seed=SEED, count=st.integers(33, 400), size=st.tuples(LENGTH, LENGTH, LENGTH), is_round=st.booleans())
@settings(max_examples=30)
def test_outer_hull_of_few_vertices_contains_the_body(
    seed: int, count: int, size: tuple[float, float, float], is_round: bool
) -> None:
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(count, 3))
    if is_round:
        points /= np.linalg.norm(points, axis=1, keepdims=True)
    vertices = find_hull_vertices(points * np.maximum(size, 0.05 * max(size)), "sample")
    outer = make_outer_hull(vertices)
    extent = float(np.ptp(vertices, axis=0).max())
    assert len(outer) <= (48 if len(vertices) > 32 else 32)
    assert _overhang(outer, vertices) <= 1e-9 * extent
    assert _overhang(vertices, outer) <= 0.06 * extent


def test_outer_hull_of_a_small_body_is_the_body() -> None:
    vertices = shapes.box(np.ones(3))
    assert make_outer_hull(vertices) is vertices


def test_outer_hull_of_many_panda_vertices_exceeds_by_3_mm(shared_data: Path) -> None:
    folder = shared_data / "mbm_panda"
    panda = load_robot(urdf=folder / "panda_bench" / "panda.urdf", package_dirs=[folder])
    reduced = [body for body in panda.bodies if len(body.vertices) > 32]
    assert len(reduced) == 9
    for body in reduced:
        assert len(body.outer) <= 48
        assert _overhang(body.outer, body.vertices) <= 0.0
        assert _overhang(body.vertices, body.outer) < 3.2e-3, body.name


def test_outer_hull_is_the_same_every_time() -> None:
    vertices = find_hull_vertices(np.random.default_rng(1).normal(size=(300, 3)), "sample")
    np.testing.assert_array_equal(make_outer_hull(vertices), make_outer_hull(vertices.copy()))


def test_flat_points_have_no_hull() -> None:
    flat = np.column_stack([np.random.default_rng(2).normal(size=(20, 2)), np.zeros(20)])
    with pytest.raises(RobotError, match="lie in a plane"):
        find_hull_vertices(flat, "sheet")


@given(kind=st.sampled_from(["sphere", "capsule", "cylinder"]), radius=RADIUS, length=LENGTH)
@settings(max_examples=20)
def test_what_sweeps_contains_the_round_shape_with_no_more_vertices_than_coal_can_sweep(
    kind: str, radius: float, length: float
) -> None:
    given_shape = make_round_shape(kind, (radius, length))
    assert given_shape is not None
    exact = given_shape.move(np.array([[0.0, 0, 1, 2], [1, 0, 0, 3], [0, 1, 0, 4], [0, 0, 0, 1]]))
    size = (radius,) if kind == "sphere" else (radius, length)
    vertices = getattr(shapes, kind)(*size) @ exact.pose[:3, :3].T + exact.pose[:3, 3]
    outer = shapes.make_swept_hull(exact, vertices)
    assert len(outer) <= shapes.MOST_SWEPT
    swept, points = make_swept_convex(outer)
    assert swept.num_points == len(points) == 2 * len(outer)
    local = (outer - exact.pose[:3, 3]) @ exact.pose[:3, :3]
    ends = np.array([0.0, 0.0, 0.5 * exact.length])
    assert _overhang(outer, vertices) < 1e-9 * max(radius, 1.0)
    if kind != "cylinder":
        past_the_axis = local - np.array([0.0, 0.0, 1.0]) * np.clip(local[:, 2:], -ends[2], ends[2])
        assert np.linalg.norm(past_the_axis, axis=1).max() - radius <= max(0.002, 0.037 * radius)


@given(seed=SEED, radius=st.floats(0.03, 0.3), is_capsule=st.booleans())
@settings(max_examples=15)
def test_a_swept_hull_of_many_vertices_is_as_far_as_the_hull_of_both_its_poses(
    seed: int, radius: float, is_capsule: bool
) -> None:
    rng = np.random.default_rng(seed)
    exact = make_round_shape("capsule" if is_capsule else "sphere", (radius, 0.3))
    assert exact is not None
    around = shapes.capsule(radius, 0.3) if is_capsule else shapes.sphere(radius)
    outer = shapes.make_swept_hull(exact, around)
    swept, points = make_swept_convex(outer)
    for _ in range(5):
        turns = Rotation.random(2, random_state=int(rng.integers(1 << 31))).as_matrix()
        ends = [outer @ turn.T + rng.normal(scale=0.3, size=3) for turn in turns]
        points[: len(outer)], points[len(outer) :] = ends
        box = shapes.box(rng.uniform(0.05, 0.5, 3)) + rng.normal(scale=0.8, size=3)
        found, expected = (
            penetration_depth(hull, make_convex(box)) for hull in (swept, make_convex(np.concatenate(ends)))
        )
        if expected < 0.0:
            assert found == pytest.approx(expected, abs=1e-6)
        else:
            assert found > 0.0
