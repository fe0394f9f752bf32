"""Moving given mechanisms: drawer, cabinet and latched drawer are certified and replayed; refusals."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from given_mechanisms import (
    box,
    cabinet_request,
    drawer_request,
    drawer_urdf,
    latched_request,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from shared_plans import plan_once, write_once, write_undrawn
from tiny_robots import atlas

from costs.robot import with_mechanism
from perception import write_npz
from perception.simulate import Pose, Scanner, scan
from perception.solids.primitives import box as solid_box
from service.client.local_files import resolve_paths
from service.demands import Demands
from service.demands.hands import HANDS
from service.demands.mechanism.demand import GivenMechanismDemand
from service.demands.mechanism.given import read_given_mechanism
from service.demands.mechanism.phases import make_mechanism_phases
from service.demands.recorded_task import MechanismDemand
from service.demands.rest.phases import RestTask
from service.demands.task_demand import World
from service.errors import RequestError, ResultError
from service.planner import plan
from service.replay.consistency import compare_figures
from service.replay.replay import read_motion, verify_result
from service.replay.whole import certify_whole
from service.request.file import load_request, parse_request, request_hash
from service.result.folder import read_result
from service.result.result import PlanResult, Verdict
from service.setup.prepare import prepare
from service.tasks.hints import find_anchor
from service.trust.folders import list_paths
from service.verify import Status, verify
from service.wire.requests import request_from_message, request_to_message
from service.wire.results import result_to_message
from service.work.robot.load import hash_motion


@pytest.fixture(scope="module")
def drawer() -> tuple[PlanResult, Path]:
    """A drawer pulled out by 0.25 m, with its folder."""
    request = parse_request(drawer_request())
    return plan_once(request), write_once(request)


def _plan_and_write(request: dict[str, Any], folder: Path) -> tuple[PlanResult, Path]:
    result = plan(parse_request(request))
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    write_undrawn(result, folder)
    return result, folder


def _refuse(request: dict[str, Any]) -> str:
    with pytest.raises(RequestError) as caught:
        plan(parse_request(request))
    (problem,) = caught.value.problems
    return problem


def test_a_drawer_is_pulled_out_and_replayed(drawer: tuple[PlanResult, Path]) -> None:
    result, folder = drawer
    assert [phase.name for phase in result.motion.phases] == ["reach", "approach", "move slide", "retract"]
    assert result.figures["slide_m"] == pytest.approx(0.25, abs=1e-4)
    again = verify_result(folder)
    assert again["verdict"] == "CERTIFIED", again["explanation"]


def test_only_all_phases_of_a_drawer_are_the_whole_task(drawer: tuple[PlanResult, Path]) -> None:
    motion, setup = drawer[0].motion, prepare(parse_request(drawer_request()))
    assert motion is not None
    assert motion.law is not None
    whole = certify_whole(setup, motion)
    assert whole is not None
    assert whole.status is Status.CERTIFIED
    for count in range(1, len(motion.phases)):
        curve = motion.curve.cut(motion.curve.find_knots(motion.curve.knots[0], motion.phases[count - 1].last))
        law = motion.law.cut(float(curve.knots[0]), float(curve.knots[-1]))
        samples = motion.samples[motion.samples <= curve.knots[-1]]
        part = replace(motion, curve=curve, law=law, samples=samples, phases=motion.phases[:count])
        assert verify(part).status is Status.CERTIFIED
        assert certify_whole(setup, part) is None


def test_the_hand_stays_behind_the_bar_while_the_drawer_comes_out(drawer: tuple[PlanResult, Path]) -> None:
    """By the recorded samples and pinocchio's frames, not by the planner's terms."""
    motion = drawer[0].motion
    model, data = motion.robot.model, motion.robot.model.createData()
    phase = next(phase for phase in motion.phases if phase.name == "move slide")
    tool = next(target.frame for target in phase.targets if hasattr(target, "frame"))
    for q in motion.curve(np.linspace(phase.first, phase.last, 30)):
        pin.framesForwardKinematics(model, data, q)
        slide = q[-1]
        bar = np.array([0.75 - 0.06 - slide, -0.25, 0.95])
        off = data.oMf[model.getFrameId(tool)].translation - bar
        assert off == pytest.approx([0.018, 0.0, 0.01], abs=5e-3)


def test_the_friction_of_the_drawer_is_in_the_forces(drawer: tuple[PlanResult, Path]) -> None:
    phase = next(phase for phase in drawer[0].motion.phases if phase.name == "move slide")
    (load,) = phase.loads
    np.testing.assert_allclose(load.force, [-30.0, 0.0, 0.0], atol=1e-9)
    forces = np.concatenate([region.witnesses.sum(axis=2).reshape(-1, 3) for region in phase.regions])
    assert np.abs(forces[:, 0]).max() == pytest.approx(30.0, abs=1e-3)


def test_a_cabinet_is_opened_and_replayed(tmp_path: Path) -> None:
    result, folder = _plan_and_write(cabinet_request(), tmp_path / "out")
    assert result.figures["hinge_deg"] == pytest.approx(np.rad2deg(0.8), abs=0.1)
    assert verify_result(folder)["verdict"] == "CERTIFIED"
    (load,) = next(phase for phase in result.motion.phases if phase.name == "move hinge").loads
    # 3 N m about a vertical axis, at the peg's distance from it.
    assert np.cross(load.place, load.force) == pytest.approx([0.0, 0.0, -3.0], abs=1e-9)


def test_a_door_ajar_is_pushed_shut_by_a_tip_that_slides(tmp_path: Path) -> None:
    handle = {"link": "door", "place": [-0.011, -0.3, 0.0], "axis": [1, 0, 0], "tool": "tip", "slide": [0, 0.06, 0]}
    ajar = {"hinge": {"start": 0.7, "friction": 3.0}}
    request = cabinet_request(to=0.0, handle={**handle, "tilt_deg": 25}, joints=ajar, hand="left")
    result, folder = _plan_and_write(request, tmp_path / "out")
    assert result.figures["hinge_deg"] == pytest.approx(0.0, abs=0.1)
    (load,) = next(phase for phase in result.motion.phases if phase.name == "move hinge").loads
    # 3 N m in the closing sense, where the tip is nearest to the hinge.
    nearest = np.linalg.norm(load.place + load.slide)
    assert np.linalg.norm(load.force) == pytest.approx(3.0 / nearest, rel=1e-9)
    assert verify_result(folder)["verdict"] == "CERTIFIED"


def test_a_hand_that_leans_at_the_end_leaves_along_its_rod(tmp_path: Path) -> None:
    """Along the handle's axis the rod would be 6 mm inside the bar on its way."""
    result, folder = _plan_and_write(cabinet_request(to=1.7, y=-0.4, hand="right"), tmp_path / "out")
    assert result.motion.phases[-1].name == "retract"
    assert verify_result(folder)["verdict"] == "CERTIFIED"


def test_a_latch_is_released_before_the_drawer_and_the_spring_is_carried(tmp_path: Path) -> None:
    result, folder = _plan_and_write(latched_request(), tmp_path / "out")
    names = [phase.name for phase in result.motion.phases]
    assert names == ["reach", "approach", "move paddle", "move slide", "move paddle 2", "retract"]
    assert (result.figures["slide_m"], result.figures["paddle_deg"]) == pytest.approx((0.2, 0.0), abs=1e-3)
    phases = {phase.name: phase for phase in result.motion.phases}
    held = {load.link: load for load in phases["move slide"].loads}
    # 0.5 N m and 1 N m/rad * 0.3 rad at an arm of 50.8 mm: the paddle's spring pulls while the drawer comes out.
    spring = held["mechanism/pivot"]
    assert np.linalg.norm(np.cross(spring.place, spring.force)) == pytest.approx(0.8, abs=1e-9)
    # The bar's face leans by 0.3 rad with the paddle, so that it takes more than the 30 N along the drawer's way.
    along, _, upwards = held["mechanism/drawer"].force
    assert along == pytest.approx(-30.0, abs=1e-9)
    assert upwards == pytest.approx(30.0 * np.tan(0.3), rel=1e-3)
    assert any(check.name == "release.slide" for check in result.certificate.checks)
    assert verify_result(folder)["verdict"] == "CERTIFIED"


def test_a_drawer_that_its_latch_still_locks_is_refused() -> None:
    moves = [{"joint": "paddle", "to": 0.15}, {"joint": "slide", "to": 0.2}]
    assert _refuse(latched_request(moves=moves)) == (
        "task.mechanism.moves[1].joint: slide is locked while paddle is at 0.15; expected a move of paddle to 0.2 or "
        "beyond before it"
    )


def test_a_result_for_another_value_or_load_is_refused(drawer: tuple[PlanResult, Path], tmp_path: Path) -> None:
    for name, changed in (
        ("value", drawer_request(to=0.3)),
        ("load", drawer_request(joints={"slide": {"friction": 60.0}})),
        ("place", drawer_request(y=-0.2)),
        ("hand", drawer_request(hand="left" if drawer[0].notes[0].startswith("right") else "right")),
    ):
        path = tmp_path / f"{name}.yaml"
        path.write_text(json.dumps(changed))
        try:
            verdict = verify_result(drawer[1], path)["verdict"]
        except ResultError:
            continue
        assert verdict != "CERTIFIED", name


def test_what_stands_before_the_drawer_makes_the_move_impossible_by_name() -> None:
    crate = {"name": "crate", "type": "box", "size": [0.1, 0.1, 0.2], "position": [0.55, -0.42, 0.95]}
    result = plan(parse_request({**drawer_request(hand="right"), "scene": {"obstacles": [crate]}}))
    assert result.verdict is Verdict.INFEASIBLE
    # Its front is at x = 0.74 less its travel, the crate's side at x = 0.6; it is looked at every 5 mm.
    (line,) = [line for line in result.explanation if "crate" in line]
    assert line == "mechanism/drawer/drawer meets crate with slide at 0.145 m of 0.25"


def test_the_hand_stays_at_the_end_if_it_is_asked_to() -> None:
    result = plan(parse_request(drawer_request(to=0.1, stays=True)))
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    assert [phase.name for phase in result.motion.phases][-1] == "move slide"


def _handle(**changes: Any) -> dict[str, Any]:
    return {**drawer_request()["task"]["mechanism"]["handle"], **changes}


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"urdf": drawer_urdf().replace("prismatic", "fixed")}, "task.mechanism.urdf: no joint moves"),
        (
            {"urdf": drawer_urdf().replace("prismatic", "floating")},
            "task.mechanism.urdf: joint 'slide': type 'floating'",
        ),
        ({"handle": _handle(link="knob")}, "task.mechanism.handle.link: unknown link 'knob'; the mechanism has"),
        ({"handle": _handle(link="cupboard")}, "task.mechanism.handle.link: no joint moves 'cupboard'"),
        (
            {"handle": _handle(place=[0.1, 0, 0])},
            "task.mechanism.handle.place: the right hand's rod of 9 mm radius would",
        ),
        ({"handle": _handle(place=[0.0, 0, 0])}, "expected at most 10 mm away and 4 mm inside"),
        ({"moves": [{"joint": "slid", "to": 0.1}]}, "task.mechanism.moves[0].joint: unknown joint 'slid'"),
        (
            {"moves": [{"joint": "slide", "to": 0.5}]},
            "task.mechanism.moves[0].to: 0.5 m is past the limits of the joint, 0 to 0.4 m",
        ),
        ({"moves": [{"joint": "slide", "to": 0.0}]}, "task.mechanism.moves[0].to: slide is at 0 already"),
        ({"joints": {"slide": {"start": -0.1}}}, "task.mechanism.joints.slide.start: -0.1 m is past the limits"),
        (
            {"joints": {"hinge": {"friction": 1.0}}},
            "task.mechanism.joints: unknown joint 'hinge'; the mechanism has slide",
        ),
        (
            {"releases": [{"joint": "slide", "latch": "key", "at": 0.1}]},
            "task.mechanism.releases[0].latch: unknown joint 'key'",
        ),
        ({"urdf": "missing.urdf"}, "task.mechanism.urdf: missing.urdf is not there"),
        ({"position": [0.1, 0.0, 0.0]}, "start is in collision"),
    ],
)
def test_a_request_that_makes_no_sense_is_refused_in_one_line(changes: dict[str, Any], problem: str) -> None:
    with pytest.raises(RequestError) as caught:
        plan(parse_request(drawer_request(**changes)))
    line = caught.value.problems[0]
    assert problem in line
    assert all("\n" not in each for each in caught.value.problems)


def test_a_spring_above_the_moving_joint_is_refused() -> None:
    request = latched_request(
        releases=[],
        joints={"slide": {"stiffness": 10.0}},
        moves=[{"joint": "slide", "to": 0.2}, {"joint": "paddle", "to": 0.3}],
    )
    assert _refuse(request).startswith("task.mechanism.joints.slide: its spring pulls while the hand moves paddle")


def test_a_joint_that_the_hand_does_not_move_is_refused() -> None:
    second = (
        f'<link name="flap">{box((0.02, 0.1, 0.1), (0, 0, 0.05))}</link><joint name="flap_hinge" type="revolute">'
        '<parent link="cupboard"/><child link="flap"/><origin xyz="0.5 0 1.2"/><axis xyz="0 1 0"/>'
        '<limit lower="0" upper="1" velocity="1" effort="1"/></joint></robot>'
    )
    text = drawer_urdf().replace("</robot>", second)
    problem = _refuse(drawer_request(urdf=text, moves=[{"joint": "flap_hinge", "to": 0.5}]))
    assert problem == (
        "task.mechanism.moves[0].joint: 'flap_hinge' does not move 'handle', which the hand holds; expected slide"
    )


def test_a_urdf_file_and_its_meshes_become_part_of_the_request(tmp_path: Path) -> None:
    corners = [(x, y, z) for x in (-10, 10) for y in (-230, 230) for z in (-80, 80)]
    (tmp_path / "front.obj").write_text("".join(f"v {x} {y} {z}\n" for x, y, z in corners))
    mesh = '<mesh filename="front.obj" scale="0.001 0.001 0.001"/>'
    text = drawer_urdf().replace('<box size="0.02 0.46 0.16"/>', mesh)
    (tmp_path / "cupboard.urdf").write_text(text)
    (tmp_path / "request.yaml").write_text(json.dumps(drawer_request(urdf="cupboard.urdf")))
    request = load_request(tmp_path / "request.yaml")
    assert ("task.mechanism.urdf", "cupboard.urdf", "file") in list(list_paths(request))
    setup = prepare(request)
    mechanism = setup.request.task.mechanism
    assert mechanism.urdf == text
    assert len(mechanism.meshes["front.obj"].points) == 8
    inline = drawer_request(urdf=text, meshes={"front.obj": {"points": [list(map(float, c)) for c in corners]}})
    assert "task.mechanism.urdf" not in [field for field, _, _ in list_paths(parse_request(inline))]
    assert request_from_message(request_to_message(setup.request)) == setup.request
    again = prepare(load_request(tmp_path / "request.yaml")).request
    assert request_hash(again) == request_hash(setup.request) != request_hash(request)


def test_a_client_sends_a_urdf_without_meshes_as_text(tmp_path: Path) -> None:
    (tmp_path / "cupboard.urdf").write_text(drawer_urdf())
    request = parse_request(drawer_request(urdf="cupboard.urdf"), tmp_path)
    for is_this_machine in (True, False):
        assert resolve_paths(request, is_this_machine).task.mechanism.urdf == drawer_urdf()
    meshed = drawer_urdf().replace('<box size="0.02 0.46 0.16"/>', '<mesh filename="front.obj"/>')
    (tmp_path / "cupboard.urdf").write_text(meshed)
    assert resolve_paths(request, is_this_machine=True).task.mechanism.urdf == str(tmp_path / "cupboard.urdf")
    with pytest.raises(RequestError, match=r"task\.mechanism\.urdf: 'cupboard\.urdf' is a path of this machine"):
        resolve_paths(request, is_this_machine=False)
    with pytest.raises(RequestError, match=r"task\.mechanism\.urdf: 'nowhere\.urdf' does not exist"):
        resolve_paths(parse_request(drawer_request(urdf="nowhere.urdf"), tmp_path), is_this_machine=False)


def test_links_that_no_joint_moves_are_obstacles_and_names_stay_apart() -> None:
    setup = prepare(parse_request(drawer_request()))
    assert {"fixture/cupboard", "fixture/cupboard.1"} <= {piece.name for piece in setup.scene.pieces}
    taken = {"name": "mechanism/drawer", "type": "box", "size": [0.1, 0.1, 0.1], "position": [2, 0, 1]}
    with pytest.raises(RequestError, match="the mechanism that the task moves"):
        prepare(parse_request({**drawer_request(), "scene": {"obstacles": [taken]}}))


def test_what_a_scan_shows_of_the_mechanism_makes_no_pieces(tmp_path: Path) -> None:
    """A floor, the cupboard with its drawer, and a crate beside it: only the crate and the floor become pieces."""
    low = np.array([0.75, -0.25, 0.0])
    parts = [((0.02, -0.25, 0.0), (0.52, 0.25, 0.85)), ((0.02, -0.25, 1.05), (0.52, 0.25, 1.15))]
    parts += [((-0.01, -0.23, 0.87), (0.01, 0.23, 1.03))]
    solids = [solid_box(low + a, low + b) for a, b in parts]
    solids += [solid_box((0.8, 0.5, 0.0), (1.1, 0.9, 0.7)), solid_box((-3, -3, -0.1), (3, 3, 0.0))]
    path = tmp_path / "scan.npz"
    write_npz(path, scan(solids, Pose((0.1, 0.0, 1.6), pitch=0.4), Scanner(n_lines=60, sigma=0.003), seed=0))
    request = {**drawer_request(), "scene": {"cloud": str(path)}}
    setup = prepare(parse_request(request), checks_start=False)
    seen = [piece for piece in setup.scene.pieces if not piece.name.startswith("fixture/") and piece.kind != "floor"]
    found = read_given_mechanism(setup.request.task.mechanism)
    bodies = np.concatenate(found.place_bodies())
    inside = (bodies.min(axis=0) - 0.03, bodies.max(axis=0) + 0.03)
    crates = [piece for piece in seen if (piece.vertices.mean(axis=0) > [0.7, 0.4, 0.0]).all()]
    assert crates
    for piece in seen:
        middle = piece.vertices.mean(axis=0)
        assert not ((inside[0] < middle) & (middle < inside[1])).all(), piece.name


@settings(max_examples=40, deadline=None)
@given(values=st.tuples(st.floats(0.0, 0.4), st.floats(0.0, 0.6)), yaw=st.floats(-3.0, 3.0))
def test_links_are_where_the_verifier_s_model_has_them(values: tuple[float, float], yaw: float) -> None:
    turned = [float(np.cos(0.5 * yaw)), 0.0, 0.0, float(np.sin(0.5 * yaw))]
    found = read_given_mechanism(parse_request(latched_request(quaternion_wxyz=turned)).task.mechanism)
    robot = with_mechanism(atlas(), found.mechanism.joints)
    data = robot.model.createData()
    q = np.concatenate([atlas().postures["stand"], values])
    pin.framesForwardKinematics(robot.model, data, q)
    for joint in found.mechanism.joints:
        pose = data.oMf[robot.model.getFrameId(joint.link)].homogeneous
        np.testing.assert_allclose(found.locate(joint.name, np.array(values)), pose, atol=1e-12)


@settings(max_examples=40, deadline=None)
@given(
    place=st.tuples(*[st.floats(0.02, 0.3)] * 3),
    ends=st.tuples(st.floats(0.05, 0.4), st.floats(0.21, 0.6)),
    yaw=st.floats(-3.0, 3.0),
    spring=st.tuples(st.floats(0.1, 5.0), st.floats(0.0, 20.0)),
)
def test_the_hand_s_forces_do_the_work_of_friction_and_springs(
    place: tuple[float, ...], ends: tuple[float, float], yaw: float, spring: tuple[float, float]
) -> None:
    """Virtual work: the force times the handle's motion per joint motion, by differences, is what the joint opposes."""
    preload, stiffness = spring
    task = latched_request(
        quaternion_wxyz=[float(np.cos(0.5 * yaw)), 0.0, 0.0, float(np.sin(0.5 * yaw))],
        joints={"slide": {"friction": 30.0}, "paddle": {"preload": preload, "stiffness": stiffness, "friction": 0.2}},
        moves=[{"joint": "paddle", "to": ends[1]}, {"joint": "slide", "to": ends[0]}, {"joint": "paddle", "to": 0.0}],
    )
    task["task"]["mechanism"]["handle"]["place"] = list(place)
    found = read_given_mechanism(parse_request(task).task.mechanism)
    names = [joint.name for joint in found.mechanism.joints]
    pulled = preload + stiffness * ends[1]
    expected = {
        "move paddle": {"paddle": [pulled + 0.2]},
        "move slide": {"slide": [30.0], "paddle": [pulled] if pulled > 0.2 else []},  # else its friction holds it
        # With the spring, less friction; the last bit against friction, where that outweighs the preload.
        "move paddle 2": {"paddle": [size for size in (pulled - 0.2,) if size > 0.0]},
    }
    if preload < 0.2:
        expected["move paddle 2"]["paddle"].append(preload - 0.2)

    def locate(link: str, values: np.ndarray) -> np.ndarray:
        return found.locate(next(joint.name for joint in found.mechanism.joints if joint.link == link), values)

    for spec in make_mechanism_phases(found, HANDS["left"]):
        for load in spec.loads:
            joint = next(joint.name for joint in found.mechanism.joints if joint.link == load.link)
            column, step = names.index(joint), 1e-6
            at = spec.first
            moved = [at + sign * step * np.eye(len(names))[column] for sign in (1.0, -1.0)]
            ahead, behind = ((locate(load.link, v) @ [*load.place, 1.0])[:3] for v in moved)
            force = locate(load.link, at)[:3, :3] @ load.force
            work = float(force @ (ahead - behind)) / (2.0 * step)
            assert work == pytest.approx(expected[spec.name][joint].pop(0), rel=1e-6, abs=1e-6)
            # It acts where the hand is.
            hand = (locate(found.handle.link, at) @ [*found.handle.place, 1.0])[:3]
            np.testing.assert_allclose((locate(load.link, at) @ [*load.place, 1.0])[:3], hand, atol=1e-9)
    assert not any(sizes for joints in expected.values() for sizes in joints.values())


def test_too_many_loads_at_once_are_refused() -> None:
    links = [f'<link name="l{k}">{box((0.05, 0.05, 0.05), (0.1, 0, 0))}</link>' for k in range(6)]
    joints = [
        f'<joint name="j{k}" type="prismatic"><parent link="{f"l{k - 1}" if k else "root"}"/><child link="l{k}"/>'
        '<axis xyz="1 0 0"/><limit lower="0" upper="1" velocity="1" effort="1"/></joint>'
        for k in range(6)
    ]
    text = f'<robot name="stack"><link name="root"/>{"".join(links + joints)}</robot>'
    request = drawer_request(
        urdf=text,
        handle={"link": "l5", "place": [0.0, 0.0, 0.0], "axis": [0, 0, -1]},
        joints={f"j{k}": {"preload": 1.0} for k in range(6)},
        moves=[{"joint": f"j{k}", "to": 0.1} for k in range(5, -1, -1)],
        stays=True,
    )
    found = read_given_mechanism(parse_request(request).task.mechanism)
    with pytest.raises(RequestError, match=r"5 loads, one per joint and direction, in moves\[4\]; expected at most 4"):
        make_mechanism_phases(found, HANDS["left"])


@pytest.mark.parametrize(
    ("figures", "words"),
    [
        ({"slide_m": 0.26}, "figures.slide_m is 0.26, measured on the motion 0.25"),
        ({}, "figures are none; those of the motion are slide_m"),
        ({"slide_m": 0.25, "holds_n": 900.0}, "figures are slide_m, holds_n; those of the motion are slide_m"),
        ({"slide_m": 0.25, "hand_displaced_mm": 0.0}, "figures are slide_m, hand_displaced_mm; those"),
    ],
)
def test_a_figure_that_is_not_the_motion_s_is_found(
    figures: dict[str, float], words: str, drawer: tuple[PlanResult, Path]
) -> None:
    result = drawer[0]
    demand = GivenMechanismDemand(read_given_mechanism(result.request.task.mechanism), atlas())
    world = World(result.request, result.robot, result.start, result.scene)
    demands = Demands(world, MechanismDemand(demand))
    assert not list(compare_figures(result.figures, demands, result.motion))
    assert any(line.startswith(words) for line in compare_figures(figures, demands, result.motion))


def test_the_phases_move_the_mechanism_without_jumps_and_the_drawer_is_their_anchor() -> None:
    found = read_given_mechanism(parse_request(latched_request()).task.mechanism)
    for hand in HANDS.values():
        specs = make_mechanism_phases(found, hand)
        assert specs[find_anchor(specs, found.mechanism)].name == "move slide"
        for spec, after in pairwise(specs):
            np.testing.assert_array_equal(spec.last, after.first)


@pytest.mark.parametrize(
    ("phase", "expected"),
    [("approach", ["reach", "approach", "move slide", "retract"]), ("retract", ["take hold", "retract"])],
)
def test_the_rest_of_a_task_reaches_for_the_handle_only_before_it_moves_anything(
    phase: str, expected: list[str]
) -> None:
    given = read_given_mechanism(parse_request(drawer_request()).task.mechanism)
    specs = make_mechanism_phases(given, HANDS["left"])
    rest = RestTask(given.mechanism, specs, phase, lambda motion: {})
    recorded = SimpleNamespace(phases=[SimpleNamespace(name=spec.name, targets=()) for spec in specs])
    chosen, problems = rest.read_choices(recorded)
    assert ([spec.name for spec in chosen], problems) == (expected, ())


def test_the_hash_of_a_motion_that_moves_a_mechanism_is_that_which_the_operator_sees(
    drawer: tuple[PlanResult, Path],
) -> None:
    result, folder = drawer
    assert hash_motion(read_motion(read_result(folder), folder)) == result_to_message(result).trajectory.sha256
