"""What stands on a level surface and what only passes its height."""

from __future__ import annotations

import numpy as np

from perception import View, make_view
from perception.detect.drill.supports import StandingCluster, standing_clusters, support_share
from perception.sightlines import sight_index
from perception.simulate import Mesh, Pose, Scanner, box, cylinder, scan

SENSOR = Pose((0.1, 0.0, 1.5), pitch=0.7)
SCANNER = Scanner(n_beams=541, fan_deg=160.0, n_lines=70)
SEAT = 0.46


def view_of(*meshes: Mesh) -> View:
    room = [box((-5.0, -5.0, -0.1), (5.0, 5.0, 0.0)), box((1.6, -3.0, 0.0), (1.7, 3.0, 2.5))]
    return make_view(scan([*room, *meshes], SENSOR, SCANNER, 0))


def standing_at(view: View, x: float, y: float, level: float) -> list[StandingCluster]:
    clusters = [one for one in standing_clusters(view) if abs(one.level - level) < 0.02]
    return [one for one in clusters if np.linalg.norm(one.points[:, :2].mean(axis=0) - (x, y)) < 0.08]


def test_a_leg_beside_a_seat_of_some_height_does_not_stand_on_it() -> None:
    seat = box((0.6, -0.5, SEAT - 0.03), (1.0, 0.0, SEAT))
    leg, top = box((0.9, 0.4, 0.0), (0.95, 0.45, 0.72)), box((0.87, 0.3, 0.72), (1.4, 0.9, 0.75))
    bottle = cylinder((0.75, -0.25, SEAT), (0.75, -0.25, SEAT + 0.22), 0.04)
    view = view_of(seat, leg, top, bottle)
    index = sight_index(view.cloud)
    legs, bottles = standing_at(view, 0.92, 0.42, SEAT), standing_at(view, 0.75, -0.25, SEAT)
    assert len(legs) == 1
    assert len(bottles) == 1
    assert support_share(index, legs[0]) < 0.3
    assert support_share(index, bottles[0]) > 0.9


def test_what_stands_at_the_very_edge_of_a_board_is_held_by_it() -> None:
    board = box((0.6, -0.5, SEAT - 0.03), (1.0, 0.5, SEAT))
    bottle = cylinder((0.641, 0.0, SEAT), (0.641, 0.0, SEAT + 0.22), 0.04)
    view = view_of(board, bottle)
    (one,) = standing_at(view, 0.641, 0.0, SEAT)
    assert support_share(sight_index(view.cloud), one) > 0.3


def test_a_foot_about_which_nothing_was_seen_is_taken_to_be_held() -> None:
    view = view_of(box((0.6, -0.5, SEAT - 0.03), (1.0, 0.0, SEAT)))
    rng = np.random.default_rng(0)
    unseen = StandingCluster(rng.uniform((3.0, 0.0, SEAT), (3.05, 0.05, SEAT + 0.2), (50, 3)), SEAT)
    assert support_share(sight_index(view.cloud), unseen) == 1.0
