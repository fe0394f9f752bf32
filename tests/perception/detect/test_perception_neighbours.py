"""Nearest neighbours, some at a time."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from scipy.spatial import cKDTree

from costs import threads
from costs.stopping import Stopped, stops_when
from perception.cleaning import clean
from perception.cleaning.clean import nearest

POINTS = np.random.default_rng(0).normal(size=(3000, 3))


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    yield
    threads.use_threads(1)


@pytest.mark.parametrize("k", [1, 5, [4], np.arange(2, 9)])
@pytest.mark.parametrize("n_threads", [1, 3])
@pytest.mark.parametrize("within", [np.inf, 0.1])
def test_neighbours_are_those_of_one_query_whatever_the_parts_and_threads(
    k: int | list[int] | np.ndarray, n_threads: int, within: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(clean, "_AT_ONCE", 1000)
    threads.use_threads(n_threads)
    tree = cKDTree(POINTS)
    for found, expected in zip(
        nearest(tree, POINTS, k, within), tree.query(POINTS, k=k, distance_upper_bound=within), strict=True
    ):
        np.testing.assert_array_equal(found, expected)


def test_of_no_points_there_are_no_neighbours() -> None:
    distance, index = nearest(cKDTree(POINTS), POINTS[:0], [3])
    assert (distance.shape, index.shape) == ((0, 1), (0, 1))


def test_a_search_ends_between_its_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clean, "_AT_ONCE", 400)
    asked = iter([False] * 3)
    with pytest.raises(Stopped), stops_when(lambda: next(asked, True)):
        nearest(cKDTree(POINTS), POINTS, 4)
    assert next(asked, None) is None


def test_one_thread_is_used_unless_a_program_says_otherwise() -> None:
    assert threads.thread_count() == 1
    threads.use_all_cores()
    assert threads.thread_count() >= 1
    with pytest.raises(ValueError, match="n_threads: expected at least 1, got 0"):
        threads.use_threads(0)
