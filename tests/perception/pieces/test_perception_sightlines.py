"""The search of rays near given positions returns the rays of an exhaustive search."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from perception.sightlines import Sightlines, index_of


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10_000), n_places=st.integers(1, 8), radius=st.floats(0.02, 0.5), n_starts=st.integers(1, 3))
def test_rays_that_pass_near_places_are_those_of_an_exhaustive_search(
    seed: int, n_places: int, radius: float, n_starts: int
) -> None:
    rng = np.random.default_rng(seed)
    starts = rng.normal(0.0, 0.2, (n_starts, 3))[rng.integers(n_starts, size=2000)]
    ways = rng.normal((2.0, 0.0, 0.0), 1.0, (2000, 3))
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    rays = Sightlines(starts, ways, rng.uniform(0.5, 3.0, 2000))
    places = np.array([1.0, 0.0, 0.0]) + np.linspace(-0.4, 0.4, n_places)[:, None] * rng.normal(size=3)
    near = index_of(rays).passing(places, radius)

    offset = places[None] - starts[:, None]
    angle = np.arccos(np.clip(np.einsum("nki,ni->nk", offset, ways) / np.linalg.norm(offset, axis=2), -1.0, 1.0))
    half = np.arcsin(np.minimum(radius / np.linalg.norm(offset, axis=2), 1.0))
    centre = places.mean(axis=0)
    size = radius + float(np.linalg.norm(places - centre, axis=1).max())
    along = ((centre - starts) * ways).sum(axis=1)
    reaches = (along > -size) & (rays.length > along - size)
    expected = np.sort(rays.length[(angle <= half).any(axis=1) & reaches])
    # Rays at the very border of a cone may fall on either side.
    assert abs(len(near) - len(expected)) <= 1
    assert np.isin(near.length, rays.length[(angle <= half + 1e-6).any(axis=1) & reaches]).all()


def test_rays_come_in_the_order_of_the_scan() -> None:
    rng = np.random.default_rng(1)
    ways = rng.normal((3.0, 0.0, 0.0), 1.0, (500, 3))
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    rays = Sightlines(np.zeros((500, 3)), ways, np.arange(2.0, 502.0))
    near = index_of(rays).passing(np.array([[1.0, 0.0, 0.0]]), 0.4)
    assert len(near) > 10
    assert (np.diff(near.length) > 0.0).all()
