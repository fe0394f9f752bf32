"""Poses in equilibrium: forces against inverse dynamics, limits, loads, mechanisms, and what is said of failures."""

from dataclasses import fields, replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation
from tiny_robots import SPATIAL, atlas, atlas_with_wheel, chain

from costs.allowance import Allowance, BodyRef
from costs.contact import Contact, WorldContacts
from costs.contact_points import ContactPoints, Load, measure_weight
from costs.kinematics import KinematicsEngine, locate_links
from costs.scene import ConvexPiece, Scene
from costs.static_region import StaticRegionError, find_static_region
from costs.terms import CentreOfMassAt, ContactForce, ContactPlace
from scopt import Constraint, Cost, Sense
from service.body.aims import Aims
from service.body.forces.contact_forces import ForceRows
from service.body.forces.equilibrium_pose import (
    ForceLimits,
    add_forces,
    make_planted_contacts,
    solve_equilibrium_pose,
)
from service.body.whole_body import CLEARANCE_TOLERANCE, WholeBody

FEET = ("l_foot", "r_foot")
UP = np.array([0.0, 0.0, 1.0])
TIP = np.zeros((1, 3))
PUSH = Load("r_tool", np.array([-80.0, 0.0, 10.0]), np.array([0.0, 3.0, -2.0]), np.array([0.02, 0.0, 0.01]))


def stand(robot=None, scene=None, feet=FEET):
    robot = atlas() if robot is None else robot
    return WholeBody.standing(robot, Scene(()) if scene is None else scene, robot.postures["stand"], feet, Aims())


def guess_of(body, seed=0):
    spread = np.where(np.arange(body.robot.n) < 6, 0.0, 0.05)
    return body.nominal + spread * np.random.default_rng(seed).normal(size=body.robot.n)


def centre_at(x):
    return Constraint("centre of mass", CentreOfMassAt(np.array([x, 0.0]), [0]), Sense.EQUAL_ZERO, 1e-3, unit="m")


def hold_bar(robot):
    """Contacts of both tools with a bar, and the constraints that put them there."""
    contacts = [Contact(tool, TIP, UP[None], 0.7, 600.0) for tool in ("l_tool", "r_tool")]
    places = [np.array([[0.75, side * 0.3, 0.9]]) for side in (1.0, -1.0)]
    terms = [ContactPlace.at(robot, c.link, TIP, [0], p) for c, p in zip(contacts, places, strict=True)]
    return contacts, [Constraint(f"{c.link} on the bar", t, Sense.EQUAL_ZERO, 1e-4) for c, t in zip(contacts, terms)]  # noqa: B905


def lean_on_bar(ahead=0.35, seed=0, **limits):
    body = stand()
    hands, places = hold_bar(body.robot)
    contacts = (*make_planted_contacts(body, 0.7, 2000.0), *hands)
    bar = {len(contacts) - 2: UP, len(contacts) - 1: UP}
    return solve_equilibrium_pose(
        body, contacts, guess_of(body, seed), ForceLimits(world_normals=bar, **limits), (), [*places, centre_at(ahead)]
    )


def push_with_hand(*loads):
    body = stand()
    contacts = make_planted_contacts(body, 0.7, 2000.0)
    return solve_equilibrium_pose(body, contacts, guess_of(body), ForceLimits(loads=loads))


def inverse_dynamics(pose, loads=()):
    """(n,) generalised forces at rest under the pose's forces, by pinocchio's recursive Newton-Euler algorithm."""
    model = atlas().model
    data = model.createData()
    pin.framesForwardKinematics(model, data, pose.q)
    external = [pin.Force.Zero() for _ in range(model.njoints)]

    def press(joint, spot, force, moment=(0.0, 0.0, 0.0)):
        rotation = data.oMi[joint].rotation.T
        local = rotation @ force
        external[joint] += pin.Force(local, np.cross(spot, local) + rotation @ moment)

    for joint, place, force in zip(pose.points.places.joint, pose.places, pose.forces_n, strict=True):
        press(int(joint), data.oMi[int(joint)].actInv(place), force)
    for load in loads:
        frame = model.frames[model.getFrameId(load.link)]
        press(int(frame.parentJoint), frame.placement.act(load.point), load.force, load.moment)
    still = np.zeros(model.nv)
    return pin.rnea(model, data, pose.q, still, still, external)


POSES = {
    "both hands on a bar": (lambda: lean_on_bar(), ()),
    "both hands on a bar, any torque": (lambda: lean_on_bar(torque_share=None), ()),
    "a hand that pushes": (lambda: push_with_hand(PUSH), (PUSH,)),
}


@pytest.mark.parametrize("name", POSES)
def test_forces_hold_the_pose_in_independent_inverse_dynamics(name):
    make, loads = POSES[name]
    pose = make()
    assert pose.is_feasible, pose.violations
    torque = inverse_dynamics(pose, loads)
    assert np.abs(torque[:6]).max() < 1e-3
    np.testing.assert_allclose(torque, pose.torque_nm, atol=1e-3)
    total = pose.forces_n.sum(axis=0) + sum((load.force for load in loads), np.zeros(3))
    np.testing.assert_allclose(total, [0.0, 0.0, measure_weight(atlas())], atol=1e-3)
    assert pose.misfit_n < 1e-3


def test_forces_keep_friction_and_caps():
    pose = lean_on_bar()
    normal = pose.forces_n[:, 2]  # soles and bar are level
    assert (normal >= 0.0).all()
    assert (np.linalg.norm(pose.forces_n[:, :2], axis=1) <= 0.7 * normal).all()
    assert (normal[:8] <= 2000.0).all()
    assert (normal[8:] <= 600.0).all()
    tools = locate_links(KinematicsEngine(atlas()), pose.q, ["l_tool", "r_tool"])
    np.testing.assert_allclose(pose.places[8:], [tools[name][:3, 3] for name in ("l_tool", "r_tool")], atol=1e-12)


def test_torque_limits_change_a_pose_that_would_exceed_them():
    limits = atlas().effort[6:]
    free, limited = lean_on_bar(torque_share=None), lean_on_bar()
    assert free.torque_share > 1.05
    assert free.most_loaded_joint.endswith("arm_wrx")
    assert limited.is_feasible
    assert limited.torque_share == pytest.approx(np.abs(limited.torque_nm[6:] / limits).max())
    assert limited.torque_share <= 1.0 + 1e-6
    assert lean_on_bar(torque_share=0.8).torque_share <= 0.8 + 1e-6


def test_a_load_changes_the_forces():
    loaded, unloaded = push_with_hand(PUSH), push_with_hand()
    assert loaded.is_feasible
    assert unloaded.is_feasible
    np.testing.assert_allclose((loaded.forces_n - unloaded.forces_n).sum(axis=0), -PUSH.force, atol=1e-3)
    assert np.abs(loaded.forces_n - unloaded.forces_n).max() > 5.0


def test_a_margin_is_room_for_errors_of_every_force():
    body = stand()
    contacts = make_planted_contacts(body, 0.7, 2000.0)
    near_toes = [centre_at(0.16)]  # nearly all weight on the toes leaves the heels' forces little room
    close = solve_equilibrium_pose(body, contacts, guess_of(body), constraints=near_toes)
    assert close.is_feasible
    assert 0.0 < close.reserve_n < 29.0
    wider = solve_equilibrium_pose(body, contacts, guess_of(body), ForceLimits(margin_n=30.0), (), near_toes)
    assert not wider.is_feasible
    pose = lean_on_bar(margin_n=40.0)
    assert pose.is_feasible
    assert pose.reserve_n >= 40.0
    # The reported forces have the room, too: level contacts, nearest side of the pyramid.
    x, y, z = pose.forces_n.T
    room = (0.7 * z - np.abs(x) - np.abs(y)) / np.sqrt(2.0 + 0.7**2)
    assert room.min() >= 40.0 - 1e-3


def test_a_missing_margin_is_told():
    body = stand()
    contacts = make_planted_contacts(body, 0.7, 2000.0)
    fixed = dict(enumerate(body.nominal.tolist()))
    pose = solve_equilibrium_pose(body, contacts, body.nominal, ForceLimits(margin_n=100.0), fixed=fixed)
    assert pose.violations == (f"contact forces can err by {pose.reserve_n:.3g} N at most, 100 N are required",)


def test_a_centre_of_mass_beyond_the_feet_is_explained():
    body = stand()
    contacts = make_planted_contacts(body, 0.7, 2000.0)
    pose = solve_equilibrium_pose(body, contacts, guess_of(body), constraints=[centre_at(0.3)])
    assert not pose.is_feasible
    assert any("centre of mass" in line or "no forces at the contacts hold" in line for line in pose.violations)


def test_missing_torque_is_named_with_its_joint():
    body = stand()
    contacts = make_planted_contacts(body, 0.7, 2000.0)
    heavy = Load("l_tool", np.array([0.0, -150.0, 0.0]))
    fixed = {i: float(value) for i, value in enumerate(body.nominal) if i >= 6}
    limits = ForceLimits(loads=(heavy,))
    pose = solve_equilibrium_pose(body, contacts, body.nominal, limits, fixed=fixed)
    assert not pose.is_feasible
    assert pose.violations == ("l_arm_shx needs 105.3 % of its torque, 100 % are allowed",)
    any_torque = ForceLimits(loads=(heavy,), torque_share=None)
    assert solve_equilibrium_pose(body, contacts, body.nominal, any_torque, fixed=fixed).is_feasible


def test_terms_of_the_body_stay():
    hand = locate_links(KinematicsEngine(atlas()), push_with_hand().q, ["l_hand"])["l_hand"][:3, 3]
    corners = np.array([[x, y, z] for x in (-0.1, 0.1) for y in (0.0, 0.3) for z in (-0.1, 0.1)])
    body = stand(scene=Scene((ConvexPiece("box", hand + corners, "obstacle"),)))
    contacts = make_planted_contacts(body, 0.7, 2000.0)
    pose = solve_equilibrium_pose(body, contacts, guess_of(body))
    assert pose.is_feasible, pose.violations
    near = body.make_checker()(body.engine(pose.q[None]))
    assert (near.margin - near.distance).max(initial=0.0) < CLEARANCE_TOLERANCE
    feet = locate_links(body.engine, pose.q, FEET)
    for foot in body.planted:
        np.testing.assert_allclose(feet[foot.link], foot.pose_world_link, atol=1e-4)


def test_a_hand_on_a_wall_touches_it_as_allowed():
    wall = np.array([[x, y, z] for x in (0.8, 1.0) for y in (-2.0, 2.0) for z in (0.0, 2.5)])
    body = stand(scene=Scene((ConvexPiece("wall", wall, "obstacle"),)))
    outward = np.array([-1.0, 0.0, 0.0])
    contacts = (*make_planted_contacts(body, 0.7, 2000.0), Contact("r_tool", TIP, UP[None], 0.7, 300.0))
    on_wall = ContactPlace.on_plane(body.robot, "r_tool", TIP, [0], -outward, 0.8)
    terms = [Constraint("tool on the wall", on_wall, Sense.EQUAL_ZERO, 1e-4), centre_at(0.2)]
    limits = ForceLimits(world_normals={2: outward})
    touches = Allowance(BodyRef.of_link("r_hook"), BodyRef.of_piece("wall"), 0.005)
    pose = solve_equilibrium_pose(body, contacts, guess_of(body), limits, (), terms, allowances=[touches])
    assert pose.is_feasible, pose.violations
    along = np.linalg.norm(pose.forces_n[-1, 1:])
    assert 100.0 < -pose.forces_n[-1, 0] <= 300.0
    assert along <= 0.7 * -pose.forces_n[-1, 0]
    forbidden = solve_equilibrium_pose(body, contacts, guess_of(body), limits, (), terms)
    assert any("r_hook" in line and "wall" in line for line in forbidden.violations)


def test_a_pushed_wheel_gets_its_load_and_no_more():
    robot = atlas_with_wheel()
    body = stand(robot)
    rim = Contact("r_tool", TIP, np.array([[0.0, 0.0, 1.0]]), 0.7, 400.0, "valve")
    on_rim = ContactPlace.at(robot, "r_tool", TIP, [0], np.array([[-0.06, -0.2, -0.1]]), "valve")
    places = [Constraint("tool on the rim", on_rim, Sense.EQUAL_ZERO, 1e-4)]
    contacts = (*make_planted_contacts(body, 0.7, 2000.0), rim)
    fixed = {robot.n - 1: 0.0}
    axis = np.array([1.0, 0.2, -0.1]) / np.linalg.norm([1.0, 0.2, -0.1])
    arm = locate_links(body.engine, body.nominal, ["valve"])["valve"][:3, 3]
    for load in (0.0, 12.0):
        limits = ForceLimits(world_normals={2: UP}, mechanism_loads={"valve_turn": load})
        pose = solve_equilibrium_pose(body, contacts, guess_of(body), limits, (), places, fixed=fixed)
        assert pose.is_feasible, pose.violations
        torque = axis @ np.cross(pose.places[-1] - arm, -pose.forces_n[-1])
        assert torque == pytest.approx(load, abs=1e-3)
    assert pose.forces_n[-1, 2] > 20.0


def test_contacts_find_their_places_on_patches():
    robot = atlas()
    body = replace(stand(), planted=())
    soles = {foot.link: foot.sole for foot in stand().planted}
    hip = np.array([[x, y, -0.095] for x in (-0.1, 0.1) for y in (-0.12, 0.12)])
    patches = {
        "pelvis": (hip, 0.7, (-0.25, 0.1, -0.2, 0.2)),
        "l_foot": (soles["l_foot"], 0.0, (0.1, 0.7, 0.0, 0.4)),
        "r_foot": (soles["r_foot"], -0.1, (0.1, 0.55, -0.5, -0.2)),
    }
    edges = np.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 1.0, 0.0]])
    contacts, places = [], []
    for link, (points, height, box) in patches.items():
        contacts.append(Contact(link, points, np.tile(UP, (4, 1)), 0.7, 1500.0))
        level = ContactPlace.on_plane(robot, link, points, [0], UP, height)
        inside = ContactPlace.inside(robot, link, points, [0], edges, np.array(box) * [-1.0, 1.0, -1.0, 1.0])
        places += [Constraint(f"{link} on plane", level, Sense.EQUAL_ZERO, 1e-4)]
        places += [Constraint(f"{link} in patch", inside, tolerance=1e-4)]
    pose = solve_equilibrium_pose(body, contacts, guess_of(body), constraints=places)
    assert pose.is_feasible, pose.violations
    for spots, (_, height, box) in zip(pose.places.reshape(3, 4, 3), patches.values(), strict=True):
        np.testing.assert_allclose(spots[:, 2], height, atol=1e-3)
        low, high = spots[:, :2].min(axis=0), spots[:, :2].max(axis=0)
        assert (low >= np.array([box[0], box[2]]) - 2e-4).all()
        assert (high <= np.array([box[1], box[3]]) + 2e-4).all()
    assert pose.forces_n[:4, 2].sum() > 300.0  # it sits


def test_a_cost_of_forces_unloads_a_foot():
    body = stand()
    contacts = make_planted_contacts(body, 0.7, 2000.0)
    points = ContactPoints.of(body.robot, contacts)
    on_left = Cost("left foot", ContactForce(points, [0], gain=np.array([1.0] * 4 + [0.0] * 4)), weight=50.0)
    shares = []
    for terms in ((), (on_left,)):
        pose = solve_equilibrium_pose(body, contacts, guess_of(body), force_terms=terms)
        assert pose.is_feasible
        shares.append(pose.forces_n[:4, 2].sum() / measure_weight(body.robot))
    assert shares[0] == pytest.approx(0.5, abs=0.05)
    assert shares[1] < 0.25


def test_widened_constraints_keep_their_figures():
    body = stand()
    lower, upper = body.bounds(2, {})
    own = Constraint("own", CentreOfMassAt(np.zeros(2), [1]), Sense.EQUAL_ZERO, 0.3, 7.0, "m", 0.4)
    narrow = body.make_problem(lower, upper, body.make_checker(), constraints=[own])
    points = ContactPoints.of(body.robot, make_planted_contacts(body, 0.7, 2000.0))
    wide = add_forces(narrow, points, ())
    assert wide.lower.shape == (2, body.robot.n + 24)
    for first, second in zip((*narrow.costs, *narrow.constraints), (*wide.costs, *wide.constraints), strict=True):
        for field in fields(first):
            if field.name != "residual":
                assert getattr(first, field.name) == getattr(second, field.name)


@settings(max_examples=12)
@given(seed=st.integers(0, 10_000))
def test_forces_exist_where_the_static_region_says_so(seed):
    robot, rng = atlas(), np.random.default_rng(seed)
    body = stand()
    q = body.nominal + 0.1 * rng.normal(size=robot.n)
    up = np.array([0.2, -0.1, 1.0]) / np.linalg.norm([0.2, -0.1, 1.0])
    contacts = (
        *make_planted_contacts(body, 0.5, 900.0),
        Contact("l_hand", 0.1 * rng.normal(size=(1, 3)), up[None], 0.4, 150.0),
    )
    poses = locate_links(body.engine, q, [contact.link for contact in contacts])
    points = ContactPoints.of(robot, contacts).lean_up(body.engine(q[None]))
    reserve = ForceRows.at(body.engine, q, points).measure_reserve(None)
    if abs(reserve) < 0.5:
        return  # too close to call within both programs' tolerances
    placed = WorldContacts.join(contact.place(poses[contact.link]) for contact in contacts)
    try:
        region = find_static_region(placed, measure_weight(robot) / 9.81)
    except StaticRegionError:
        assert reserve < 0.0
        return
    assert bool(region.contains(body.engine(q[None]).com[:, :2])[0]) == (reserve > 0.0)


def test_torque_leaves_the_reserve_of_forces_alone():
    pose = lean_on_bar(torque_share=None)
    body = stand()
    rows = ForceRows.at(body.engine, pose.q, pose.points)
    least, forces = rows.spread_torque()
    assert rows.measure_shares(forces).max() == pytest.approx(least)
    assert least == pytest.approx(pose.least_torque_share)
    assert rows.find_least(least - 1e-4) is None
    assert rows.find_least(least + 1e-4) is not None
    (A, a), (U, u), (E, e) = rows.inside, rows.used, rows.balance
    share = least + 0.02
    inequalities = np.block([[A, rows.length[:, None]], [U, np.zeros((len(U), 1))], [-U, np.zeros((len(U), 1))]])
    reference = linprog(
        [0.0] * A.shape[1] + [-1.0], inequalities, np.concatenate([-a, share - u, share + u]),
        np.column_stack([E, 0.0 * e]), -e, bounds=(None, None),
    )  # fmt: skip
    assert rows.measure_reserve(share) == pytest.approx(-rows.weight_n * reference.fun, abs=1e-3)
    assert rows.measure_reserve(share) < rows.measure_reserve(None) - 1.0


def test_a_smooth_contact_takes_no_reserve_away():
    body = stand()
    wall = Contact("l_tool", TIP, UP[None], 0.0, 400.0)
    contacts = (*make_planted_contacts(body, 0.7, 2000.0), wall)
    limits = ForceLimits(margin_n=20.0, world_normals={2: UP})
    pose = solve_equilibrium_pose(body, contacts, guess_of(body), limits)
    assert pose.is_feasible, pose.violations
    assert pose.reserve_n >= 20.0
    np.testing.assert_allclose(pose.forces_n[-1, :2], 0.0, atol=1e-3)


def test_a_free_wheel_carries_nobody():
    robot = atlas_with_wheel()
    body = stand(robot)
    spot = locate_links(body.engine, body.nominal, ["valve"])["valve"][:3, 3] + [-0.06, -0.2, -0.1]
    on_rim = ContactPlace.at(robot, "r_tool", TIP, [0], spot[None])
    terms = [Constraint("tool on the rim", on_rim, Sense.EQUAL_ZERO, 1e-4), centre_at(0.25)]
    limits = ForceLimits(torque_share=None, world_normals={2: UP})
    poses = []
    for reference in ("valve", None):
        rim = Contact("r_tool", TIP, UP[None], 0.7, 600.0, reference)
        contacts = (*make_planted_contacts(body, 0.7, 2000.0), rim)
        fixed = {robot.n - 1: 0.0}
        poses.append(solve_equilibrium_pose(body, contacts, guess_of(body), limits, (), terms, fixed=fixed))
    free, rigid = poses
    assert rigid.is_feasible, rigid.violations
    assert rigid.forces_n[-1, 2] > 100.0
    assert not free.is_feasible
    assert "mechanism load" in free.result.violation  # the optimiser knew of it, not only the check of the forces


def test_planted_soles_are_pushed_up_however_the_foot_stands():
    body = stand()
    turned = Rotation.from_euler("zyx", [0.5, 0.3, -0.2]).as_matrix()
    pose = body.planted[0].pose_world_link.copy()
    pose[:3, :3] = turned
    tilted = replace(body, planted=(replace(body.planted[0], pose_world_link=pose),))
    (contact,) = make_planted_contacts(tilted, 0.7, 2000.0)
    np.testing.assert_allclose(contact.normals @ turned.T, np.tile(UP, (4, 1)), atol=1e-12)


def test_a_fixed_base_is_refused():
    arm = chain(SPATIAL)
    body = WholeBody.standing(arm, Scene(()), np.zeros(4), (), Aims())
    contact = Contact("tip", TIP, UP[None], 0.5, 100.0)
    with pytest.raises(ValueError, match="robot 'chain' has a fixed base"):
        solve_equilibrium_pose(body, (contact,), np.zeros(4))


def test_a_pose_needs_contacts_and_a_guess():
    body = stand()
    with pytest.raises(ValueError, match=r"guess must be finite with shape \(36,\), got shape \(35,\)"):
        solve_equilibrium_pose(body, make_planted_contacts(body, 0.7, 2000.0), body.nominal[1:])
    with pytest.raises(ValueError, match="at least one contact"):
        solve_equilibrium_pose(body, (), body.nominal)
