"""Swept clearance against dense sampling, and against answers worked out by hand."""

import numpy as np
import pytest
from convex_distance import box, signed_distance
from hypothesis import given, settings
from hypothesis import strategies as st
from swept_scenes import (
    body_in_body,
    body_in_world,
    checker_of,
    chord_deviation_bound,
    keys,
    random_motion,
    random_scene,
    state_of,
)
from tiny_robots import PLANAR, Segment, atlas, chain

from costs.collision.shapes import make_convex, make_rewritable_convex
from costs.kinematics import KinematicsEngine
from costs.scene import ConvexPiece, Scene

# four revolute joints about different axes; the last box is wide enough to reach the first
ARM = (
    Segment((0.0, 0.0, 1.0), size=(0.4, 0.15, 0.15)),
    Segment((0.0, 1.0, 0.0), origin=(0.4, 0.0, 0.1), size=(0.3, 0.1, 0.1)),
    Segment((0.6, 0.0, 0.8), origin=(0.3, 0.05, 0.0), size=(0.3, 0.1, 0.08)),
    Segment((0.0, 1.0, 0.0), origin=(0.3, 0.0, 0.0), size=(0.3, 0.2, 0.06)),
)
ROBOTS = {
    "arm": (lambda: chain(ARM), 0.3),
    "floating arm": (lambda: chain(ARM, "floating"), 0.2),
    "atlas": (atlas, 0.1),
}
FRACTIONS = np.linspace(0.0, 1.0, 9)
ROUNDING = 1e-6


def motion_with_contacts(name, seed):
    make, step = ROBOTS[name]
    robot = make()
    rng = np.random.default_rng(seed)
    scene = random_scene(rng, 6, 0.7)
    x = random_motion(robot, rng, 2, step)
    state = state_of(robot, checker_of(robot, scene, 0.03))(x)
    chosen = rng.permutation(len(state.contacts))[:6]
    return robot, scene, x, state.kinematics, state.contacts.where(chosen)


def vertices(robot, scene, kinematics, waypoint, contact):
    """Vertices of both sides of a contact at a waypoint, in the frame of the sweep."""
    body, other, is_self = int(contact.body[0]), int(contact.other[0]), bool(contact.is_self[0])
    if is_self:
        return body_in_body(robot, kinematics, waypoint, body, other), robot.bodies[other].outer
    return body_in_world(robot, kinematics, waypoint, body), scene.pieces[other].vertices


@pytest.mark.parametrize("name", ROBOTS)
@settings(max_examples=12)
@given(seed=st.integers(0, 100_000))
def test_swept_clearance_never_exceeds_that_of_linearly_moving_vertices(name, seed):
    robot, scene, _, kinematics, contacts = motion_with_contacts(name, seed)
    for row in range(len(contacts)):
        contact = contacts.where([row])
        first, other = vertices(robot, scene, kinematics, 0, contact)
        second, _ = vertices(robot, scene, kinematics, 1, contact)
        dense = min(signed_distance((1.0 - s) * first + s * second, other) for s in FRACTIONS)
        assert contact.distance[0] <= dense + ROUNDING
        hull = signed_distance(np.concatenate([first, second]), other)
        assert contact.distance[0] == pytest.approx(hull, abs=ROUNDING)


def bound_of(robot, dq, contact):
    """The rotation bound of a contact whose bodies lie on one branch; None where they do not."""
    body, other = int(contact.body[0]), int(contact.other[0])
    if not contact.is_self[0]:
        return chord_deviation_bound(robot, dq, body)
    carrier, joint = robot.bodies[other].joint, robot.bodies[body].joint
    while joint > carrier:
        joint = int(robot.model.parents[joint])
    return chord_deviation_bound(robot, dq, body, carrier) if joint == carrier else None


@pytest.mark.parametrize("name", ROBOTS)
@settings(max_examples=12)
@given(seed=st.integers(0, 100_000))
def test_swept_clearance_exceeds_that_of_linearly_moving_joints_by_the_rotation_bound_at_most(name, seed):
    robot, scene, x, _, contacts = motion_with_contacts(name, seed)
    dense = KinematicsEngine(robot)(x[0] + FRACTIONS[:, None] * (x[1] - x[0]))
    for row in range(len(contacts)):
        contact = contacts.where([row])
        bound = bound_of(robot, x[1] - x[0], contact)
        if bound is None:
            continue
        clearance = min(signed_distance(*vertices(robot, scene, dense, t, contact)) for t in range(len(FRACTIONS)))
        assert contact.distance[0] <= clearance + bound + ROUNDING


def test_the_rotation_bound_is_needed():
    # a 2 m arm that turns by 60 degrees passes 2 cm from the pillar, 24 cm nearer than the hull of its end poses
    robot = chain(PLANAR)
    pillar = ConvexPiece("pillar", box([2.03, 0.0, 0.0], [0.02, 0.02, 1.0]))
    x = np.array([[-np.pi / 6, 0.0], [np.pi / 6, 0.0]])
    contacts = state_of(robot, checker_of(robot, Scene((pillar,)), 0.5))(x).contacts
    outer = contacts.where(contacts.body == 1)
    gap = 2.02 - np.hypot(2.0, 0.05) * np.cos(np.pi / 6 - np.arctan2(0.05, 2.0))
    assert outer.distance[0] == pytest.approx(gap, abs=1e-9)
    assert gap > 0.26
    assert gap <= 0.02 + chord_deviation_bound(robot, x[1] - x[0], 1)


CART = (Segment((1.0, 0.0, 0.0), origin=(0.0, 0.0, 0.0), size=(0.2, 0.2, 0.2), kind="prismatic"),)


def cart_contacts(x, *pieces, **options):
    """Contacts of a 20 cm cube that moves along x; its faces stand at q and q + 0.2."""
    robot = chain(CART)
    checker = checker_of(robot, Scene(tuple(pieces)), 0.05, **options)
    return state_of(robot, checker)(np.array(x)[:, None]).contacts


def test_clearance_of_boxes_by_hand():
    wall = ConvexPiece("wall", box([0.5, 0.0, 0.0], [0.1, 1.0, 1.0]))
    contacts = cart_contacts([0.2], wall)
    np.testing.assert_allclose(contacts.distance, [0.05], atol=1e-9)  # 0.45 - 0.4
    np.testing.assert_allclose(contacts.normal[0], [[-1.0, 0.0, 0.0]] * 2, atol=1e-6)
    np.testing.assert_allclose(contacts.margin, [0.05])


def test_penetration_of_boxes_is_the_least_way_out():
    wall = ConvexPiece("wall", box([0.5, 0.0, 0.0], [0.1, 1.0, 1.0]))
    np.testing.assert_allclose(cart_contacts([0.28], wall).distance, [-0.03], atol=1e-9)
    shelf = ConvexPiece("shelf", box([0.5, 0.0, 0.58], [1.0, 1.0, 1.0]))  # from z = 0.08
    contacts = cart_contacts([0.28], shelf)
    np.testing.assert_allclose(contacts.distance, [-0.02], atol=1e-9)
    np.testing.assert_allclose(contacts.normal[0], [[0.0, 0.0, -1.0]] * 2, atol=1e-6)


def test_a_thin_wall_between_two_free_poses_is_hit():
    sheet = ConvexPiece("sheet", box([0.6, 0.0, 0.0], [0.01, 2.0, 2.0]))
    assert len(cart_contacts([0.0], sheet)) == len(cart_contacts([1.0], sheet)) == 0
    swept = cart_contacts([0.0, 1.0], sheet)
    # the hull reaches from 0 to 1.2, the sheet's middle plane halves it: way out 0.6 and half the sheet
    np.testing.assert_allclose(swept.distance, [-0.605], atol=1e-9)


def test_each_interval_sees_its_own_sweep():
    sheet = ConvexPiece("sheet", box([0.6, 0.0, 0.0], [0.01, 2.0, 2.0]))
    contacts = cart_contacts([0.0, 0.1, 1.0, 1.1], sheet)
    assert keys(contacts) == [(1, 0, 0, False)]
    np.testing.assert_array_equal(contacts.second, [2])


@pytest.mark.parametrize(("n_swept", "n_still"), [(20, 8), (33, 8), (54, 40), (96, 70), (64, 3), (40, 1)])
def test_distances_are_exact_beyond_the_points_coal_scans_one_by_one(n_swept, n_still):
    import coal

    rng = np.random.default_rng(n_swept)
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    request.enable_signed_distance = True
    swept, written = make_rewritable_convex(n_swept)
    here = coal.Transform3s()
    worst = 0.0
    for trial in range(40):
        still = rng.normal(size=(n_still, 3))
        still /= np.linalg.norm(still, axis=1, keepdims=True)  # all of them vertices of the hull
        fixed = make_convex(still)
        half = rng.normal(size=(n_swept // 2, 3)) * [0.5, 0.2, 0.1]
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        shift = rng.normal(size=3) * (1.5 if trial % 2 else 0.3)
        points = np.concatenate([half, half @ turn.T + 0.2 * rng.normal(size=3)])
        points = np.concatenate([points, points[:1]])[:n_swept] + shift
        written[: len(points)] = points
        written[len(points) :] = points[-1]
        result.clear()
        distance = coal.ComputeDistance(swept, fixed)(here, here, request, result)
        worst = max(worst, abs(distance - signed_distance(points, still)))
    assert worst < 1e-5


@pytest.mark.parametrize("name", ROBOTS)
def test_contacts_at_poses_are_those_of_each_pose_alone(name):
    robot, scene, x, _, _ = motion_with_contacts(name, 3)
    checker, engine = checker_of(robot, scene, 0.03), KinematicsEngine(robot)
    together = checker.at_poses(engine.place(x))
    for t, pose in enumerate(x):
        alone = checker(engine(pose[None]))
        found = together.where(np.flatnonzero(together.first == t))
        assert found.second.tolist() == [t] * len(found)
        for one, other in ((found.body, alone.body), (found.other, alone.other), (found.distance, alone.distance)):
            np.testing.assert_array_equal(one, other)
