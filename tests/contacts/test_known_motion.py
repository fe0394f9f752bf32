"""Ways of an earlier plan, led to other ends."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from service.tasks.rest.earlier_motion import lead_way

SEEDS = st.integers(0, 2**32 - 1)


def draw_way(rng, count=9):
    """A way of even steps in one direction, bent a little."""
    return np.outer(np.arange(count), np.ones(4)) + 0.1 * rng.normal(size=(count, 4))


@given(SEEDS)
def test_a_way_led_to_its_own_ends_stays_as_it_is(seed):
    way = draw_way(np.random.default_rng(seed))
    np.testing.assert_allclose(lead_way(way, way[0], way[-1]), way)


@given(SEEDS)
def test_a_way_led_to_other_ends_has_them_and_moves_no_more_than_they_do(seed):
    rng = np.random.default_rng(seed)
    way = draw_way(rng)
    first, last = way[0] + 0.1 * rng.normal(size=4), way[-1] + 0.1 * rng.normal(size=4)
    led = lead_way(way, first, last)
    np.testing.assert_allclose(led[[0, -1]], [first, last])
    assert (
        np.linalg.norm(led - way, axis=1).max() <= np.linalg.norm([first - way[0], last - way[-1]], axis=1).max() + 1e-9
    )


def test_what_is_behind_the_robot_is_left_out():
    way = draw_way(np.random.default_rng(0))
    led = lead_way(way, way[4] + 0.01, way[-1])
    assert len(led) == 5
    np.testing.assert_allclose(led[0], way[4] + 0.01)


def test_of_a_way_that_is_nearly_over_nothing_is_left():
    way = draw_way(np.random.default_rng(0))
    assert lead_way(way, way[-2], way[-1]) is None
