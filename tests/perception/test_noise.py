"""Noise of sensors: estimated from flat surfaces, and what depends on it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from perception import Cloud, Reach, perceive
from perception.noise import MODELS, estimate_noise, find_noise
from perception.simulate import DepthCamera, Pose, Scanner, Sensor, TimeOfFlight, box, scan

ROOM = [
    box((-1.0, -3.0, -0.1), (4.0, 3.0, 0.0)),
    box((3.0, -3.0, 0.0), (3.1, 3.0, 2.5)),
    box((1.2, -0.8, 0.7), (2.0, 0.8, 0.75)),
]


def _scan(sensor: Sensor) -> Cloud:
    return scan(ROOM, Pose((0.0, 0.0, 1.4), pitch=0.4), sensor, seed=1)


@pytest.mark.parametrize(
    ("sensor", "name", "at_2_m"),
    [
        (DepthCamera(width=640, height=480, field_deg=60.0, correlation=0.5), "depth", 0.008),
        (TimeOfFlight(width=320, height=240, wiggle=0.0), "depth", 0.006),
        (Scanner(n_lines=180, sigma=0.002, footprint_deg=0.02, mixed_share=0.0), "survey", 0.002),
        (Scanner(n_lines=180, sigma=0.01, mixed_share=0.0), "spinning", 0.01),
    ],
)
def test_the_kind_of_sensor_is_seen_from_the_noise_of_flat_surfaces(sensor: Sensor, name: str, at_2_m: float) -> None:
    noise = estimate_noise(_scan(sensor))
    assert noise.name == name
    assert 0.3 * at_2_m < noise.sigma(np.array(2.0)) < 2.0 * at_2_m


def test_a_known_sensor_is_not_estimated() -> None:
    cloud = replace(_scan(Scanner(n_lines=60)), sensor="depth")
    assert find_noise(cloud) == MODELS["depth"]


def test_only_noise_that_neighbours_share_makes_pieces_grow() -> None:
    assert MODELS["spinning"].bulge(np.array([3.0])) == 0.0
    assert 0.005 < MODELS["depth"].bulge(np.array([3.0]))[0] < 0.01


def test_no_space_is_free_beside_points_where_the_start_of_the_rays_is_not_known() -> None:
    cloud = _scan(Scanner(n_lines=60, sigma=0.002))
    moved = Cloud(cloud.points, cloud.origin + np.array([0.03, 0.04, 0.0]), origin_sigma=0.05)
    doubted = perceive(replace(cloud, origin_sigma=0.05), reach=Reach(radius=3.5))
    shifted = perceive(moved, reach=Reach(radius=3.5))
    assert abs(len(shifted.pieces) - len(doubted.pieces)) <= 2
