"""What is asked of wheels that are found in dense scans."""

from __future__ import annotations

import numpy as np

from perception import CONFIDENT, ValveDetection


def assert_matches(found: ValveDetection, centre: object, axis: object, outer_radius: float) -> None:
    """The targets for dense scans."""
    assert found.confidence >= CONFIDENT
    assert np.linalg.norm(found.centre - np.asarray(centre)) <= 0.010
    direction = np.asarray(axis) / np.linalg.norm(np.asarray(axis))
    assert np.degrees(np.arccos(np.clip(found.axis @ direction, -1, 1))) <= 2.0
    assert abs(found.outer_radius - outer_radius) <= 0.005
