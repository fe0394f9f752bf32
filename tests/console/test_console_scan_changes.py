"""What the console says moved between two scans."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from service.cli.console.scan_changes import describe_groups, find_groups

RNG = np.random.default_rng(3)
WALL = np.column_stack([np.full(4000, 1.0), RNG.uniform(-1, 1, 4000), RNG.uniform(0, 2, 4000)])


def make_box(centre: tuple[float, float, float], side: float = 0.2) -> np.ndarray:
    return np.array(centre) + RNG.uniform(-side / 2, side / 2, (2000, 3))


@settings(max_examples=20)
@given(y=st.floats(-0.8, 0.8), z=st.floats(0.2, 1.8))
def test_a_box_that_came_is_new_and_seen_from_the_other_side_gone(y: float, z: float) -> None:
    with_box = np.concatenate([WALL, make_box((0.7, y, z))])
    (group,) = find_groups(with_box, WALL)
    assert np.allclose(group.centre, [0.7, y, z], atol=0.03)
    assert abs(group.size_m - 0.2) < 0.03
    assert find_groups(WALL, with_box) == []


def test_noise_and_strays_have_not_moved() -> None:
    noisy = WALL + RNG.normal(0, 0.005, WALL.shape)
    strays = np.array([[0.2, 0.0, 1.0], [0.3, 0.5, 1.0]])
    assert find_groups(np.concatenate([noisy, strays]), WALL) == []
    assert find_groups(np.empty((0, 3)), WALL) == []
    (whole,) = find_groups(WALL, np.full((1, 3), 9.0))
    assert whole.size_m > 1.9


def test_the_largest_groups_are_named_with_their_places() -> None:
    clouds = [make_box((0.5, y, 1.0), 0.2) for y in (-1.0, -0.5, 0.0, 0.5)]
    line = describe_groups(find_groups(np.concatenate(clouds), WALL), "new")
    assert line.startswith("4 new: 0.20 m at 0.50, ")
    assert line.endswith(" and 1 more")
    assert describe_groups([], "new") == ""
