"""A hand leaves what it pressed before it goes away: a ring on an easy slide, a lever of an easy door."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from given_doors import door_request
from given_mechanisms import request_for
from shared_plans import write_undrawn

from service.demands.door.demand import make_door, read_given_door
from service.errors import RequestError
from service.planner import plan
from service.replay.replay import verify_result
from service.request.file import parse_request
from service.result.result import Verdict

URDF = """<robot name="hose"><link name="base"/>
  <link name="carrier"><collision><origin xyz="0.05 0 0" rpy="0 1.570796 0"/><geometry>
    <cylinder radius="0.03" length="0.02"/></geometry></collision></link>
  <link name="ring"><collision><origin xyz="0 0 0.085"/><geometry>
    <cylinder radius="0.01" length="0.09"/></geometry></collision></link>
  <joint name="push" type="prismatic"><parent link="base"/><child link="carrier"/><axis xyz="1 0 0"/>
    <limit lower="-1" upper="1" velocity="1" effort="500"/></joint>
  <joint name="turn" type="revolute"><parent link="carrier"/><child link="ring"/><axis xyz="1 0 0"/>
    <limit lower="-1.5" upper="1.5" velocity="1" effort="500"/></joint>
</robot>"""


def hose_request(slide_n: float, **more: Any) -> dict[str, Any]:
    handle = {"link": "ring", "place": [0.0, 0.019, 0.1], "axis": [1, 0, 0], "tool": "peg", "tilt_deg": 20}
    return request_for({
        "urdf": URDF, "position": [0.62, -0.2, 1.0], "handle": {**handle, "approach": [-0.12, 0, 0]},
        "joints": {"turn": {"friction": 2.0}, "push": {"friction": slide_n}},
        "moves": [{"joint": "turn", "to": 0.6}], **more,
    })  # fmt: skip


def test_a_hand_sets_on_a_bar_on_an_easy_slide_and_leaves_it_straight() -> None:
    result = plan(parse_request(hose_request(3.0)))
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    names = [phase.name for phase in result.motion.phases]
    assert names == ["reach", "approach", "set on", "move turn", "let go", "retract"]
    onto = next(phase for phase in result.motion.phases if phase.name == "set on")
    places = []
    for q in result.motion.curve([onto.first, onto.last]):
        data = result.motion.robot.model.createData()
        pin.framesForwardKinematics(result.motion.robot.model, data, q)
        ring, peg = (data.oMf[result.motion.robot.model.getFrameId(name)] for name in ("mechanism/ring", "r_peg"))
        places.append(ring.actInv(peg.translation))
    first, last = places
    assert first[1] - last[1] > 5e-3  # from beside the bar onto it
    assert abs(first[0] - last[0]) < 1e-3  # and not along the slide
    checks = {check.name: check for check in result.certificate.checks}
    for phase in ("let go", "retract"):
        assert checks[f"let_go.{phase}.push"].basis.value == "proof"


def test_a_slide_that_bears_the_drag_needs_no_phase_of_its_own() -> None:
    result = plan(parse_request(hose_request(60.0)))
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    assert [phase.name for phase in result.motion.phases][-2:] == ["move turn", "retract"]
    assert not any(check.name.startswith("let_go") for check in result.certificate.checks)


def test_a_slide_without_friction_is_refused_unless_the_hand_stays() -> None:
    words = r"joints\.push\.friction: the hand presses on push while it moves turn, and nothing brings push to rest"
    with pytest.raises(RequestError, match=words):
        plan(parse_request(hose_request(0.0)))
    assert plan(parse_request(hose_request(0.0, stays=True))).verdict is Verdict.CERTIFIED


def test_a_hand_leaves_the_lever_of_an_easy_door_upwards(tmp_path: Path) -> None:
    result = plan(parse_request(door_request(open_deg=20.0, x=0.75, hinge_nm=0.1)))
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    assert [phase.name for phase in result.motion.phases][-3:] == ["let the handle go", "let go", "retract"]
    checks = {check.name: check for check in result.certificate.checks}
    for phase in ("let go", "retract"):
        assert checks[f"let_go.{phase}.door_opening"].basis.value == "proof"
    assert verify_result(write_undrawn(result, tmp_path / "out"))["verdict"] == "CERTIFIED"


@pytest.mark.parametrize(
    ("kind", "hinge_nm", "least"), [("lever", 0.02, "0.0"), ("push_bar", 0.5, "0."), ("lever", 0.0, "0.0")]
)
def test_a_leaf_that_nothing_brings_to_rest_is_refused(kind: str, hinge_nm: float, least: str) -> None:
    """About 40 kg: pushed as slowly as may be it needs 0.06 N m; a bar of 67 N throws it with half a joule."""
    with pytest.raises(RequestError, match=rf"hinge_nm: .*a leaf of about 4\d kg would run ahead.*at least {least}"):
        plan(parse_request(door_request(kind=kind, x=0.75, open_deg=30.0, hinge_nm=hinge_nm)))


def test_a_leaf_is_moved_as_gently_as_its_hinge_slows_it() -> None:
    """Seven tenths of the hinge's torque, over a third of 41 kg times the width squared; at most 1 rad/s^2."""
    for hinge_nm, expected in ((2.0, 0.7 * 2.0 / 11.1), (200.0, 1.0), (0.01, 5e-3)):
        task = parse_request(door_request(hinge_nm=hinge_nm)).task.door
        door = make_door(task, read_given_door(task, np.zeros(3)))
        assert door.mechanism.joints[0].acceleration == pytest.approx(expected, rel=0.03)
