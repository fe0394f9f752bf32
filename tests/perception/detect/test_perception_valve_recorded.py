"""Valve detection on recorded scans and on the shipped one: the wheels that are there."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from valve_targets import assert_matches

from perception import CONFIDENT, Reach, detect_valves, has_clear_spokes, perceive, read_cloud, select_wheels

SHIPPED = Path(__file__).parents[3] / "examples" / "data"


def test_the_shared_valve_is_found_within_the_targets(shared_data: Path) -> None:
    folder = shared_data / "scenes" / "valve_a"
    truth = json.loads((folder / "gt.json").read_text())["valves"][0]
    found = detect_valves(read_cloud(folder / "scan2.pcd"))
    assert_matches(found[0], truth["centre"], truth["axis"], truth["outer_radius"])


def test_a_cars_steering_wheel_is_no_valve_but_for_who_points_at_it(shared_data: Path) -> None:
    folder = shared_data / "scenes" / "car_ev"
    steering = np.array(json.loads((folder / "gt.json").read_text())["car"]["steering_wheel"]["mean"])
    cloud = read_cloud(folder / "scan0.pcd")
    unasked = detect_valves(cloud)
    assert all(found.confidence < CONFIDENT for found in unasked)
    assert min(np.linalg.norm(found.centre - steering) for found in unasked) < 0.03
    pointed_at = detect_valves(cloud, hint=steering)[0]
    assert np.linalg.norm(pointed_at.centre - steering) < 0.03
    assert pointed_at.confidence >= CONFIDENT


def test_the_shipped_scan_shows_its_valve() -> None:
    truth = json.loads((SHIPPED / "valve_scan.json").read_text())["valve"]
    perceived = perceive(read_cloud(SHIPPED / "valve_scan.pcd"), reach=Reach(radius=2.0), kinds=("wheel",))
    wheel = select_wheels(perceived.detections)[0]
    assert wheel.confidence >= CONFIDENT
    assert_matches(wheel, truth["centre"], truth["axis"], truth["outer_radius"])
    assert has_clear_spokes(wheel)
    np.testing.assert_allclose(wheel.spoke_angles, np.mod(truth["spoke_angles"], 2 * np.pi), atol=0.06)
    assert {"floor", "stem", "plane"} <= {piece.kind for piece in perceived.scene.pieces}
    assert (SHIPPED / "valve_scan.pcd").stat().st_size <= 1_000_000
