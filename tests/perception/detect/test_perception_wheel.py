"""What tells a wheel from a ring laid through other things: depths about the rim, parts in its plane, slim places."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from perception.detect.shared.slender import slim_places
from perception.detect.valve.inside import look_inside
from perception.detect.valve.ring import Ring, depth_error, pass_ring, unevenness
from perception.sightlines import Sightlines

_RING = Ring(np.array([1.0, 0.0, 0.0]), np.array([-1.0, 0.0, 0.0]), 0.1, 0.01, 0.01)


def _ahead(places: np.ndarray, length: np.ndarray) -> Sightlines:
    """Rays along the ring's axis through places of its plane, so long [m]."""
    start = _RING.centre + places @ _RING.basis[:2] + 1.0 * _RING.axis
    return Sightlines(start, np.broadcast_to(-_RING.axis, start.shape), length)


@pytest.mark.parametrize(("step", "least", "most"), [(0.0, 0.0, 0.003), (0.015, 0.012, 0.017)])
def test_a_ring_through_parts_of_other_things_is_uneven_and_a_noisy_rim_is_not(
    step: float, least: float, most: float
) -> None:
    rng = np.random.default_rng(0)
    angle = rng.uniform(0.0, 2.0 * np.pi, 600)
    rays = _ahead(0.1 * np.column_stack([np.cos(angle), np.sin(angle)]), np.ones(600))
    passage = pass_ring(rays, _RING)
    off = rng.normal(0.0, 0.012, 600) + step * np.sign(np.sin(angle))
    met = Sightlines(rays.start, rays.direction, passage.depth + off)
    assert least <= unevenness(met, passage, np.ones(600, dtype=bool)) < most
    assert depth_error(met, passage, np.ones(600, dtype=bool)) == pytest.approx(np.hypot(0.012, step), rel=0.1)


@pytest.mark.parametrize(("behind", "widest"), [(0.0, 2.0 * np.pi / 3.0), (0.02, 0.0)])
def test_a_broad_part_counts_as_one_only_in_the_rims_plane(behind: float, widest: float) -> None:
    along, up = (grid.ravel() for grid in np.meshgrid(*2 * [np.linspace(-0.085, 0.085, 60)]))
    angle = np.arctan2(up, along)
    is_hub = np.hypot(along, up) < 0.03
    is_broad = np.abs(angle - np.pi / 2.0) < np.pi / 3.0
    length = 1.0 + np.where(is_hub, 0.0, np.where(is_broad, behind, 0.5))
    rays = _ahead(np.column_stack([along, up]), length)
    inside = look_inside(rays, _RING, pass_ring(rays, _RING))
    assert inside.spokes_known
    assert inside.widest_spoke == pytest.approx(widest, abs=0.25)


def test_slim_places_are_those_of_a_rim_and_not_of_a_wall() -> None:
    rng = np.random.default_rng(1)
    angle = np.linspace(0.0, 2.0 * np.pi, 60, endpoint=False)
    rim = 0.14 * np.column_stack([np.zeros(60), np.cos(angle), np.sin(angle)]) + rng.normal(0.0, 0.003, (60, 3))
    wall = np.column_stack([np.full(1600, 0.3), *(grid.ravel() for grid in np.meshgrid(*2 * [np.arange(40) * 0.015]))])
    points = np.concatenate([rim, wall + rng.normal(0.0, 0.003, wall.shape)])
    slim, ways = slim_places(points, cKDTree(points), 0.045)
    assert (slim < 60).sum() > 50
    assert (slim >= 60).sum() < 0.02 * len(wall)
    outwards = rim[slim[slim < 60]] / 0.14
    assert np.abs((ways[slim < 60] * outwards).sum(axis=1)).max() < 0.5, "along the rim"
