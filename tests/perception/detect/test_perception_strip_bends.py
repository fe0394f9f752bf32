"""Strips that are two: faces of two bars in about the same line."""

from __future__ import annotations

import numpy as np
import pytest

from perception.detect.beam.strips import Strip, straight_parts


def strip_of(*faces: np.ndarray) -> Strip:
    """As one run along x of all their points."""
    points = np.concatenate(faces)
    first, last = float(points[:, 0].min()), float(points[:, 0].max())
    return Strip(np.zeros(3), np.eye(3)[0], np.eye(3)[2], 0.06, first, last, points, 20.0)


def face(first: float, last: float, slope: float, half: float, seed: int) -> np.ndarray:
    """Of a bar along x at first, then turned about z by its slope."""
    rng = np.random.default_rng(seed)
    n = int(600 * (last - first))
    along = rng.uniform(first, last, n)
    across = rng.uniform(-half, half, n) + slope * (along - first)
    return np.column_stack([along, across, rng.normal(0.0, 0.008, n)])


def test_faces_at_an_angle_are_two_strips_each_along_its_own() -> None:
    one, other = straight_parts(strip_of(face(-0.6, 0.0, 0.0, 0.045, 0), face(0.0, 0.6, 0.3, 0.045, 1)))
    assert abs(one.axis[1]) < 0.03
    assert other.axis[1] == pytest.approx(0.29, abs=0.03)
    assert one.last - one.first == pytest.approx(0.6, abs=0.06)
    assert 2.0 * other.half == pytest.approx(0.09, abs=0.015)


def test_faces_of_different_width_in_one_line_are_two_strips() -> None:
    parts = straight_parts(strip_of(face(-0.6, 0.0, 0.0, 0.02, 0), face(0.0, 0.6, 0.0, 0.07, 1)))
    assert [2.0 * part.half for part in parts] == pytest.approx([0.04, 0.14], abs=0.015)


@pytest.mark.parametrize("slope", [0.0, 0.03])
def test_a_straight_face_stays_one_strip(slope: float) -> None:
    strip = strip_of(face(-0.6, 0.6, slope, 0.045, 2))
    assert straight_parts(strip) == [strip]


def test_a_short_strip_is_left_alone() -> None:
    strip = strip_of(face(-0.2, 0.0, 0.0, 0.02, 0), face(0.0, 0.2, 0.3, 0.07, 1))
    assert straight_parts(strip) == [strip]
