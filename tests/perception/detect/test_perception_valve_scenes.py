"""Wheel valves in simulated scenes by other sensors: the smallest and the largest, and hose ends that are none."""

from __future__ import annotations

import pytest
from valve_targets import assert_matches

from perception import CONFIDENT, detect_valves
from perception.simulate.scenes import make_scene


@pytest.mark.parametrize(
    ("name", "seed", "sensor"),
    [("hose_up", 5, "dense"), ("hose_wide", 0, "solid")],
)
def test_a_pipe_seen_from_its_open_end_is_no_wheel(name: str, seed: int, sensor: str) -> None:
    assert all(found.confidence < CONFIDENT for found in detect_valves(make_scene(name, seed).scan(sensor)))


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
