"""Feet on a slope or on two levels stand on whole soles, and contact forces prove where they hold the robot."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jaxtyping import Float
from scipy.spatial.transform import Rotation
from shared_plans import write_undrawn
from stance_starts import write_start

from costs.scene import Scene
from costs.support import SupportPolygon
from costs.terms import JointTarget
from service.body.aims import Aims
from service.body.holds import project_onto_holds
from service.body.whole_body import WholeBody
from service.errors import RequestError
from service.planner import plan
from service.replay.replay import verify_result
from service.request.file import parse_request
from service.result.result import PlanResult, Verdict
from service.setup.prepare import prepare
from service.start.robot import load_requested_robot
from service.start.standing import find_sole, is_level
from service.verify import Status, verify

ROBOT = load_requested_robot(parse_request({"robot": {"name": "atlas"}, "goal": {"joints": {"l_arm_shx": 0.0}}}))
FEET = ("l_foot", "r_foot")
SOLE = np.array([[x, y, 0.0] for x in (-0.1, 0.15) for y in (-0.06, 0.06)])


def lean(deg: float, way_deg: float) -> Float[np.ndarray, "3 3"]:
    axis = [np.cos(np.deg2rad(way_deg)), np.sin(np.deg2rad(way_deg)), 0.0]
    return np.asarray(Rotation.from_rotvec(np.deg2rad(deg) * np.array(axis)).as_matrix())


def stand_on(*moves: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "n"]:
    """Return Atlas with each foot moved by a pose of the world, balanced over both, on bent knees."""
    level = WholeBody.standing(ROBOT, Scene(()), ROBOT.postures["stand"], FEET, Aims())
    planted = tuple(
        replace(foot, pose_world_link=move @ foot.pose_world_link)
        for foot, move in zip(level.planted, moves, strict=True)
    )
    moved = replace(level, planted=planted)
    q = level.nominal.copy()
    q[2] += np.mean([move[2, 3] for move in moves]) - 0.02
    height, column = q[2:3].copy(), np.array([2])
    lowered = lambda waypoints: JointTarget(len(waypoints), ROBOT.n, waypoints, column, height)  # noqa: E731
    return np.asarray(project_onto_holds(level.engine, q[None], [*moved.holds(), *moved.hold_in_balance(), lowered])[0])


def request_on_slope(deg: float, way_deg: float, *, under: float | None = None) -> Any:
    """Return a reach on a slope; ``under`` is the lean of the ground where it is not that of the soles."""
    move = np.eye(4)
    move[:3, :3] = lean(deg, way_deg)
    turn = lean(deg if under is None else under, way_deg)
    slope = {
        "name": "ramp", "type": "box", "size": [1.5, 1.5, 0.2], "position": (-0.1 * turn[:, 2]).tolist(),
        "quaternion_wxyz": Rotation.from_matrix(turn).as_quat(scalar_first=True).tolist(),
    }  # fmt: skip
    return make_request(stand_on(move, move), [slope], floor=False)


def make_request(start: Float[np.ndarray, "n"], obstacles: list[dict[str, Any]], *, floor: bool) -> Any:
    goal = {"poses": [{"link": "l_tool", "position": [0.5, 0.25, 1.1], "position_tolerance_m": 0.01}]}
    scene = {"floor": floor, "obstacles": obstacles}
    return parse_request({"robot": {"name": "atlas"}, "start": write_start(ROBOT, start), "scene": scene, "goal": goal})


@cache
def plan_on_slope() -> PlanResult:
    return plan(request_on_slope(15.0, 50.0))


def test_a_reach_on_15_degrees_is_proven_by_contact_forces_and_holds_when_it_is_replayed(tmp_path: Path) -> None:
    result = plan_on_slope()
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    assert result.certificate is not None
    names = {check.name for check in result.certificate.checks}
    assert {"equilibrium.reach", "balance.reach", "forces.reach", "ground.reach.l_foot"} <= names
    write_undrawn(result, tmp_path)
    assert verify_result(tmp_path)["verdict"] == "CERTIFIED"


def test_whole_soles_stay_on_the_slope_by_other_kinematics() -> None:
    motion = plan_on_slope().motion
    assert motion is not None
    model, normal = motion.robot.model, lean(15.0, 50.0)[:, 2]
    data = model.createData()
    feet = [body for body in motion.robot.bodies if body.link in FEET]
    for q in motion.curve(motion.samples[::20]):
        pin.forwardKinematics(model, data, q)
        pressing = []
        for body in feet:
            placed = body.vertices @ data.oMi[body.joint].rotation.T + data.oMi[body.joint].translation
            heights = placed @ normal
            assert heights.min() == pytest.approx(0.0, abs=3e-4)
            pressing.append(placed[heights < 1e-3])
        centre = pin.centerOfMass(model, data, q)
        assert SupportPolygon.of_soles(pressing).margin(centre[None, :2])[0] > 0.02


def test_a_record_that_takes_a_slope_for_level_ground_is_refuted() -> None:
    motion = plan_on_slope().motion
    assert motion is not None
    (phase,) = motion.phases
    for normal in ([0.0, 0.0, 1.0], lean(15.0, 230.0)[:, 2]):
        contacts = tuple(replace(contact, normal=np.array(normal)) for contact in phase.contacts)
        certificate = verify(replace(motion, phases=(replace(phase, contacts=contacts),)))
        assert certificate.status is Status.VIOLATED
        assert not any(check.ok for check in certificate.checks if check.name.startswith("ground."))


def test_a_reach_with_one_foot_on_a_step_is_certified() -> None:
    raised = np.eye(4)
    raised[2, 3] = 0.08
    step = {"name": "step", "type": "box", "size": [0.5, 0.3, 0.08], "position": [0.0, 0.2, 0.04]}
    result = plan(make_request(stand_on(raised, np.eye(4)), [step], floor=True))
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    assert result.certificate is not None
    assert any(check.name == "equilibrium.reach" for check in result.certificate.checks)


def test_soles_that_lean_off_the_ground_are_refused() -> None:
    with pytest.raises(RequestError, match="the sole of"):
        prepare(request_on_slope(10.0, 0.0, under=7.0))


@settings(max_examples=60, deadline=None)
@given(st.floats(0.0, 15.0), st.floats(-180.0, 180.0), st.floats(-3.0, 3.0))
def test_a_flat_foot_has_its_whole_sole_on_any_slope(deg: float, way_deg: float, yaw: float) -> None:
    turn = lean(deg, way_deg) @ Rotation.from_rotvec([0.0, 0.0, yaw]).as_matrix()
    foot = np.concatenate([SOLE, 0.8 * SOLE + np.array([0.0, 0.0, 0.08])]) @ turn.T
    sole = find_sole([foot])
    assert len(sole) == 4
    assert np.allclose(sole @ turn, SOLE, atol=1e-12)
    assert is_level(sole) or deg > 0.5


def test_a_foot_on_its_edge_stands_on_the_edge() -> None:
    foot = np.concatenate([SOLE, SOLE + np.array([0.0, 0.0, 0.08])]) @ lean(40.0, 90.0).T
    assert len(find_sole([foot])) == 2
