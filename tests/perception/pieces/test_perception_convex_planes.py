"""What a plane explains: the tail of its noise, but nothing that hangs before it."""

from __future__ import annotations

import numpy as np
import pytest
from jaxtyping import Bool

from perception.convex.planes import Plane, PlaneSettings, find_noise

_SETTINGS = PlaneSettings()


def _explained(before: float, share: float) -> Bool[np.ndarray, "K"]:
    """Which points ``before`` a wall [m] count as its noise when they are this share of the wall's own about them."""
    rng = np.random.default_rng(7)
    n_wall, n_before = 20_000, round(share * 20_000)
    wall = np.column_stack([rng.normal(0.0, 0.008, n_wall), rng.uniform(-0.5, 0.5, (n_wall, 2))])
    hung = np.column_stack([rng.normal(before, 0.002, n_before), rng.uniform(-0.5, 0.5, (n_before, 2))])
    points = np.concatenate([wall, hung])
    plane = Plane(np.array([1.0, 0.0, 0.0]), 0.0, np.arange(n_wall), np.arange(0))
    return find_noise(plane, points, np.ones(len(points)), np.arange(n_wall, len(points)), _SETTINGS)


@pytest.mark.parametrize("before", [0.035, -0.045])
def test_the_thin_tail_of_a_wall_s_noise_is_the_wall_s(before: float) -> None:
    assert _explained(before, 0.01).mean() > 0.95


@pytest.mark.parametrize("before", [0.035, -0.045])
def test_what_hangs_farther_before_a_wall_than_its_slab_reaches_is_not_its_noise(before: float) -> None:
    assert _explained(before, 0.2).mean() < 0.05


def test_what_a_wall_s_slab_covers_is_its_noise() -> None:
    assert _explained(0.020, 0.2).mean() > 0.95


def test_tails_on_both_sides_of_a_wall_are_its_noise_however_thick() -> None:
    rng = np.random.default_rng(7)
    points = np.column_stack([rng.normal(0.0, 0.022, 30_000), rng.uniform(-0.5, 0.5, (30_000, 2))])
    is_member = np.abs(points[:, 0]) < 0.02
    tail = np.flatnonzero((np.abs(points[:, 0]) > 0.027) & (np.abs(points[:, 0]) < 0.06))
    plane = Plane(np.array([1.0, 0.0, 0.0]), 0.0, np.flatnonzero(is_member), tail[:0])
    assert find_noise(plane, points, np.ones(len(points)), tail, _SETTINGS).mean() > 0.95
