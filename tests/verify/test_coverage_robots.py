"""A verdict covers only what was checked: robots whose descriptions keep things from being checked."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import dishonest_robots as dishonest
import numpy as np
import pytest
from shared_plans import plan_example

from costs.robot import load_robot
from service.cli.report import describe_omissions
from service.errors import RequestError
from service.planner import plan
from service.replay.replay import verify_result
from service.request.file import parse_request
from service.result.output import write_result
from service.result.result import PlanResult, Verdict
from service.result.result_json import summary_json
from service.verify import Certificate, RelativePoseTarget, verify


def planned(
    folder: Path,
    urdf: str,
    start: dict[str, float],
    goal: dict[str, float],
    srdf: str | None = None,
    obstacles: tuple[dict[str, Any], ...] = (),
    **options: Any,
) -> PlanResult:
    """The plan of a robot with a fixed base from one joint position to another."""
    (folder / "robot.urdf").write_text(urdf)
    robot = {"urdf": str(folder / "robot.urdf")}
    if srdf is not None:
        (folder / "robot.srdf").write_text(srdf)
        robot["srdf"] = str(folder / "robot.srdf")
    scene = {"obstacles": list(obstacles)}
    options = {"starts": 4, **options}
    request = {"robot": robot, "start": {"joints": start}, "goal": {"joints": goal}, "scene": scene, "options": options}
    return plan(parse_request(request))


FOLD = ({"j0": 0.0, "j1": 0.0, "j2": 0.0}, {"j0": 0.3, "j1": 0.5, "j2": 0.4})


def box(name: str, position: tuple[float, float, float], size: tuple[float, float, float]) -> dict[str, Any]:
    """A box obstacle of a request."""
    return {"name": name, "type": "box", "position": position, "size": size}


def far_box() -> dict[str, Any]:
    """An obstacle that is in nobody's way."""
    return box("far", (3.0, 0.0, 0.0), (0.1, 0.1, 0.1))


def against(result: PlanResult) -> set[str]:
    """Names of the checks that keep a motion from being certified for lack of coverage."""
    assert result.certificate is not None
    return {check.name for check in result.certificate.checks if check.name.startswith("coverage.")}


def test_an_honest_arm_is_certified_and_says_what_it_covers(tmp_path: Path) -> None:
    result = planned(tmp_path, dishonest.arm(), *FOLD, obstacles=(far_box(),))
    assert result.verdict is Verdict.CERTIFIED
    coverage = result.certificate.coverage
    assert coverage.links_with_shape == dishonest.ARM_LINKS
    assert coverage.links_without_shape == ()
    # Three neighbours of six pairs are left out; every link but the base, which stands still, is held against the box.
    assert (coverage.n_link_pairs, coverage.n_piece_pairs) == (3, 3)
    assert {item.pair for item in coverage.left_out} == {("base", "upper"), ("forearm", "upper"), ("forearm", "hand")}
    assert {item.reason for item in coverage.left_out} == {"adjacent"}
    assert coverage.not_checked == ()


def test_a_wall_that_the_robots_file_fixes_to_the_world_is_an_obstacle(tmp_path: Path) -> None:
    result = planned(tmp_path, dishonest.rail_arm_with_wall(), {"rail": 0.3, "lift": 0.0}, {"rail": 1.7, "lift": 0.0})
    assert result.verdict is Verdict.CERTIFIED
    s = np.linspace(result.motion.curve.knots[0], result.motion.curve.knots[-1], 2000)
    rail, lift = result.motion.curve(s).T
    over = np.abs(rail - 1.0) < 0.15 + 0.025
    assert np.all(lift[over] > 0.25)
    assert result.certificate.coverage.n_link_pairs == 1
    (tmp_path / "robot.urdf").write_text(dishonest.rail_arm_with_wall())
    assert load_robot(urdf=tmp_path / "robot.urdf").ignored_pairs == frozenset()


def test_a_wall_that_is_part_of_what_carries_the_robot_prevents_a_certificate(tmp_path: Path) -> None:
    result = planned(tmp_path, dishonest.rail_arm_on_wall(), {"rail": 0.3, "lift": 0.0}, {"rail": 1.7, "lift": 0.0})
    assert result.verdict is Verdict.FEASIBLE_AT_SAMPLES
    assert "coverage.overlap.bar.world" in against(result)
    over = planned(
        tmp_path,
        dishonest.rail_arm_on_wall(),
        {"rail": 0.3, "lift": 0.5},
        {"rail": 1.7, "lift": 0.5},
        obstacles=(far_box(),),
    )
    assert over.verdict is Verdict.CERTIFIED


def test_a_box_that_slides_through_one_fixed_to_the_world_goes_round_it(tmp_path: Path) -> None:
    start, goal = {"boxbot_x_joint": -1.9, "boxbot_y_joint": 0.0}, {"boxbot_x_joint": 1.9, "boxbot_y_joint": 0.5}
    result = planned(tmp_path, dishonest.boxbot(), start, goal)
    assert result.verdict is Verdict.CERTIFIED
    x, y = result.motion.curve(np.linspace(*result.motion.curve.knots[[0, -1]], 2000)).T
    assert np.all((np.abs(x) > 1.0) | (np.abs(y) > 1.0))


def test_a_box_that_begins_in_one_fixed_to_the_world_is_refused(tmp_path: Path) -> None:
    start, goal = {"boxbot_x_joint": -0.951, "boxbot_y_joint": 0.0}, {"boxbot_x_joint": -0.951, "boxbot_y_joint": 0.3}
    with pytest.raises(RequestError, match="49 mm inside"):
        planned(tmp_path, dishonest.boxbot(), start, goal)


def test_a_robot_without_collision_shapes_is_not_certified_in_a_box(tmp_path: Path) -> None:
    obstacles = (box("all", (0.0, 0.0, 0.0), (3.0, 3.0, 3.0)),)
    result = planned(tmp_path, dishonest.arm(shaped=()), *FOLD, obstacles=obstacles)
    assert result.verdict is Verdict.FEASIBLE_AT_SAMPLES
    assert "coverage.pairs" in against(result)
    assert {f"coverage.shape.{link}" for link in dishonest.ARM_LINKS} <= against(result)
    assert "no pair was checked" in " ".join(result.explanation)


@pytest.mark.parametrize("known", ["drawn and heavy", "drawn", "heavy", "neither"])
def test_a_robot_whose_hand_and_forearm_have_no_shape_is_not_certified(tmp_path: Path, known: str) -> None:
    urdf = dishonest.arm(
        shaped=("base", "upper"),
        drawn=dishonest.ARM_LINKS if "drawn" in known else (),
        heavy=dishonest.ARM_LINKS if "heavy" in known else (),
    )
    result = planned(tmp_path, urdf, *FOLD, obstacles=(far_box(),))
    assert result.verdict is Verdict.FEASIBLE_AT_SAMPLES
    # Without mass and drawing, a hand is no more than a frame; the forearm still carries a joint 0.3 m away.
    expected = {"coverage.shape.forearm", "coverage.shape.hand"} if known != "neither" else {"coverage.shape.forearm"}
    assert against(result) == expected
    assert result.certificate.coverage.links_without_shape == ("forearm", "hand")
    assert {one.link: one.place for one in result.certificate.coverage.shapeless} == {"forearm": "end", "hand": "end"}


def test_links_that_are_only_drawn_are_checked_by_their_drawn_shapes(tmp_path: Path) -> None:
    urdf = dishonest.arm(shaped=("base", "upper"))
    checks = planned(tmp_path, urdf, *FOLD, obstacles=(far_box(),)).certificate.checks
    texts = [check.text for check in checks if check.name.startswith("coverage.shape.")]
    assert len(texts) == 2
    assert texts[0].endswith("robot.drawn_links: [forearm, hand] checks their drawn shapes")
    assert "drawn_links" not in texts[1]
    (tmp_path / "robot.urdf").write_text(urdf)
    robot = {"urdf": str(tmp_path / "robot.urdf"), "drawn_links": ["forearm", "hand"]}
    request = {"robot": robot, "start": {"joints": FOLD[0]}, "goal": {"joints": FOLD[1]}}
    result = plan(parse_request(request | {"scene": {"obstacles": [far_box()]}}))
    assert result.verdict is Verdict.CERTIFIED
    assert result.certificate.coverage.links_without_shape == ()
    write_result(result, tmp_path / "out")
    assert verify_result(tmp_path / "out")["verdict"] == "CERTIFIED"
    whole = planned(tmp_path, dishonest.arm(), *FOLD, obstacles=(far_box(),))
    assert result.certificate.min_clearance_m == pytest.approx(whole.certificate.min_clearance_m)


@pytest.mark.parametrize(("mass", "inertia", "is_body"), [(0.01, 1e-4, False), (0.06, 1e-2, True), (0.04, 1e-4, True)])
def test_a_frame_with_the_mass_and_inertia_of_no_body_needs_no_shape(
    tmp_path: Path, mass: float, inertia: float, is_body: bool
) -> None:
    values = " ".join(f'{key}="{inertia}"' for key in ("ixx", "iyy", "izz")) + ' ixy="0" ixz="0" iyz="0"'
    frame = (
        f'<link name="flange"><inertial><mass value="{mass}"/><inertia {values}/></inertial></link>'
        '<joint name="to_flange" type="fixed"><parent link="hand"/><child link="flange"/>'
        '<origin xyz="0.28 0 0"/></joint></robot>'
    )
    result = planned(tmp_path, dishonest.arm().replace("</robot>", frame), *FOLD, obstacles=(far_box(),))
    assert (result.verdict is Verdict.CERTIFIED) == (not is_body)
    assert against(result) == ({"coverage.shape.flange"} if is_body else set())


def test_a_forearm_without_shape_between_shapes_is_not_certified(tmp_path: Path) -> None:
    result = planned(tmp_path, dishonest.arm(shaped=("base", "upper", "hand")), *FOLD, obstacles=(far_box(),))
    assert result.verdict is Verdict.FEASIBLE_AT_SAMPLES
    (one,) = result.certificate.coverage.shapeless
    assert (one.link, one.place) == ("forearm", "between")
    assert 0.1 < one.reach_m < 0.2  # from its middle to the upper arm on one side, and to the hand on the other
    assert any("forearm" in line and "no collision shape" in line for line in result.explanation)


def test_a_pair_that_the_srdf_leaves_out_and_that_overlaps_is_not_certified(tmp_path: Path) -> None:
    # The hand turns back over the upper arm.
    goal = {"j0": 0.0, "j1": 2.6, "j2": 2.6}
    srdf = dishonest.srdf_without_pairs(dishonest.ARM_LINKS)
    result = planned(tmp_path, dishonest.arm(), FOLD[0], goal, srdf, (far_box(),), timed=False)
    assert result.verdict is Verdict.FEASIBLE_AT_SAMPLES
    assert "coverage.overlap.hand.upper" in against(result)
    item = next(one for one in result.certificate.coverage.left_out if one.pair == ("hand", "upper"))
    assert item.reason == "srdf (Never)"
    assert not item.is_neighbour
    assert item.deepest_m > 0.01
    check = next(c for c in result.certificate.checks if c.name == "coverage.overlap.hand.upper")
    assert f"{1e3 * item.deepest_m:.1f} mm inside" in check.text
    assert describe_omissions(summary_json(result)["coverage"]).startswith(
        "; 6 pairs of links left out, 3 of them no neighbours"
    )


def test_an_srdf_that_leaves_out_every_pair_of_an_empty_scene_is_not_certified(tmp_path: Path) -> None:
    srdf = dishonest.srdf_without_pairs(dishonest.ARM_LINKS)
    result = planned(tmp_path, dishonest.arm(), *FOLD, srdf=srdf)
    assert result.verdict is Verdict.FEASIBLE_AT_SAMPLES
    assert against(result) == {"coverage.pairs"}


def test_a_robot_without_torque_limits_is_certified_with_a_verdict_that_names_them(tmp_path: Path) -> None:
    result = planned(tmp_path, dishonest.without_torque_limits(dishonest.arm()), *FOLD, obstacles=(far_box(),))
    assert result.verdict is Verdict.CERTIFIED
    assert result.certificate.coverage.joints_without_torque_limit == ("j0", "j1", "j2")
    assert "not checked: torques (no joint names a limit)" in describe_omissions(summary_json(result)["coverage"])


def test_an_untimed_motion_says_in_its_verdict_what_was_not_checked(tmp_path: Path) -> None:
    result = planned(tmp_path, dishonest.arm(), *FOLD, obstacles=(far_box(),), timed=False)
    assert result.verdict is Verdict.CERTIFIED
    assert "not checked: speeds, accelerations and forces" in describe_omissions(summary_json(result)["coverage"])


def test_a_robot_without_masses_says_that_its_torques_were_not_checked(tmp_path: Path) -> None:
    result = planned(tmp_path, dishonest.without_masses(dishonest.arm()), *FOLD, obstacles=(far_box(),))
    assert result.verdict is Verdict.CERTIFIED
    assert "not checked: torques (no link names a mass)" in describe_omissions(summary_json(result)["coverage"])


def test_no_further_motion_is_tried_where_none_could_be_certified(tmp_path: Path) -> None:
    steps: list[str] = []
    (tmp_path / "robot.urdf").write_text(dishonest.arm(shaped=()))
    robot = {"urdf": str(tmp_path / "robot.urdf")}
    request = {"robot": robot, "start": {"joints": FOLD[0]}, "goal": {"joints": FOLD[1]}, "scene": {}}
    result = plan(parse_request(request), lambda step, done: steps.append(step))
    assert result.verdict is Verdict.FEASIBLE_AT_SAMPLES
    assert steps.count("certificate") == 1


def test_what_a_certificate_covers_survives_its_file(tmp_path: Path) -> None:
    certificate = planned(tmp_path, dishonest.arm(shaped=("base", "upper", "hand")), *FOLD).certificate
    again = Certificate.from_json(certificate.to_json())
    assert again.to_json() == certificate.to_json()
    assert again.coverage.shapeless == certificate.coverage.shapeless


def test_pairs_that_are_held_together_or_overlap_around_a_joint_are_told_apart() -> None:
    result = plan_example("carry")
    told = {item.pair: item for item in result.certificate.coverage.left_out}
    # Both hands hold the beam: the right one's pose relative to it is a check of its own.
    for pair in (("beam", "r_hand"), ("beam", "r_hook")):
        assert not told[pair].is_neighbour
        assert told[pair].reason in ("kept", "srdf (User)")
    assert any(told[pair].reason == "kept" for pair in (("beam", "r_hand"), ("beam", "r_hook")))
    around = told["mtorso", "pelvis"]
    assert (around.reason, around.is_neighbour) == ("around a joint", True)
    assert around.deepest_m > 0.05
    let_go = replace(
        result.motion,
        phases=tuple(
            replace(phase, targets=tuple(t for t in phase.targets if not isinstance(t, RelativePoseTarget)))
            for phase in result.motion.phases
        ),
    )
    assert any(check.name.startswith("coverage.overlap.beam") for check in verify(let_go).checks)
