"""Sums over the layers of a histogram."""

from __future__ import annotations

import numpy as np
import pytest

from perception.detect.shared.arithmetic import sum_about

ALONE = (0.5, 0.5, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5, 0.5, 0.5)


@pytest.mark.parametrize("n_layers", range(1, 16))
@pytest.mark.parametrize("weights", [(1.0, 2.0, 4.0), ALONE])
def test_each_layer_gets_the_weighted_sum_of_those_about_it(n_layers: int, weights: tuple[float, ...]) -> None:
    counts = np.random.default_rng(n_layers).uniform(size=n_layers)
    half = len(weights) // 2
    expected = [
        sum(weight * counts[i + k - half] for k, weight in enumerate(weights) if 0 <= i + k - half < n_layers)
        for i in range(n_layers)
    ]
    np.testing.assert_allclose(sum_about(counts, weights), expected, atol=1e-12)
