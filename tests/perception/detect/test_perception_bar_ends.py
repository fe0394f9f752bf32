"""Where a bar ends: rays that hit it, went through behind its end, or were stopped before."""

from __future__ import annotations

import numpy as np
import pytest

from perception.detect.shared.bar_ends import likely_ends
from perception.detect.shared.bars import Bar, SurroundingRays
from perception.ground.floor import FloorPlane

# Along x, its upper face at z = 0.
BAR = Bar(np.eye(3), np.array([0.0, 0.0, -0.02]), (0.045, 0.02), -0.2, 0.2)
TRUE_END = 0.5
UP = np.array([0.0, 0.0, 1.0])
FLOOR = FloorPlane(UP, -1.0, 0.0, 10.0)


def rays_from_above(along: np.ndarray, height: np.ndarray, seed: int = 0) -> SurroundingRays:
    """Straight down, each ending at its height above the upper face [m], with a scanner's noise."""
    rng = np.random.default_rng(seed)
    n = len(along)
    start = np.column_stack([along, rng.uniform(-0.04, 0.04, n), np.full(n, 2.0)])
    ends = height + rng.normal(0.0, 0.008, n)
    return SurroundingRays(start, np.tile([0.0, 0.0, -1.0], (n, 1)), 2.0 - ends, np.zeros(n, dtype=bool))


def ended(along: np.ndarray, *others: tuple[float, float, float]) -> np.ndarray:
    """Heights where rays end: the bar up to its true ends, the ground far below, others (first, last, height)."""
    height = np.where(np.abs(along) < TRUE_END, 0.0, -0.6)
    for first, last, level in others:
        height = np.where((along > first) & (along < last), level, height)
    return height


ALONG = np.linspace(-0.9, 0.9, 720)


def test_a_bar_ends_where_rays_went_on_behind_it() -> None:
    found = likely_ends(rays_from_above(ALONG, ended(ALONG)), BAR, FLOOR)
    assert found.bar.first == pytest.approx(-TRUE_END, abs=0.005)
    assert found.bar.last == pytest.approx(TRUE_END, abs=0.005)
    assert found.seen == (True, True)
    assert max(found.hidden) < 0.02


def test_behind_what_lies_over_its_end_a_bar_may_be_longer() -> None:
    found = likely_ends(rays_from_above(ALONG, ended(ALONG, (0.4, 0.7, 0.1))), BAR, FLOOR)
    assert found.bar.last == pytest.approx(0.4, abs=0.005)
    assert not found.seen[1]
    assert found.hidden[1] == pytest.approx(0.1)
    assert found.hidden[0] < 0.02


def test_an_end_that_is_hidden_along_a_short_stretch_is_taken_for_the_middle_of_it() -> None:
    found = likely_ends(rays_from_above(ALONG, ended(ALONG, (0.45, 0.55, 0.1))), BAR, FLOOR)
    assert found.bar.last == pytest.approx(0.5, abs=0.015)
    assert found.hidden[1] == pytest.approx(0.05, abs=0.015)


def test_a_bar_goes_on_behind_what_lies_across_it() -> None:
    found = likely_ends(rays_from_above(ALONG, ended(ALONG, (0.2, 0.35, 0.1))), BAR, FLOOR)
    assert found.bar.last == pytest.approx(TRUE_END, abs=0.005)
    assert found.hidden[1] < 0.02


def test_what_slopes_through_the_line_of_a_bar_behind_its_end_is_not_of_it() -> None:
    slope = np.where((ALONG > TRUE_END) & (ALONG < 0.64), -0.03 + (ALONG - TRUE_END), ended(ALONG))
    found = likely_ends(rays_from_above(ALONG, slope), BAR, FLOOR)
    assert found.bar.last + found.hidden[1] >= TRUE_END - 0.005
    assert found.bar.last < TRUE_END + 0.05 or found.hidden[1] > 0.05


def test_a_bar_is_not_followed_across_air_to_another_in_its_line() -> None:
    found = likely_ends(rays_from_above(ALONG, ended(ALONG, (TRUE_END + 0.08, 0.8, 0.0))), BAR, FLOOR)
    assert found.bar.last == pytest.approx(TRUE_END, abs=0.005)
    assert found.hidden[1] < 0.02


def test_a_few_rays_in_line_far_behind_what_covers_an_end_do_not_make_a_bar_longer() -> None:
    heights = ended(ALONG, (0.4, 0.7, 0.1), (0.7, 0.71, 0.0))
    found = likely_ends(rays_from_above(ALONG, heights), BAR, FLOOR)
    assert found.bar.last == pytest.approx(0.4, abs=0.005)
    assert found.hidden[1] == pytest.approx(0.1)


def test_the_floor_a_bar_lies_on_is_no_part_of_it_and_bounds_it() -> None:
    floor = FloorPlane(UP, -0.04, 0.0, 10.0)
    rays = rays_from_above(ALONG, np.where(np.abs(ALONG) < TRUE_END, 0.0, -0.04))
    lying = SurroundingRays(rays.start, rays.direction, rays.length, floor.above(rays.ends) < 0.02)
    found = likely_ends(lying, BAR, floor)
    assert found.bar.length == pytest.approx(2.0 * TRUE_END, abs=0.02)
    assert max(found.hidden) < 0.03


def test_a_bar_that_descends_ends_at_the_floor_even_when_its_end_is_hidden() -> None:
    floor = FloorPlane(np.array([0.8, 0.0, 0.6]), -0.31, 0.0, 10.0)
    down = likely_ends(rays_from_above(ALONG, ended(ALONG, (-0.7, -0.3, 0.1))), BAR, floor)
    up = likely_ends(rays_from_above(ALONG, ended(ALONG, (0.3, 0.7, 0.1))), BAR, floor)
    # Its lower edge is 4.6 cm above the floor there and comes 0.8 m nearer with each metre; 2 cm are for noise.
    room = (0.046 + 0.02) / 0.8
    assert down.hidden[0] == pytest.approx(0.5 * room, abs=0.005)
    assert down.bar.first == pytest.approx(-0.3 - 0.5 * room, abs=0.01)
    assert up.hidden[1] == pytest.approx(0.1)


def test_of_a_bar_that_no_ray_hit_nothing_is_known() -> None:
    found = likely_ends(rays_from_above(ALONG, np.full(len(ALONG), 0.5)), BAR, FLOOR)
    assert found.seen == (False, False)
    assert found.hidden == (0.1, 0.1)
    assert found.bar.length <= BAR.length
