"""Subproblems recorded from whole-body problems: every back end solves them alike, in stage order."""

from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from convex_distance import box
from tiny_robots import SPATIAL, atlas, chain

from costs.robot import RobotModel
from costs.scene import ConvexPiece, Scene
from costs.terms import AxisDirection, FramePose, JointDifference
from scopt import Constraint, Cost, Penalty, Sense
from scopt.convex_model import assemble, convexify
from scopt.qp import BACKENDS, select_backend
from service.body.aims import Aims
from service.body.whole_body import WholeBody

N_ITERATIONS = 3
N_WAYPOINTS = 6
TRUST_RADIUS = 0.2
OPTIMALITY = 1e-5  # relative objective by which back ends may differ


def boxes(robot: RobotModel) -> Scene:
    """A floor, and boxes that the motions of these tests pass closely."""
    if not robot.is_floating:
        return Scene((ConvexPiece("post", box([0.55, 0.3, 0.5], [0.1, 0.1, 0.6])),))
    return Scene(
        (
            ConvexPiece("floor", box([0.0, 0.0, -0.05], [4.0, 4.0, 0.1]), "floor"),
            ConvexPiece("table", box([0.75, 0.0, 0.8], [0.6, 1.2, 0.04])),
            ConvexPiece("lamp", box([0.5, 0.4, 1.2], [0.1, 0.1, 0.5])),
        )
    )


def problem_of(robot: RobotModel, order: int):
    """Feet, balance, collision and a pose at the end; differences of this order make rows span more waypoints."""
    start = robot.postures["stand"] if robot.is_floating else np.array([0.2, 0.1, 0.0, 0.3])
    feet = ("l_foot", "r_foot") if robot.is_floating else ()
    frame = "l_tool" if robot.is_floating else "tip"
    body = WholeBody.standing(robot, boxes(robot), start, feet, Aims())
    target = np.eye(4)
    target[:3, 3] = [0.6, 0.3, 1.1] if robot.is_floating else [0.5, 0.5, 0.3]
    last = [N_WAYPOINTS - 1]
    reach = FramePose(robot, frame, last, target, (True,) * 3 + (False,) * 3)
    axis = AxisDirection(robot, frame, last, np.array([1.0, 0.0, 0.0]), np.array([1.0, 0.5, 0.0]))
    smooth = JointDifference(N_WAYPOINTS, np.ones(robot.n), order)
    problem = body.make_problem(
        *body.bounds(N_WAYPOINTS, {0: start}),
        body.make_checker(ends=[start]),
        costs=[Cost("smooth", smooth, 2.0), Cost("axis", axis, 0.5, Penalty.ABS)],
        constraints=[Constraint("reach", reach, Sense.EQUAL_ZERO)],
    )
    return problem, np.tile(start, (N_WAYPOINTS, 1))


@cache
def recorded(name: str, order: int):
    """(subproblem, model, step bounds) of the first iterations, each at the step the one before it took."""
    robot = atlas() if name == "atlas" else chain(SPATIAL)
    problem, x = problem_of(robot, order)
    records = []
    for iteration in range(N_ITERATIONS):
        model = convexify(problem, problem.state(x), 10.0**iteration)
        subproblem = assemble(model, (problem.upper > problem.lower).ravel())
        lower = np.maximum(problem.lower - x, -TRUST_RADIUS).ravel()
        upper = np.minimum(problem.upper - x, TRUST_RADIUS).ravel()
        records.append((subproblem, model, lower, upper))
        step = subproblem.extract_step(select_backend("clarabel")(subproblem.bound_steps(lower, upper)).x)
        x = x + np.clip(step, lower, upper).reshape(x.shape)
    return records


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("name", ["atlas", "chain"])
def test_back_ends_agree_on_recorded_subproblems(name, order):
    for subproblem, model, lower, upper in recorded(name, order):
        program = subproblem.bound_steps(lower, upper)
        merits, steps = {}, {}
        for solver in BACKENDS:
            solution = select_backend(solver)(program)
            assert solution.is_usable, solver
            steps[solver] = np.clip(subproblem.extract_step(solution.x), lower, upper)
            merits[solver] = model.merit(steps[solver])
        assert merits["cvxpy"] < model.merit(np.zeros(len(lower)))
        for solver, merit in merits.items():
            assert merit == pytest.approx(merits["cvxpy"], rel=OPTIMALITY), solver


@pytest.mark.parametrize("order", [1, 2, 3])
@pytest.mark.parametrize("name", ["atlas", "chain"])
def test_recorded_programs_couple_neighbouring_stages_only(name, order):
    subproblem, _, lower, upper = recorded(name, order)[-1]
    program = subproblem.bound_steps(lower, upper)
    position = np.full(len(lower), -1)
    position[subproblem.is_free] = subproblem.step_index
    # the waypoints of a stage, `order` of them, stand together after its slacks
    stage = np.full(len(program.c), -1)
    for waypoint in range(N_WAYPOINTS):
        columns = position.reshape(N_WAYPOINTS, -1)[waypoint]
        stage[columns[columns >= 0]] = waypoint // order
    is_step = stage >= 0
    for column in reversed(range(len(stage) - 1)):
        if stage[column] < 0:
            stage[column] = stage[column + 1]
    for group in range(N_WAYPOINTS // order):
        steps = np.flatnonzero(is_step & (stage == group))
        assert not len(steps) or np.ptp(steps) == len(steps) - 1
    assert (np.diff(stage[stage >= 0]) >= 0).all()
    row, column = program.P.tocoo().coords
    assert np.abs(stage[row] - stage[column]).max() <= 1
    rows = program.G.tocsr()
    touched = [stage[rows.indices[first:last]] for first, last in pairwise(rows.indptr)]
    assert max(np.ptp(stages) for stages in touched) <= 1
    assert (np.diff([stages.max() for stages in touched]) >= 0).all()


def test_recorded_subproblems_have_rows_of_every_kind():
    for name in ("atlas", "chain"):
        _, model, _, _ = recorded(name, 2)[-1]
        assert len(model.squared.weight) > 0
        assert len(model.absolute.weight) > 0
        assert len(model.hinge.weight) > 0
        assert "collision" in model.constraint_rows
