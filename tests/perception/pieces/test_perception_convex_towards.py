"""Which rays may pass some boxes, selected by their directions and lengths."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from perception.convex.towards import Bearings, Sheaf


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.02, 3.0), st.floats(0.35, 6.0))
def test_every_ray_that_passes_a_box_is_selected(seed: int, size: float, distance: float) -> None:
    rng = np.random.default_rng(seed)
    start, boxes = rng.uniform(-2.0, 2.0, 3), np.empty((3, 2, 3))
    for box in boxes:
        way = rng.normal(size=3)
        box[0] = start + distance * way / np.linalg.norm(way) - size * rng.uniform(0.0, 1.0, 3)
        box[1] = box[0] + size * rng.uniform(0.0, 1.0, 3)
    ends = start + rng.normal(size=(100, 3)) * rng.uniform(0.1, 6.0, (100, 1))
    selected = Bearings.of(start, ends).may_pass(boxes)
    places = start + np.linspace(0.0, 1.0, 300)[:, None, None] * (ends - start)
    passes = np.zeros(len(ends), dtype=bool)
    for lower, upper in boxes:
        passes |= ((places >= lower) & (places <= upper)).all(axis=2).any(axis=0)
    assert selected[passes].all()


def test_rays_that_end_before_a_box_or_go_elsewhere_are_not_selected() -> None:
    start = np.array([0.0, 0.0, 1.5])
    ahead, aside, beyond = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.3, 0.0])
    ends = start + np.array([1.5 * ahead, 3.0 * ahead, 3.0 * aside, 3.0 * beyond])
    boxes = np.array([[[2.0, -0.1, 1.4], [2.2, 0.1, 1.6]]])
    assert Bearings.of(start, ends).may_pass(boxes).tolist() == [False, True, False, False]
    assert not Bearings.of(start, ends).may_pass(boxes[:0]).any()


def test_all_rays_are_selected_for_a_box_that_holds_their_start() -> None:
    start = np.zeros(3)
    ends = np.random.default_rng(0).normal(size=(50, 3))
    assert Bearings.of(start, ends).may_pass(np.array([[[-0.1, -0.1, -0.1], [0.1, 0.1, 0.1]]])).all()


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.01, 2.0), st.floats(0.0, 6.0))
def test_every_ray_that_passes_a_ball_is_selected(seed: int, radius: float, distance: float) -> None:
    rng = np.random.default_rng(seed)
    start, way = rng.uniform(-2.0, 2.0, 3), rng.normal(size=3)
    centre = start + distance * way / np.linalg.norm(way)
    ends = start + rng.normal(size=(400, 3)) * rng.uniform(0.1, 6.0, (400, 1))
    along = (ends - start) / np.linalg.norm(ends - start, axis=1, keepdims=True)
    nearest = start + along * (along @ (centre - start)).clip(0.0, np.linalg.norm(ends - start, axis=1))[:, None]
    passes = np.flatnonzero(np.linalg.norm(nearest - centre, axis=1) <= radius)
    selected = Sheaf.of(start, ends).select_about(centre, radius)
    assert set(passes) <= set(selected)
    assert (np.diff(selected) > 0).all()


def test_few_rays_are_selected_for_a_small_ball() -> None:
    ends = 3.0 * np.random.default_rng(0).normal(size=(2000, 3))
    assert len(Sheaf.of(np.zeros(3), ends).select_about(np.array([2.0, 0.5, 0.3]), 0.1)) < 100
