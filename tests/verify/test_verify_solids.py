"""Convex solids: how far they reach along directions, and their distances from coal against another reference."""

from __future__ import annotations

import numpy as np
import pytest
from hull_reference import hull_distance
from hypothesis import given, settings
from hypothesis import strategies as st
from small_robots import CUBE

from costs.robot import LinkBody
from service.verify.solids import CoalSolid, DistanceQuery, make_coal_convex, supports


def _apart(first: np.ndarray, second: np.ndarray, shift: np.ndarray) -> tuple[float, np.ndarray]:
    """coal's signed distance and direction for the first set, shifted, and the second."""
    distance, direction = DistanceQuery().closest(
        [make_coal_convex(first)], np.eye(3)[None], shift[None], [make_coal_convex(second)]
    )
    return float(distance[0]), direction[0]


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1))
def test_supports_are_the_farthest_vertices_of_each_solid(seed: int) -> None:
    rng = np.random.default_rng(seed)
    solids = [CoalSolid(f"s{k}", "", 0, rng.normal(size=(int(rng.integers(1, 90)), 3))) for k in range(5)]
    which, directions = rng.integers(0, 5, size=40), rng.normal(size=(40, 3))
    found = supports(solids, which, directions)
    expected = [max(float(vertex @ d) for vertex in solids[k].vertices) for k, d in zip(which, directions, strict=True)]
    assert np.allclose(found, expected, rtol=0.0, atol=1e-12)


def test_no_supports_are_asked_of_no_solids() -> None:
    assert supports([], np.zeros(0, dtype=int), np.zeros((0, 3))).shape == (0,)


@pytest.mark.parametrize("count", [1, 2, 3, 4, 8, 32, 33, 60, 129, 300])
def test_distances_of_sets_of_any_size_are_right(count: int) -> None:
    rng = np.random.default_rng(count)
    points = rng.normal(size=(count, 3))
    points *= 0.2 / np.linalg.norm(points, axis=1)[:, None]
    for _ in range(10):
        shift = rng.normal(size=3)
        shift *= 0.8 / np.linalg.norm(shift)
        distance, direction = _apart(points, CUBE * 0.1, shift)
        assert distance == pytest.approx(hull_distance(points + shift, CUBE * 0.1), abs=1e-5)
        # The direction leads from the first set to the second and separates them by that distance.
        gap = (CUBE * 0.1 @ direction).min() - ((points + shift) @ direction).max()
        assert gap == pytest.approx(distance, abs=1e-6)


@pytest.mark.parametrize("count", [40, 400])
def test_distances_of_flat_sets_are_right(count: int) -> None:
    rng = np.random.default_rng(count)
    flat = np.column_stack([rng.uniform(-1.0, 1.0, (count, 2)), np.zeros(count)])
    distance, direction = _apart(CUBE * 0.1, flat, np.array([0.1, -0.2, 0.35]))
    assert distance == pytest.approx(0.25, abs=1e-6)
    assert np.allclose(direction, [0.0, 0.0, -1.0], atol=1e-6)


def test_overlapping_sets_have_their_depth_as_negative_distance() -> None:
    distance, direction = _apart(CUBE * 0.1, CUBE * 0.1, np.array([0.0, 0.0, 0.17]))
    assert distance == pytest.approx(-0.03, abs=1e-9)
    assert np.allclose(direction, [0.0, 0.0, -1.0], atol=1e-9)


def test_equal_points_share_a_convex_and_other_points_never_do() -> None:
    points = np.random.default_rng(0).normal(size=(40, 3))
    assert make_coal_convex(points) is make_coal_convex(points.copy())
    moved = points.copy()
    moved[0, 0] += 1e-12
    assert make_coal_convex(moved) is not make_coal_convex(points)


def test_the_solid_of_a_body_is_made_once() -> None:
    body = LinkBody("body", "link", 1, CUBE, CUBE)
    assert CoalSolid.of_body(body) is CoalSolid.of_body(body)
    assert CoalSolid.of_body(LinkBody("body", "link", 1, 2.0 * CUBE, CUBE)).vertices is not CUBE


# A foot of Atlas on a stone, as the verifier met it: with the faces exactly in touch coal returned -1.8e308.
FOOT = np.array(
    [
        *([x, y, z] for z in (-0.07645, -0.05445) for x in (0.17279, -0.0877) for y in (0.06609, -0.0626)),
        [-0.06, 0.0226, -0.01],
        [-0.06, -0.01911, -0.01],
        *([x, y, 0.018] for x in (0.04, -0.04) for y in (0.038, -0.038)),
    ]
)
TOUCHING = [
    (
        [[1.0, 6.107777224481405e-17, -1.0395375962725377e-16], [-4.163336342344337e-17, 1.0, 0.0],
         [5.551115123125783e-17, 2.7755575615628914e-17, 0.9999999999999999]],
        [0.4574550000000003, 0.118255, 0.17645000000000005], [0.35, 0.01], [0.65, 0.23], 0.1,
    ),
    (
        [[0.9999999999999999, 3.4099814849482786e-17, -3.883958690646824e-16],
         [-3.2959746043559335e-17, 0.9999999999999999, -3.469446951953614e-18],
         [2.7755575615628914e-16, 3.469446951953614e-18, 0.9999999999999999]],
        [0.32745500000000005, -0.11825499999999994, 0.12645000000000017], [0.22, -0.23], [0.52, -0.01], 0.05,
    ),
]  # fmt: skip


@pytest.mark.parametrize(("turned", "moved", "low", "high", "top"), TOUCHING)
@pytest.mark.parametrize("offset", [0.0, 1e-12, -1e-12, 1e-4, -1e-4])
def test_faces_that_just_touch_have_a_distance_of_zero(
    turned: list[list[float]], moved: list[float], low: list[float], high: list[float], top: float, offset: float
) -> None:
    stone = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (0.0, top)])
    shift = np.array(moved) + np.array([0.0, 0.0, offset])
    distance, _ = DistanceQuery().closest(
        [make_coal_convex(FOOT)], np.array(turned)[None], shift[None], [make_coal_convex(stone)]
    )
    assert distance[0] == pytest.approx(offset, abs=1e-7)
