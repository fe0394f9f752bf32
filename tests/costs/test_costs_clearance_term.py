"""The swept clearance as a residual: its rows, its gradient against differences, and cases by hand."""

import numpy as np
import pytest
from convex_distance import box, signed_distance
from swept_scenes import body_in_body, body_in_world, checker_of, keys, random_motion, random_scene, state_of
from tiny_robots import SPATIAL, Segment, atlas, atlas_with_wheel, chain

from costs.collision import PairMargins, SweptCollisionChecker
from costs.scene import ConvexPiece, Scene
from costs.terms import Room, SweptClearance

ROBOTS = {"chain": (lambda: chain(SPATIAL), 0.2), "atlas": (atlas, 0.1), "atlas with a wheel": (atlas_with_wheel, 0.1)}
STEP = 1e-6


def rows_by_pair(term, state, *, is_self):
    """Value and Jacobian row of every contact by its key."""
    rows = term.linearize(state)
    contacts = state.contacts.where(state.contacts.is_self == is_self)
    np.testing.assert_array_equal(rows.at(np.zeros(rows.jacobian.shape[1])), term.value(state))
    return dict(zip(keys(contacts), zip(rows.value, rows.jacobian.toarray(), strict=True), strict=True)), contacts


def gradient_errors(name, seed, n_waypoints, *, is_self):
    """Relative error of every contact's row against central differences, with the state it was measured at."""
    make, step = ROBOTS[name]
    robot = make()
    rng = np.random.default_rng(seed)
    scene = Scene() if is_self else random_scene(rng, 12, 0.8)
    buffer = 0.25 if is_self else 0.1
    make_state = state_of(robot, checker_of(robot, scene, 0.02, buffer=buffer))
    term = SweptClearance(robot, is_self=is_self)
    x = random_motion(robot, rng, n_waypoints, step)
    state = make_state(x)
    rows, contacts = rows_by_pair(term, state, is_self=is_self)
    differences = {key: np.full(x.size, np.nan) for key in rows}
    for index in range(x.size):
        values = []
        for sign in (1.0, -1.0):
            y = x.copy()
            y.flat[index] += sign * STEP
            moved = make_state(y)
            found = moved.contacts.where(moved.contacts.is_self == is_self)
            values.append(dict(zip(keys(found), term.value(moved), strict=True)))
        for key, difference in differences.items():
            difference[index] = (values[0].get(key, np.nan) - values[1].get(key, np.nan)) / (2.0 * STEP)
    errors = []
    for key, (_, row) in rows.items():
        expected = differences[key]
        errors.append(np.abs(row - expected).max() / max(np.abs(expected).max(), 1e-3))
    return robot, state, contacts, np.array(errors)


def supported_by_one_vertex(robot, kinematics, contacts):
    """(m,) whether the contact rests on one vertex of the swept hull, all others 2 mm or more behind it."""
    alone = []
    for row in range(len(contacts)):
        contact = contacts.where([row])
        heights = []
        for side, waypoint in enumerate((int(contact.first[0]), int(contact.second[0]))):
            if contact.is_self[0]:
                still = int(contact.other[0])
                points = body_in_body(robot, kinematics, waypoint, int(contact.body[0]), still)
                normal = contact.normal[0, side] @ kinematics.rotation[waypoint, robot.bodies[still].joint]
            else:
                points = body_in_world(robot, kinematics, waypoint, int(contact.body[0]))
                normal = contact.normal[0, side]
            heights.append(points @ normal)
        lowest = np.sort(np.concatenate(heights))
        alone.append(lowest[1] - lowest[0] > 2e-3)
    return np.array(alone, dtype=bool)


@pytest.mark.parametrize("is_self", [False, True], ids=["world", "self"])
@pytest.mark.parametrize(("name", "seed"), [("chain", 19), ("atlas", 2), ("atlas with a wheel", 2)])
def test_gradient_of_a_single_pose_is_exact(name, seed, is_self):
    _, _, contacts, errors = gradient_errors(name, seed, 1, is_self=is_self)
    assert len(contacts) >= (1 if name == "chain" else 10)
    assert np.nanmax(errors) < 1e-4
    assert np.isnan(errors).sum() <= 1  # a pair may cross the query distance within the step


@pytest.mark.parametrize("name", ROBOTS)
def test_gradient_of_a_sweep_is_exact_where_one_pose_or_one_vertex_touches(name):
    robot, state, contacts, errors = gradient_errors(name, 3, 3, is_self=False)
    at_one_pose = (contacts.share == 0.0) | (contacts.share == 1.0)
    at_one_vertex = supported_by_one_vertex(robot, state.kinematics, contacts)
    assert at_one_pose.sum() >= 3
    assert at_one_vertex.sum() >= 3
    assert np.nanmax(errors[at_one_pose | at_one_vertex]) < 1e-4


@pytest.mark.parametrize(("is_self", "median"), [(False, 1e-3), (True, 0.1)], ids=["world", "self"])
def test_gradient_of_a_sweep_is_near_elsewhere(is_self, median):
    # where vertices of both poses support, the share between them is estimated and the gradient approximate
    errors = np.concatenate([gradient_errors("atlas", seed, 3, is_self=is_self)[3] for seed in (3, 4)])
    assert len(errors) >= 40
    assert np.nanmedian(errors) < median
    assert np.nanquantile(errors, 0.75) < 0.3


CART = (Segment((1.0, 0.0, 0.0), size=(0.2, 0.2, 0.2), kind="prismatic"),)
WALL = Scene((ConvexPiece("wall", box([1.0, 0.0, 0.0], [0.2, 1.0, 1.0])),))  # from x = 0.9


def cart_rows(x, scene=WALL, margin=0.05):
    """Rows of a 20 cm cube from q to q + 0.2."""
    robot = chain(CART)
    state = state_of(robot, checker_of(robot, scene, margin))(np.array(x)[:, None])
    rows = SweptClearance(robot, is_self=False).linearize(state)
    return rows.value, rows.jacobian.toarray()


def test_a_cube_before_a_wall_by_hand():
    # 4 cm from the wall where 5 are asked: short by 1 cm, and by as much more as it moves on
    value, jacobian = cart_rows([0.66])
    np.testing.assert_allclose(value, [0.01], atol=1e-9)
    np.testing.assert_allclose(jacobian, [[1.0]], atol=1e-6)


def test_a_sweep_answers_for_the_end_that_is_nearer_by_hand():
    value, jacobian = cart_rows([0.2, 0.66, 0.3])
    np.testing.assert_allclose(value, [0.01, 0.01], atol=1e-9)
    np.testing.assert_allclose(jacobian, [[0.0, 1.0, 0.0], [0.0, 1.0, 0.0]], atol=1e-6)


def test_a_sweep_along_a_shelf_is_shared_by_its_ends():
    # the cube slides along a shelf 3 cm above it: moving an end along x changes nothing, and no row is lost
    shelf = Scene((ConvexPiece("shelf", box([0.5, 0.0, 0.63], [3.0, 1.0, 1.0])),))
    value, jacobian = cart_rows([0.0, 0.4], shelf)
    np.testing.assert_allclose(value, [0.02], atol=1e-9)
    np.testing.assert_allclose(jacobian, [[0.0, 0.0]], atol=1e-6)


def test_the_parts_of_a_contact_share_out_to_its_witness():
    robot, rng = atlas(), np.random.default_rng(8)
    scene = random_scene(rng, 12, 0.8)
    state = state_of(robot, checker_of(robot, scene, 0.02))(random_motion(robot, rng, 3, 0.1))
    contacts = state.contacts.where(~state.contacts.is_self)
    witness = np.einsum("mk,mkl->ml", np.stack([1.0 - contacts.share, contacts.share], axis=1), contacts.point)
    for row in range(len(contacts)):
        contact = contacts.where([row])
        swept = np.concatenate(
            [
                body_in_world(robot, state.kinematics, int(t[0]), int(contact.body[0]))
                for t in (contact.first, contact.second)
            ]
        )
        normal = contact.normal[0, 0]
        assert witness[row] @ normal == pytest.approx((swept @ normal).min(), abs=1e-5)
        if contact.distance[0] > 0.0:
            piece = scene.pieces[int(contact.other[0])].vertices
            apart = signed_distance(witness[row][None], piece)
            assert apart == pytest.approx(contact.distance[0], abs=1e-5)


def test_rows_of_links_and_of_the_world_are_told_apart():
    robot, rng = atlas(), np.random.default_rng(9)
    scene = random_scene(rng, 10, 0.8)
    state = state_of(robot, checker_of(robot, scene, 0.05))(random_motion(robot, rng, 2, 0.1))
    own, world = (SweptClearance(robot, is_self=is_self).value(state) for is_self in (True, False))
    assert len(own) == state.contacts.is_self.sum()
    assert len(world) == (~state.contacts.is_self).sum()
    assert len(own) > 0
    assert len(world) > 0


def test_no_contacts_make_no_rows():
    robot = atlas()
    margins = PairMargins.of(robot, Scene(), 0.0)
    state = state_of(robot, SweptCollisionChecker(robot, Scene(), margins, buffer=0.0))(
        robot.postures["stand"][None].repeat(2, axis=0)
    )
    rows = SweptClearance(robot, is_self=False).linearize(state)
    assert rows.jacobian.shape == (0, 2 * robot.n)


@pytest.mark.parametrize("n_waypoints", [1, 3])
def test_room_is_the_clearance_of_nearer_world_contacts_with_a_larger_margin(n_waypoints):
    robot, rng = atlas(), np.random.default_rng(5)
    scene = random_scene(rng, 12, 0.8)
    state = state_of(robot, checker_of(robot, scene, 0.02, buffer=0.1))(random_motion(robot, rng, n_waypoints, 0.1))
    wider = state_of(robot, checker_of(robot, scene, 0.06, buffer=0.0))(state.kinematics.q)
    room, clearance = Room(robot, 0.04), SweptClearance(robot, is_self=False)
    assert len(room.value(state)) > 3
    np.testing.assert_allclose(np.sort(room.value(state)), np.sort(clearance.value(wider)), atol=1e-9)
    rows, expected = room.linearize(state), clearance.linearize(wider)
    np.testing.assert_array_equal(rows.value, room.value(state))
    order, other = np.argsort(rows.value), np.argsort(expected.value)
    np.testing.assert_allclose(rows.jacobian.toarray()[order], expected.jacobian.toarray()[other], atol=1e-6)


def test_room_is_not_asked_of_pairs_that_may_touch():
    robot = chain(SPATIAL)
    scene = random_scene(np.random.default_rng(19), 12, 0.8)
    make_state = state_of(robot, checker_of(robot, scene, -0.003, buffer=0.5))
    state = make_state(random_motion(robot, np.random.default_rng(19), 2, 0.2))
    assert len(state.contacts) > 0
    assert len(Room(robot, 0.1).value(state)) == 0
