"""Lines of points grown from what is near a place."""

from __future__ import annotations

import numpy as np

from perception.detect.shared.nearby import Nearby
from perception.detect.valve.lines import Line, _grow


def test_from_a_place_whose_points_lie_off_the_line_nothing_grows() -> None:
    points = np.random.default_rng(0).uniform(0.1, 0.2, (100, 3))
    along_x = Line(np.zeros(3), np.array([1.0, 0.0, 0.0]), -0.3, 0.3, 0.01, np.arange(0), 0.0)
    assert _grow(Nearby.of(points), along_x) is None


def test_a_line_whose_middle_lies_beside_its_tube_does_not_grow() -> None:
    two_sides = np.array([[x, y, 0.0] for x in np.linspace(0.0, 0.3, 20) for y in (-0.05, 0.05)])
    along_x = Line(np.zeros(3), np.array([1.0, 0.0, 0.0]), -0.3, 0.3, 0.01, np.arange(len(two_sides)), 0.0)
    assert _grow(Nearby.of(two_sides), along_x) is None
