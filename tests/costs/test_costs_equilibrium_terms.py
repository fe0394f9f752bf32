"""Equilibrium, friction, torque and place of contacts: Jacobians, pinocchio's figures, and cases worked out by hand."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from jacobian import check_jacobian
from tiny_robots import PLANAR, SPATIAL, Segment, atlas, atlas_with_wheel, chain, random_configurations

from costs.collision import Contacts
from costs.contact import Contact
from costs.contact_points import ContactPoints, Load, measure_weight
from costs.kinematics import KinematicsEngine, locate_links
from costs.robot import MechanismJoint, with_mechanism
from costs.state import LoadedState, MotionState
from costs.terms import (
    ContactPlace,
    Equilibrium,
    FramePose,
    FrictionPyramid,
    JointTorque,
    MechanismBalance,
    StaticTorque,
    Widened,
)
from scopt import Residual, check_derivative

UP = np.array([0.0, 0.0, 1.0])
LADDER = (
    Segment((1.0, 0.0, 0.0), size=(0.5, 0.1, 0.1), mass=4.0),
    Segment((0.0, 1.0, 0.0), origin=(0.5, 0.0, 0.0), size=(0.5, 0.1, 0.1), mass=4.0),
)
BOX = (Segment((1.0, 0.0, 0.0), mass=3.0),)


def touch(link, count, rng, reference=None):
    """A contact with random points and normals."""
    normals = rng.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return Contact(link, 0.2 * rng.normal(size=(count, 3)), normals, 0.6, 900.0, reference)


def loaded_state(robot, n_points):
    """Maps an iterate (T, n + 3 C) to a state."""
    engine = KinematicsEngine(robot)

    def make(x):
        q, forces = LoadedState.split(x, n_points)
        return LoadedState(MotionState(engine(q), Contacts.none()), forces)

    return make


def random_iterate(robot, n_points, rng, n_waypoints=3):
    q = random_configurations(robot, rng, n_waypoints)
    return np.concatenate([q, 0.4 * rng.normal(size=(n_waypoints, 3 * n_points))], axis=1)


def iterate(q, forces):
    return np.concatenate([q, np.ravel(forces)])[None]


def two_leaves():
    """A chain and a mechanism of two hinges, the second carried by the first."""
    robot = with_mechanism(chain(SPATIAL), [MechanismJoint(
        name="leaf_hinge", origin=np.array([0.5, 0.3, 0.1]), axis=np.array([0.2, 0.1, 1.0]),
        bodies={"leaf/1": np.random.default_rng(0).normal(size=(8, 3))}, link="leaf",
        lower=-2.0, upper=2.0, velocity=1.0, acceleration=1.0,
    )])  # fmt: skip
    model = robot.model.copy()
    place = pin.SE3(np.eye(3), np.array([0.4, 0.0, 0.2]))
    axis = np.array([0.0, 0.8, 0.6])
    joint = model.addJoint(model.njoints - 1, pin.JointModelRevoluteUnaligned(axis), place, "lever_hinge")
    model.addJointFrame(joint)
    model.addBodyFrame("lever", joint, pin.SE3.Identity(), -1)
    return replace(
        robot, model=model, joint_names=(*robot.joint_names, "lever_hinge"),
        mechanism_links=robot.mechanism_links | {"lever"},
        **{key: np.append(getattr(robot, key), getattr(robot, key)[-1])
           for key in ("lower", "upper", "velocity", "acceleration", "effort")},
    )  # fmt: skip


ROBOTS = {
    "atlas": (atlas, ("l_foot", "r_foot", "l_hand"), None),
    "atlas on a wheel": (atlas_with_wheel, ("l_foot", "r_hand", "pelvis"), "valve"),
    "chain": (lambda: chain(SPATIAL), ("link4", "link2"), None),
    "floating chain": (lambda: chain(SPATIAL, "floating"), ("link4", "link1", "base"), None),
    "chain on two leaves": (two_leaves, ("link4", "link3"), "lever"),
}


@pytest.fixture(params=ROBOTS, name="case")
def _case(request):
    """Robot, points of its contacts, loads, and an iterate of three waypoints."""
    make, links, reference = ROBOTS[request.param]
    robot, rng = make(), np.random.default_rng(7)
    contacts = [touch(link, 2 + k, rng, reference if k == 1 else None) for k, link in enumerate(links)]
    points = ContactPoints.of(robot, contacts, {0: np.array([0.1, -0.4, 1.0])})
    weight = measure_weight(robot)
    loads = [
        Load(links[0], 0.2 * weight * rng.normal(size=3), 0.1 * weight * rng.normal(size=3), rng.normal(size=3)),
        Load(links[-1], 0.2 * weight * rng.normal(size=3), 0.1 * weight * rng.normal(size=3)),
    ]
    return robot, points, loads, random_iterate(robot, len(points), rng)


def test_equilibrium_jacobian(case):
    robot, points, loads, x = case
    term = Equilibrium(robot, points, [2, 0], loads, about=np.array([0.3, 0.1, -0.2]))
    dense = check_jacobian(term, loaded_state(robot, len(points)), x, tolerance=1e-8)
    assert dense.shape == (12, x.size)


def test_friction_jacobian(case):
    robot, points, _, x = case
    term = FrictionPyramid(points, [2, 0], margin=0.01)
    assert check_jacobian(term, loaded_state(robot, len(points)), x, tolerance=1e-8).shape[0] == 10 * len(points)


def test_joint_torque_jacobian(case):
    robot, points, loads, x = case
    term = JointTorque(robot, points, [2, 0], loads, share=0.8)
    check_jacobian(term, loaded_state(robot, len(points)), x, tolerance=1e-7)


def test_generalised_forces_jacobian(case):
    robot, points, loads, x = case

    class Rows(Residual[LoadedState]):
        def value(self, state):
            return StaticTorque(robot, points, loads).measure(state, np.arange(1)).ravel()

    state = loaded_state(robot, len(points))(x[:1])
    by_q, by_forces = StaticTorque(robot, points, loads).differentiate(state, np.arange(1))
    measured = Rows().linearize(state).jacobian.toarray()
    np.testing.assert_allclose(np.concatenate([by_q, by_forces], axis=2)[0], measured, atol=1e-8)


@pytest.mark.parametrize("name", ["atlas on a wheel", "chain on two leaves"])
def test_mechanism_balance_jacobian(name):
    make, links, reference = ROBOTS[name]
    robot, rng = make(), np.random.default_rng(3)
    points = ContactPoints.of(robot, [touch(links[0], 2, rng), touch(links[1], 3, rng, reference)])
    term = MechanismBalance(robot, points, [2, 0], {robot.joint_names[-1]: 20.0})
    x = random_iterate(robot, len(points), rng)
    dense = check_jacobian(term, loaded_state(robot, len(points)), x, tolerance=1e-8)
    assert len(dense) == (4 if reference == "lever" else 2)


@pytest.mark.parametrize("reference", [None, "valve"])
def test_contact_place_jacobian(reference):
    robot, rng = atlas_with_wheel(), np.random.default_rng(5)
    state, x = loaded_state(robot, 0), random_iterate(robot, 0, rng)
    spots, places = rng.normal(size=(4, 3)), rng.normal(size=(4, 3))
    directions, offsets = rng.normal(size=(3, 3)), rng.normal(size=3)
    for term in (
        ContactPlace.at(robot, "l_hand", spots, [2, 0], places, reference),
        ContactPlace.on_plane(robot, "l_hand", spots, [2, 0], UP, 0.3, reference),
        ContactPlace.inside(robot, "l_hand", spots, [2, 0], directions, offsets, reference),
    ):
        check_jacobian(Widened(term), state, x, tolerance=1e-8)


def test_a_widened_term_has_its_own_rows_and_none_of_forces(case):
    robot, points, _, x = case
    narrow = FramePose(robot, robot.bodies[-1].link, [2, 0], np.eye(4))
    state = loaded_state(robot, len(points))
    dense = check_jacobian(Widened(narrow), state, x).reshape(12, 3, -1)
    expected = narrow.linearize(state(x).motion).jacobian.toarray().reshape(12, 3, robot.n)
    np.testing.assert_array_equal(dense[:, :, : robot.n], expected)
    assert not dense[:, :, robot.n :].any()


def test_a_widened_term_without_a_derivative_gets_one_of_its_own_width():
    class Height(Residual[MotionState]):
        def value(self, state):
            return state.kinematics.position[:, -1, 2]

    robot = atlas()
    x = random_iterate(robot, 2, np.random.default_rng(4))
    assert check_derivative(Widened(Height()), loaded_state(robot, 2), x).is_right


def test_differences_of_a_loaded_state_name_forces():
    robot = atlas()
    state = loaded_state(robot, 2)(random_iterate(robot, 2, np.random.default_rng(4)))
    assert state.variable_names[-1] == "force 1 z"
    assert len(state.variable_names) == state.x.shape[1]
    np.testing.assert_array_equal(state.at(state.x).x, state.x)


def test_torques_are_those_of_pinocchio(case):
    robot, points, _, x = case
    weight, model = measure_weight(robot), robot.model
    state = loaded_state(robot, len(points))(x)
    measured = StaticTorque(robot, points).measure(state, np.arange(3))
    by_q, _ = StaticTorque(robot, points).differentiate(
        replace(state, forces=np.zeros_like(state.forces)), np.arange(3)
    )
    for t in range(3):
        data = model.createData()
        torque = pin.computeGeneralizedGravity(model, data, x[t, : robot.n]).copy()
        pin.computeJointJacobians(model, data, x[t, : robot.n])
        for i, (joint, local) in enumerate(zip(points.places.joint, points.places.local, strict=True)):
            J = pin.getJointJacobian(model, data, int(joint), pin.LOCAL_WORLD_ALIGNED).reshape(6, -1)
            lever = data.oMi[int(joint)].rotation @ local
            force = weight * state.forces[t, i]
            torque -= J[:3].T @ force + J[3:].T @ np.cross(lever, force)
        np.testing.assert_allclose(weight * measured[t], torque, rtol=1e-9, atol=1e-8)
        gravity = pin.computeGeneralizedGravityDerivatives(model, model.createData(), x[t, : robot.n])
        joints = slice(6 if robot.is_floating else 0, None)  # pinocchio leaves out how a composite base turns itself
        np.testing.assert_allclose(weight * by_q[t, joints], gravity[joints], atol=1e-8)


def test_the_base_is_free_of_generalised_force_in_equilibrium():
    robot, rng = atlas(), np.random.default_rng(2)
    points = ContactPoints.of(robot, [touch("l_foot", 4, rng), touch("r_foot", 4, rng)])
    state = loaded_state(robot, 8)
    x = random_iterate(robot, 8, rng, 1)
    rows = Equilibrium(robot, points, [0]).linearize(state(x))
    by_forces = rows.jacobian.toarray()[:, robot.n :]
    x[0, robot.n :] -= np.linalg.pinv(by_forces) @ rows.value
    np.testing.assert_allclose(Equilibrium(robot, points, [0]).value(state(x)), 0.0, atol=1e-12)
    torque = StaticTorque(robot, points).measure(state(x), np.arange(1))[0]
    np.testing.assert_allclose(torque[:6], 0.0, atol=1e-12)
    assert np.abs(torque[6:]).max() > 0.01


SLOPES = st.floats(0.02, 0.9)


@given(angle=SLOPES)
def test_a_box_on_a_slope_by_hand(angle):
    # Along the slope the ground holds sin, across it cos; tipping about the middle shifts 0.05 sin to the lower edge.
    robot = chain(BOX, "floating")
    corners = np.array([[x, y, -0.05] for x in (0.0, 1.0) for y in (-0.05, 0.05)])
    friction = np.tan(angle)  # an edge of the pyramid lies on the cone, and holds it just so
    points = ContactPoints.of(robot, [Contact("link1", corners, np.tile(UP, (4, 1)), friction, 1e3)])
    q = np.zeros(7)
    q[:3], q[4] = (1.0, -2.0, 0.3), angle
    across = 0.25 * np.cos(angle) + 0.025 * np.sin(angle) * np.array([-1.0, -1.0, 1.0, 1.0])
    along = -across * np.tan(angle)
    box_axes = locate_links(KinematicsEngine(robot), q, ["link1"])["link1"][:3, :3]
    forces = along[:, None] * box_axes[:, 0] + across[:, None] * box_axes[:, 2]
    state = loaded_state(robot, 4)(iterate(q, forces))
    np.testing.assert_allclose(Equilibrium(robot, points, [0]).value(state), 0.0, atol=1e-12)
    rows = FrictionPyramid(points, [0]).value(state).reshape(4, 5)
    np.testing.assert_allclose(rows[:, :4].max(axis=1), 0.0, atol=1e-12)
    np.testing.assert_allclose(rows[:, 4], across - 1e3 / (9.81 * 3.0), atol=1e-12)
    steeper = replace(points, friction=0.9 * points.friction)
    slip = 0.1 * across.max() * np.tan(angle) / np.sqrt(2.0)
    assert FrictionPyramid(steeper, [0]).value(state).max() == pytest.approx(slip)


@given(angle=st.floats(0.2, 1.4))
def test_a_ladder_against_a_smooth_wall_by_hand(angle):
    # The wall pushes half the weight over the tangent; the hinge in the middle carries an eighth of weight times foot.
    robot = chain(LADDER, "floating")
    foot = Contact("link1", np.zeros((1, 3)), UP[None], 0.7, 1e4)
    top = Contact("link2", np.array([[0.5, 0.0, 0.0]]), UP[None], 0.0, 1e4)
    points = ContactPoints.of(robot, [foot, top], {0: UP, 1: np.array([-1.0, 0.0, 0.0])})
    q = np.zeros(8)
    q[4] = -angle
    wall = 0.5 / np.tan(angle)
    state = loaded_state(robot, 2)(iterate(q, [[wall, 0.0, 1.0], [-wall, 0.0, 0.0]]))
    np.testing.assert_allclose(Equilibrium(robot, points, [0]).value(state), 0.0, atol=1e-12)
    of_foot, of_top = np.split(FrictionPyramid(points, [0]).value(state), [5])
    assert of_foot[:4].max() == pytest.approx((wall - 0.7) / np.sqrt(2.0))
    np.testing.assert_allclose(of_top[:4], 0.0, atol=1e-12)  # nothing along the smooth wall
    np.testing.assert_allclose(of_top[4:], [-wall, wall - 1e4 / (8.0 * 9.81)], atol=1e-9)
    hinge = JointTorque(robot, points, [0]).value(state)[[1, 3]]
    used = np.cos(angle) / 8.0 * 8.0 * 9.81 / 50.0
    np.testing.assert_allclose(hinge, [used - 1.0, -used - 1.0], atol=1e-12)


def test_a_pushed_wheel_by_hand():
    # 20 N along y at 0.5 m from an axis along z: 10 N m, of which 4 are the wheel's load.
    robot = with_mechanism(chain(PLANAR), [MechanismJoint(
        name="wheel_turn", origin=np.array([1.5, 0.0, 0.0]), axis=UP,
        bodies={"wheel/rim": np.random.default_rng(0).normal(size=(8, 3))}, link="wheel",
        lower=-2.0, upper=2.0, velocity=1.0, acceleration=1.0,
    )])  # fmt: skip
    points = ContactPoints.of(robot, [Contact("tip", np.zeros((1, 3)), UP[None], 0.5, 100.0, "wheel")])
    weight = measure_weight(robot)
    state = loaded_state(robot, 1)(iterate(np.zeros(3), np.array([0.0, -20.0, 3.0]) / weight))
    np.testing.assert_allclose(weight * MechanismBalance(robot, points, [0], {"wheel_turn": 4.0}).value(state), [6.0])
    # The wheel has no limit: its coordinate has no row of torque.
    assert len(JointTorque(robot, points, [0]).value(state)) == 4
    with pytest.raises(KeyError, match="no contact moves 'joint1'; joints that contacts move: wheel_turn"):
        MechanismBalance(robot, points, [0], {"joint1": 1.0})


def test_a_load_needs_other_forces_than_none():
    robot = atlas()
    points = ContactPoints.of(robot, [touch("l_foot", 4, np.random.default_rng(1))])
    x = random_iterate(robot, 4, np.random.default_rng(2), 1)
    state = loaded_state(robot, 4)(x)
    spot = np.array([0.1, -0.2, 0.05])
    push = Load("r_hand", np.array([-80.0, 30.0, 20.0]), point=spot)
    unloaded = Equilibrium(robot, points, [0]).value(state)
    loaded = Equilibrium(robot, points, [0], [push]).value(state)
    weight = measure_weight(robot)
    hand = locate_links(KinematicsEngine(robot), x[0, : robot.n], ["r_hand"])["r_hand"] @ [*spot, 1.0]
    np.testing.assert_allclose(weight * (loaded - unloaded)[:3], push.force, atol=1e-9)
    np.testing.assert_allclose(weight * (loaded - unloaded)[3:], np.cross(hand[:3], push.force), atol=1e-9)
    torques = [StaticTorque(robot, points, loads).measure(state, np.arange(1))[0] for loads in ((), [push])]
    moved = np.abs(torques[1] - torques[0]) > 1e-9
    arm = [i for i, name in enumerate(robot.joint_names) if name.startswith("r_arm")]
    assert moved[arm].all()
    assert not moved[robot.joint_names.index("l_arm_elx")]


@given(seed=st.integers(0, 10_000), margin=st.floats(0.0, 0.02))
def test_a_force_inside_by_a_margin_may_err_by_it(seed, margin):
    rng = np.random.default_rng(seed)
    robot = chain(BOX, "floating")
    points = ContactPoints.of(robot, [touch("link1", 1, rng)])
    q = random_configurations(robot, rng, 1)[0]
    make, term = loaded_state(robot, 1), FrictionPyramid(points, [0])
    normal = points.turn(make(iterate(q, np.zeros(3))).kinematics, np.array([0]), np.array([0]), points.normal)[0, 0]
    force = rng.uniform(0.1, 2.0) * normal + 0.3 * rng.normal(size=3)
    error = rng.normal(size=3)
    error *= margin / np.linalg.norm(error)
    is_inside = FrictionPyramid(points, [0], margin).value(make(iterate(q, force))).max() <= 0.0
    is_still_inside = term.value(make(iterate(q, force + error))).max() <= 1e-12
    assert is_still_inside or not is_inside


def test_a_wall_carries_its_full_friction_upwards():
    robot = chain(BOX, "floating")
    q = np.array([0.0, 0.0, 0.0, 0.3, -0.5, 0.2, 0.0])
    make = loaded_state(robot, 1)
    wall = make(iterate(q, np.zeros(3))).kinematics
    outward = np.array([-0.6, 0.8, 0.0]) @ wall.rotation[0, 2]
    points = ContactPoints.of(robot, [Contact("link1", np.zeros((1, 3)), outward[None], 0.5, 1e3)])
    force = np.array([-0.6, 0.8, 0.5])  # presses by 1 and holds up 0.5
    value = FrictionPyramid(points.lean_up(wall), [0]).value(make(iterate(q, force)))
    np.testing.assert_allclose(sorted(value)[-2:], 0.0, atol=1e-12)  # on an edge: on two sides
    further = FrictionPyramid(points.lean_up(wall), [0]).value(make(iterate(q, force + 0.01 * UP)))
    assert further.max() == pytest.approx(0.01 / np.sqrt(2.0))


def test_contact_places_by_hand():
    robot = chain(PLANAR)
    state = MotionState(KinematicsEngine(robot)(np.array([[0.0, 0.5 * np.pi]])), Contacts.none())
    spots = np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 0.2]])  # in the world at (1, 1, 0) and (1, 1.5, 0.2)
    places = np.array([[1.0, 1.0, 0.0], [1.0, 1.0, 0.0]])
    value = ContactPlace.at(robot, "tip", spots, [0], places).value(state)
    np.testing.assert_allclose(value, [0.0, 0.0, 0.0, 0.0, 0.5, 0.2], atol=1e-12)
    heights = ContactPlace.on_plane(robot, "tip", spots, [0], UP, 0.05).value(state)
    np.testing.assert_allclose(heights, [-0.05, 0.15], atol=1e-12)
    edges = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    beyond = ContactPlace.inside(robot, "tip", spots, [0], edges, np.array([1.2, 1.2])).value(state)
    np.testing.assert_allclose(beyond, [-0.2, -0.2, -0.2, 0.3], atol=1e-12)
    relative = ContactPlace.at(robot, "tip", spots[:1], [0], np.zeros((1, 3)), "link1").value(state)
    np.testing.assert_allclose(relative, [1.0, 1.0, 0.0], atol=1e-12)


def test_places_are_those_of_the_reference_frame():
    robot, rng = atlas(), np.random.default_rng(8)
    q, spot = random_configurations(robot, rng, 1), rng.normal(size=3)
    state = MotionState(KinematicsEngine(robot)(q), Contacts.none())
    poses = locate_links(KinematicsEngine(robot), q[0], ["l_tool", "r_tool"])
    expected = np.linalg.inv(poses["r_tool"]) @ poses["l_tool"] @ [*spot, 1.0]
    value = ContactPlace.at(robot, "l_tool", spot[None], [0], np.zeros((1, 3)), "r_tool").value(state)
    np.testing.assert_allclose(value, expected[:3], atol=1e-12)


def test_a_force_on_a_smooth_point_keeps_its_margin_along_the_normal_only():
    robot = chain(BOX, "floating")
    points = ContactPoints.of(robot, [Contact("link1", np.zeros((1, 3)), UP[None], 0.0, 100.0)])
    cap = 100.0 / measure_weight(robot)
    make, term = loaded_state(robot, 1), FrictionPyramid(points, [0], 0.1)
    for normal, inside in ((0.09, False), (0.11, True), (cap - 0.11, True), (cap - 0.09, False)):
        value = term.value(make(iterate(np.zeros(7), [0.0, 0.0, normal])))
        assert (value.max() <= 1e-12) == inside


def test_contacts_and_loads_on_the_wrong_side_are_refused():
    robot, spot = atlas_with_wheel(), (np.zeros((1, 3)), UP[None], 0.5, 100.0)
    with pytest.raises(ValueError, match="contact of valve: valve belongs to a mechanism"):
        ContactPoints.of(robot, [Contact("valve", *spot)])
    with pytest.raises(ValueError, match="reference 'pelvis' is no link of a mechanism; mechanism links: valve"):
        ContactPoints.of(robot, [Contact("l_hand", *spot, "pelvis")])
    with pytest.raises(ValueError, match="load on valve: valve belongs to a mechanism"):
        Equilibrium(robot, ContactPoints.of(robot, [Contact("l_hand", *spot)]), [0], [Load("valve", UP)])


def test_a_normal_of_no_direction_is_refused():
    contact = Contact("tip", np.zeros((1, 3)), UP[None], 0.5, 100.0)
    with pytest.raises(ValueError, match=r"world_normals\[0\] is zero; give the direction that pushes on tip"):
        ContactPoints.of(chain(PLANAR), [contact], {0: np.zeros(3)})
