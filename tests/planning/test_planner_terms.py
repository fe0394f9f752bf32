"""Terms of the caller's own in a plan."""

from dataclasses import replace

import cvxpy
import numpy as np
import pytest
from planar_arm import write_planar_arm

from costs.state import MotionState
from scopt import Constraint, ConvexExpression, Cost, EffortClock, Residual
from service.planner import plan
from service.request.file import parse_request
from service.result.result import Verdict


@pytest.fixture
def request_of(tmp_path):
    """A three-link arm that turns with its elbow a little bent."""
    urdf = write_planar_arm(tmp_path, 3, 0.4, 0.05, 3.0)
    return parse_request(
        {
            "robot": {"urdf": str(urdf)},
            "start": {"joints": {"j0": -1.0, "j1": 0.4, "j2": 0.0}},
            "goal": {"joints": {"j0": 1.0, "j1": 0.4, "j2": 0.0}},
        }
    )


class TipRadius(Residual[MotionState]):
    """How far the last joint's axis is from the first beyond 0.5 m, one row per waypoint but the ends [m]."""

    def value(self, state):
        return np.linalg.norm(state.kinematics.position[1:-1, -1], axis=1) - 0.5


def radius(result):
    """Of the last joint's axis along the middle of the motion [m]."""
    q = result.motion.curve(np.linspace(0.35, 0.65, 30) * result.motion.curve.knots[-1])
    return 0.4 * np.hypot(1.0 + np.cos(q[:, 1]), np.sin(q[:, 1])).max()


def test_a_cost_of_which_only_the_value_is_written_changes_a_certified_plan(request_of):
    def terms(phase, robot, n_waypoints):
        return [Cost("draw in", TipRadius(), 100.0)]

    plain, drawn_in = plan(request_of), plan(request_of, terms=terms)
    assert plain.verdict is drawn_in.verdict is Verdict.CERTIFIED
    assert radius(drawn_in) < 0.6 < radius(plain)


def test_a_convex_constraint_of_the_caller_is_kept_in_every_phase(request_of):
    seen = []

    def terms(phase, robot, n_waypoints):
        seen.append((phase, robot.n, n_waypoints))
        halfway = ConvexExpression(robot.n, lambda q: cvxpy.norm(q - [0.0, 0.6, -0.5]) <= 0.05, [n_waypoints // 2])
        return [Constraint("through", halfway, tolerance=1e-3)]

    result = plan(request_of, terms=terms)
    assert result.verdict is Verdict.CERTIFIED
    q = result.motion.curve(np.linspace(0.0, result.motion.curve.knots[-1], 1001))
    assert np.linalg.norm(q - [0.0, 0.6, -0.5], axis=1).min() < 0.052
    assert {(phase, n) for phase, n, _ in seen} == {("reach", 3)}


def test_a_constraint_that_cannot_be_kept_is_the_reason_why_nothing_was_found(request_of):
    def terms(phase, robot, n_waypoints):
        return [Constraint("nowhere", ConvexExpression(robot.n, lambda q: cvxpy.norm(q - 9.0) <= 1.0, [3]))]

    options = replace(request_of.options, time_limit_s=3.0)  # which the search uses up
    result = plan(replace(request_of, options=options), terms=terms, clock=EffortClock())
    assert result.verdict is Verdict.NOT_FOUND
    assert any("nowhere is missed by" in line for line in result.explanation)


def test_what_is_no_term_is_refused(request_of):
    with pytest.raises(TypeError, match=r"must be a scopt\.Cost or a scopt\.Constraint, got TipRadius"):
        plan(request_of, terms=lambda phase, robot, n_waypoints: [TipRadius()])
