"""The ladder of starts, and the search for poses, on small problems whose outcome is known."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import chain, islice, pairwise, repeat
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from planar_arm import write_planar_arm

from costs.robot import load_robot
from costs.scene import ConvexPiece, Scene
from scopt import Settings
from service.body.aims import Aims
from service.body.effort import Effort
from service.body.ladder import GivenEnd, MotionSearch, NoEnd, find_motion, list_motions
from service.body.monitor import Monitor
from service.body.phases import PhaseSolver
from service.body.poses import PoseProblem, Poses, find_pose
from service.body.starts import (
    BETWEEN_POSES,
    MOST_ARM_JOINTS,
    MOST_CHECKS,
    POLICIES,
    WIDE,
    Policy,
    RobotClass,
    Start,
    Way,
    choose_policy,
)
from service.body.whole_body import WholeBody

CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
POST = ConvexPiece("post", 0.1 * CORNERS + [0.5, 0.0, 0.0])


def make_solver(folder: Any, *pieces: ConvexPiece, n_joints: int = 2, **options: Any) -> PhaseSolver:
    """A planar arm at -0.9 rad among pieces."""
    robot = load_robot(urdf=write_planar_arm(folder, n_joints, 0.3, 0.03, limit=2.9))
    start = np.zeros(n_joints)
    start[0] = -0.9
    body = WholeBody.standing(robot, Scene(pieces), start, (), Aims())
    return PhaseSolver(body, Monitor(60.0), Settings(), **options)


def solve(solver: PhaseSolver, path: np.ndarray) -> Any:
    return solver.solve_trajectory("turn", path, {0: path[0], len(path) - 1: path[-1]})


def make_search(solver: PhaseSolver, **options: Any) -> MotionSearch:
    first = solver.body.nominal
    return MotionSearch("turn", solver, solve, first, GivenEnd(-first), choose_policy(solver.body.robot), **options)


def test_a_free_way_is_straight_and_nothing_else_is_tried(tmp_path):
    solver = make_solver(tmp_path)
    assert find_motion(make_search(solver)).is_feasible
    assert [tried.start for tried in solver.monitor.tried] == ["straight line"]


def test_every_start_that_was_tried_is_recorded_with_its_cost(tmp_path):
    solver = make_solver(tmp_path, POST)
    found = find_motion(make_search(solver))
    assert found.is_feasible
    tried = solver.monitor.tried
    assert tried[0].start == "straight line"
    assert not tried[0].is_feasible
    assert tried[-1].start == "path of LBKPIECE1, tree 1"
    assert tried[-1].is_feasible
    assert all(attempt.step == "turn" and attempt.cpu_s > 0.0 and attempt.n_steps > 0 for attempt in tried)
    assert sum(attempt.n_steps for attempt in tried) == sum(len(steps) for _, steps in solver.monitor.history)


def test_a_path_that_the_phase_knows_comes_before_all_others(tmp_path):
    solver = make_solver(tmp_path)
    known = np.linspace(solver.body.nominal, -solver.body.nominal, 5)
    search = replace(make_search(solver), policy=BETWEEN_POSES, paths={Way.KNOWN: lambda: (("before", known),)})
    name, solved = next(list_motions(search))
    assert name == "before"
    assert len(solved.x) == 5


def test_a_motion_without_an_end_has_only_the_paths_of_its_phase(tmp_path):
    solver = make_solver(tmp_path)
    first = solver.body.nominal
    still = np.tile(first, (4, 1))
    search = MotionSearch("rest", solver, solve, first, NoEnd(), paths={Way.GIVEN: lambda: (("still", still),)})
    assert [name for name, _ in list_motions(search)] == ["still"]
    with pytest.raises(ValueError, match="rest: at least one start is needed"):
        find_motion(replace(search, paths={}))


def test_the_number_of_starts_is_limited_and_a_restoration_is_none(tmp_path):
    solver = make_solver(tmp_path, POST, most_starts=1)
    restored = list(list_motions(make_search(solver, restorable=np.inf)))
    assert [name for name, _ in restored] == ["straight line", "straight line"]
    assert [name for name, _ in list_motions(make_search(solver))] == ["straight line"]


def test_rounds_end_when_the_time_for_the_explanation_begins(tmp_path):
    solver = make_solver(tmp_path, POST)
    rows = tuple(Start(Way.STRAIGHT, Effort.NONE) for _ in range(3))
    search = replace(make_search(solver), policy=Policy(rows[:1], rows))
    assert len(list(islice(list_motions(search), 7))) == 7  # there is time for two rounds
    times = chain([0.0], repeat(95.0))
    late = replace(solver, monitor=Monitor(100.0, clock=lambda: next(times)))
    assert len(list(islice(list_motions(replace(search, solver=late)), 7))) == 2  # the start of a round is the last


def test_trees_grow_from_round_to_round_and_each_has_a_seed_of_its_own():
    policy = POLICIES[RobotClass.ARM]
    starts = list(islice(policy.list_starts(), len(policy.once) + 12 * len(policy.rounds)))
    trees = [(number, start.tree) for number, start in starts if start.tree is not None]
    assert [tree.seed for _, tree in trees] == list(range(len(trees)))
    wide = [tree.most_checks for number, tree in trees if tree.clearance == WIDE.clearance and tree.edge_step == 0.05]
    assert all(one <= other for one, other in pairwise(wide))
    assert wide[:2] == [WIDE.most_checks, WIDE.most_checks]
    assert wide[-1] == MOST_CHECKS


@pytest.mark.parametrize(("n_joints", "kind"), [(MOST_ARM_JOINTS, "ARM"), (MOST_ARM_JOINTS + 1, "ARM_ON_BASE")])
def test_the_policy_follows_from_the_number_of_joints(tmp_path, n_joints, kind):
    robot = load_robot(urdf=write_planar_arm(tmp_path, n_joints, 0.3, 0.03, limit=2.9))
    assert choose_policy(robot) is POLICIES[RobotClass[kind]]


def test_a_robot_on_its_feet_tries_trees_last():
    policy = choose_policy(load_robot("atlas"))
    assert policy is POLICIES[RobotClass.STANDING]
    ways = [start.way for start in policy.once]
    assert Way.TREE not in ways[: ways.index(Way.TREE)]
    assert set(ways[ways.index(Way.TREE) :]) == {Way.TREE}


def test_an_effort_changes_what_it_names_and_nothing_else():
    settings = Settings(max_iterations=33, penalty=7.0)
    assert Effort.WHOLE.apply(settings) == settings
    assert Effort.NONE.apply(settings) == replace(settings, max_iterations=0)


def make_pose(q: float, shortfall: float) -> Any:
    result = SimpleNamespace(history=())
    return SimpleNamespace(q=np.array([q]), is_feasible=shortfall == 0.0, shortfall=shortfall, result=result)


def list_seeds(*values: float) -> Iterator[tuple[str, float]]:
    return ((f"seed {value:g}", value) for value in values)


def test_the_first_feasible_pose_ends_the_search():
    monitor = Monitor(60.0)
    problem = PoseProblem("pose", lambda seed: make_pose(seed, max(3.0 - seed, 0.0)), monitor)
    assert find_pose(problem, list_seeds(1.0, 4.0, 5.0)).q == 4.0
    assert [(tried.start, tried.is_feasible) for tried in monitor.tried] == [("seed 1", False), ("seed 4", True)]


def test_without_a_feasible_pose_the_nearest_miss_is_returned():
    problem = PoseProblem("pose", lambda seed: make_pose(seed, seed))
    assert find_pose(problem, list_seeds(3.0, 1.0, 2.0)).q == 1.0
    assert find_pose(replace(problem, most=1), list_seeds(3.0, 1.0)).q == 3.0
    with pytest.raises(ValueError, match="at least one start"):
        find_pose(problem, ())


def test_poses_that_are_alike_count_once():
    poses = Poses(PoseProblem("pose", lambda seed: make_pose(seed, 0.0)), apart=0.5)
    assert [float(pose.q[0]) for pose in poses.find(list_seeds(1.0, 1.2, 2.0))] == [1.0, 2.0]
    assert not poses.is_new(np.array([2.4]))


def test_a_pose_is_what_its_problem_accepts():
    problem = PoseProblem("pose", lambda seed: make_pose(seed, 0.0), accepts=lambda pose: pose.q[0] > 1.5)
    assert find_pose(problem, list_seeds(1.0, 2.0)).q == 2.0
