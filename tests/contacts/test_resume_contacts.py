"""The rest of a plan that changes contacts, planned again from one of its phases with displaced places."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from shared_plans import write_undrawn

from costs.contact import Contact
from costs.rotation import make_quaternions
from service.demands.contacts.stances import Surface, find_link_pose, find_link_yaw, place_patch
from service.errors import RequestError, ResultError
from service.planner import plan
from service.replay.adjust import adjust_request, read_adjustment
from service.replay.replay import read_record, verify_result
from service.replay.rest import hash_plan, make_rest_request
from service.request.file import parse_request
from service.result.folder import read_result
from service.verify.timeline import find_times

FIRST, SECOND = "right foot forward", "left foot forward"
REQUEST = {
    "robot": {"name": "atlas"},
    "start": {"posture": "reach_ready"},
    "scene": {
        "floor": True,
        "obstacles": [
            {"name": "plank", "type": "box", "size": [0.3, 0.3, 0.04], "position": [0.4, 0.15, 0.02]},
        ],
    },
    "task": {
        "contacts": {
            "surfaces": {"plank": {"piece": "plank"}},
            "stances": [
                {"name": FIRST, "make": {"right_foot": {"surface": "floor", "at": [0.2, -0.12, 0.0]}}},
                {"name": SECOND, "make": {"left_foot": {"surface": "plank", "at": [0.4, 0.15, 0.0], "yaw_deg": 10.0}}},
            ],
        }
    },
    "options": {"seed": 0},
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("steps") / "out"
    result = plan(parse_request(json.loads(json.dumps(REQUEST))))
    assert result.verdict.value == "CERTIFIED", result.explanation
    write_undrawn(result, path)
    return path


def _write_state(folder: Path, phase: str, path: Path, **more) -> Path:
    """Write the state at the start of a phase."""
    robot, motion = read_record(read_result(folder), folder)
    first = next(entry.first for entry in motion.phases if entry.name == phase)
    q = motion.curve(np.array([first]))[0]
    state = {
        "joints": dict(zip(robot.joint_names[6:], q[6 : robot.n].tolist(), strict=True)),
        "base": {"position": q[:3].tolist(), "quaternion_wxyz": make_quaternions(q[None, 3:6])[0].tolist()},
        **more,
    }
    path.write_text(json.dumps(state))
    return path


def _locate(robot, q, link):
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    return data.oMf[robot.model.getFrameId(link)].translation.copy()


def test_the_rest_from_a_swing_ends_where_the_displaced_plank_is(folder, tmp_path):
    phase = f"{SECOND}: swing"
    state = _write_state(folder, phase, tmp_path / "state.json")
    request = make_rest_request(folder, phase, state)
    assert len(request.resume.nominal.phases[phase].knots) >= 20
    moved, _ = adjust_request(request, None, "plank", np.array([0.02, -0.01, 0.01]))
    result = plan(moved)
    assert result.verdict.value == "CERTIFIED", result.explanation
    assert [entry.name for entry in result.phases] == [f"{SECOND}: swing", f"{SECOND}: land"]
    assert result.motion.continues == hash_plan(read_result(folder))
    robot, before = read_record(read_result(folder), folder)
    places = [
        _locate(robot, motion.curve(np.array([motion.phases[-1].last]))[0][: robot.n], "l_foot")
        for motion in (before, result.motion)
    ]
    np.testing.assert_allclose(places[1] - places[0], [0.02, -0.01, 0.01], atol=1.5e-3)
    write_undrawn(result, tmp_path / "rest")
    assert verify_result(tmp_path / "rest")["verdict"] == "CERTIFIED"


@pytest.mark.parametrize(
    ("phase", "start", "stances"),
    [
        (f"{FIRST}: shift", {"left_foot", "right_foot"}, [FIRST, SECOND]),
        (f"{FIRST}: lift", {"left_foot", "right_foot"}, [FIRST, SECOND]),
        (f"{FIRST}: swing", {"left_foot"}, [FIRST, SECOND]),
        (f"{SECOND}: shift", {"left_foot", "right_foot"}, [SECOND]),
        (f"{SECOND}: land", {"right_foot"}, [SECOND]),
    ],
)
def test_the_rest_begins_on_what_carries_the_robot_then(folder, tmp_path, phase, start, stances):
    request = make_rest_request(folder, phase, _write_state(folder, phase, tmp_path / "state.json"))
    task = request.task.contacts
    assert set(task.start) == start
    assert [stance.name for stance in task.stances] == stances
    assert all(f"{stance.name}: land" in request.resume.nominal.phases for stance in task.stances)


def _read_phase(motion, name):
    """Waypoints, and the time since its beginning at each of them, of a phase."""
    entry = next(entry for entry in motion.phases if entry.name == name)
    curve = motion.curve.cut(motion.curve.find_knots(entry.first, entry.last))
    times = find_times(motion.law, curve.knots)
    return curve.positions, times - times[0]


def test_phases_that_an_adjustment_does_not_touch_stay_as_they_were(folder, tmp_path):
    phase = f"{FIRST}: swing"
    request = make_rest_request(folder, phase, _write_state(folder, phase, tmp_path / "state.json"))
    moved, _ = adjust_request(request, None, "plank", np.array([0.02, -0.01, 0.01]))
    result = plan(moved)
    assert result.verdict.value == "CERTIFIED", result.explanation
    _, before = read_record(read_result(folder), folder)
    for name in (phase, f"{FIRST}: land", f"{SECOND}: shift", f"{SECOND}: lift", f"{SECOND}: swing"):
        known, made = _read_phase(before, name), _read_phase(result.motion, name)
        is_same = known[0].shape == made[0].shape and np.abs(known[0] - made[0]).max() < 1e-6
        assert is_same == (name != f"{SECOND}: swing"), name
        if is_same:
            np.testing.assert_allclose(made[1], known[1], rtol=1e-4)


def test_an_earlier_motion_that_is_wrong_is_not_kept(folder, tmp_path):
    phase = f"{SECOND}: swing"
    request = make_rest_request(folder, phase, _write_state(folder, phase, tmp_path / "state.json"))
    nominal = request.resume.nominal
    names = list(nominal.joint_names)
    wrong = {}
    for name, entry in nominal.phases.items():
        positions = np.reshape(entry.positions, (-1, len(names)))
        positions[1:-1, names.index("base_x" if "base_x" in names else names[0])] += 0.05
        wrong[name] = replace(entry, positions=tuple(positions.ravel().tolist()))
    bad = replace(request, resume=replace(request.resume, nominal=replace(nominal, phases=wrong)))
    result = plan(bad)
    assert result.verdict.value == "CERTIFIED", result.explanation
    off = np.abs(_read_phase(result.motion, phase)[0][5] - np.reshape(wrong[phase].positions, (-1, len(names)))[5])
    assert off.max() > 1e-3


def test_a_stance_that_changes_contacts_has_no_posture():
    posture = {"base": [0.0, 0.0, 0.9, 0.0, 0.0, 0.0]}
    stance = {"name": "a", "release": ["left_foot"], "posture": posture}
    with pytest.raises(RequestError, match="changes contacts and has a posture to move to"):
        parse_request({**REQUEST, "task": {"contacts": {"stances": [stance]}}})


def test_contacts_yield_to_nothing(folder, tmp_path):
    phase = f"{SECOND}: swing"
    state = _write_state(folder, phase, tmp_path / "state.json")
    with pytest.raises(ResultError, match="no hand holds a mechanism"):
        make_rest_request(folder, phase, state, is_compliant=True)


def test_places_and_surfaces_of_the_rest_are_those_of_the_plan(folder, tmp_path):
    phase = f"{SECOND}: swing"
    place = (
        make_rest_request(folder, phase, _write_state(folder, phase, tmp_path / "s.json"))
        .task.contacts.stances[0]
        .make["left_foot"]
    )
    np.testing.assert_allclose([*place.at, place.yaw_deg], [0.4, 0.15, 0.04, 10.0], atol=1e-6)


def test_what_cannot_be_planned_again_is_refused_by_name(folder, tmp_path):
    phase = f"{SECOND}: swing"
    state = _write_state(folder, phase, tmp_path / "state.json")
    with pytest.raises(RequestError, match=f"unknown phase 'hop'; the plan has {FIRST}: shift"):
        make_rest_request(folder, "hop", state)
    with pytest.raises(RequestError, match="no contact of 'nose'; expected left_foot"):
        make_rest_request(folder, phase, _write_state(folder, phase, tmp_path / "other.json", contacts=["nose"]))
    request = make_rest_request(folder, phase, state)
    with pytest.raises(RequestError, match=r"no target 'right_foot'.*expected left_foot, plank"):
        adjust_request(request, None, "right_foot", np.array([0.01, 0.0, 0.0]))
    with pytest.raises(RequestError, match=r"at most 0\.3 m"):
        adjust_request(request, None, "plank", np.array([0.4, 0.0, 0.0]))
    off = replace(request, start=replace(request.start, base=replace(request.start.base, position=(0.0, 0.0, 1.2))))
    with pytest.raises(RequestError, match=r"a point of right_foot is .* m above floor"):
        plan(off)


@pytest.mark.parametrize("text", ["plank", "plank:1,2", "plank:1,2,x", ":0,0,0", "plank:0,0,inf"])
def test_an_adjustment_is_a_target_and_three_numbers(text):
    with pytest.raises(RequestError, match="expected TARGET:X,Y,Z"):
        read_adjustment(text)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6), yaw=st.floats(-3.1, 3.1), n_points=st.sampled_from([2, 4]))
def test_the_yaw_of_a_contact_is_the_one_it_was_placed_with(seed, yaw, n_points):
    rng = np.random.default_rng(seed)
    normal = Rotation.random(random_state=seed).apply([0.0, 0.0, 1.0])
    middle = rng.normal(size=3)
    side = np.linalg.svd(normal[None])[2][1:]
    corners = middle + np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) @ side
    surface = Surface("s", corners, normal, 0.6)
    own = Rotation.random(random_state=seed + 1)
    flat = np.column_stack([rng.uniform(-0.1, 0.1, (n_points, 2)), np.zeros(n_points)])
    patch = Contact("foot", own.apply(flat), np.tile(own.apply([0.0, 0.0, 1.0]), (n_points, 1)), 0.6, 100.0)
    contact = place_patch(patch, "foot", surface, find_link_pose(patch, surface, middle, yaw))
    again = find_link_pose(patch, surface, contact.points.mean(axis=0), find_link_yaw(patch, contact))
    placed = place_patch(patch, "foot", surface, again)
    np.testing.assert_allclose(placed.points, contact.points, atol=1e-9)
