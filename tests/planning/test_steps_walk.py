"""Steps that change what the robot stands on: footsteps between motions of a hand."""

from __future__ import annotations

from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from service.demands import hold_to_request
from service.demands.contacts.surfaces import FLOOR
from service.demands.steps.holding import Holding
from service.demands.steps.walking import plan_footsteps
from service.planner import plan
from service.replay.rebuild import make_setup_demands
from service.request.file import parse_request
from service.request.tasks.steps import StepsSection, WalkStep
from service.result.result import PlanResult
from service.setup.prepare import PlanSetup, prepare
from service.verify import Status, verify

RISE = {"hand": "right", "by": {"translation": [0.0, 0.0, 0.04]}, "along": "line"}


def request_of(steps: list[dict[str, Any]]) -> dict[str, Any]:
    return {
        "robot": {"name": "atlas"},
        "start": {"posture": "reach_ready"},
        "scene": {"floor": True},
        "task": {"steps": steps},
    }


PRESS = {"at": [0.74, -0.25, 1.2], "normal": [-1, 0, 0], "force_n": 15, "travel_m": 0.012}
WALK = [
    {"name": "push", "press": PRESS},
    {"name": "walk", "walk": {"to": [0.2, 0.0]}},
    {"name": "back", "move": {"posture": "reach_ready"}},
    {"name": "push again", "press": {**PRESS, "at": [0.92, -0.25, 1.3]}},
]


@pytest.fixture(scope="module", name="walked")
def _walked() -> PlanResult:
    return plan(parse_request(request_of(WALK)))


def test_hands_press_parts_before_and_after_a_certified_walk(walked: PlanResult) -> None:
    assert walked.verdict.value == "CERTIFIED", walked.explanation
    motion = walked.motion
    assert motion is not None
    names = [phase.name for phase in motion.phases]
    assert (names[0], names[-1]) == ("push: reach", "push again: retract")
    assert [name for name in names if name.endswith("land")] == ["walk: left foot 1: land", "walk: right foot 1: land"]
    first, last = ({foot.link: foot.pose_world_link for foot in motion.phases[k].contacts} for k in (0, -1))
    moved = np.mean([last[link][:3, 3] for link in last], axis=0)
    ahead = moved - np.mean([first[link][:3, 3] for link in first], axis=0)
    middle = np.mean([foot.points.mean(axis=0) for foot in motion.phases[-1].contacts], axis=0)
    assert ahead[0] > 0.1
    assert abs(ahead[1]) < 1e-3
    np.testing.assert_allclose(middle[:2], [0.2, 0.0], atol=2e-3)


def test_what_a_hand_has_pressed_stays_while_the_robot_walks_and_moves(walked: PlanResult) -> None:
    assert walked.motion is not None
    curve, phases = walked.motion.curve, walked.motion.phases
    between = [phase for phase in phases if not phase.name.startswith("push")]
    assert {phase.name.split(":")[0] for phase in between} == {"walk", "back"}
    for phase in between:
        values = curve(np.linspace(phase.first, phase.last, 20))[:, -2:]
        np.testing.assert_allclose(values, np.tile([PRESS["travel_m"], 0.0], (20, 1)), atol=1e-6)
    np.testing.assert_allclose(curve.positions[-1, -2:], [PRESS["travel_m"]] * 2, atol=1e-3)


def test_the_promises_of_a_walk_are_made_again_from_the_request_alone(walked: PlanResult) -> None:
    assert walked.motion is not None
    held = hold_to_request(make_setup_demands(prepare(parse_request(request_of(WALK)))), walked.motion)
    assert held.differences == ()
    assert verify(held.motion).status is Status.CERTIFIED


@pytest.mark.parametrize("to", [[0.25, 0.0], [0.2, 0.03]])
def test_a_walk_to_another_place_is_told_apart(walked: PlanResult, to: list[float]) -> None:
    assert walked.motion is not None
    steps = [WALK[0], {"name": "walk", "walk": {"to": to}}, *WALK[2:]]
    held = hold_to_request(make_setup_demands(prepare(parse_request(request_of(steps)))), walked.motion)
    assert held.differences


def test_where_the_robot_stands_already_it_does_not_walk() -> None:
    result = plan(parse_request(request_of([{"name": "go", "walk": {"to": [0.0425, 0.0]}}])))
    assert result.verdict.value == "NOT_FOUND"
    assert "step 'go': walk: the robot stands there already" in " ".join(result.explanation)


@cache
def stand() -> PlanSetup:
    return prepare(parse_request(request_of([{"walk": {"to": [1.0, 0.0]}}])))


@settings(max_examples=30, deadline=None)
@given(
    st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.floats(-90.0, 90.0), st.floats(0.1, 0.4)
)  # fmt: skip
def test_footsteps_keep_to_the_stride_and_end_at_the_place(x: float, y: float, yaw: float, stride: float) -> None:
    setup = stand()
    holding = Holding.of(StepsSection(()), setup.request, setup.robot, setup.scene)
    made = plan_footsteps(holding, setup.scene, WalkStep((x, y + 2.0), yaw, stride), setup.start)
    places: dict[str, list[tuple[np.ndarray, float]]] = {"left_foot": [], "right_foot": []}
    for stance in made.stances:
        for patch, place in stance.make.items():
            assert place.surface == FLOOR
            places[patch].append((np.array(place.at), place.yaw_deg))
    assert len(places["left_foot"]) == len(places["right_foot"])
    for steps in places.values():
        for (before, turned), (after, turn) in pairwise(steps):
            assert np.linalg.norm(after - before) < stride + 0.05
            assert abs(turn - turned) < 15.0 + 1e-9
        assert steps[-1][1] == pytest.approx(yaw, abs=1e-6)
    middle = 0.5 * (places["left_foot"][-1][0] + places["right_foot"][-1][0])
    np.testing.assert_allclose(middle[:2], [x, y + 2.0], atol=1e-9)
