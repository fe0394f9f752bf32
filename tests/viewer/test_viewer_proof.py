"""Clearance proof over time as drawn by the viewer."""

from __future__ import annotations

import base64

import numpy as np
import pytest
from viewer_results import make_result

from costs.robot import load_robot
from service.viewer import list_drawn_frames
from service.viewer.payload import make_payload
from service.viewer.proof import trace_clearance


def proven_result():
    """Return a certificate with two broad stretches, one near pair, and a hand that may touch the rim during the turn.

    The path runs from 0 to 1 within 6 s at constant speed.
    """
    result, placements = make_result()
    result["curve"] = {"law": {"times": [0.0, 6.0], "path": [0.0, 1.0], "speed": [1 / 6, 1 / 6]}}
    result["certificate"] = {
        "exempt": [{"pair": ["rim/0", "l_hand"], "phase": "turn"}],
        "stretches": {
            "pairs": [["l_hand", "crate"], ["l_hand", "rim/0"]],
            "edges": [0.0, 0.5, 1.0],
            "floors": [0.2, 0.1],
            "pair": [0, 0, 1, 1],
            "first": [0.25, 0.5, 0.0, 0.5],
            "last": [0.5, 0.75, 0.25, 1.0],
            "distance": [0.05, 0.03, 0.09, -0.004],
            "bound": [0.01, 0.005, 0.01, 0.001],
        },
    }
    result["checks"][1]["where"] = {"time_s": None, "position": None, "names": []}
    return result, placements


@pytest.mark.parametrize(("time", "expected"), [(0.7, 0.08), (2.0, 0.04), (4.0, 0.025), (5.5, 0.1)])
def test_clearance_at_a_time_is_the_least_of_floor_and_covering_rows(time, expected):
    track = trace_clearance(proven_result()[0])
    assert np.interp(time, track.times, track.clearance) == pytest.approx(expected)


def test_the_place_of_least_clearance_is_the_middle_of_its_stretch():
    track = trace_clearance(proven_result()[0])
    assert track.pair == ("l_hand", "crate")
    assert track.time_s == pytest.approx(0.625 * 6.0, abs=1e-3)


def test_the_same_pair_counts_in_a_phase_where_it_may_not_touch():
    result, _ = proven_result()
    result["certificate"]["exempt"][0]["phase"] = "reach"
    assert trace_clearance(result).clearance.min() == pytest.approx(-0.005)


def test_the_clearance_check_points_to_the_place_of_least_clearance():
    check = make_payload(*proven_result())["checks"][1]
    assert check["where"]["names"] == ["l_hand", "crate"]
    assert check["where"]["time_s"] == pytest.approx(3.75, abs=1e-3)


def test_payload_carries_the_track_as_time_and_clearance():
    entry = make_payload(*proven_result())["clearance"]
    rows = np.frombuffer(base64.b64decode(entry["data"]), dtype="<f4").reshape(entry["shape"])
    assert rows[-1, 0] == pytest.approx(6.0)
    assert rows[:, 1].min() == pytest.approx(0.025)


def test_what_was_not_checked_is_carried_but_for_neighbours():
    result, placements = proven_result()
    assert make_payload(result, placements)["not_checked"] == []
    pairs = [("adjacent", True), ("same joint", False), ("srdf (never)", False), ("derived", False)]
    left_out = [{"pair": ["a", "b"], "reason": reason, "is_neighbour": near} for reason, near in pairs]
    result["coverage"] = {"not_checked": ["torques (no link names a mass)"], "left_out": left_out}
    expected = ["torques (no link names a mass)", "2 pairs of links that are no neighbours"]
    assert make_payload(result, placements)["not_checked"] == expected


@pytest.mark.parametrize("missing", ["certificate", "curve"])
def test_without_certificate_or_time_law_there_is_no_track(missing):
    result, _ = proven_result()
    result[missing] = None
    assert trace_clearance(result) is None


def test_a_proof_without_near_pairs_has_floors_only():
    result, _ = proven_result()
    for key in ("pair", "first", "last", "distance", "bound"):
        result["certificate"]["stretches"][key] = []
    track = trace_clearance(result)
    assert track.pair is None
    assert set(track.clearance) == {0.2, 0.1}


def test_drawn_frames_are_those_with_bodies_targets_and_checks():
    robot = load_robot("atlas")
    result = {
        "bodies": [{"name": "pelvis", "link": "pelvis"}, {"name": "pelvis/1", "link": "pelvis"}],
        "phases": [{"targets": [{"kind": "pose", "frame": "l_tool"}, {"kind": "joints"}]}],
        "checks": [{"where": {"names": ["back_bkz", "crate"]}}, {"where": None}],
    }
    assert list_drawn_frames(robot, result) == ("pelvis", "l_tool", "back_bkz")
