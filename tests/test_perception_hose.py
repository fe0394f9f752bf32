"""Hose ends and standpipes: place and radius against the truth, and no sure hit on pipes that run on."""

from __future__ import annotations

import numpy as np

from perception import CONFIDENT, Cloud, View, make_view
from perception.detect.hose import detect_hose
from perception.simulate import Mesh, Pose, Scanner, box, cylinder, scan
from perception.simulate.objects.fixtures import Standpipe

SENSOR = Pose((0.1, 0.0, 1.5), pitch=0.5)
SCANNER = Scanner(n_beams=721, fan_deg=180.0, n_lines=90)


def view_of(*meshes: Mesh, seed: int = 0) -> View:
    room = [box((-5.0, -5.0, -0.1), (5.0, 5.0, 0.0)), box((1.3, -3.0, 0.0), (1.4, 3.0, 2.5))]
    return make_view(scan([*room, *meshes], SENSOR, SCANNER, seed))


def test_a_standpipe_is_found_where_it_opens() -> None:
    out = np.array([-0.9, 0.43, 0.0]) / np.hypot(0.9, 0.43)
    pipe = Standpipe((0.7, 0.1, 1.0), (out[0], out[1], out[2]), 0.04, collar=False).placed()
    found = detect_hose(view_of(*pipe.meshes))[0]
    assert found.confidence >= CONFIDENT
    assert np.linalg.norm(found.pose_world_object[:3, 3] - pipe.truth[0].pose_world_object[:3, 3]) <= 0.025
    assert found.pose_world_object[:3, 2] @ out >= np.cos(np.radians(15.0))
    assert abs(found.sizes["radius"] - 0.04) <= 0.008


def test_pipes_that_run_from_wall_to_floor_and_wall_to_wall_are_no_hose_ends() -> None:
    view = view_of(cylinder((1.0, 0.4, 0.0), (1.0, 0.4, 2.5), 0.04), cylinder((1.1, -3.0, 0.7), (1.1, 3.0, 0.7), 0.03))
    assert all(one.confidence < CONFIDENT for one in detect_hose(view))


def test_a_wooden_post_and_a_carton_are_no_hose_ends() -> None:
    view = view_of(box((0.9, 0.2, 0.0), (0.96, 0.26, 0.9)), box((0.9, -0.5, 0.0), (1.2, -0.2, 0.5)))
    assert all(one.confidence < CONFIDENT for one in detect_hose(view))


def test_a_hint_elsewhere_leaves_the_opening_out() -> None:
    pipe = Standpipe((0.7, 0.1, 1.0), (-0.9, 0.43, 0.0), 0.04).placed()
    assert detect_hose(view_of(*pipe.meshes), hint=np.array([0.9, -1.2, 1.0])) == []


def test_a_view_without_obstacles_holds_no_hose_end() -> None:
    points = np.random.default_rng(0).uniform((-2.0, -2.0, 0.0), (2.0, 2.0, 0.0), (5000, 3))
    assert detect_hose(make_view(Cloud(points, np.array([0.0, 0.0, 1.5])))) == []
