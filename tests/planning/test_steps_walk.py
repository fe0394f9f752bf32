"""Steps that change what the robot stands on: footsteps between motions of a hand."""

from __future__ import annotations

from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from service.demands import hold_to_request
from service.demands.contacts.surfaces import FLOOR
from service.demands.phase import TaskPhase
from service.demands.steps.holding import Holding, carry_along
from service.demands.steps.moved import MovedParts
from service.demands.steps.walking import plan_footsteps, read_stances
from service.errors import RequestError
from service.planner import plan
from service.replay.rebuild import make_setup_demands
from service.request.file import parse_request
from service.request.tasks.steps import StepsSection, WalkStep
from service.result.result import PlanResult
from service.setup.prepare import PlanSetup, prepare
from service.start.mechanism_file import inline_mechanisms
from service.verify import Status, verify

RISE = {"hand": "right", "by": {"translation": [0.0, 0.0, 0.04]}, "along": "line"}


def request_of(steps: list[dict[str, Any]]) -> dict[str, Any]:
    return {
        "robot": {"name": "atlas"},
        "start": {"posture": "reach_ready"},
        "scene": {"floor": True},
        "task": {"steps": steps},
    }


LEAF = (
    '<robot name="door"><link name="frame"/><link name="leaf"><collision><origin xyz="0 -0.45 1.0"/>'
    '<geometry><box size="0.04 0.9 2.0"/></geometry></collision></link><joint name="hinge" type="revolute">'
    '<parent link="frame"/><child link="leaf"/><origin xyz="0 0 0.02"/><axis xyz="0 0 1"/>'
    '<limit lower="-1.6" upper="1.6" velocity="1" effort="500"/></joint></robot>'
)
FIRST, SECOND = 0.3, 0.6


def push(to: float, name: str, **more: Any) -> dict[str, Any]:
    """A step that pushes a door with the tip of the right hand to an angle [rad]."""
    handle = {"link": "leaf", "place": [-0.02, -0.72, 1.1], "axis": [1, 0, 0], "tool": "tip", "tilt_deg": 25}
    mechanism = {
        "urdf": LEAF, "position": [0.72, 0.45, 0.0], "joints": {"hinge": {"friction": 4.0}}, "handle": handle,
        "moves": [{"joint": "hinge", "to": to}], "hand": "right", **more,
    }  # fmt: skip
    return {"name": name, "mechanism": mechanism}


WALK = [
    push(FIRST, "open"),
    {"name": "walk", "walk": {"to": [0.2, -0.05]}},
    {"name": "back", "move": {"posture": "reach_ready"}},
    push(SECOND, "wider"),
]


def section_of(steps: list[dict[str, Any]]) -> StepsSection:
    section = parse_request(request_of(steps)).section
    assert isinstance(section, StepsSection)
    return section


@pytest.fixture(scope="module", name="walked")
def _walked() -> PlanResult:
    return plan(parse_request(request_of(WALK)))


def test_a_hand_pushes_a_door_before_and_after_a_certified_walk(walked: PlanResult) -> None:
    assert walked.verdict.value == "CERTIFIED", walked.explanation
    motion = walked.motion
    assert motion is not None
    names = [phase.name for phase in motion.phases]
    assert (names[0], names[-1]) == ("open: reach", "wider: retract")
    assert [name for name in names if name.endswith("land")][-2:] == [
        "walk: right foot 1: land",
        "walk: left foot 1: land",
    ]
    first, last = ({foot.link: foot.pose_world_link for foot in motion.phases[k].contacts} for k in (0, -1))
    moved = np.mean([last[link][:3, 3] for link in last], axis=0)
    ahead = moved - np.mean([first[link][:3, 3] for link in first], axis=0)
    middle = np.mean([foot.points.mean(axis=0) for foot in motion.phases[-1].contacts], axis=0)
    assert ahead[0] > 0.1
    np.testing.assert_allclose(middle[:2], [0.2, -0.05], atol=2e-3)


def test_the_door_stays_while_the_robot_walks_and_is_opened_on_from_there(walked: PlanResult) -> None:
    assert walked.motion is not None
    curve, phases = walked.motion.curve, walked.motion.phases
    between = [phase for phase in phases if phase.name.split(":")[0] in ("walk", "back")]
    for phase in between:
        np.testing.assert_allclose(curve(np.linspace(phase.first, phase.last, 20))[:, -1], FIRST, atol=1e-6)
    assert curve.positions[-1, -1] == pytest.approx(SECOND, abs=1e-6)
    assert walked.figures["hinge_deg"] == pytest.approx(np.rad2deg(SECOND), abs=0.1)


def test_a_step_goes_on_where_another_left_the_same_mechanism() -> None:
    made = MovedParts.of(section_of([push(0.3, "open"), push(0.6, "wider")]))
    assert [given.read.joints[0].start for given in made.parts.values()] == [0.0, 0.3]
    assert list(made.distinct) == [0]
    assert made.mechanism is not None
    assert [joint.name for joint in made.mechanism.joints] == ["hinge"]


def test_a_mechanism_elsewhere_with_the_same_joints_is_refused() -> None:
    with pytest.raises(RequestError, match="the same mechanism in both, with equal urdf, position"):
        MovedParts.of(section_of([push(0.3, "open"), push(0.6, "wider", position=[0.73, 0.45, 0.0])]))


def test_what_a_spring_takes_back_is_not_pushed_on() -> None:
    sprung = {"hinge": {"friction": 4.0, "stiffness": 2.0}}
    with pytest.raises(RequestError, match="the spring of joint hinge takes it back"):
        MovedParts.of(section_of([push(0.3, "open", joints=sprung), push(0.6, "wider", joints=sprung)]))


def test_the_file_of_a_step_s_urdf_is_read_into_the_request(tmp_path: Path) -> None:
    (tmp_path / "door.urdf").write_text(LEAF)
    request = inline_mechanisms(parse_request(request_of([push(0.3, "open", urdf="door.urdf")]), tmp_path))
    assert request == parse_request(request_of([push(0.3, "open")]), tmp_path)


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


def test_a_hand_that_a_step_puts_on_a_rail_carries_the_robot_until_another_step_releases_it() -> None:
    rail = {"name": "rail", "type": "box", "size": [0.04, 0.5, 0.04], "position": [0.6, 0.5, 1.05]}
    hook = {"name": "hook", "make": {"left_hook": {"surface": "rail", "at": [0.62, 0.35, 1.05]}}}
    steps: list[dict[str, Any]] = [
        {"contacts": {"surfaces": {"rail": {"piece": "rail", "normal": [1, 0, 0]}}, "stances": [hook]}},
        {"contacts": {"stances": [{"name": "off", "release": ["left_hook"]}]}},
    ]
    data = {**request_of(steps), "robot": {"name": "atlas"}, "scene": {"floor": True, "obstacles": [rail]}}
    setup = prepare(parse_request(data))
    section = setup.request.section
    assert isinstance(section, StepsSection)
    holding = Holding.of(section, setup.request, setup.robot, setup.scene)
    on, _ = read_stances(holding, setup.scene, section.steps[0], "on", setup.start)
    braced = holding.stand(setup.start, on[-1].contacts)
    push = carry_along(TaskPhase("push"), braced)
    assert push.contacts is not None
    assert {contact.patch for contact in push.contacts} == {"left_foot", "right_foot", "left_hook"}
    assert any(touch.first.link == "l_hook" and touch.second.body == "rail" for touch in push.touches)
    off, _ = read_stances(braced, setup.scene, section.steps[1], "off", setup.start)
    assert {contact.patch for contact in off[0].contacts} == {"left_foot", "right_foot", "left_hook"}
    free = carry_along(TaskPhase("next"), braced.stand(setup.start, off[-1].contacts))
    assert (free.contacts, free.touches) == (None, ())


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
