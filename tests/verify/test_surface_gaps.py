"""Distances of contact points from the surfaces behind them, against a linear program over the vertices."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation

from costs.primitive import Primitive, make_round_shape, measure_outside_round
from costs.scene import ConvexPiece
from service.verify.ground import find_surface_gaps

UP = np.array([0.0, 0.0, 1.0])
SIGNS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)


def make_box(name: str, middle: np.ndarray, half: np.ndarray, turn: Rotation | None = None) -> ConvexPiece:
    vertices = SIGNS * half
    return ConvexPiece(name, (vertices if turn is None else turn.apply(vertices)) + middle)


def find_entry(point: np.ndarray, normal: np.ndarray, piece: ConvexPiece) -> float:
    """Return the least t for which ``point - t normal`` is a combination of the piece's vertices; inf for none."""
    count = len(piece.vertices)
    equal = np.vstack([np.column_stack([piece.vertices.T, normal]), np.append(np.ones(count), 0.0)])
    cost = np.append(np.zeros(count), 1.0)
    limits = [(0.0, None)] * count + [(None, None)]
    found = linprog(cost, A_eq=equal, b_eq=np.append(point, 1.0), bounds=limits, method="highs")
    return float("inf") if found.x is None else float(found.x[-1])


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10**6), n_pieces=st.integers(1, 4))
def test_gaps_are_those_of_the_nearest_piece_on_the_line_along_the_normal(seed: int, n_pieces: int) -> None:
    rng = np.random.default_rng(seed)
    pieces = [
        ConvexPiece(str(k), rng.uniform(-0.4, 0.4, 3) + rng.normal(size=(12, 3)) * rng.uniform(0.05, 0.3))
        for k in range(n_pieces)
    ]
    points = rng.uniform(-0.6, 0.6, (5, 3))
    normal = rng.normal(size=3)
    normal /= np.linalg.norm(normal)
    gaps, lean = find_surface_gaps(points, normal, pieces)
    for point, gap in zip(points, gaps, strict=True):
        entries = np.array([find_entry(point, normal, piece) for piece in pieces])
        nearest = entries[np.abs(entries).argmin()]
        assert gap == pytest.approx(nearest, abs=1e-7)
    assert 0.0 <= lean <= 0.5 * np.pi


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10**6), angle=st.floats(0.0, 0.7))
def test_the_lean_is_the_angle_of_the_face_that_is_nearest(seed: int, angle: float) -> None:
    rng = np.random.default_rng(seed)
    axis = np.append(rng.normal(size=2), 0.0)
    turn = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis))
    piece = make_box("ramp", np.zeros(3), np.array([0.5, 0.5, 0.1]), turn)
    # Over the middle of the upper face.
    point = turn.apply([0.0, 0.0, 0.1]) + 0.01 * UP
    gaps, lean = find_surface_gaps(point[None], UP, [piece])
    assert gaps[0] == pytest.approx(0.01, abs=1e-9)
    assert lean == pytest.approx(angle, abs=1e-6)


def test_a_point_past_the_end_of_a_bar_has_no_surface() -> None:
    bar = make_box("bar", np.zeros(3), np.array([0.5, 0.02, 0.02]))
    gaps, _ = find_surface_gaps(np.array([[0.499, 0.0, 0.02], [0.501, 0.0, 0.02]]), UP, [bar])
    assert gaps[0] == pytest.approx(0.0, abs=1e-12)
    assert np.isinf(gaps[1])


def test_the_side_that_faces_away_is_as_far_as_the_piece_is_thick() -> None:
    plate = make_box("plate", np.zeros(3), np.array([0.5, 0.5, 0.05]))
    gaps, _ = find_surface_gaps(np.array([[0.0, 0.0, -0.05]]), UP, [plate])
    assert gaps[0] == pytest.approx(-0.1)


def test_a_piece_behind_another_does_not_count_where_the_first_is_nearer() -> None:
    back, front = (
        make_box(name, np.array([0.0, 0.0, z]), np.array([0.5, 0.5, 0.05])) for name, z in (("b", -0.2), ("f", 0.0))
    )
    gaps, _ = find_surface_gaps(np.array([[0.0, 0.0, 0.06]]), UP, [back, front])
    assert gaps[0] == pytest.approx(0.01)


def test_no_piece_and_flat_pieces_are_no_surface() -> None:
    flat = ConvexPiece("flat", np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]))
    for pieces in ([], [flat]):
        gaps, lean = find_surface_gaps(np.zeros((2, 3)), UP, pieces)
        assert np.isinf(gaps).all()
        assert lean == 0.0


def test_a_round_pillar_counts_as_it_is_and_not_as_the_polytope_around_it() -> None:
    shape = make_round_shape("cylinder", (0.5, 1.0))
    assert shape is not None
    angles = 2.0 * np.pi * np.arange(16) / 16
    ring = 0.5 / np.cos(np.pi / 16) * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    vertices = np.vstack([np.column_stack([ring, np.full(16, z)]) for z in (-0.5, 0.5)])
    edge = np.array([[ring[0, 0], 0.0, 0.0]])
    outwards = np.array([1.0, 0.0, 0.0])
    polytope, _ = find_surface_gaps(edge, outwards, [ConvexPiece("pillar", vertices)])
    exact, _ = find_surface_gaps(edge, outwards, [ConvexPiece("pillar", vertices, exact=shape)])
    assert polytope[0] == pytest.approx(0.0, abs=1e-9)
    assert exact[0] == pytest.approx(ring[0, 0] - 0.5)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10**6), kind=st.sampled_from(["sphere", "cylinder", "capsule"]))
def test_distances_from_round_shapes_are_those_from_many_of_their_points(seed: int, kind: str) -> None:
    rng = np.random.default_rng(seed)
    radius, length = rng.uniform(0.05, 0.5), rng.uniform(0.1, 1.0)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.random(random_state=seed).as_matrix(), rng.normal(size=3)
    shape = make_round_shape(kind, (radius, length))
    assert isinstance(shape, Primitive)
    point = pose[:3, 3] + rng.normal(size=3) * 0.6
    own = (point - pose[:3, 3]) @ pose[:3, :3]
    half = 0.0 if kind == "sphere" else 0.5 * length
    across = np.hypot(own[0], own[1])
    heights = np.linspace(-half, half, 4001)
    if kind == "cylinder":
        expected = np.hypot(np.maximum(across - radius, 0.0), heights - own[2]).min()
    else:
        expected = max(np.hypot(across, heights - own[2]).min() - radius, 0.0)
    assert measure_outside_round(point[None], shape.move(pose))[0] == pytest.approx(expected, abs=1e-3)
