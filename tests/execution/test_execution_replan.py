"""The rest of a plan, planned again from where its execution stands, with an adjusted target; and plans not trusted."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from shared_plans import write_undrawn
from small_plan import small_plan

from costs.scene import ConvexPiece
from perception.detect.door.geometry import DoorGeometry, HandleGeometry
from perception.detect.valve.bodies import ValveDetection
from service import parse_request, plan
from service.demands.door.demand import SeenDoor
from service.errors import ExecutionError, RequestError, ResultError
from service.execution.execution import Execution
from service.execution.machine import Order
from service.execution.replan import adjust_request, plan_rest, read_certified, write_state
from service.execution.tracking import Action, KinematicRobot, track
from service.replay.replay import verify_result
from service.result.result import Verdict
from service.setup.world import Surroundings

PERIOD = 1e-2


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("plans") / "reach"
    goal = {"link": "l_tool", "position": [0.6, 0.25, 1.05], "position_tolerance_m": 0.005}
    write_undrawn(plan(parse_request({"robot": {"name": "atlas"}, "goal": {"poses": [goal]}})), path)
    return path


@pytest.fixture(scope="module")
def reference(folder):
    return read_certified(folder)


def start(reference):
    return Execution(reference, KinematicRobot(reference.joint_names, reference.at(0.0).q, PERIOD))


def test_an_adjusted_goal_is_planned_again_from_its_phase_and_reached(folder, reference, tmp_path):
    state, rest, offset = tmp_path / "state.json", tmp_path / "rest", np.array([0.0, 0.03, 0.04])
    phases = []

    def replan(execution, action):
        write_state(execution, state)
        phases.append(execution.reference.phases[execution.state.phase].name)
        return plan_rest(folder, phases[0], state, {action.link: action.offset}, rest)

    execution = start(reference)
    report = track(execution, [Action(0.5, link="l_tool", offset=offset, plans=True)], replan=replan)
    assert report.verdict == "TRACKED"
    assert phases == [reference.phases[0].name]
    data = reference.robot.model.createData()
    pin.framesForwardKinematics(reference.robot.model, data, execution.command.q)
    tool = data.oMf[reference.robot.model.getFrameId("l_tool")].translation
    np.testing.assert_allclose(tool, np.array([0.6, 0.25, 1.05]) + offset, atol=6e-3)
    assert verify_result(rest)["verdict"] == "CERTIFIED"
    saved = json.loads(state.read_text())
    assert set(saved["joints"]) == set(reference.joint_names)


def test_the_state_of_a_robot_that_moves_is_not_written(reference, tmp_path):
    execution = start(reference)
    for _ in range(30):
        execution.step()
    with pytest.raises(ExecutionError, match="moves; pause it"):
        write_state(execution, tmp_path / "state.json")
    execution.give(Order.PAUSE)
    for _ in range(50):
        execution.step()
    write_state(execution, tmp_path / "state.json")
    base = json.loads((tmp_path / "state.json").read_text())["base"]
    np.testing.assert_allclose(base["position"], execution.command.q[:3])


def test_without_a_certified_plan_nothing_is_written_and_the_execution_stays_paused(
    folder, reference, tmp_path, monkeypatch
):
    execution, phase, rest = start(reference), reference.phases[0].name, tmp_path / "rest"
    execution.give(Order.PAUSE)
    for _ in range(60):
        execution.step()
    write_state(execution, tmp_path / "state.json")

    def fail(request, **_):
        return replace(plan(request), verdict=Verdict.NOT_FOUND, explanation=("the arm is too short",))

    monkeypatch.setattr("service.execution.replan.plan", fail)
    with pytest.raises(ExecutionError, match=f"no new plan from '{phase}' on: NOT_FOUND, the arm is too short"):
        plan_rest(folder, phase, tmp_path / "state.json", {}, rest)
    assert not rest.exists()
    assert execution.is_at_rest


def test_a_valve_given_by_its_circle_is_displaced():
    request = parse_request(
        {
            "robot": {"name": "atlas"},
            "task": {"valve": {"centre": [0.7, 0.1, 1.1], "axis": [-1, 0, 0], "radius": 0.12}},
        }
    )
    moved, around = adjust_request(request, None, "valve", np.array([0.01, 0.0, -0.02]))
    np.testing.assert_allclose(moved.task.valve.centre, [0.71, 0.1, 1.08])
    assert around is None
    assert replace(moved, task=request.task) == request


def test_a_valve_of_the_scan_is_displaced_with_its_stem():
    centre, axis = np.array([0.7, 0.0, 1.1]), np.array([-1.0, 0.0, 0.0])
    valve = ValveDetection(centre, axis, 0.2, 0.21, 0.01, 0.01, (0.0,), 0.03, (0.0, 0.0), 0.9, 0.001, 500)
    corners = centre + np.array([[0.1, 0.0, 0.0], [0.2, 0.0, 0.0], [0.1, 0.02, 0.0], [0.1, 0.0, 0.02]])
    wall, stem = ConvexPiece("wall", corners + 0.3, "wall"), ConvexPiece("stem", corners, "stem")
    request = parse_request({"robot": {"name": "atlas"}, "scene": {"cloud": "scan.pcd"}, "task": {"valve": {}}})
    offset = np.array([0.0, 0.01, -0.005])
    same, moved = adjust_request(request, Surroundings((wall, stem), (valve,)), "valve", offset)
    assert same == request
    np.testing.assert_allclose(moved.valves[0].centre, centre + offset)
    assert moved.pieces[0] == wall
    np.testing.assert_allclose(moved.pieces[1].vertices, corners + offset)


def test_a_given_door_is_displaced_with_its_handle():
    leaf = {"hinge": [0.9, 0.5, 0.0], "edge": [0.9, -0.4, 0.0]}
    door = {"opens": "push", "leaf": leaf, "handle": {"kind": "lever", "centre": [0.85, -0.3, 1.0]}}
    request = parse_request({"robot": {"name": "atlas"}, "task": {"door": door}})
    moved, _ = adjust_request(request, None, "door", np.array([0.01, 0.02, 0.0]))
    for now, before in (
        (moved.task.door.leaf.hinge, leaf["hinge"]),
        (moved.task.door.leaf.edge, leaf["edge"]),
        (moved.task.door.handle.centre, [0.85, -0.3, 1.0]),
    ):
        np.testing.assert_allclose(np.subtract(now, before), [0.01, 0.02, 0.0], atol=1e-12)
    with pytest.raises(RequestError, match="no target 'valve'"):
        adjust_request(request, None, "valve", np.array([0.01, 0.0, 0.0]))


def test_a_door_of_the_scan_is_displaced_with_its_handle():
    seen = DoorGeometry(
        hinge=np.zeros(3),
        along=np.array([0.0, 1.0, 0.0]),
        normal=np.array([-1.0, 0.0, 0.0]),
        face=0.0,
        width=0.9,
        height=2.0,
        thickness=0.04,
        opens="push",
        handle=HandleGeometry("lever", np.array([-0.05, 0.8, 1.0]), np.array([0.0, -1.0, 0.0]), 0.12, 0.01),
    )
    request = parse_request({"robot": {"name": "atlas"}, "scene": {"cloud": "scan.pcd"}, "task": {"door": {}}})
    around = Surroundings((), (), doors=(SeenDoor(seen, 0.9),))
    same, moved = adjust_request(request, around, "door", np.array([0.0, 0.01, 0.0]))
    assert same == request
    np.testing.assert_allclose(moved.doors[0].geometry.hinge, [0.0, 0.01, 0.0])
    np.testing.assert_allclose(moved.doors[0].geometry.handle.centre, [-0.05, 0.81, 1.0])


@pytest.mark.parametrize(
    ("goal", "target", "message"),
    [
        ({"joints": {"l_arm_elx": 1.0}}, "l_tool", "only poses of a goal, valves and doors can be"),
        ({"poses": [{"link": "l_tool", "position": [0.6, 0.2, 1.0]}]}, "r_tool", "expected l_tool"),
    ],
)
def test_a_target_that_the_request_does_not_have_is_refused(goal, target, message):
    request = parse_request({"robot": {"name": "atlas"}, "goal": goal})
    with pytest.raises(RequestError, match=message):
        adjust_request(request, None, target, np.array([0.01, 0.0, 0.0]))


def test_a_folder_that_was_changed_is_not_carried_out(folder, tmp_path):
    changed = tmp_path / "changed"
    shutil.copytree(folder, changed)
    data = json.loads((changed / "result.json").read_text())
    data["curve"]["positions"][1][10] += 0.2
    (changed / "result.json").write_text(json.dumps(data))
    with pytest.raises(ResultError) as caught:
        read_certified(changed)
    assert "changed" in str(caught.value)


def test_a_plan_without_time_law_is_not_carried_out(tmp_path):
    path = tmp_path / "untimed"
    request = {"robot": {"name": "atlas"}, "goal": {"joints": {"l_arm_elx": 1.2}}, "options": {"timed": False}}
    write_undrawn(plan(parse_request(request)), path)
    with pytest.raises(ResultError, match="no time law") as caught:
        read_certified(path)
    assert "\n" not in str(caught.value)


def test_a_robot_without_efforts_is_refused_in_one_line():
    from service.execution.reference import PlannedReference

    motion = small_plan().motion
    effort = motion.robot.effort.copy()
    effort[8] = np.inf
    with pytest.raises(ResultError, match="has no effort limit") as caught:
        PlannedReference(replace(motion, robot=replace(motion.robot, effort=effort)))
    assert "\n" not in str(caught.value)
