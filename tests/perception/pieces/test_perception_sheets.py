"""Flat meshes become plates: the same area, holes open, few pieces."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import ConvexHull, Delaunay
from scipy.spatial.transform import Rotation

from perception.solids.decompose import split_solid
from perception.solids.mesh import Mesh
from perception.solids.sheet import THICKNESS_M, make_sheet

WINDOW = np.array(
    [(0, 0), (3, 0), (3, 3), (0, 3), (1, 1), (2, 1), (2, 2), (1, 2)], dtype=float
)  # a wall with a square hole
WINDOW_FACES = [(0, 1, 5), (0, 5, 4), (1, 2, 6), (1, 6, 5), (2, 3, 7), (2, 7, 6), (3, 0, 4), (3, 4, 7)]


def place(flat: np.ndarray, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.c_[flat, np.zeros(len(flat))] @ Rotation.random(random_state=rng).as_matrix().T + rng.normal(size=3)


def volume(sheet) -> float:
    return float(sum(part.volume for part in sheet.closed))


@given(seed=st.integers(0, 10_000), count=st.integers(3, 30))
def test_the_plates_of_a_sheet_cover_its_area_once(seed: int, count: int) -> None:
    flat = np.random.default_rng(seed).uniform(-2.0, 2.0, (count, 2))
    triangles = Delaunay(flat).simplices.astype(np.int64)
    sheet = make_sheet(Mesh(place(flat, seed), triangles), "sheet")
    assert sheet is not None
    assert volume(sheet) == pytest.approx(ConvexHull(flat).volume * THICKNESS_M, rel=1e-4)


def test_a_wall_of_two_triangles_is_one_plate() -> None:
    corners = place(np.array([(0, 0), (2, 0), (2, 1), (0, 1)], dtype=float), 1)
    sheet = make_sheet(Mesh(corners, np.array([(0, 1, 2), (0, 2, 3)])), "wall")
    assert sheet is not None
    assert len(sheet.closed) == 1
    assert "flat" in sheet.notes[0]
    (part,) = split_solid(sheet, name="wall")
    assert np.linalg.norm(part[:, None] - corners[None], axis=2).min(axis=0).max() < 0.51 * THICKNESS_M


def test_a_hole_in_a_sheet_stays_open() -> None:
    sheet = make_sheet(Mesh(place(WINDOW, 2), np.array(WINDOW_FACES)), "window")
    assert sheet is not None
    assert volume(sheet) == pytest.approx(8.0 * THICKNESS_M, rel=1e-6)
    assert len(sheet.closed) <= 4


def test_a_line_and_a_solid_are_no_sheets() -> None:
    line = np.array([(0, 0, 0), (1, 0, 0), (2, 0, 0)], dtype=float)
    assert make_sheet(Mesh(line, np.array([(0, 1, 2)])), "line") is None
    solid = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], dtype=float)
    assert make_sheet(Mesh(solid, np.array([(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)])), "solid") is None
