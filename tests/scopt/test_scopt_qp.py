"""All QP back ends solve the programs of real convex models alike."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import sparse

from scopt import AffineRows, SolverError
from scopt.affine import WeightedRows
from scopt.convex_model import ConvexModel, assemble, drop_idle_rows
from scopt.qp import BACKENDS, QPStatus, QuadraticProgram, select_backend


def random_model(rng, n_waypoints, n, span):
    """A model whose rows touch up to ``span + 1`` consecutive waypoints, as those of a trajectory do."""

    def rows(m):
        first = rng.integers(0, n_waypoints - span, m)
        blocks = rng.normal(size=(m, span + 1, n)) * (rng.random((m, span + 1, n)) < 0.7)
        return WeightedRows(
            AffineRows.from_blocks(rng.normal(size=m), first, blocks, n_waypoints), rng.uniform(0.1, 20.0, m)
        )

    identity = AffineRows(rng.normal(size=n_waypoints * n), sparse.eye_array(n_waypoints * n, format="csr"))
    squared = rows(5)
    stacked = AffineRows.stack([squared.rows, identity])
    weights = np.concatenate([squared.weight, np.full(n_waypoints * n, 0.3)])
    return ConvexModel(WeightedRows(stacked, weights), rows(6), rows(7), {}, n_waypoints, n)


def best_step(model, name, lower, upper):
    problem = assemble(model, np.ones(len(lower), dtype=bool))
    solution = select_backend(name)(problem.bound_steps(lower, upper))
    assert solution.is_usable
    return problem.extract_step(solution.x)


@given(seed=st.integers(0, 10_000), span=st.integers(1, 3), n_waypoints=st.integers(4, 9))
def test_back_ends_agree_with_cvxpy_on_trajectory_models(seed, span, n_waypoints):
    rng = np.random.default_rng(seed)
    model = random_model(rng, n_waypoints, 3, span)
    box = np.full(n_waypoints * 3, rng.uniform(0.05, 1.0))
    merits = {name: model.merit(best_step(model, name, -box, box)) for name in BACKENDS}
    for name, merit in merits.items():
        assert merit == pytest.approx(merits["cvxpy"], rel=2e-5), name


@given(seed=st.integers(0, 10_000), n_waypoints=st.integers(4, 9))
def test_back_ends_agree_with_cvxpy_where_rows_are_equalities(seed, n_waypoints):
    rng = np.random.default_rng(seed)
    model = random_model(rng, n_waypoints, 3, 1)
    is_moved = np.diff(model.absolute.rows.jacobian.indptr) > 0
    is_hard = is_moved & (rng.random(len(is_moved)) < 0.5)
    model.absolute.rows.value[is_hard] *= 1e-3  # all but met, or they could not be met in the box
    box = np.ones(n_waypoints * 3)
    subproblem = assemble(model, np.ones(len(box), dtype=bool), is_hard)
    solutions = {name: select_backend(name)(subproblem.bound_steps(-box, box)) for name in BACKENDS}
    if not solutions["cvxpy"].is_usable:
        return
    objective = subproblem.program.objective
    scale = 2e-5 * model.merit(np.zeros(len(box)))  # the objective is a difference of numbers of this size
    for name, solution in solutions.items():
        step = subproblem.extract_step(solution.x)
        np.testing.assert_allclose(model.absolute.rows.at(step)[is_hard], 0.0, atol=1e-5, err_msg=name)
        assert objective(solution.x) == pytest.approx(objective(solutions["cvxpy"].x), abs=scale), name


@given(seed=st.integers(0, 10_000), n_waypoints=st.integers(4, 9))
def test_rows_that_no_step_in_the_box_raises_above_zero_are_idle(seed, n_waypoints):
    rng = np.random.default_rng(seed)
    model = random_model(rng, n_waypoints, 3, 1)
    model.hinge.rows.value[:] -= rng.uniform(0.0, 1.0, len(model.hinge.weight))
    upper = rng.uniform(0.0, 0.5, n_waypoints * 3)
    lower = -rng.uniform(0.0, 0.5, n_waypoints * 3)
    kept = drop_idle_rows(model, lower, upper)
    corners = np.where(rng.random((20, len(upper))) < 0.5, lower, upper)
    for step in corners:
        assert kept.merit(step) == pytest.approx(model.merit(step), rel=1e-12)
    slope = model.hinge.rows.jacobian.toarray()
    most = model.hinge.rows.value + np.maximum(slope * upper, slope * lower).sum(axis=1)
    assert len(kept.hinge.weight) == (most > 0.0).sum()


def test_an_equality_is_what_a_great_penalty_comes_to():
    model = random_model(np.random.default_rng(5), 5, 3, 1)
    model.absolute.rows.value[:] *= 1e-3
    model.absolute.weight[:] = 1e4
    box, every = np.ones(15), np.ones(6, dtype=bool)
    hard = assemble(model, box > 0, every)
    soft = hard.soften()
    assert soft.program.E is None
    assert hard.program.E.shape[0] == 6
    assert len(soft.program.c) == len(hard.program.c) + 6
    steps = [p.extract_step(select_backend("clarabel")(p.bound_steps(-box, box)).x) for p in (hard, soft)]
    np.testing.assert_allclose(steps[0], steps[1], atol=1e-5)


def test_equalities_that_nothing_free_moves_are_left_out():
    model = random_model(np.random.default_rng(7), 4, 2, 1)
    is_free = np.zeros(8, dtype=bool)
    is_free[:2] = True
    touched = np.abs(model.absolute.rows.jacobian.toarray()[:, :2]).any(axis=1)
    subproblem = assemble(model, is_free, np.ones(len(touched), dtype=bool))
    assert subproblem.program.E.shape[0] == touched.sum()


@given(seed=st.integers(0, 10_000))
def test_program_objective_is_the_merit_up_to_a_constant(seed):
    rng = np.random.default_rng(seed)
    model = random_model(rng, 5, 2, 1)
    problem = assemble(model, np.ones(10, dtype=bool))

    def objective(dx):
        x = np.zeros(len(problem.program.c))
        x[problem.step_index] = dx
        is_slack = np.ones(len(x), dtype=bool)
        is_slack[problem.step_index] = False
        need = problem.program.G @ x - problem.program.h  # each row is r - slack <= 0, two rows for an absolute value
        for row, slack in zip(*np.nonzero(problem.program.G.toarray()[:, is_slack]), strict=True):
            column = np.flatnonzero(is_slack)[slack]
            x[column] = max(x[column], need[row])
        return problem.program.objective(x)

    a, b = rng.normal(size=(2, 10))
    assert objective(a) - objective(b) == pytest.approx(model.merit(a) - model.merit(b), rel=1e-9, abs=1e-9)


def test_fixed_variables_do_not_move():
    rng = np.random.default_rng(3)
    model = random_model(rng, 4, 2, 1)
    is_free = np.ones(8, dtype=bool)
    is_free[[0, 1, 6]] = False
    problem = assemble(model, is_free)
    box = np.full(8, 0.5)
    step = problem.extract_step(select_backend("clarabel")(problem.bound_steps(-box, box)).x)
    assert not step[~is_free].any()
    full = assemble(model, np.ones(8, dtype=bool))
    pinned = np.where(is_free, 0.5, 0.0)
    reference = full.extract_step(select_backend("cvxpy")(full.bound_steps(-pinned, pinned)).x)
    np.testing.assert_allclose(step, reference, atol=1e-5)


def test_an_infeasible_program_is_called_infeasible_by_all_back_ends():
    program = QuadraticProgram(
        P=sparse.eye_array(1, format="csc"),
        c=np.zeros(1),
        G=sparse.csc_array(np.array([[1.0], [-1.0]])),
        h=np.array([-1.0, -1.0]),
        lower=np.array([-5.0]),
        upper=np.array([5.0]),
    )
    for name in BACKENDS:
        assert select_backend(name)(program).status is QPStatus.INFEASIBLE, name


def test_unknown_back_end_is_refused_by_name():
    with pytest.raises(SolverError, match="unknown QP back end 'gurobi'; expected one of piqp, clarabel, cvxpy"):
        select_backend("gurobi")
