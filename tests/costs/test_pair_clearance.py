"""The clearance required of each pair: its limits, gains and single poses, by hand."""

from __future__ import annotations

import numpy as np
import pytest
from convex_distance import box
from swept_scenes import checker_of, state_of
from tiny_robots import Segment, chain

from costs.collision import Contacts
from costs.scene import ConvexPiece, Scene
from costs.terms import ClearancePerPair, PairClearance, RequiredClearance
from costs.terms.pair_clearance import find_pose_contacts

# A cube of 20 cm that begins where its joint is, before a board from x = 0.9 to x = 1.1.
CART = (Segment((1.0, 0.0, 0.0), size=(0.2, 0.2, 0.2), kind="prismatic"),)
BOARD = Scene((ConvexPiece("board", box([1.0, 0.0, 0.0], [0.2, 1.0, 1.0])),))


def contacts_between(body: list[int], other: list[int], is_self: list[bool], distance: list[float]) -> Contacts:
    """Contacts of these pairs at waypoint 0."""
    m = len(body)
    zero, arrows = np.zeros(m, dtype=int), np.zeros((m, 2, 3))
    pairs = np.array(body), np.array(other), np.array(is_self), np.array(distance)
    return Contacts(zero, zero, *pairs, np.zeros(m), np.zeros(m), arrows, arrows)


def require(distance: list[float], gain: list[float]) -> ClearancePerPair:
    """The same clearance of the cart's only pair, by waypoint or interval."""
    checker = checker_of(chain(CART), BOARD, 0.05)
    return ClearancePerPair.of(checker, RequiredClearance(np.array(distance), np.array(gain)))


def cart_value(x: list[float], required: ClearancePerPair) -> np.ndarray:
    robot = chain(CART)
    state = state_of(robot, checker_of(robot, BOARD, 0.05))(np.array(x)[:, None])
    term = PairClearance(robot, required)
    np.testing.assert_array_equal(term.linearize(state).value, term.value(state))
    return term.value(state)


def test_limits_are_the_least_distances_less_the_reserve_and_those_of_two_bodies_have_no_order():
    free = ClearancePerPair(
        (), np.zeros((3, 2), int), np.zeros((3, 3), int), np.full((3, 2), np.inf), np.full((3, 3), 1.0)
    )
    found = contacts_between([0, 0, 2, 1], [1, 1, 0, 2], [False, False, True, True], [0.03, 0.02, 0.05, 1.5])
    limited = free.relax_to(found, 0.01)
    world, own = np.full((3, 2), np.inf), np.full((3, 3), 1.0)
    world[0, 1] = 0.01  # of 3 and 2 cm the less, less 1 cm
    own[2, 0] = own[0, 2] = 0.04  # the pair 1, 2 has a tighter limit than 1.49 m already
    np.testing.assert_allclose(limited.world_limit, world)
    np.testing.assert_allclose(limited.own_limit, own)
    np.testing.assert_array_equal(free.own_limit, 1.0)


@pytest.mark.parametrize(("reserve", "expected"), [(-1.0, 0.01), (0.0, 0.0), (0.015, -0.015)])
def test_a_pair_is_asked_for_its_limit_where_that_is_less_than_the_required_clearance(reserve, expected):
    # 4 cm from the board where 5 are required
    contacts = checker_of(chain(CART), BOARD, 0.05)(
        state_of(chain(CART), checker_of(chain(CART), BOARD, 0.05))(np.array([[0.66]])).kinematics
    )
    required = require([0.05], [2.0]).relax_to(contacts, reserve)
    np.testing.assert_allclose(cart_value([0.66], required), [2.0 * expected], atol=1e-9)


def test_each_interval_has_its_own_clearance_and_gain_and_none_where_the_gain_is_zero():
    required = require([0.05, 0.06, 0.07], [2.0, 0.0, 0.5])
    # 4, 4 and 3 cm from the board: short by 1 and 4 cm
    np.testing.assert_allclose(cart_value([0.2, 0.66, 0.66, 0.67], required), [2.0 * 0.01, 0.5 * 0.04], atol=1e-9)


def test_poses_are_measured_each_by_itself_and_not_on_the_way_between_them():
    robot = chain(CART)
    checker = checker_of(robot, BOARD, 0.05)
    make_state = state_of(robot, checker)
    before_and_behind = make_state(np.array([[0.2], [1.8]]))
    assert len(before_and_behind.contacts) == 1  # the way leads through the board
    assert len(find_pose_contacts(checker, before_and_behind.kinematics)) == 0
    near = find_pose_contacts(checker, make_state(np.array([[0.2], [0.66], [1.8], [0.67]])).kinematics)
    order = np.argsort(near.first)
    np.testing.assert_array_equal(near.first[order], [1, 3])
    np.testing.assert_array_equal(near.second, near.first)
    np.testing.assert_allclose(near.distance[order], [0.04, 0.03], atol=1e-9)
    np.testing.assert_array_equal(near.share, 0.0)
