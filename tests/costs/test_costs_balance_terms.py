"""Balance terms: Jacobians over all waypoints and values worked out by hand."""

import numpy as np
import pytest
from jacobian import check_jacobian
from tiny_robots import SPATIAL, Segment, atlas, chain, contact_free_state, random_configurations

from costs.support import SupportPolygon
from costs.terms import CartTableZmpInPolygon, CentreOfMassAt, CentreOfMassInPolygon

ROBOTS = {"atlas": atlas, "chain": lambda: chain(SPATIAL)}
SQUARE = SupportPolygon.of_points(np.array([[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]]))
PENTAGON = SupportPolygon.of_points(np.array([[-0.1, -0.1], [0.1, -0.2], [0.3, 0.0], [0.1, 0.2], [-0.1, 0.1]]))
# a cart of 3 kg on a rail along x, 0.5 m above the ground, with its mass 0.4 m from the origin of its joint
CART = (Segment((1.0, 0.0, 0.0), origin=(-0.4, 0.0, 0.5), size=(0.8, 0.1, 0.1), mass=3.0, kind="prismatic"),)


@pytest.fixture(params=ROBOTS, name="robot")
def _robot(request):
    return ROBOTS[request.param]()


def test_centre_of_mass_jacobian(robot):
    x = random_configurations(robot, np.random.default_rng(1), 4)
    term = CentreOfMassInPolygon(PENTAGON, [3, 1], margin=0.02)
    assert check_jacobian(term, contact_free_state(robot), x).shape[0] == 10


def test_centre_of_mass_offset_jacobian(robot):
    x = random_configurations(robot, np.random.default_rng(3), 4)
    assert check_jacobian(CentreOfMassAt([0.1, -0.2], [0, 2]), contact_free_state(robot), x).shape[0] == 4


def test_centre_of_mass_offset_by_hand():
    state = contact_free_state(chain(CART))(np.array([[0.0], [0.06]]))
    np.testing.assert_allclose(
        CentreOfMassAt([0.05, 0.01], [0, 1]).value(state), [-0.05, -0.01, 0.01, -0.01], atol=1e-12
    )


def test_every_waypoint_may_have_a_place_of_its_own(robot):
    x = random_configurations(robot, np.random.default_rng(4), 4)
    places = np.array([[0.1, -0.2], [0.0, 0.3]])
    term, state = CentreOfMassAt(places, [3, 1]), contact_free_state(robot)
    assert check_jacobian(term, state, x).shape[0] == 4
    alone = [CentreOfMassAt(place, [row]).value(state(x)) for place, row in zip(places, (3, 1), strict=True)]
    np.testing.assert_array_equal(term.value(state(x)), np.concatenate(alone))


def test_cart_table_jacobian(robot):
    rng = np.random.default_rng(2)
    x = random_configurations(robot, rng, 1) + 0.05 * rng.normal(size=(4, robot.n))
    term = CartTableZmpInPolygon(PENTAGON, [2, 1], dt=0.3, margin=0.02, ground=-0.2)
    assert check_jacobian(term, contact_free_state(robot), x).shape[0] == 10


def worst_rows(term, q):
    """The largest row of each waypoint of a cart that moves along x."""
    return term.value(contact_free_state(chain(CART))(np.array(q)[:, None])).reshape(-1, 4).max(axis=1)


def test_centre_of_mass_by_hand():
    term = CentreOfMassInPolygon(SQUARE, [0, 1, 2], margin=0.03)
    np.testing.assert_allclose(worst_rows(term, [0.0, 0.06, -0.3]), [-0.07, -0.01, 0.23], atol=1e-12)


def test_cart_table_zmp_by_hand():
    # acceleration (0 - 2 * 0.01 + 0.04) / 0.1^2 = 2 m/s^2 at height 0.5: the ZMP trails by 0.5 / 9.81 * 2
    term = CartTableZmpInPolygon(SQUARE, [1], dt=0.1)
    zmp = 0.01 - 0.5 / 9.81 * 2.0
    np.testing.assert_allclose(worst_rows(term, [0.0, 0.01, 0.04]), [-zmp - 0.1], atol=1e-12)
    raised = CartTableZmpInPolygon(SQUARE, [1], dt=0.1, ground=0.3, margin=0.01)
    zmp = 0.01 - 0.2 / 9.81 * 2.0
    np.testing.assert_allclose(worst_rows(raised, [0.0, 0.01, 0.04]), [-zmp - 0.1 + 0.01], atol=1e-12)


def test_a_cart_at_constant_speed_has_its_zmp_below_its_centre_of_mass():
    zmp, com = CartTableZmpInPolygon(SQUARE, [1], dt=0.1), CentreOfMassInPolygon(SQUARE, [1])
    np.testing.assert_allclose(worst_rows(zmp, [0.0, 0.03, 0.06]), worst_rows(com, [0.0, 0.03, 0.06]), atol=1e-12)


def test_a_time_step_that_is_not_positive_is_refused():
    with pytest.raises(ValueError, match="dt must be positive, got 0"):
        CartTableZmpInPolygon(SQUARE, [1], dt=0.0)
