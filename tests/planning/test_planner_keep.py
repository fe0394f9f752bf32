"""Two hands that keep their relative pose, and two that each reach a place, from request to replayed certificate."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation
from shared_plans import plan_example, write_undrawn
from stranger import Stranger, load_checker
from tiny_robots import Segment, Z, chain_urdf

from costs.robot import load_robot
from service.body.holds import relative_pose
from service.planner import plan
from service.replay.replay import verify_result
from service.request.file import parse_request
from service.request.schema import PlanRequest
from service.result.result import PlanResult, Verdict
from service.verify import RelativePoseTarget, Status, verify

LEFT = np.array([0.473, 0.321, 1.096])  # of the hand in the posture reach_ready
SHIFT = np.array([0.05, 0.1, -0.2])
SHELF = {"name": "shelf", "type": "box", "size": [0.3, 0.5, 0.02], "position": [0.62, 0.35, 1.22]}
STUMP = {"name": "stump", "type": "box", "size": [0.06, 0.06, 0.94], "position": [0.64, 0.06, 0.47]}
POST = {"name": "post", "type": "box", "size": [0.05, 0.05, 2.0], "position": [0.75, -0.2, 1.0]}


def carry(shift: np.ndarray, *keep: dict[str, Any], **more: Any) -> PlanRequest:
    """Atlas with both hands before it moves the left one by ``shift``."""
    goal = {"link": "l_hand", "position": (LEFT + shift).tolist(), "position_tolerance_m": 0.005}
    return parse_request(
        {
            "robot": {"name": "atlas"},
            "start": {"posture": "reach_ready"},
            "scene": {"obstacles": [SHELF, POST]},
            "goal": {"poses": [goal]},
            "keep": list(keep),
            **more,
        }
    )


def beam_between_the_hooks() -> dict[str, Any]:
    """A beam of 90 cm across, held by both hooks of the posture reach_ready."""
    robot = load_robot("atlas")
    ready = robot.postures["reach_ready"]
    left, right, hand = (relative_pose(robot, ready, link, None) for link in ("l_tool", "r_tool", "l_hand"))
    place = np.linalg.inv(hand) @ np.append(0.5 * (left + right)[:3, 3], 1.0)
    quaternion = Rotation.from_matrix(hand[:3, :3].T).as_quat(scalar_first=True)
    return {
        "name": "beam",
        "link": "l_hand",
        "type": "box",
        "size": [0.05, 0.9, 0.05],
        "position": place[:3].tolist(),
        "quaternion_wxyz": quaternion.tolist(),
        "touches": ["r_hand", "r_hook"],
        "mass_kg": 3.0,
    }


def both(left: list[float], right: list[float]) -> PlanRequest:
    """Atlas brings both hooks to a place."""
    poses = [
        {"link": f"{side}_tool", "position": position, "position_tolerance_m": 0.005}
        for side, position in (("l", left), ("r", right))
    ]
    return parse_request({"robot": {"name": "atlas"}, "scene": {"obstacles": [SHELF, POST]}, "goal": {"poses": poses}})


def keep_checks(result: PlanResult) -> dict[str, Any]:
    return {check.name: check for check in result.certificate.checks if check.name.startswith("keep.")}


def apart(stranger: Stranger, row: np.ndarray) -> pin.SE3:
    """Pose of the right hand in the left one."""
    places = stranger.placements(row)
    return places["l_hand"].actInv(places["r_hand"])


@pytest.fixture(scope="module", name="carried")
def _carried(tmp_path_factory):
    """A certified motion in which the right hand follows the left one, and its folder."""
    result = plan(carry(SHIFT, {"link": "r_hand", "relative_to": "l_hand"}))
    folder = tmp_path_factory.mktemp("carry") / "out"
    write_undrawn(result, folder)
    return result, folder, Stranger(folder)


def test_a_hand_follows_the_other_and_is_certified_to(carried):
    result, _, stranger = carried
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    left = stranger.placements(stranger.positions[-1])["l_hand"].translation
    assert np.linalg.norm(left - LEFT - SHIFT) < 0.01
    checks = keep_checks(result)
    assert set(checks) == {"keep.reach.r_hand.l_hand", "keep.reach.r_hand.l_hand.rotation"}
    for check, limit in zip(checks.values(), (0.005, np.deg2rad(1.0)), strict=True):
        assert check.basis.value == "proof"
        assert 0.0 < check.value <= check.limit == pytest.approx(limit)


def test_dense_samples_keep_the_relative_pose_as_certified(carried):
    result, _, stranger = carried
    first = apart(stranger, stranger.positions[0])
    off = [first.actInv(apart(stranger, row)) for row in stranger.rows(2)]
    place, rotation = keep_checks(result).values()
    assert max(np.linalg.norm(pose.translation) for pose in off) <= place.value
    assert max(np.linalg.norm(pin.log3(pose.rotation)) for pose in off) <= rotation.value


def test_the_replayed_result_is_certified_with_the_same_checks(carried):
    result, folder, _ = carried
    again = verify_result(folder)
    assert again["verdict"] == "CERTIFIED"
    replayed = {check["name"]: check["limit"] for check in again["checks"] if check["name"].startswith("keep.")}
    assert replayed == pytest.approx({name: check.limit for name, check in keep_checks(result).items()})


@pytest.fixture(name="program")
def _program():
    """The stranger's replay as a module."""
    return load_checker()


@pytest.mark.parametrize(("change", "is_kept"), [("nothing", True), ("position", False), ("rotation", False)])
def test_the_strangers_replay_bounds_the_relative_pose_too(carried, program, change, is_kept):
    _, folder, _ = carried
    data = json.loads((folder / "result.json").read_text())
    (phase,) = data["phases"]
    (kept,) = [target for target in phase["targets"] if target["kind"] == "relative_pose"]
    if change == "position":
        kept["position"][1] += 0.006
    elif change == "rotation":
        turned = Rotation.from_quat(kept["quaternion_wxyz"], scalar_first=True) * Rotation.from_rotvec([0.0, 0.09, 0.0])
        kept["quaternion_wxyz"] = turned.as_quat(scalar_first=True).tolist()
    found, text = program.kept(program.Replay(program.read_model(folder, data), data), phase, kept)
    assert found is is_kept, text


def test_a_motion_that_lets_go_is_refuted_by_the_same_promise(carried):
    result, _, _ = carried
    (promise,) = [t for t in result.motion.phases[0].targets if isinstance(t, RelativePoseTarget)]
    loose = plan(carry(SHIFT))
    assert loose.verdict is Verdict.CERTIFIED, loose.explanation
    (phase,) = loose.motion.phases
    certificate = verify(replace(loose.motion, phases=(replace(phase, targets=(promise,)),)))
    assert certificate.status is Status.VIOLATED
    assert all(check.name.startswith("keep.reach.r_hand.l_hand") for check in certificate.failed())


def test_a_hand_may_turn_about_its_free_axis():
    result = plan(carry(SHIFT, {"link": "r_hand", "relative_to": "l_hand", "free_axis": "y"}))
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    assert result.certificate.checks


def test_a_hand_kept_in_the_world_stays_while_the_other_reaches():
    result = plan(carry(SHIFT, {"link": "r_hand", "position_tolerance_m": 0.002}))
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    assert keep_checks(result)["keep.reach.r_hand.world"].limit == 0.002


@pytest.mark.parametrize("timed", [True, False])
def test_the_tightest_tolerances_can_be_certified_timed_or_not(timed):
    keep = {"link": "r_hand", "relative_to": "l_hand", "position_tolerance_m": 5e-4, "rotation_tolerance_deg": 0.05}
    result = plan(carry(SHIFT, keep, options={"timed": timed}))
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    assert all(0.0 < check.value <= check.limit < 1e-3 for check in keep_checks(result).values())


def test_a_start_that_must_settle_settles_without_letting_go():
    keep = {"link": "r_hand", "relative_to": "l_hand"}
    result = plan(carry(np.array([0.0, 0.0, -0.1]), keep, options={"balance_margin_m": 0.128}))
    assert [phase.name for phase in result.motion.phases] == ["settle", "reach"]
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    assert "keep.settle.r_hand.l_hand" in keep_checks(result)


def test_places_that_both_hands_cannot_keep_are_infeasible():
    keep = {"link": "r_hand", "relative_to": "l_hand"}
    goal = {"link": "r_hand", "position": [0.5, 0.1, 1.1]}
    left = {"link": "l_hand", "position": [0.5, 0.3, 1.1]}
    result = plan(carry(np.zeros(3), keep, goal={"poses": [left, goal]}))
    assert result.verdict is Verdict.INFEASIBLE
    assert result.explanation == (
        "the goals of r_hand and l_hand are 0.20 m apart, "
        "and keeping r_hand relative to l_hand holds them 0.64 m apart",
    )


def test_both_hands_reach_their_places_at_once(tmp_path):
    places = [0.55, 0.3, 1.0], [0.6, -0.35, 1.25]
    result = plan(both(*places))
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    write_undrawn(result, tmp_path / "out")
    stranger = Stranger(tmp_path / "out")
    last = stranger.placements(stranger.positions[-1])
    for side, place in zip("lr", places, strict=True):
        assert np.linalg.norm(last[f"{side}_tool"].translation - place) < 0.01
        assert f"target.reach.{side}_tool" in {check.name for check in result.certificate.checks}


def test_a_beam_in_both_hands_is_part_of_the_robot_that_keeps_clear(carried, tmp_path):
    keep = {"link": "r_hand", "relative_to": "l_hand"}
    scene = {"obstacles": [SHELF, POST, STUMP]}
    result = plan(carry(SHIFT, keep, scene=scene, attached=[beam_between_the_hooks()]))
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    assert "beam" in {body.name for body in result.robot.bodies}
    write_undrawn(result, tmp_path / "out")
    assert verify_result(tmp_path / "out")["verdict"] == "CERTIFIED"
    stranger = Stranger(tmp_path / "out")
    planted = {"l_foot", "r_foot"}
    clearance, pair = stranger.closest(
        stranger.rows(1, stride=8), lambda body, link, piece: link in planted and piece == "floor"
    )
    assert clearance >= result.certificate.min_clearance_m - 1e-6, pair
    # empty hands pass on either side of the stump, and would push the beam into it
    empty = replace(carried[0].motion, scene=result.scene)
    assert verify(empty).status is Status.CERTIFIED
    refuted = verify(replace(empty, robot=result.robot))
    assert [check.where.names for check in refuted.failed()] == [("beam", "stump")]


def test_a_goal_may_be_the_beams_own():
    beam = beam_between_the_hooks()
    goal = {"link": "beam", "position": [0.6, 0.05, 1.0], "position_tolerance_m": 0.005}
    keep = {"link": "r_hand", "relative_to": "l_hand"}
    result = plan(carry(SHIFT, keep, goal={"poses": [goal]}, attached=[beam], scene={"obstacles": []}))
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    assert "target.reach.beam" in {check.name for check in result.certificate.checks}


def test_the_beam_of_the_example_gets_over_the_rail():
    result = plan_example("carry")
    first, last = (relative_pose(result.robot, q, "beam", None) for q in result.motion.curve.positions[[0, -1]])
    (rail,) = [piece for piece in result.scene.pieces if piece.name == "rail"]
    assert first[0, 3] < rail.lower[0]
    assert first[2, 3] < rail.lower[2]
    assert last[0, 3] > rail.lower[0]
    assert last[2, 3] > rail.upper[2]


def test_a_cup_stays_upright_on_a_long_way_over_an_obstacle(tmp_path: Path) -> None:
    """The place is a region of a metre, the tilt one of 20 deg: both are used, and proven between the waypoints."""
    urdf = tmp_path / "arm.urdf"
    y, thin = (0.0, 1.0, 0.0), (0.3, 0.05, 0.05)
    links = [
        Segment(Z, size=thin),
        *(Segment(y, (0.3, 0.0, 0.0), thin) for _ in range(3)),
        Segment(Z, (0.3, 0.0, 0.0), thin),
    ]
    urdf.write_text(chain_urdf(links), encoding="utf-8")
    bent = {"joint2": -0.6, "joint3": 1.0, "joint4": -0.4}
    pole = {"name": "pole", "type": "box", "size": [0.06, 0.06, 0.4], "position": [1.1, 0.0, 0.05]}
    request = parse_request(
        {
            "robot": {"urdf": str(urdf)},
            "scene": {"floor": False, "obstacles": [pole]},
            "start": {"joints": {"joint1": -0.3, **bent}},
            "goal": {"joints": {"joint1": 0.3, **bent}},
            "keep": [{"link": "tip", "position_tolerance_m": 1.0, "rotation_tolerance_deg": 20.0, "free_axis": "z"}],
        }
    )
    result = plan(request)
    assert result.verdict is Verdict.CERTIFIED
    model, motion = result.robot.model, result.motion
    data, frame, most, far = model.createData(), model.getFrameId("tip"), 0.0, 0.0
    poses = []
    for q in motion.curve(np.linspace(*motion.curve.knots[[0, -1]], 2000)):
        pin.framesForwardKinematics(model, data, q)
        poses.append(data.oMf[frame].homogeneous.copy())
        most = max(most, float(np.arccos(np.clip(poses[-1][:3, 2] @ poses[0][:3, 2], -1.0, 1.0))))
        far = max(far, float(np.linalg.norm(poses[-1][:3, 3] - poses[0][:3, 3])))
    assert np.rad2deg(most) <= 20.0
    assert 0.3 < far <= 1.0
