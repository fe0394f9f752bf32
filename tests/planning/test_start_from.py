"""Plans that begin with an earlier motion, and sessions that go from goal to goal."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from jaxtyping import Float
from planar_arm import write_planar_arm
from shared_plans import write_undrawn

from service import ReachSession
from service.body.paths import bend_path, cut_path
from service.demands.rest.earlier_motion import find_beginning, read_earlier_motion, record_motion
from service.errors import RequestError, ResultError
from service.planner import plan
from service.replay.state import read_state, write_state
from service.request.file import parse_request
from service.request.plain_file import load_section
from service.request.schema import PlanRequest, StartRequest, StateRequest
from service.request.tasks.reach import GoalRequest
from service.result.result import PlanResult, Verdict

POST = {"name": "post", "type": "box", "size": [0.1, 0.1, 0.1], "position": [0.5, 0.0, 0.0]}
SIDES = ({"j0": -0.8, "j1": 0.0, "j2": 0.0}, {"j0": 0.8, "j1": 0.0, "j2": 0.0})
numbers = st.floats(-3.0, 3.0)
rows = st.integers(2, 6).flatmap(lambda count: arrays(float, (count, 2), elements=numbers))


@pytest.fixture(scope="module")
def request_past_the_post(tmp_path_factory: pytest.TempPathFactory) -> PlanRequest:
    urdf = write_planar_arm(tmp_path_factory.mktemp("arm"), 3, 0.2, 0.04, limit=3.0)
    return parse_request({
        "robot": {"urdf": str(urdf)},
        "scene": {"obstacles": [POST], "floor": False},
        "start": {"joints": SIDES[0]},
        "goal": {"joints": SIDES[1]},
    })  # fmt: skip


@pytest.fixture(scope="module")
def earlier(request_past_the_post: PlanRequest) -> PlanResult:
    return plan(request_past_the_post)


def shift(joints: dict[str, float], by: float) -> dict[str, Any]:
    return {name: value + by for name, value in joints.items()}


@settings(max_examples=50, deadline=None)
@given(rows, arrays(float, 2, elements=numbers), arrays(float, 2, elements=numbers))
def test_a_bent_path_has_the_new_ends_and_one_with_its_own_ends_is_itself(
    path: Float[np.ndarray, "T 2"], first: Float[np.ndarray, "2"], last: Float[np.ndarray, "2"]
) -> None:
    bent = bend_path(path, first, last)
    assert np.allclose(bent[[0, -1]], [first, last])
    assert np.allclose(bend_path(path, path[0], path[-1]), path)
    most = max(np.abs(first - path[0]).max(), np.abs(last - path[-1]).max())
    assert np.abs(bent - path).max() <= most + 1e-9


@settings(max_examples=50, deadline=None)
@given(rows, arrays(float, 2, elements=numbers))
def test_a_cut_path_begins_with_the_nearest_waypoint_and_has_something_between_its_ends(
    path: Float[np.ndarray, "T 2"], at: Float[np.ndarray, "2"]
) -> None:
    off = np.abs(path - at).max(axis=1)
    cut = cut_path(path, at)
    if cut is None:
        assert off[: len(path) - 2].min(initial=np.inf) >= off.min()
        return
    assert len(cut) >= 3
    assert np.array_equal(cut, path[-len(cut) :])
    assert np.abs(cut[0] - at).max() == off.min()


def test_a_recorded_motion_is_read_as_it_was(earlier: PlanResult) -> None:
    motion = earlier.motion
    assert motion is not None
    assert motion.law is not None
    record = record_motion(motion)
    known = read_earlier_motion(motion.robot, record, np.zeros(3))
    (phase,) = motion.phases
    curve, at = known.curves[phase.name], np.linspace(phase.first, phase.last, 20)
    assert np.allclose(curve(at), motion.curve(at), atol=1e-6)
    assert known.law is not None
    assert np.allclose(known.law.speed, motion.law.speed)
    beginning = find_beginning(motion.robot, record)
    assert beginning is not None
    assert np.allclose(beginning, motion.curve.positions[0], atol=1e-7)
    assert not read_earlier_motion(motion.robot, replace(record, joint_names=("j0", "j1", "j9")), np.zeros(3)).ways


def test_the_search_begins_with_the_earlier_motion_between_new_ends(
    request_past_the_post: PlanRequest, earlier: PlanResult
) -> None:
    assert earlier.found_from != "straight line"
    moved = replace(
        request_past_the_post,
        start=StartRequest(joints=shift(SIDES[0], 0.03)),
        goal=GoalRequest(joints=shift(SIDES[1], -0.03)),
    )
    result = plan(moved, start_from=earlier)
    assert result.verdict is Verdict.CERTIFIED
    assert result.found_from == "earlier motion"
    assert len(result.tried) == 1


def test_an_earlier_motion_of_a_standing_robot_is_bent_on_its_feet() -> None:
    reach = {"link": "l_tool", "position": [0.45, 0.45, 1.2], "position_tolerance_m": 0.01}
    data = {"robot": {"name": "atlas"}, "start": {"posture": "reach_ready"}, "goal": {"poses": [reach]}}
    before = plan(parse_request(data))
    moved = parse_request({**data, "goal": {"poses": [{**reach, "position": [0.46, 0.43, 1.21]}]}})
    result = plan(moved, start_from=before)
    assert result.verdict is Verdict.CERTIFIED
    assert result.found_from == "earlier motion"
    assert result.tried[-1].n_steps <= 2  # feet that have to be put back take four


def test_a_start_on_the_way_begins_with_the_rest_of_the_motion(
    request_past_the_post: PlanRequest, earlier: PlanResult
) -> None:
    middle = earlier.waypoints[len(earlier.waypoints) // 2]
    joints = dict(zip(earlier.joint_names, middle.tolist(), strict=True))
    result = plan(replace(request_past_the_post, start=StartRequest(joints=joints)), start_from=earlier)
    assert result.verdict is Verdict.CERTIFIED
    assert result.found_from == "earlier motion"


def test_a_start_far_from_the_motion_is_noted_and_searched_anew(
    request_past_the_post: PlanRequest, earlier: PlanResult
) -> None:
    far = replace(request_past_the_post, start=StartRequest(joints={"j0": 2.4, "j1": 0.1, "j2": 0.0}))
    result = plan(far, start_from=earlier)
    assert result.verdict is Verdict.CERTIFIED
    assert any("off at j0 from every waypoint of the earlier motion" in note for note in result.notes)


def test_waypoints_of_another_robot_are_refused_in_a_sentence(request_past_the_post: PlanRequest) -> None:
    with pytest.raises(RequestError, match=r"start_from: has shape \(5, 2\); expected finite numbers \(T, 3\)"):
        plan(request_past_the_post, start_from=np.zeros((5, 2)))


def test_a_session_goes_back_by_the_way_it_came(request_past_the_post: PlanRequest) -> None:
    session = ReachSession(request_past_the_post)
    there = session.plan()
    back = session.plan(GoalRequest(joints=shift(SIDES[0], 0.02)))
    assert session.last is back
    assert [there.verdict, back.verdict] == [Verdict.CERTIFIED] * 2
    assert there.found_from != "earlier motion"
    assert back.found_from == "earlier motion"
    assert np.allclose(back.start, there.waypoints[-1], atol=1e-12)
    assert not any("earlier motions" in note for note in back.notes)
    away = session.plan(GoalRequest(joints=shift(SIDES[0], -1.5)))
    assert away.verdict is Verdict.CERTIFIED
    assert any(note.startswith("start_from: none of 2 earlier motions leads") for note in away.notes)


def test_a_session_may_be_told_where_the_robot_is(request_past_the_post: PlanRequest) -> None:
    session = ReachSession(request_past_the_post)
    result = session.plan(GoalRequest(joints=SIDES[0]), StartRequest(joints=shift(SIDES[0], 0.1)))
    assert result.verdict is Verdict.CERTIFIED
    assert np.allclose(result.start, [-0.7, 0.1, 0.1])


def test_a_session_of_a_task_is_refused() -> None:
    request = parse_request({"robot": {"name": "atlas"}, "task": {"steps": [{"wait": "once"}]}})
    with pytest.raises(RequestError, match="a session plans reaches"):
        ReachSession(request)


def test_a_state_file_has_where_the_robot_is_at_a_time(earlier: PlanResult, tmp_path: Path) -> None:
    write_undrawn(earlier, tmp_path / "plan")
    for k in (0, len(earlier.times) // 2, -1):
        write_state(tmp_path / "plan", float(earlier.times[k]), tmp_path / "state.json")
        state = load_section(StateRequest, tmp_path / "state.json")
        assert [state.joints[name] for name in earlier.joint_names] == pytest.approx(earlier.positions[k], abs=1e-6)
    with pytest.raises(ResultError, match=r"--at: 99 is outside the motion; expected 0 to \d"):
        read_state(tmp_path / "plan", 99.0)
