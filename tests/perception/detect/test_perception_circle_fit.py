"""Scores of circles, by hand: coverage of sectors, share of inliers in the disc, and what few points are worth."""

from __future__ import annotations

import numpy as np
import pytest

from perception.detect.valve.circle_fit import Circles, Inliers, score_circles

CIRCLES = Circles(np.zeros((2, 3)), np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]), np.array([0.2, 0.3]))


def points_on(circle: int, n_sectors: int) -> np.ndarray:
    """Offsets of two points in the middle of each of the first sectors of 15 degrees, in the circle's plane."""
    angles = np.repeat(np.deg2rad(15.0 * (np.arange(n_sectors) + 0.5)), 2)
    flat = CIRCLES.radii[circle] * np.column_stack([np.cos(angles), np.sin(angles), 0.0 * angles])
    return flat if circle == 0 else np.roll(flat, 1, axis=1)


# 25 points are enough; of fewer the score is in proportion
@pytest.mark.parametrize(("count", "worth"), [(100, 1.0), (25, 1.0), (20, 0.8), (5, 0.2)])
def test_a_score_is_coverage_squared_times_the_share_of_inliers_and_less_of_few_points(
    count: int, worth: float
) -> None:
    offsets = [points_on(0, 12), points_on(1, 6)]
    circle = np.repeat([0, 1], [len(part) for part in offsets])
    inliers = Inliers(circle, np.concatenate(offsets), np.array([count, 50]), np.array([0.5, 0.8]))
    scored = score_circles(CIRCLES, inliers)
    np.testing.assert_allclose(scored.coverage, [12 / 24, 6 / 24])
    np.testing.assert_allclose(scored.scores, [0.5**2 * 0.5 * worth, 0.25**2 * 0.8])
