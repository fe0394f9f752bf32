"""The cheapest sequence of poses against Dijkstra's algorithm, and drawn places against random ones."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from scipy.stats.qmc import discrepancy

from service.tasks.egress.graph import PoseGraph, measure_connection
from service.tasks.egress.samples import draw_places


def draw_graph(seed: int, sizes: list[int], density: float) -> PoseGraph:
    """Layers of the given sizes, with some of the edges."""
    rng = np.random.default_rng(seed)
    layer = np.repeat(np.arange(len(sizes)), sizes)
    edges = rng.uniform(0.0, 10.0, (len(layer), len(layer)))
    edges[(layer[None] != layer[:, None] + 1) | (rng.random(edges.shape) > density)] = np.inf
    return PoseGraph(layer, rng.uniform(0.0, 5.0, len(layer)), edges)


def cheapest_by_dijkstra(graph: PoseGraph) -> float:
    """Cost from any first node to any last one, each node's cost moved onto the edges into it."""
    count = len(graph.layer)
    weights = np.full((count + 2, count + 2), np.inf)
    weights[:count, :count] = graph.edge_cost + graph.pose_cost
    weights[count, :count] = np.where(graph.layer == 0, graph.pose_cost, np.inf)
    weights[:count, count + 1] = np.where(graph.is_last, 1e-9, np.inf)
    rows, columns = np.nonzero(np.isfinite(weights))
    sparse = csr_array((weights[rows, columns], (rows, columns)), shape=weights.shape)
    return float(dijkstra(sparse, indices=count)[count + 1])


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000), st.lists(st.integers(1, 8), min_size=2, max_size=6), st.sampled_from([0.2, 0.6, 1.0]))
def test_value_iteration_finds_what_dijkstra_finds(seed, sizes, density):
    graph = draw_graph(seed, sizes, density)
    expected, path = cheapest_by_dijkstra(graph), graph.find_sequence()
    if not np.isfinite(expected):
        assert path is None
        return
    assert path is not None
    assert list(graph.layer[list(path)]) == list(range(len(sizes)))
    assert graph.measure_cost(path) == pytest.approx(expected, abs=1e-6)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.lists(st.integers(2, 6), min_size=3, max_size=5))
def test_a_sequence_without_an_edge_is_the_next_best(seed, sizes):
    graph = draw_graph(seed, sizes, 1.0)
    best = graph.find_sequence()
    cut = (best[0], best[1])
    following = graph.find_sequence({cut})
    edges = graph.edge_cost.copy()
    edges[cut] = np.inf
    expected = cheapest_by_dijkstra(PoseGraph(graph.layer, graph.pose_cost, edges))
    if following is None:
        assert not np.isfinite(expected)
    else:
        assert cut not in pairwise(following)
        assert graph.measure_cost(following) == pytest.approx(expected, abs=1e-6)
        assert graph.measure_cost(following) >= graph.measure_cost(best)


def test_connection_and_sequence_of_a_case_worked_out_by_hand():
    # One contact point on a line, one joint. Poses: A at 0 m, 0 rad; B at 0.01 m, 0 rad and C at 0 m, 0.5 rad.
    points = np.zeros((3, 1, 3))
    points[1, 0, 0] = 0.01
    joints = np.array([[0.0], [0.0], [0.5]])
    costs = measure_connection(points[:1], joints[:1], points[1:], joints[1:])
    np.testing.assert_allclose(costs, [[1e4 * 0.01**2, 1e1 * 0.5**2]])  # 1 and 2.5
    edges = np.full((3, 3), np.inf)
    edges[0, 1:] = costs[0]
    assert PoseGraph(np.array([0, 1, 1]), np.array([0.0, 0.0, 0.0]), edges).find_sequence() == (0, 1)
    graph = PoseGraph(np.array([0, 1, 1]), np.array([0.3, 2.0, 0.2]), edges)
    assert graph.find_sequence() == (0, 2)
    np.testing.assert_allclose(graph.find_values(), [0.3 + 2.5 + 0.2, 2.0, 0.2])


def test_drawn_places_fill_the_region_more_evenly_than_random_ones():
    middle, lengths = np.array([0.36, -0.77]), np.array([0.2, 0.1])
    for count in (10, 25, 100):
        places = draw_places(middle, lengths, count, seed=3)
        unit = (places - middle) / lengths + 0.5
        assert ((unit >= 0.0) & (unit <= 1.0)).all()
        random = [discrepancy(np.random.default_rng(k).random((count, 2))) for k in range(20)]
        assert discrepancy(unit) < min(random)


def test_more_drawn_places_keep_the_first_ones():
    few = draw_places(np.zeros(2), np.ones(2), 7, seed=1)
    np.testing.assert_array_equal(draw_places(np.zeros(2), np.ones(2), 30, seed=1)[:7], few)
