"""Places of contacts that are moved along their surfaces by the planner, and read from a record by the verifier."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from shared_plans import write_undrawn

from costs.robot import load_robot
from costs.scene import Scene
from service.demands.contacts.moved_places import list_movable, move_place
from service.demands.contacts.stances import ContactStance, Surface, place_patch_as_it_is
from service.errors import RequestError
from service.planner import plan
from service.replay.replay import verify_result
from service.replay.rest import make_rest_request
from service.request.file import parse_request
from service.result.folder import read_result

FAR = 1.0  # of a foot that a step from the start does not reach [m]
SLACK = 0.4
REQUEST = {
    "robot": {"name": "atlas"},
    "start": {"posture": "reach_ready"},
    "scene": {
        "floor": True,
        "obstacles": [
            {"name": "plank", "type": "box", "size": [1.4, 0.6, 0.04], "position": [0.95, 0.0, 0.02]},
        ],
    },
    "task": {
        "contacts": {
            "surfaces": {"plank": {"piece": "plank"}},
            "stances": [
                {"name": "left", "make": {"left_foot": {"surface": "plank", "at": [FAR, 0.14, 0.0]}}},
                {"name": "right", "make": {"right_foot": {"surface": "plank", "at": [0.4, -0.14, 0.0]}}},
            ],
        }
    },
    "options": {"seed": 0},
}


def ask(slack_m: float) -> dict:
    data = json.loads(json.dumps(REQUEST))
    data["task"]["contacts"]["stances"][0]["make"]["left_foot"]["slack_m"] = slack_m
    return data


@pytest.fixture(scope="module")
def moved(tmp_path_factory):
    """The plan of a step that is too far but for its slack, and its folder."""
    result = plan(parse_request(ask(SLACK)))
    folder = tmp_path_factory.mktemp("moved") / "out"
    write_undrawn(result, folder)
    return result, folder


def find_foot(result) -> np.ndarray:
    """Middle of the left sole where the second step stands on it."""
    phase = next(phase for phase in result.motion.phases if phase.name == "right: shift")
    return next(contact for contact in phase.contacts if contact.link == "l_foot").points.mean(axis=0)


def test_a_place_out_of_reach_is_moved_along_its_surface_within_its_slack(moved):
    result, folder = moved
    assert result.verdict.value == "CERTIFIED", result.explanation
    assert any(note.startswith("left_foot is moved by") for note in result.notes)
    foot = find_foot(result)
    assert 0.01 < abs(foot[0] - FAR) <= SLACK
    np.testing.assert_allclose(foot[1:], [0.14, 0.04], atol=1e-6)
    assert verify_result(folder)["verdict"] == "CERTIFIED"


def test_a_place_beyond_the_slack_of_the_request_is_refused(moved, tmp_path):
    _, folder = moved
    other = tmp_path / "request.json"
    other.write_text(json.dumps(ask(0.005)))
    summary = verify_result(folder, other)
    assert summary["verdict"] != "CERTIFIED"
    assert any("left_foot in 'left' is " in line and "m along plank" in line for line in summary["explanation"]), (
        summary
    )


def test_the_rest_of_a_plan_stands_where_the_place_was_moved_to(moved, tmp_path):
    result, folder = moved
    data = read_result(folder)
    at = next(entry["first"] for entry in data["phases"] if entry["name"] == "left: land")
    values = dict(zip(data["trajectory"]["joint_names"], data["trajectory"]["positions"][at], strict=True))
    base = [values.pop(name) for name in data["trajectory"]["joint_names"][:7]]
    state = tmp_path / "state.json"
    state.write_text(json.dumps({"joints": values, "base": {"position": base[:3], "quaternion_wxyz": base[3:]}}))
    place = make_rest_request(folder, "left: land", state).task.contacts.stances[0].make["left_foot"]
    np.testing.assert_allclose(place.at, find_foot(result), atol=1e-6)
    assert 0.0 <= place.slack_m < SLACK


def test_slack_needs_a_place():
    data = {
        "robot": {"name": "atlas"},
        "task": {
            "egress": {
                "phases": [{"name": "sit", "contacts": {"hip": {"surface": "seat", "slack_m": 0.1}}, "postures": []}]
            }
        },
    }
    with pytest.raises(RequestError, match="slack_m needs a place that may be moved"):
        parse_request(data)


@pytest.fixture(scope="module")
def stances():
    """The start, and stances that make the left foot, keep it, and make it anew; on a strip along y."""
    robot = load_robot("atlas")
    corners = np.array([[-0.2, -1.0, 0.0], [0.2, -1.0, 0.0], [0.2, 1.0, 0.0], [-0.2, 1.0, 0.0]])
    strip = Surface("strip", corners, np.array([0.0, 0.0, 1.0]), 0.6)
    own = place_patch_as_it_is(robot, robot.postures["stand"], "left_foot", strip)
    made = own.move(np.array([0.1, 0.0, 0.0]))
    again = own.move(np.array([0.2, 0.0, 0.0]))
    return strip, [
        ContactStance(name, (contact,)) for name, contact in zip("abcd", (own, made, made, again), strict=True)
    ]


def test_a_contact_moves_as_long_as_it_stays(stances):
    strip, before = stances
    np.testing.assert_allclose(np.abs(strip.along), [0.0, 1.0, 0.0])
    after = move_place(before, 1, "left_foot", 0.05, Scene(()))
    off = [b.contacts[0].points - a.contacts[0].points for a, b in zip(before, after, strict=True)]
    for k, expected in enumerate((0.0, 0.05, 0.05, 0.0)):
        np.testing.assert_allclose(off[k], np.tile(expected * strip.along, (4, 1)), atol=1e-12)
    assert after[1].contacts[0].is_kept_in(after[2])


def test_only_places_with_slack_that_a_later_phase_stands_on_may_be_moved(stances):
    _, before = stances
    assert list_movable(before) == ()
    loose = [
        ContactStance(stance.name, tuple(replace(contact, slack_m=0.1) for contact in stance.contacts))
        for stance in before
    ]
    assert list_movable(loose) == ((1, "left_foot"),)
