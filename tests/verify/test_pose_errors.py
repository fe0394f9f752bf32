"""Errors of poses: angles, leans and chords against scipy, and by hand at their ends."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from service.verify import PoseTarget
from service.verify.targets.pose_errors import (
    angle_of,
    chord_of,
    list_position_demands,
    measure_angle,
    measure_lean,
    offset_from_target,
)

ANGLES = np.array([0.0, 1e-7, 0.3, 0.5 * np.pi, 2.0, np.pi - 1e-7, np.pi])


@pytest.mark.parametrize("seed", range(3))
def test_angles_and_leans_are_those_of_rotations_about_any_axis(seed: int) -> None:
    rng = np.random.default_rng(seed)
    axis, wanted = rng.normal(size=(2, 3))
    axis /= np.linalg.norm(axis)
    turns = Rotation.from_rotvec(ANGLES[:, None] * axis)
    np.testing.assert_allclose(measure_angle(turns.as_matrix()), ANGLES, atol=1e-9)
    across = np.cross(axis, wanted)
    across /= np.linalg.norm(across)
    np.testing.assert_allclose(measure_lean(turns.apply(across), across), ANGLES, atol=1e-9)


def test_a_chord_is_the_distance_of_the_tips_and_beyond_the_diameter_the_angle_is_more_than_half_a_turn() -> None:
    tips = np.column_stack([np.cos(ANGLES), np.sin(ANGLES)])
    chords = np.linalg.norm(tips - [1.0, 0.0], axis=1)
    np.testing.assert_allclose(chord_of(ANGLES), chords, atol=1e-12)
    np.testing.assert_allclose(angle_of(chords), ANGLES, atol=1e-6)
    np.testing.assert_allclose(angle_of(np.array([1.0, 2.0, 2.5])), [np.pi / 3.0, np.pi, np.pi + 0.5], atol=1e-12)


@pytest.mark.parametrize(
    ("tolerance", "expected"),
    [
        ((0.1, 0.1, 0.1), [(None, 0.1, [5.0, 13.0])]),
        ((0.1, 0.2, np.inf), [(0, 0.1, [3.0, 0.0]), (1, 0.2, [4.0, 5.0])]),
        ((np.inf,) * 3, []),
    ],
)
def test_equal_tolerances_demand_a_distance_and_others_an_offset_along_each_axis(
    tolerance: tuple[float, ...], expected: list[tuple[int | None, float, list[float]]]
) -> None:
    quarter = Rotation.from_rotvec([0.0, 0.0, 0.5 * np.pi]).as_matrix()  # the target's x is the world's y
    target = PoseTarget("tip", np.ones(3), quarter, np.array(tolerance), np.full(3, 0.1))
    offset = offset_from_target(target, np.ones(3) + quarter @ [-3.0, 4.0, 0.0] + np.zeros((1, 3)))
    np.testing.assert_allclose(offset, [[-3.0, 4.0, 0.0]], atol=1e-12)
    offset = np.vstack([offset, [0.0, -5.0, 12.0]])
    demands = [(demand.axis, demand.tolerance_m, demand.measure(offset)) for demand in list_position_demands(target)]
    assert [demand[:2] for demand in demands] == [each[:2] for each in expected]
    for (*_, errors), (*_, by_hand) in zip(demands, expected, strict=True):
        np.testing.assert_allclose(errors, by_hand)
