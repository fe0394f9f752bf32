"""Residuals on a robot's state of which only the value is written, and the check of those that bring a derivative."""

import numpy as np
import pytest
from swept_scenes import checker_of, random_scene, state_of
from tiny_robots import SPATIAL, atlas, chain, contact_free_state, random_configurations

from costs import terms
from costs.state import MotionState
from costs.terms import CentreOfMassAt, FramePose
from scopt import AffineRows, DerivativeError, Residual, check_derivative
from scopt.finite_difference import differentiate


class ElbowHeight(Residual[MotionState]):
    """Height of Atlas' left elbow [m]."""

    def value(self, state):
        return state.kinematics.position[:, atlas().model.getJointId("l_arm_elx"), 2]


class Deepest(Residual[MotionState]):
    """Depth of the deepest contact [m]."""

    def value(self, state):
        return -state.contacts.distance[:1]


@pytest.fixture
def iterate():
    return random_configurations(atlas(), np.random.default_rng(5), 4)


def test_differences_on_a_floating_base_agree_with_written_derivatives(iterate):
    state = contact_free_state(atlas())(iterate)
    for residual in (FramePose(atlas(), "l_tool", [1, 3], np.eye(4)), CentreOfMassAt(np.zeros(2), range(4))):
        by_differences = differentiate(residual.value, state, "term")
        np.testing.assert_allclose(
            by_differences.jacobian.toarray(), residual.linearize(state).jacobian.toarray(), atol=1e-8
        )


def test_no_collision_is_looked_for_while_differences_are_made():
    robot = chain(SPATIAL)
    checker = checker_of(robot, random_scene(np.random.default_rng(0), 5, 0.5), 0.02)
    queries = []

    def counting(kinematics):
        queries.append(kinematics)
        return checker(kinematics)

    class Height(Residual[MotionState]):
        def value(self, state):
            return state.kinematics.position[:, -1, 2]

    state = state_of(robot, counting)(random_configurations(robot, np.random.default_rng(1), 5))
    assert Height().linearize(state).jacobian.nnz > 0
    assert len(queries) == 1


def test_a_residual_on_contacts_without_a_derivative_is_refused(iterate):
    robot = chain(SPATIAL)
    checker = checker_of(robot, random_scene(np.random.default_rng(0), 5, 0.5), 0.02)
    state = state_of(robot, checker)(random_configurations(robot, np.random.default_rng(1), 5))
    with pytest.raises(DerivativeError, match=r"contacts\.distance was read"):
        Deepest().linearize(state)
    with pytest.raises(DerivativeError, match="contacts"):
        len(state.at(state.x).contacts)


def test_the_check_names_the_joint(iterate):
    class Wrong(ElbowHeight):
        def linearize(self, state):
            jacobian = super().linearize(state).jacobian.tolil()
            jacobian[2, 2 * atlas().n + atlas().joint_names.index("l_arm_shx")] += 0.25
            return AffineRows(self.value(state), jacobian.tocsr())

    state = contact_free_state(atlas())
    assert check_derivative(ElbowHeight(), state, iterate).is_right
    check = check_derivative(Wrong(), state, iterate)
    assert (check.row, check.waypoint, check.variable_name) == (2, 2, "l_arm_shx")
    assert check.given - check.measured == pytest.approx(0.25, abs=1e-6)
    assert "'l_arm_shx'" in str(check)


def test_every_term_of_the_house_brings_its_derivative():
    residuals = [t for t in vars(terms).values() if isinstance(t, type) and issubclass(t, Residual)]
    assert len(residuals) > 5
    for residual in residuals:
        assert residual.linearize is not Residual.linearize, residual.__name__
