"""Where nothing is found, the demands that stand against each other are named: links, obstacles, joints, metres."""

import dataclasses
import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from planar_arm import write_planar_arm
from small_plan import small_plan
from small_robots import box
from tiny_robots import atlas

from costs.kinematics import locate_links
from costs.robot import load_robot
from costs.scene import Scene
from costs.terms import JointTarget
from scopt import Constraint, Sense, Settings
from service.body.aims import Aims
from service.body.monitor import Monitor
from service.body.paths import straight_path
from service.body.phases import PhaseSolver
from service.body.poses import find_pose
from service.body.task_plan import LEAST_CLEARANCE
from service.body.whole_body import CLEARANCE_TERMS, WholeBody
from service.explain.conflict import Conflict, Demand, DemandKind, FilterOutcome
from service.explain.narrow import explain
from service.planner import _explain, plan
from service.request.file import parse_request
from service.request.tasks.reach import GoalRequest, PoseGoalRequest
from service.result.attempt import list_shortfalls
from service.result.result import Verdict
from service.result.result_json import summary_json
from service.start.standing import FEET_GROUP
from service.tasks.reach.goal import Goal
from service.verify import Status, verify

# 30 mm between them for an arm of 40 mm: it is 5 mm deep in either, or deeper in one.
WALLS = (box("left wall", (0.3, 0.515, 0.0), (0.02, 0.5, 0.1)), box("right wall", (0.3, -0.515, 0.0), (0.02, 0.5, 0.1)))
STRETCHED = np.array([1.2, -1.8, 0.6, 0.0])  # through the gap, as far as it can


def stuck(body, link, position, guess=None):
    """The best attempt to bring a link to a place, which must have failed."""
    goal = Goal.of(body, GoalRequest(poses=(PoseGoalRequest(link, position),)))
    start = body.nominal if guess is None else guess
    solver = PhaseSolver(body, Monitor(60.0), Settings())
    solved = find_pose(solver.pose_problem("goal pose", goal.constraints(0)), [("start", start)])
    assert not solved.is_feasible
    return solved


def arm_behind(folder, *pieces, n_links=4, start=(1.2, -2.4, 2.4, 1.2), limit=3.0):
    """An arm of links 0.2 m long and 40 mm thick."""
    robot = load_robot(urdf=write_planar_arm(folder, n_links, 0.2, 0.04, limit=limit))
    return WholeBody.standing(robot, Scene(pieces), np.array(start), (), Aims())


def standing_atlas(**aims):
    robot = atlas()
    feet = robot.link_groups[FEET_GROUP]
    return WholeBody.standing(robot, Scene(), robot.postures["stand"], feet, Aims(**aims))


def by_name(conflict):
    return {demand.name: demand for demand in conflict.demands}


def test_a_gap_narrower_than_the_arm_names_both_of_its_sides_and_the_link_between_them(tmp_path):
    body = arm_behind(tmp_path, *WALLS)
    conflict = explain("goal pose", stuck(body, "l3", (0.36, 0.0, 0.0), STRETCHED), 1, Settings(), time_limit_s=60.0)
    assert conflict.search is FilterOutcome.REDUCED
    found = by_name(conflict)
    assert set(found) == {"left wall", "right wall", "position of l3"}
    assert all(demand.is_decisive for demand in found.values())
    walls = [found["left wall"], found["right wall"]]
    assert all(demand.links == ("l2",) for demand in walls)
    assert sum(demand.shortfall for demand in walls) == pytest.approx(0.01 + 2 * 0.005, abs=1e-3)
    lines = conflict.sentences()
    assert lines[0] == "goal pose: the one attempt failed; at its end, 3 demands conflict:"
    assert [line[:-1] for line in lines[1:4]] == [demand.text for demand in conflict.demands]
    assert {demand.text for demand in walls} == {"l2 is 5 mm inside right wall", "l2 is 5 mm inside left wall"}
    assert found["position of l3"].text == "position of l3 is only just kept"
    assert lines[4].startswith("Without any one of them everything else was kept. ")
    assert lines[4].endswith("it does not prove that there is no motion.")


def test_what_pulls_the_robot_where_it_is_stuck_is_named_even_if_it_is_not_loaded_most(tmp_path):
    # the caller wants what no joint can do, and the arm folds into itself on the way there
    body = arm_behind(tmp_path, n_links=3, start=(-1.0, 0.4, 0.0))
    end = np.array([1.0, 0.4, 0.0])
    nowhere = Constraint("nowhere", JointTarget(8, 3, [3], np.arange(3), np.full(3, 9.0)), Sense.EQUAL_ZERO)
    solver = PhaseSolver(body, Monitor(60.0), Settings())
    line = straight_path(body.nominal, end, 8)
    solved = solver.solve_trajectory("reach", line, {0: body.nominal, 7: end}, constraints=[nowhere])
    assert not solved.is_feasible
    found = by_name(explain("reach", solved, 1, Settings(), time_limit_s=60.0))
    assert found["nowhere"].is_decisive
    assert found["nowhere"].waypoints == (3, 3)


def test_a_target_beyond_balance_names_balance_and_position_and_where_the_robot_stands():
    body = standing_atlas(balance_margin=0.1)
    conflict = explain("goal pose", stuck(body, "l_tool", (1.25, 0.2, 1.1)), 3, Settings(), time_limit_s=60.0)
    found = by_name(conflict)
    assert set(found) == {"position of l_tool", "balance"}
    assert all(demand.is_decisive for demand in found.values())
    assert found["balance"].shortfall + found["position of l_tool"].shortfall > 0.05
    head, *clauses, _ = conflict.sentences()
    assert head == (
        "goal pose, standing on l_foot and r_foot: all 3 attempts failed; at the end of the best, 2 demands conflict:"
    )
    assert any("m short of its balance margin" in clause for clause in clauses)


def test_a_joint_limit_is_named_with_its_value(tmp_path):
    # with joints of +-0.3 rad the arm cannot come round to the side
    body = arm_behind(tmp_path, n_links=3, start=(0.0, 0.1, 0.1), limit=0.3)
    conflict = explain("goal pose", stuck(body, "l2", (0.2, 0.3, 0.0)), 1, Settings(), time_limit_s=60.0)
    found = by_name(conflict)
    assert set(found) == {"joint limits", "position of l2"}
    assert found["joint limits"].joints[0] == "j0"
    assert "j0 is at its upper limit of 0.300 rad" in found["joint limits"].text
    assert all(demand.is_decisive for demand in found.values())


def test_a_pillar_between_fixed_ends_is_named_with_waypoints(tmp_path):
    fence = box("fence", (-0.12, 0.0, 0.0), (0.05, 0.25, 0.1))
    pillar = box("pillar", (0.25, 0.0, 0.0), (0.1, 0.05, 0.1))
    body = arm_behind(tmp_path, pillar, fence, n_links=3, start=(-1.0, 0.0, 0.0))
    end = np.array([1.0, 0.0, 0.0])
    solver = PhaseSolver(body, Monitor(60.0), Settings())
    solved = solver.solve_trajectory("reach", straight_path(body.nominal, end, 8), {0: body.nominal, 7: end})
    assert not solved.is_feasible
    conflict = explain("reach", solved, 1, Settings(), time_limit_s=60.0)
    (demand,) = conflict.demands
    assert demand.name == "pillar"
    assert demand.is_decisive
    first, last = demand.waypoints
    assert last == first + 1
    assert f"inside pillar between waypoints {first} and {last}" in demand.text
    assert conflict.sentences()[0].endswith("at its end, one demand is not met:")


def test_a_pair_of_links_is_named_by_both(tmp_path):
    # three links that close a triangle: the end of the third cannot be where the first begins, as thick as they are
    body = arm_behind(tmp_path, start=(0.0, 1.8, 1.8, 0.0))
    conflict = explain("goal pose", stuck(body, "l3", (0.0, 0.0, 0.0)), 1, Settings(), time_limit_s=60.0)
    pair = next(demand for demand in conflict.demands if demand.kind is DemandKind.LINKS)
    assert pair.name == "l0 and l2"
    assert set(pair.links) == {"l0", "l2"}


def test_demands_given_up_one_at_a_time_leave_a_problem_that_is_solved(tmp_path):
    """The filter's claim, checked by solving anew without each demand from the start."""
    for left in range(2):
        body = arm_behind(tmp_path, WALLS[left])
        goal = Goal.of(body, GoalRequest(poses=(PoseGoalRequest("l3", (0.36, 0.0, 0.0)),)))
        solver = PhaseSolver(body, Monitor(60.0), Settings())
        problem = solver.pose_problem("goal pose", goal.constraints(0))
        assert find_pose(problem, [("stretched", STRETCHED)]).is_feasible


def test_without_time_demands_are_ranked_and_it_is_said(tmp_path):
    solved = stuck(arm_behind(tmp_path, *WALLS), "l3", (0.36, 0.0, 0.0), STRETCHED)
    conflict = explain("goal pose", solved, 2, Settings(), time_limit_s=0.0)
    assert conflict.search is FilterOutcome.CUT_SHORT
    assert conflict.n_solves == 0
    assert {"left wall", "right wall"} <= set(by_name(conflict))
    assert conflict.sentences()[-1].startswith("There was no time to find out which of them to give up.")
    stopped = explain("goal pose", solved, 2, Settings(), time_limit_s=60.0, should_stop=lambda: True)
    assert stopped.search is FilterOutcome.CUT_SHORT


def test_a_search_cut_short_tells_after_which_time_and_what_was_found_by_then():
    found = conflict_of(None, None, search=FilterOutcome.CUT_SHORT)
    assert (
        replace(found, cut_short_after_s=9.96)
        .sentences()[-1]
        .startswith("Which of them to give up was not determined within 10.0 s. ")
    )
    found = conflict_of(None, True, search=FilterOutcome.CUT_SHORT)
    assert (
        replace(found, cut_short_after_s=17.8)
        .sentences()[-1]
        .startswith(
            "Without box 1 everything else was kept; "
            "whether that holds for the others was not determined within 17.8 s. "
        )
    )


@pytest.mark.parametrize(
    ("limit_s", "searched_s", "spent_s"), [(60.0, 18.0, 18.0), (900.0, 177.0, 60.0), (60.0, 1.0, 10.0), (6.0, 5.0, 1.0)]
)
def test_an_explanation_may_take_as_long_as_the_search_within_what_is_left(monkeypatch, limit_s, searched_s, spent_s):
    given = []
    monkeypatch.setattr("service.explain.narrow.explain", lambda *terms: given.append(terms[4]))
    times = iter([1000.0 - searched_s])
    monitor = Monitor(limit_s, clock=lambda: next(times, 1000.0))
    task = SimpleNamespace(stuck=SimpleNamespace(step="reach", best=None))
    _explain(SimpleNamespace(task=task, conflict=None), SimpleNamespace(monitor=monitor, settings=None))
    assert given == [pytest.approx(spent_s)]


def test_equal_problems_are_explained_equally(tmp_path):
    solved = stuck(arm_behind(tmp_path, *WALLS), "l3", (0.36, 0.0, 0.0), STRETCHED)
    first, second = (explain("goal pose", solved, 1, Settings(), time_limit_s=60.0) for _ in range(2))
    assert first == second


def conflict_of(*decisive, search=FilterOutcome.REDUCED, attempts=4):
    demands = tuple(
        Demand(DemandKind.OBSTACLE, f"box {k}", 1.0, 0.01, "m", f"l{k} is in box {k}", is_decisive=is_decisive)
        for k, is_decisive in enumerate(decisive)
    )
    return Conflict("reach", attempts, (), demands, search, 5)


@pytest.mark.parametrize(
    ("conflict", "learnt"),
    [
        (conflict_of(True), "Without it everything else was kept."),
        (conflict_of(True, True), "Without either of them everything else was kept."),
        (conflict_of(True, True, True), "Without any one of them everything else was kept."),
        (conflict_of(True, False, True), "Without box 0 or without box 2 everything else was kept."),
        (conflict_of(False), "Giving up it is not enough: constraints that are not listed then fail."),
        (conflict_of(False, False), "Giving up any of them is not enough: constraints that are not listed then fail."),
        (conflict_of(None, None, search=FilterOutcome.NO_HELP), "Giving them up did not help within a few steps."),
        (
            conflict_of(None, search=FilterOutcome.GIVES_WAY),
            "With nothing else required, all of it was kept there: more options.starts may help.",
        ),
    ],
)
def test_what_was_learnt_is_said(conflict, learnt):
    assert conflict.sentences()[-1] == f"{learnt} This was met there; it does not prove that there is no motion."


def test_a_conflict_is_json_and_keeps_its_figures():
    conflict = conflict_of(True, False)
    data = json.loads(json.dumps(conflict.to_dict(), allow_nan=False))
    assert data["search"] == "reduced"
    assert data["attempts"] == 4
    assert [demand["name"] for demand in data["demands"]] == ["box 0", "box 1"]
    assert [demand["is_decisive"] for demand in data["demands"]] == [True, False]
    assert set(data["demands"][0]) == {field.name for field in dataclasses.fields(Demand)}


def test_a_plan_that_finds_nothing_tells_the_conflict_in_words_and_in_its_file(tmp_path):
    urdf = write_planar_arm(tmp_path, 3, 0.2, 0.04, limit=3.0)
    boxes = ({"name": "fence", "position": [-0.12, 0, 0], "size": [0.1, 0.5, 0.2]},
             {"name": "pillar", "position": [0.25, 0, 0], "size": [0.2, 0.1, 0.2]})  # fmt: skip
    result = plan(
        parse_request(
            {
                "robot": {"urdf": str(urdf)},
                "scene": {"obstacles": [{"type": "box", **one} for one in boxes], "floor": False},
                "start": {"joints": {"j0": -1.0}},
                "goal": {"joints": {"j0": 1.0, "j1": 0.0, "j2": 0.0}},
                "options": {"starts": 1},
            }
        )
    )
    assert result.verdict is Verdict.NOT_FOUND
    assert result.explanation == result.conflict.sentences()
    assert [demand.name for demand in result.conflict.demands] == ["pillar"]
    written = summary_json(result)["conflict"]
    assert written["step"] == "reach"
    assert written["demands"][0]["links"][0] == "l1"
    json.dumps(written, allow_nan=False)


def test_what_costs_and_margins_keep_from_being_found_is_found_without_them():
    body = standing_atlas()
    solved = stuck(body, "l_tool", (1.245, 0.2, 1.1))
    solver = PhaseSolver(body, Monitor(60.0), Settings())
    last = solver.restore_feasibility("goal pose", solved)
    assert last.is_feasible
    assert solver.monitor.count_attempts("goal pose") == 1
    tool = locate_links(body.engine, last.x[0], ["l_tool"])["l_tool"][:3, 3]
    np.testing.assert_allclose(tool, (1.245, 0.2, 1.1), atol=1.1e-3)
    state = solved.problem.state(last.x)
    assert state.contacts.distance[state.contacts.margin > 0.0].min() >= LEAST_CLEARANCE
    for constraint in solved.problem.constraints:
        if constraint.name not in CLEARANCE_TERMS:
            short = constraint.measure_violation(constraint.residual.value(state))
            assert short.max(initial=0.0) <= constraint.tolerance, constraint.name
    beyond = stuck(body, "l_tool", (0.3, 0.2, 2.4))
    assert solver.restore_feasibility("goal pose", beyond) is beyond


def test_what_could_not_be_proven_is_told_with_its_time():
    motion = small_plan().motion
    barefoot = replace(motion, phases=tuple(replace(phase, allowances=()) for phase in motion.phases))
    certificate = verify(barefoot)  # feet that touch the floor, which nothing proves to stay out of it
    assert certificate.status is Status.FEASIBLE_AT_SAMPLES
    lines = list_shortfalls(certificate)
    assert {line.split(" not shown")[0] for line in lines} == {
        "clearance of l_foot and floor",
        "clearance of r_foot and floor",
    }
    assert all(line.endswith(" s)") for line in lines)
    assert list_shortfalls(small_plan().certificate) == ()
