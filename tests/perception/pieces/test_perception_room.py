"""Pieces that are cut where they enter the box of an object, such as a door's leaf in its wall."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from costs.scene import ConvexPiece
from perception.convex.hulls import make_hull
from perception.convex.piece import Evidence, Piece
from perception.convex.room import make_room, subtract_box

_UNIT = np.array([[*(sign * axis), -0.5] for axis in np.eye(3) for sign in (-1.0, 1.0)])  # a cube about the origin


def _beyond(points: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    planes = ConvexHull(vertices).equations
    return np.asarray((points @ planes[:, :3].T + planes[:, 3]).max(axis=1))


def _box_sides(low: np.ndarray, high: np.ndarray, turn: np.ndarray) -> np.ndarray:
    sides = [[*-axis, bound] for axis, bound in zip(turn, low, strict=True)]
    return np.array(sides + [[*axis, -bound] for axis, bound in zip(turn, high, strict=True)])


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10_000), n_vertices=st.integers(4, 40), size=st.floats(0.05, 2.0))
def test_parts_cover_all_that_a_hull_has_outside_the_box_and_nothing_inside_it(
    seed: int, n_vertices: int, size: float
) -> None:
    rng = np.random.default_rng(seed)
    vertices = rng.normal(size=(n_vertices, 3)) * rng.uniform(0.2, 1.0, 3)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    low = rng.normal(scale=0.3, size=3) - 0.5 * size
    sides = _box_sides(low, low + size * rng.uniform(0.2, 1.0, 3), turn)
    parts = subtract_box(vertices, sides)
    shares = rng.dirichlet(np.full(n_vertices, 0.3), size=500)
    inside = shares @ vertices
    outside_box = (inside @ sides[:, :3].T + sides[:, 3]).max(axis=1) > 1e-6
    if parts is None:
        assert not (inside @ sides[:, :3].T + sides[:, 3] < -1e-9).all(axis=1).any()
        return
    covered = np.zeros(len(inside), dtype=bool)
    for part in parts:
        covered |= _beyond(inside, part) < 1e-9
        deepest = (part @ sides[:, :3].T + sides[:, 3]).min(axis=0)
        assert (deepest > -1e-9).any(), "one side of the box separates the part from it"
        assert (_beyond(part, vertices) < 1e-9).all(), "no part is larger than the hull"
    assert covered[outside_box].all()


def _piece(name: str, vertices: np.ndarray, points: np.ndarray) -> Piece:
    shape = ConvexPiece(name, vertices, kind=name.partition("/")[0])
    return Piece(shape, points, Evidence(0, 0.0, 1.0), make_hull(vertices).simplified)


def test_a_wall_that_cuts_across_a_corner_keeps_its_points_and_leaves_the_corner() -> None:
    # A triangle whose long edge passes the corner (0.5, 0.5) of the cube 0.1 m inside it.
    flat = np.array([[-0.1, 0.9], [0.9, -0.1], [0.9, 0.9]])
    wall = np.array([[x, y, z] for x, y in flat for z in (-0.02, 0.02)])
    points = np.array([[0.8, 0.7, 0.0], [0.7, 0.2, 0.0], [0.2, 0.7, 0.0]])
    other = _piece("plane/4", wall + np.array([2.0, 0.0, 0.0]), np.array([0]))
    parts = make_room([_piece("plane/3", wall, np.arange(3)), other], [_UNIT], points)
    assert [part.name for part in parts] == ["plane/3", "plane/5", "plane/4"]
    assert parts[-1] is other
    assert {int(point) for part in parts[:-1] for point in part.points} == {0, 1, 2}
    assert all(not (part.shape.vertices @ _UNIT[:, :3].T + _UNIT[:, 3] < -1e-9).all(axis=1).any() for part in parts)
    corner = np.array([[0.45, 0.45, 0.0]])
    assert _beyond(corner, wall)[0] < 0.0
    assert all(_beyond(corner, part.shape.vertices)[0] > 0.0 for part in parts)
