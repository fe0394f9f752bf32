"""Ball valves with levers of sheet metal close before their pipe, and bars before a pipe without a body."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.clouds.others import make_other
from perception import CONFIDENT, detect, make_view
from perception.detect.shared.bars import Bar
from perception.detect.valve.detector import detect_lever_valve
from perception.detect.valve.valve_body import find_body
from perception.sightlines import sight_index
from perception.simulate import Pose, Room, Scanner, cylinder, scan
from perception.simulate.scenes.scene import frame
from perception.simulate.scenes.valves import valve_body
from perception.solids.primitives import Mesh, box

SENSOR = Pose((0.12, 0.0, 1.6), pitch=0.3)
SCANNER = Scanner(n_beams=361, fan_deg=90.0, n_lines=110)
PIVOT, TOWARDS, LEVEL = (0.75, 0.05, 1.1), (-0.94, 0.0, 0.34), (0.0, 1.0, 0.0)
ABOVE = 0.07


def plate(pose: np.ndarray, length: float) -> Mesh:
    return box((-0.02, -0.013, -0.003), (length, 0.013, 0.003)).place(pose)


@pytest.mark.parametrize("turn_deg", [4.0, -25.0, 88.0], ids=["open", "askew", "shut"])
def test_a_flat_lever_close_before_its_pipe_is_found(turn_deg: float) -> None:
    turn = np.radians(turn_deg)
    along = np.cos(turn) * np.array(LEVEL) + np.sin(turn) * np.cross(TOWARDS, LEVEL)
    pose = frame(PIVOT, along.tolist(), TOWARDS)
    body = pose[:3, 3] - ABOVE * pose[:3, 2]
    stem = cylinder(body.tolist(), (pose[:3, 3] + 0.008 * pose[:3, 2]).tolist(), 0.012)
    parts = [plate(pose, 0.2), stem, *valve_body(body, pose[:3, 2], LEVEL, 0.03, 0.9)]
    view = make_view(scan([*Room(wall_x=1.1).meshes(), *parts], SENSOR, SCANNER, seed=5))
    found = detect("valve", view)[0]
    assert found.confidence >= CONFIDENT
    assert np.linalg.norm((found.pose_world_object - pose)[:3, 3]) <= 0.025
    assert found.pose_world_object[:3, 2] @ pose[:3, 2] >= np.cos(np.radians(6.0))
    assert found.pose_world_object[:3, 0] @ pose[:3, 0] >= np.cos(np.radians(5.0))
    assert abs(found.sizes["lever_length"] - 0.2) <= 0.02


def test_a_flat_bar_before_a_bare_pipe_is_no_valve() -> None:
    pose = frame(PIVOT, LEVEL, TOWARDS)
    body = pose[:3, 3] - ABOVE * pose[:3, 2]
    reach = 0.9 * np.array(LEVEL)
    pipe = cylinder((body - reach).tolist(), (body + reach).tolist(), 0.03)
    view = make_view(scan([*Room(wall_x=1.1).meshes(), pipe, plate(pose, 0.2)], SENSOR, SCANNER, seed=5))
    assert all(found.confidence < CONFIDENT for found in detect("valve", view))


def test_a_wheels_spoke_before_a_pipe_is_no_lever() -> None:
    view = make_view(make_other("wheel_20_wide", 41).scan("dense"))
    assert all(found.confidence < CONFIDENT for found in detect_lever_valve(view))


@pytest.mark.parametrize("sleeve", [0.012, 0.0])
def test_the_body_on_a_pipe_is_where_its_surface_stands_out(sleeve: float) -> None:
    ends = ((0.8, -0.9, 1.1), (0.8, 0.9, 1.1))
    meshes = [cylinder(*ends, 0.03)]
    if sleeve:
        meshes.append(cylinder((0.8, 0.02, 1.1), (0.8, 0.12, 1.1), 0.03 + sleeve))
    index = sight_index(scan([*Room(wall_x=1.1).meshes(), *meshes], SENSOR, SCANNER, seed=5))
    towards = np.array([-0.9, 0.0, 0.436])
    towards /= np.linalg.norm(towards)
    axes = np.stack([[0.0, 1.0, 0.0], np.cross(towards, [0.0, 1.0, 0.0]), towards])
    pipe = Bar(axes, np.array([0.8, 0.0, 1.1]), (0.03, 0.03), -0.9, 0.9, "round")
    lever = Bar(axes, pipe.centre + ABOVE * towards, (0.01, 0.01), 0.05, 0.25, "round")
    body = find_body(pipe, lever, towards, index, None)
    if sleeve:
        assert body is not None
        assert body.evidence > 10.0
        assert abs(body.first - 0.02) <= 0.025
        assert abs(body.last - 0.12) <= 0.025
    else:
        assert body is None or body.evidence < 2.0
