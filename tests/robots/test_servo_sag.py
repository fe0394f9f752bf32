"""Sag of the centre of mass on position servos: by hand, and what a plan says of it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from rich.console import Console
from small_robots import floating_joint, robot_of

from costs.curve import Curve
from costs.robot import MechanismJoint, RobotModel, load_robot, with_mechanism
from costs.robot.servo import ATLAS_STIFFNESS, default_stiffness, list_group_joints, list_servo_joints, make_stiffness
from costs.scene import Scene
from service.cli.report import print_verdict
from service.errors import RequestError
from service.motion.hand_sag import list_short_hands
from service.motion.servo_sag import ServoSag, measure_sag
from service.planner import plan
from service.request.file import parse_request, request_hash
from service.result.result_json import summary_json
from service.setup.prepare import prepare
from service.verify import HandLoad, Motion, Phase, PlantedContact, SupportPolygon

FOOT, ARM, LENGTH, G = 3.0, 5.0, 0.8, 9.81
ANGLE, STIFFNESS = 0.3, 900.0
CAP = (
    '<robot name="m"><link name="panel"/><link name="cap"><collision><origin rpy="0 1.5708 0"/>'
    '<geometry><cylinder radius="0.02" length="0.02"/></geometry></collision></link>'
    '<joint name="press" type="prismatic"><parent link="panel"/><child link="cap"/><axis xyz="1 0 0"/>'
    '<limit lower="0" upper="0.015" velocity="1" effort="200"/></joint></robot>'
)
BUTTON: dict[str, Any] = {
    "robot": {"name": "atlas"},
    "start": {"posture": "reach_ready"},
    "task": {
        "mechanism": {
            "urdf": CAP,
            "position": [0.75, -0.25, 1.2],
            "handle": {
                "link": "cap",
                "place": [-0.008, 0, 0],
                "axis": [1, 0, 0],
                "tool": "tip",
                "approach": [-0.08, 0, 0],
            },
            "joints": {"press": {"friction": 60}},
            "moves": [{"joint": "press", "to": 0.008}],
        }
    },
}
REACH: dict[str, Any] = {"robot": {"name": "atlas"}, "goal": {"joints": {"l_arm_elx": 1.6}}}


def leaning_pendulum() -> RobotModel:
    """A foot of 3 kg on the ground, and 5 kg at the end of a rod that leans forward from it by the joint's angle."""
    model = pin.Model()
    base = model.addJoint(0, floating_joint(), pin.SE3.Identity(), "base")
    model.appendBodyToJoint(base, pin.Inertia(FOOT, np.zeros(3), 0.01 * np.eye(3)), pin.SE3.Identity())
    model.addJointFrame(base)
    model.addBodyFrame("foot", base, pin.SE3.Identity(), -1)
    joint = model.addJoint(base, pin.JointModelRY(), pin.SE3.Identity(), "joint0")
    tip = np.array([0.0, 0.0, LENGTH])
    model.appendBodyToJoint(joint, pin.Inertia(ARM, tip, 1e-6 * np.eye(3)), pin.SE3.Identity())
    return robot_of(model, [], is_floating=True)


def standing(half: float) -> Motion:
    """The pendulum at rest on a square sole."""
    q = np.zeros(7)
    q[6] = ANGLE
    sole = np.array([[x, y, 0.0] for x in (-half, half) for y in (-half, half)])
    polygon = np.array([[half, half], [-half, half], [-half, -half], [half, -half]])
    phase = Phase("rest", 0.0, 1.0, (PlantedContact("foot", np.eye(4), sole),), support=SupportPolygon(polygon))
    curve = Curve(np.array([0.0, 1.0]), np.stack([q, q]), np.zeros((2, 7)))
    return Motion(leaning_pendulum(), Scene(()), curve, phases=(phase,))


def by_hand() -> tuple[float, float]:
    """Horizontal sag and place of the centre of mass: torque over stiffness, times the arm's height and its share."""
    # k d = m g l sin(a + d), linear in d: the arm tips further as it sinks.
    turned = ARM * G * LENGTH * np.sin(ANGLE) / (STIFFNESS - ARM * G * LENGTH * np.cos(ANGLE))
    share = ARM / (ARM + FOOT)
    return share * LENGTH * np.cos(ANGLE) * turned, share * LENGTH * np.sin(ANGLE)


def test_one_joint_sags_by_its_torque_over_its_stiffness() -> None:
    expected, place = by_hand()
    sag = measure_sag(standing(0.2), {"joint0": STIFFNESS})
    assert sag is not None
    assert sag.sag_m == pytest.approx(expected, rel=1e-4)
    assert sag.margin_m == pytest.approx(0.2 - place, abs=1e-9)
    assert sag.margin_after_m == pytest.approx(0.2 - place - expected, abs=1e-6)
    assert sag.list_notes() == ()


def test_a_servo_too_soft_to_hold_the_arm_upright_lets_it_fall() -> None:
    sag = measure_sag(standing(0.2), {"joint0": 0.9 * ARM * G * LENGTH * np.cos(ANGLE)})
    assert sag is not None
    assert sag.sag_m == pytest.approx(ARM / (ARM + FOOT) * LENGTH * np.cos(ANGLE), rel=1e-6)  # as far as it is high
    assert len(sag.list_notes()) == 1


def test_a_margin_below_the_sag_is_named_with_its_phase() -> None:
    expected, place = by_hand()
    sag = measure_sag(standing(place + 0.5 * expected), {"joint0": STIFFNESS})
    assert sag is not None
    (note,) = sag.list_notes()
    assert "phase 'rest'" in note
    assert f"sags by up to {1e3 * expected:.1f} mm, and the balance margin is {500.0 * expected:.1f} mm" in note


def test_a_margin_that_the_sag_uses_up_and_no_more_is_not_named() -> None:
    sag = ServoSag({}, 0.02, 1.0, margin_m=0.02, margin_after_m=0.0, tight_phase="reach", led_m=0.0)
    assert sag.list_notes() == ()
    assert len(replace(sag, margin_after_m=-1e-9).list_notes()) == 1


def test_a_fixed_base_has_no_sag() -> None:
    assert measure_sag(replace(standing(0.2), robot=replace(leaning_pendulum(), is_floating=False)), {}) is None


def test_groups_of_joints_are_words_srdf_groups_or_joints() -> None:
    atlas = load_robot("atlas")
    assert list_group_joints(atlas, "l_arm_elx") == ("l_arm_elx",)
    assert len(list_group_joints(atlas, "leg")) == 12
    assert len(list_group_joints(atlas, "left_arm")) == 7
    values = dict(zip(list_servo_joints(atlas), make_stiffness(atlas, {"leg": 5e3, "l_leg_kny": 6e3}), strict=True))
    assert (values["l_leg_hpy"], values["l_leg_kny"], values["back_bky"]) == (5e3, 6e3, ATLAS_STIFFNESS["back"])
    with pytest.raises(ValueError, match="unknown joint group 'legs'"):
        make_stiffness(atlas, {"legs": 1.0})


def test_a_robot_without_a_table_gets_its_stiffness_from_its_efforts_and_its_mass() -> None:
    atlas = replace(load_robot("atlas"), name="other")
    table = default_stiffness(atlas)
    assert table["l_arm_elx"] == pytest.approx(112.0 / 0.05)
    mass = sum(float(inertia.mass) for inertia in atlas.model.inertias)
    assert table["l_leg_hpz"] > 2.0 * mass * G  # stiff enough to stand, though its effort is small
    assert set(table) == set(list_servo_joints(atlas))


def pushing(force: float, angle: float = 0.0) -> Motion:
    """The pendulum pushes a slide forward by 0.1 m with a force at the end of its rod."""
    robot = leaning_pendulum()
    robot.model.addFrame(
        pin.Frame("tool", 2, 0, pin.SE3(np.eye(3), np.array([0.0, 0.0, LENGTH])), pin.FrameType.OP_FRAME)
    )
    vertices = np.array([[x, y, z] for x in (1.0, 1.1) for y in (0.0, 0.1) for z in (0.7, 0.8)])
    slide = MechanismJoint(
        "slide",
        "drawer",
        np.array([1.0, 0.0, 0.8]),
        np.array([1.0, 0.0, 0.0]),
        {"drawer/1": vertices},
        kind="prismatic",
    )
    robot = with_mechanism(robot, [slide])
    q = np.zeros((2, 8))
    q[:, 6], q[1, 7] = angle, 0.1
    sole = np.array([[x, y, 0.0] for x in (-0.2, 0.2) for y in (-0.2, 0.2)])
    load = HandLoad("tool", "drawer", np.zeros(3), np.array([force, 0.0, 0.0]))
    phase = Phase("push", 0.0, 1.0, (PlantedContact("foot", np.eye(4), sole),), loads=(load,))
    curve = Curve(np.array([0.0, 1.0]), q, np.zeros_like(q))
    return Motion(robot, Scene(()), curve, phases=(phase,), mechanism_links=robot.mechanism_links)


def test_a_hand_gives_way_by_its_force_over_the_stiffness_of_its_arm() -> None:
    (sag,) = list_short_hands(pushing(20.0), {"joint0": STIFFNESS})
    # The rod is upright: the force turns it by F l / K, and its end goes back by l times that.
    assert (sag.phase, sag.tool, sag.travel_m) == ("push", "tool", pytest.approx(0.1))
    assert sag.sag_m == pytest.approx(20.0 * LENGTH**2 / STIFFNESS, rel=1e-4)
    assert sag.stiffer == pytest.approx(sag.sag_m / 5e-3)
    assert f"tool gives way by {1e3 * sag.sag_m:.1f} of 100.0 mm in phase 'push'" in sag.describe()
    assert list_short_hands(pushing(20.0), {"joint0": 1.01 * sag.stiffer * STIFFNESS}) == ()


def test_gravity_that_leans_on_the_object_takes_from_what_a_hand_gives_way() -> None:
    light, heavy = (list_short_hands(pushing(40.0, angle), {"joint0": STIFFNESS}) for angle in (0.0, 0.1))
    assert heavy[0].sag_m < light[0].sag_m - 0.9 * LENGTH**2 * ARM * G * np.sin(0.1) / STIFFNESS


def test_a_plan_that_position_servos_do_not_carry_out_says_so_in_its_last_line(
    capsys: pytest.CaptureFixture[str],
) -> None:
    result = plan(parse_request(BUTTON))
    assert result.verdict.value == "CERTIFIED", result.explanation
    (note,) = [note for note in result.notes if "needs torque feed-forward" in note]
    assert "r_tool gives way by" in note
    assert "of 8.0 mm in phase 'move press'" in note
    print_verdict(Console(width=400), summary_json(result))
    assert "; needs torque feed-forward: on position servos r_tool gives way by" in capsys.readouterr().out
    stiff = {**BUTTON, "robot": {"name": "atlas", "servo": {"stiffness": dict.fromkeys(("leg", "back", "arm"), 5e5)}}}
    assert not [note for note in plan(parse_request(stiff)).notes if "feed-forward" in note]


def test_a_plan_says_stiffness_and_sag_and_soft_servos_get_a_note() -> None:
    result = plan(parse_request(REACH))
    servo = summary_json(result)["servo"]
    assert servo["stiffness"]["l_leg_kny"] == 16_000.0
    assert 0.0 < servo["sag_m"] < 0.02
    assert result.certificate is not None
    assert servo["margin_after_sag_m"] < result.certificate.min_balance_margin_m
    assert not [note for note in result.notes if "servos" in note]
    soft = {**REACH, "robot": {"name": "atlas", "servo": {"stiffness": {"leg": 200.0}}}}
    request = parse_request(soft)
    assert request_hash(request) != request_hash(parse_request(REACH))
    weak = plan(request)
    assert weak.verdict is result.verdict
    assert [note for note in weak.notes if note.startswith("needs torque feed-forward or stiffer servos in phase")]


def test_an_unknown_group_is_refused_with_the_field() -> None:
    request = parse_request({**REACH, "robot": {"name": "atlas", "servo": {"stiffness": {"tail": 10.0}}}})
    with pytest.raises(RequestError, match=r"^robot.servo.stiffness: unknown joint group 'tail'; expected"):
        prepare(request)
    with pytest.raises(RequestError, match=r"robot.servo.stiffness.leg"):
        parse_request({**REACH, "robot": {"name": "atlas", "servo": {"stiffness": {"leg": 0.0}}}})


def test_servos_that_follow_their_reference_keep_a_quarter_of_their_sag_where_they_are_a_fifth_softer() -> None:
    (sag,) = list_short_hands(pushing(20.0), {"joint0": STIFFNESS})
    # tau / K is led, and tau / (0.8 K) is what the servo gives: a quarter of tau / K is left.
    assert sag.led_m == pytest.approx(0.25 * sag.sag_m)
    body = measure_sag(standing(0.2), {"joint0": STIFFNESS})
    assert body is not None
    assert body.margin_m is not None
    assert body.led_m is not None
    assert body.margin_after_m is not None
    assert body.margin_after_m < body.led_m < body.margin_m
    assert body.margin_m - body.led_m < 0.4 * (body.margin_m - body.margin_after_m)
