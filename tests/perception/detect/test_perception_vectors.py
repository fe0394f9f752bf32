"""Small vector arithmetic against numpy's own."""

from __future__ import annotations

import numpy as np
import pytest

from perception.detect.shared.arithmetic import cross, median_of_known


@pytest.mark.parametrize("shape", [(3,), (5, 3), (2, 4, 3)])
def test_cross_products_are_numpys_to_the_last_bit(shape: tuple[int, ...]) -> None:
    u, v = np.random.default_rng(0).normal(size=(2, *shape))
    np.testing.assert_array_equal(cross(u, v), np.cross(u, v))


def test_the_median_of_what_is_known_leaves_out_what_is_not() -> None:
    nan = np.nan
    values = np.array([[3.0, nan, 1.0, 2.0], [nan, 4.0, 1.0, nan], [nan, nan, nan, nan], [7.0, nan, nan, nan]])
    np.testing.assert_array_equal(median_of_known(values, -1.0), [2.0, 2.5, -1.0, 7.0])
