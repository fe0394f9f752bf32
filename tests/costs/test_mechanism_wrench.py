"""Wrenches of loads that move with a mechanism lie in the hull of the listed corners."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation

from costs.mechanism_wrench import list_arc_wrenches, list_slide_wrenches


def lies_in_hull(wrench, corners):
    """Whether some convex combination of the corners is the wrench, to 1e-6."""
    rows = np.vstack([corners.T, np.ones(len(corners))])
    target = np.append(wrench, 1.0)
    slack = np.hstack([rows, np.eye(7), -np.eye(7)])
    cost = np.concatenate([np.zeros(len(corners)), np.ones(14)])
    return linprog(cost, A_eq=slack, b_eq=target, method="highs").fun < 1e-6


def random_load(rng):
    force, axis = rng.normal(size=3) * 40.0, rng.normal(size=3)
    return force, rng.uniform(-1.0, 1.0, 3), axis / np.linalg.norm(axis), rng.uniform(-1.0, 1.0, 3)


def turned(force, point, axis, origin, angle):
    rotation = Rotation.from_rotvec(angle * axis).as_matrix()
    acting = rotation @ force
    return np.concatenate([acting, np.cross(origin + rotation @ (point - origin), acting)])


@given(seed=st.integers(0, 10_000), first=st.floats(-3.0, 3.0), span=st.floats(-6.5, 6.5))
def test_every_wrench_of_an_arc_lies_in_the_hull_of_its_corners(seed, first, span):
    rng = np.random.default_rng(seed)
    load = random_load(rng)
    corners = list_arc_wrenches(*load, first, first + span)
    np.testing.assert_allclose(corners[0], turned(*load, first), atol=1e-9)
    for share in (0.0, 0.5, 1.0, *rng.random(3)):
        assert lies_in_hull(turned(*load, first + share * span), corners)


def test_corners_stay_near_the_arc():
    corners = list_arc_wrenches(
        np.array([10.0, 0.0, 0.0]), np.zeros(3), np.array([0.0, 0.0, 2.0]), np.zeros(3), 0.0, 2.0
    )
    assert len(corners) == 4  # two ends, two arcs of 57 degrees
    lengths = np.linalg.norm(corners[:, :3], axis=1)
    np.testing.assert_allclose(lengths, [10.0, 10.0, 10.0 / np.cos(0.5), 10.0 / np.cos(0.5)])


def test_corners_of_a_quarter_turn_by_hand():
    # 10 N along x at (0, 1, 0), a door that turns about the upright line through (1, 0, 0)
    x, y, z = np.eye(3)
    corners = list_arc_wrenches(10.0 * x, y, z, x, 0.0, 0.5 * np.pi)
    np.testing.assert_allclose(corners[0], [10.0, 0.0, 0.0, 0.0, 0.0, -10.0], atol=1e-9)
    # turned: 10 N along y at (0, -1, 0)
    np.testing.assert_allclose(corners[1], [0.0, 10.0, 0.0, 0.0, 0.0, 0.0], atol=1e-9)


def test_an_arc_without_length_is_one_wrench():
    rng = np.random.default_rng(0)
    load = random_load(rng)
    corners = list_arc_wrenches(*load, 0.7, 0.7)
    assert corners.shape == (1, 6)
    np.testing.assert_allclose(corners[0], turned(*load, 0.7), atol=1e-9)


@given(seed=st.integers(0, 10_000), share=st.floats(0.0, 1.0))
def test_every_wrench_of_a_slide_is_between_its_ends(seed, share):
    rng = np.random.default_rng(seed)
    force, point, axis, _ = random_load(rng)
    corners = list_slide_wrenches(force, point, 3.0 * axis, -0.2, 0.6)
    at = point + (-0.2 + 0.8 * share) * axis
    expected = np.concatenate([force, np.cross(at, force)])
    np.testing.assert_allclose((1.0 - share) * corners[0] + share * corners[1], expected, atol=1e-9)
    assert list_slide_wrenches(force, point, axis, 0.1, 0.1).shape == (1, 6)


def test_values_that_make_no_sense_are_refused():
    x, zero = np.array([1.0, 0.0, 0.0]), np.zeros(3)
    with pytest.raises(ValueError, match="axis must have a length"):
        list_arc_wrenches(x, x, zero, x, 0.0, 1.0)
    with pytest.raises(ValueError, match="angles must be finite"):
        list_arc_wrenches(x, x, x, x, 0.0, np.nan)
    with pytest.raises(ValueError, match="force must be finite"):
        list_slide_wrenches(np.array([np.inf, 0.0, 0.0]), x, x, 0.0, 1.0)
