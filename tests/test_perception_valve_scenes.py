"""Wheel valves in simulated scenes by other sensors: the smallest and the largest, and hose ends that are none."""

from __future__ import annotations

import numpy as np
import pytest

from perception import CONFIDENT, ValveDetection, detect_valves
from perception.simulate.scenes import make_scene


def assert_matches(found: ValveDetection, centre: object, axis: object, outer_radius: float) -> None:
    """The targets for dense scans."""
    assert found.confidence >= CONFIDENT
    assert np.linalg.norm(found.centre - np.asarray(centre)) <= 0.010
    direction = np.asarray(axis) / np.linalg.norm(np.asarray(axis))
    assert np.degrees(np.arccos(np.clip(found.axis @ direction, -1, 1))) <= 2.0
    assert abs(found.outer_radius - outer_radius) <= 0.005


@pytest.mark.parametrize(("name", "sensor"), [("hose_wide", "dense"), ("hose_up", "dense"), ("hose_wide", "solid")])
def test_a_pipe_seen_from_its_open_end_is_no_wheel(name: str, sensor: str) -> None:
    assert all(found.confidence < CONFIDENT for found in detect_valves(make_scene(name, seed=5).scan(sensor)))


@pytest.mark.parametrize(("name", "sensor"), [("valve_tiny", "solid"), ("valve_large", "solid")])
def test_the_smallest_and_a_large_wheel_among_pipes_and_boxes_are_found_within_the_targets(
    name: str, sensor: str
) -> None:
    scene = make_scene(name)
    (true,) = (one for one in scene.truth if one.kind == "valve")
    pose = true.pose_world_object
    assert_matches(detect_valves(scene.scan(sensor))[0], pose[:3, 3], pose[:3, 2], true.sizes["outer_radius"])


def test_a_standpipes_coupling_looked_down_on_is_no_wheel() -> None:
    assert all(found.confidence < CONFIDENT for found in detect_valves(make_scene("hose_up").scan("camera")))
