"""Holds of a mechanism that cannot push are refused with a side that can; those that can are certified."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from given_mechanisms import BAR, PEG, cabinet_request, drawer_request, latched_request
from shared_plans import plan_once, write_undrawn
from tiny_robots import atlas

from costs.robot import load_robot, with_mechanism
from service.demands.hands import HANDS
from service.demands.holds.pushes import add_pushes, find_nominal_pushes
from service.demands.mechanism.given import read_given_mechanism
from service.demands.mechanism.phases import make_mechanism_phases
from service.demands.mechanism.settling import settle_handle
from service.demands.mechanism.tips import list_pushing_hands
from service.errors import RequestError
from service.planner import plan
from service.replay.replay import verify_result
from service.request.file import load_request, parse_request
from service.request.tasks.steps import StepsSection
from service.result.result import Verdict
from service.start.mechanism_file import inline_mechanisms

FRICTION = (0.3, 0.6)
ERRAND = Path(__file__).resolve().parents[2] / "benchmarks" / "tasks" / "requests" / "errand.yaml"


def mirror(request: dict[str, Any]) -> dict[str, Any]:
    """The request with the peg on the other side of the bar."""
    handle = request["task"]["mechanism"]["handle"]
    handle["place"] = [-handle["place"][0], -handle["place"][1], handle["place"][2]]
    return request


@pytest.mark.parametrize("make", [drawer_request, cabinet_request])
@pytest.mark.parametrize("loads", [None, {}])
def test_a_peg_that_would_have_to_pull_is_refused_with_the_side_that_pushes(make: Any, loads: Any) -> None:
    """Whatever the mechanism opposes: without a load nothing moves it either."""
    changed = {} if loads is None else {"joints": loads}
    request = mirror(make(**changed))
    result = plan(parse_request(request))
    assert result.verdict is Verdict.INFEASIBLE
    (sentence,) = result.explanation
    assert "would have to pull" in sentence
    assert "deg off the way of" in sentence
    wrong = request["task"]["mechanism"]["handle"]["place"]
    place = [float(number) for number in sentence.split("handle.place [")[1].split("]")[0].split(", ")]
    assert np.dot(place[:2], wrong[:2]) < -0.8 * np.linalg.norm(place[:2]) * np.linalg.norm(wrong[:2])


def test_the_side_that_the_refusal_names_is_certified_and_its_push_is_in_the_record(tmp_path: Path) -> None:
    result = plan_once(parse_request(drawer_request(to=0.1)))
    phase = next(phase for phase in result.motion.phases if phase.name == "move slide")
    (push,) = phase.pushes
    assert (push.joint, push.sense, push.force_n, push.friction) == ("slide", 1.0, 30.0, FRICTION)
    assert [contact.surface for contact in push.contacts] == ["the rod"]
    checks = {check.name: check for check in result.certificate.checks}
    assert checks["hand_contact.move slide.slide"].basis.value == "proof"
    folder = write_undrawn(result, tmp_path / "out")
    assert verify_result(folder)["verdict"] == "CERTIFIED"


def test_a_place_that_is_off_is_moved_until_the_hand_touches() -> None:
    """5 mm from the bar and 3 mm inside it: the rod ends a millimetre inside, which it loses as its lean changes."""
    robot = atlas()
    for off in (5e-3, -3e-3):
        handle = {"link": "handle", "place": [BAR + PEG + off, 0.0, 0.01], "axis": [0, 0, -1]}
        given = read_given_mechanism(parse_request(drawer_request(handle=handle)).task.mechanism)
        augmented = with_mechanism(robot, given.mechanism.joints)
        settled = settle_handle(given, augmented, HANDS["left"], FRICTION)
        spec = next(spec for spec in make_mechanism_phases(settled, HANDS["left"]) if spec.moving)
        (nominal,) = find_nominal_pushes(spec, augmented, given.mechanism, FRICTION)
        assert nominal.met[0].gap == pytest.approx(-1e-3, abs=2e-6)


def test_a_tip_ends_inside_what_it_presses() -> None:
    """Before the face it would press a button of some millimetres by so much less."""
    handle = {"link": "door", "place": [-0.011, -0.3, 0.0], "axis": [1, 0, 0], "tool": "tip", "tilt_deg": 25}
    ajar = {"hinge": {"start": 0.7, "friction": 3.0}}
    given = read_given_mechanism(parse_request(cabinet_request(to=0.0, handle=handle, joints=ajar)).task.mechanism)
    augmented = with_mechanism(atlas(), given.mechanism.joints)
    settled = settle_handle(given, augmented, HANDS["left"], FRICTION)
    spec = next(spec for spec in make_mechanism_phases(settled, HANDS["left"]) if spec.moving)
    (nominal,) = find_nominal_pushes(spec, augmented, given.mechanism, FRICTION)
    assert nominal.met[0].gap == pytest.approx(-1e-3, abs=2e-5)


def test_a_gripper_presses_a_lever_with_the_side_of_its_closed_fingers_and_the_leaf_with_its_front() -> None:
    """The fingers lie on the bar, whichever way the hand is turned about its own axis."""
    section = inline_mechanisms(load_request(ERRAND)).section
    assert isinstance(section, StepsSection)
    given = read_given_mechanism(section.steps[1].mechanism)
    robot = load_robot("atlas", hand="gripper")
    augmented = with_mechanism(robot, given.mechanism.joints)
    hands = list(list_pushing_hands(robot, given))
    assert [hand.side for hand in hands] == ["right", "right"]
    for hand, finger in zip(hands, ("r_finger_2", "r_finger_1"), strict=True):
        settled = settle_handle(given, augmented, hand, FRICTION)
        specs = add_pushes(make_mechanism_phases(settled, hand), augmented, given.mechanism, FRICTION)
        press, opening = (spec for spec in specs if spec.name in ("move handle", "move hinge"))
        assert [[contact.frame for contact in push.contacts] for push in press.pushes] == [[finger]]
        assert [[contact.frame for contact in push.contacts] for push in opening.pushes] == [[finger], ["r_tool"]]
        assert press.loads[0].force @ [0, 0, 1] == pytest.approx(-2.0 / 0.1, rel=0.05)


@pytest.mark.parametrize(
    ("off_deg", "tilt_deg", "left_deg"), [(10.0, 30.0, 10.0), (36.0, 30.0, 24.0), (36.0, 12.0, 32.0)]
)
def test_a_rod_leans_until_its_side_faces_the_way_or_as_far_as_it_may(
    off_deg: float, tilt_deg: float, left_deg: float
) -> None:
    """The rod points down in the plane of the way, ``off_deg`` from square to it, behind a bar across both.

    39 deg are permitted: 12 in reserve leave 27, reached in steps of 4; 8 of the tilt stay the hand's.
    """
    off = np.deg2rad(off_deg)
    axis = np.array([np.sin(off), 0.0, -np.cos(off)])
    place = 0.018 * np.array([np.cos(off), 0.0, np.sin(off)])
    handle = {"link": "handle", "place": place.tolist(), "axis": axis.tolist(), "tilt_deg": tilt_deg}
    given = read_given_mechanism(parse_request(drawer_request(handle=handle)).task.mechanism)
    augmented = with_mechanism(atlas(), given.mechanism.joints)
    settled = settle_handle(given, augmented, HANDS["left"], FRICTION)
    spec = next(spec for spec in make_mechanism_phases(settled, HANDS["left"]) if spec.moving)
    (nominal,) = find_nominal_pushes(spec, augmented, given.mechanism, FRICTION)
    assert np.rad2deg(nominal.angle) == pytest.approx(left_deg, abs=0.1)
    assert nominal.met[0].gap == pytest.approx(-1e-3, abs=2e-5)
    leant = np.arccos(np.clip(settled.handle.axis @ given.handle.axis, -1.0, 1.0))
    assert leant + settled.handle.tilt == pytest.approx(given.handle.tilt, abs=1e-6)


def test_a_paddle_and_its_drawer_are_pushed_at_once_by_what_each_takes() -> None:
    """The spring of the paddle pulls back while the drawer comes out, so that both are pushed."""
    given = read_given_mechanism(parse_request(latched_request()).task.mechanism)
    augmented = with_mechanism(atlas(), given.mechanism.joints)
    specs = {spec.name: spec for spec in make_mechanism_phases(given, HANDS["left"])}
    found = {
        name: [each.push for each in find_nominal_pushes(spec, augmented, given.mechanism, FRICTION)]
        for name, spec in specs.items()
    }
    joints = {name: {(push.joint, push.sense) for push in pushes} for name, pushes in found.items()}
    assert joints["move paddle"] == {("paddle", 1.0)}
    assert joints["move slide"] == {("slide", 1.0), ("paddle", 1.0)}
    assert joints["move paddle 2"] == {("paddle", 1.0)}  # the spring turns it back against the hand
    (slide,) = found["move paddle"][0].held
    assert (slide.joint, slide.low, slide.high) == ("slide", -np.inf, np.inf)  # latched


def test_a_recorded_hold_that_would_drag_a_loose_joint_is_refused(shared_cases: Path) -> None:
    with pytest.raises(RequestError, match="nothing brings across to rest once the hand has gone"):
        plan(load_request(shared_cases / "holds/plugb_100.yaml"))


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("holds/rail_push_wrong_side.yaml", "would have to pull"),
        ("holds/circle_114_20.yaml", "jams"),
        ("lies/peg_front/request.yaml", "would have to pull"),
    ],
)
def test_recorded_holds_that_move_nothing_in_physics_are_refused(shared_cases: Path, name: str, words: str) -> None:
    result = plan(load_request(shared_cases / name))
    assert result.verdict is Verdict.INFEASIBLE
    assert words in result.explanation[0]
    assert "deg off the way of" in result.explanation[0]
