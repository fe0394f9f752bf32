"""Lever valves: found on their pipes within the targets, and none where no pipe holds a lever."""

from __future__ import annotations

import numpy as np
import pytest

from perception import CONFIDENT, detect, make_view
from perception.simulate import Pose, Room, Scanner, cylinder, scan
from perception.simulate.scenes import make_scene
from perception.simulate.scenes.fixtures import BoxLever
from perception.simulate.scenes.valves import LeverValve

SENSOR = Pose((0.12, 0.0, 1.6), pitch=0.3)
SCANNER = Scanner(n_beams=361, fan_deg=90.0, n_lines=110)


def tilted(yaw_deg: float, pitch_deg: float) -> tuple[float, float, float]:
    yaw, pitch = np.radians([yaw_deg, pitch_deg])
    return (-np.cos(yaw) * np.cos(pitch), -np.sin(yaw) * np.cos(pitch), np.sin(pitch))


def test_a_hoses_coupling_beside_its_standpipe_is_no_lever() -> None:
    view = make_view(make_scene("hose_aside", seed=21).scan("dense"))
    assert all(found.confidence < CONFIDENT for found in detect("valve", view))


ACROSS = (0.0, 1.0, 0.0)


@pytest.mark.parametrize("along", [(0.0, 0.0, 1.0), (0.0, 0.5, 0.8), ACROSS], ids=["across", "askew", "along"])
def test_a_lever_on_a_pipe_is_found_within_the_targets(along: tuple[float, float, float]) -> None:
    lever = LeverValve((0.72, 0.05, 1.15), tilted(8, 8), along, 0.24, pipe_direction=ACROSS)
    placed = lever.build()
    view = make_view(scan([*Room(wall_x=1.1).meshes(), *placed.meshes], SENSOR, SCANNER, seed=3))
    true = placed.truth[0].pose_world_object
    for hint in (None, true[:3, 3] + [0.06, -0.05, 0.04]) if along == ACROSS else (None,):
        found = detect("valve", view, hint)[0]
        assert found.confidence >= CONFIDENT
        assert np.linalg.norm((found.pose_world_object - true)[:3, 3]) <= 0.010
        assert found.pose_world_object[:3, 2] @ true[:3, 2] >= np.cos(np.radians(2.0))
        assert found.pose_world_object[:3, 0] @ true[:3, 0] >= np.cos(np.radians(3.0))
        assert abs(found.sizes["lever_length"] - lever.length) <= 0.005


def test_pipes_that_cross_and_a_lever_before_a_box_are_no_lever_valves() -> None:
    pipes = [
        cylinder((0.8, -1.0, 1.1), (0.8, 0.4, 1.1), 0.05),
        cylinder((0.7, -0.1, 0.0), (0.7, -0.1, 2.4), 0.015),
        cylinder((0.72, -0.5, 0.9), (0.68, -0.55, 1.3), 0.012),
    ]
    lever = BoxLever((0.65, 0.6, 1.2), angle=0.1).build()
    view = make_view(scan([*Room(wall_x=1.1).meshes(), *pipes, *lever.meshes], SENSOR, SCANNER, seed=3))
    assert all(found.confidence < CONFIDENT for found in detect("valve", view))


def test_a_box_with_a_lever_is_no_pipe_where_air_is_seen_at_its_corners_alone() -> None:
    view = make_view(make_scene("lever_box_across", 2).scan("camera"))
    assert all(found.confidence < CONFIDENT for found in detect("valve", view))
