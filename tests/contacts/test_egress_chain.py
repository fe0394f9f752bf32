"""Chains of poses in the shipped car: identical contact points and equilibrium, by pinocchio alone."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from egress_car import car, phases, solver, stages, task
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation
from tiny_robots import PLANAR, chain

from costs.contact import GRAVITY, Contact
from costs.scene import Scene
from service.body.aims import Aims
from service.body.forces.loaded_regions import plan_contact_region
from service.body.whole_body import WholeBody
from service.demands.contacts.stances import Surface
from service.request.tasks.egress import WeightsRequest
from service.tasks.egress.aims import ContactAim
from service.tasks.egress.chain import BrokenChain, Chain, link_poses
from service.tasks.egress.plan import explain_missing, find_sequences, make_all_stages, make_graph, solve_poses
from service.tasks.egress.poses import PoseSolver, Shape
from service.tasks.egress.stages import find_changes

DRAWN = 3  # a drawn place of the right foot from which all phases link
FIRST, LAST = 6, 9  # from the arms on the bar to the left foot on the platform


@pytest.fixture(scope="module")
def whole() -> Chain:
    """The shipped phases from the seat to standing."""
    robot, scene = car()
    drawn = make_all_stages(robot, scene, task(), phases())[DRAWN]
    found = link_poses(PoseSolver.of(robot, scene, task().torque_share, task().margin_n), drawn)
    assert isinstance(found, Chain), found.reason
    return found


@pytest.fixture(scope="module")
def linked(whole: Chain) -> Chain:
    """A part of them."""
    part = slice(FIRST, LAST + 1)
    return replace(
        whole, stances=whole.stances[part], poses=whole.poses[part], transitions=whole.transitions[FIRST:LAST]
    )


def place_points(robot, q, contact):
    """(C, 3) points of a patch in the world, by pinocchio's forward kinematics."""
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    pose = data.oMf[robot.model.getFrameId(contact.planted.link)]
    return np.array([pose.act(point) for point in contact.planted.sole])


def measure_imbalance(robot, pose):
    """What is left of the base's force and moment [N, N m] by recursive Newton-Euler, and the joints' torques."""
    model = robot.model
    data = model.createData()
    pin.framesForwardKinematics(model, data, pose.q)
    external = [pin.Force.Zero() for _ in range(model.njoints)]
    for joint, place, force in zip(pose.points.places.joint, pose.places, pose.forces_n, strict=True):
        there = data.oMi[int(joint)]
        local = there.rotation.T @ force
        external[int(joint)] += pin.Force(local, np.cross(there.actInv(place), local))
    still = np.zeros(model.nv)
    torque = pin.rnea(model, data, pose.q, still, still, external)
    return np.abs(torque[:6]).max(), torque[6:]


def test_kept_contacts_are_the_same_points_in_every_pose(linked):
    robot, _ = car()
    for before, after, pose, following, between in zip(
        linked.stances, linked.stances[1:], linked.poses, linked.poses[1:], linked.transitions, strict=False
    ):
        kept = before.keep_common(after)
        assert {contact.patch for contact in kept} == set(between.kept)
        for contact in kept:
            there = [pose, following, *(q for q in (between.leaving, between.arriving) if q is not None)]
            for other in there:
                assert np.abs(place_points(robot, other.q, contact) - contact.points).max() <= 1e-4
    for stance, pose in zip(linked.stances, linked.poses, strict=True):
        for contact in stance.contacts:
            assert np.abs(place_points(robot, pose.q, contact) - contact.points).max() <= 1e-4
            assert np.abs(contact.surface.measure_height(contact.points)).max() <= 1e-4
            assert contact.surface.measure_outside(contact.points).max() <= 1e-4


def test_all_contacts_of_both_stances_are_in_place_where_the_robot_stands_on_the_common_ones(linked):
    robot, _ = car()
    for before, after, between in zip(linked.stances, linked.stances[1:], linked.transitions, strict=False):
        for stance, pose in ((before, between.leaving), (after, between.arriving)):
            if pose is not None:
                links = {robot.contacts[patch].link for patch in between.kept}
                joints = {robot.model.frames[robot.model.getFrameId(link)].parentJoint for link in links}
                assert {int(joint) for joint in pose.points.places.joint} == joints
                for contact in stance.contacts:
                    assert np.abs(place_points(robot, pose.q, contact) - contact.points).max() <= 1e-4


def test_every_pose_of_a_chain_is_in_equilibrium_within_limits_by_inverse_dynamics(linked):
    robot, _ = car()
    named = linked.list_poses()
    assert len(named) == 1 + 6 + 3
    for name, pose in named:
        imbalance, torque = measure_imbalance(robot, pose)
        assert imbalance < 1e-3, name
        assert (np.abs(torque) <= robot.effort[6:] * (1.0 + 1e-6)).all(), name
        assert ((pose.q >= robot.lower) & (pose.q <= robot.upper)).all(), name
        normals = np.einsum("ci,ci->c", pose.forces_n, find_normals(linked, pose))
        across = np.linalg.norm(pose.forces_n, axis=1) ** 2 - normals**2
        assert (normals >= -1e-6).all(), name
        assert (np.sqrt(np.maximum(across, 0.0)) <= pose.points.friction * normals + 1e-6).all(), name


BAR_AXIS = np.array([0.45, 0.0, 1.285])  # a point of the wooden bar, which lies along y


def find_normals(linked, pose):
    """(C, 3) normal of the surface nearest to each point of a pose; on the round bar away from its axis."""
    contacts = [contact for stance in linked.stances for contact in stance.contacts]

    def find_normal(place):
        nearest = min(contacts, key=lambda contact: np.linalg.norm(contact.points - place, axis=1).min())
        if not nearest.surface.name.startswith("bar"):
            return nearest.surface.normal
        outwards = (place - BAR_AXIS) * [1.0, 0.0, 1.0]
        return outwards / np.linalg.norm(outwards)

    return np.array([find_normal(place) for place in pose.places])


def test_the_shipped_phases_link_from_the_seat_to_standing_with_room_for_errors_of_forces(whole):
    robot, _ = car()
    assert [stance.name for stance in whole.stances] == [phase.name for phase in phases()]
    named = whole.list_poses()
    assert len(named) == 39
    for name, pose in named:
        assert pose.reserve_n >= task().margin_n, name
        assert measure_imbalance(robot, pose)[0] < 1e-3, name
        assert pose.torque_share <= 1.0, name
    for stance, pose in zip(whole.stances, whole.poses, strict=True):
        for contact in stance.contacts:
            assert np.abs(place_points(robot, pose.q, contact) - contact.points).max() <= 1e-4
    on_feet = [(name, pose) for name, pose in named if is_on_feet_alone(robot, pose)]
    assert len(on_feet) == 6
    for name, pose in on_feet:
        assert measure_balance(robot, pose) > 0.05, name


def is_on_feet_alone(robot, pose):
    feet = {robot.model.frames[robot.model.getFrameId(foot)].parentJoint for foot in robot.link_groups["feet"]}
    return {int(joint) for joint in pose.points.places.joint} <= feet


def measure_balance(robot, pose):
    """How far the centre of mass is inside the hull of the contact points [m]."""
    corners = pose.places[ConvexHull(pose.places[:, :2]).vertices, :2]
    edges = np.roll(corners, -1, axis=0) - corners
    off = pin.centerOfMass(robot.model, robot.model.createData(), pose.q)[:2] - corners
    across = edges[:, 0] * off[:, 1] - edges[:, 1] * off[:, 0]
    return float((across / np.linalg.norm(edges, axis=1)).min())


def test_poses_of_drawn_places_make_a_sequence():
    robot, scene = car()
    all_stages = make_all_stages(robot, scene, replace(task(), samples=2), phases()[FIRST : LAST + 1])
    counts: list[int] = []

    def count(function, items):
        done = [function(item) for item in items]
        counts.append(len(done))
        return done

    poses = solve_poses(solver(), all_stages, count)
    assert counts == [1 + 2 + 2]  # the first stage once, two that are sampled
    assert sum(count.solved for count in poses.counts) == 5
    assert len(poses.nodes) == sum(count.feasible - count.duplicates for count in poses.counts)
    graph = make_graph(solver(), poses)
    assert graph.layer.max() == 2
    sequence = next(find_sequences(solver(), poses))
    cheapest = graph.find_values()[graph.layer == 0].min()
    assert cheapest <= sequence.cost + 1e-9  # the cheapest of the graph may fail once kept contacts are the same points
    assert len(sequence.chain.stances) == 4
    assert sequence.slip_m >= 0.0


def test_a_solver_sent_to_another_process_finds_the_same_pose():
    stage = stages()[0]
    sent, kept = pickle.loads(pickle.dumps((solver(), stage)))
    expected = solver().solve(stage.aims, stage.shapes[0])
    found = sent.solve(kept.aims, kept.shapes[0])
    assert found.is_feasible
    np.testing.assert_allclose(found.q, expected.q, atol=1e-9)


def test_changes_between_stages_are_named():
    assert find_changes(stages())[0] == (("right_foot",), ("right_foot",))
    assert find_changes(stages())[-6:-4] == ((("right_forearm",), ()), (("left_forearm",), ()))
    assert find_changes(stages())[-1] == ((), ())  # another pose on the same contacts


def test_a_bar_on_two_points_shares_its_weight_by_the_levers():
    # Two links of 1 kg, each 1 m long with its mass in the middle, straight along x on points at x = 0 and x = 1.5 m.
    robot = chain(PLANAR, root="floating")
    up = np.array([[0.0, 0.0, 1.0]])
    left = Contact("link1", np.array([[0.0, 0.0, -0.05]]), up, 0.5, 100.0)
    right = Contact("link2", np.array([[0.5, 0.0, -0.05]]), up, 0.5, 100.0)
    robot = replace(robot, contacts={"left": left, "right": right})
    corners = np.array([[-1.0, -1.0, 0.0], [3.0, -1.0, 0.0], [3.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
    floor = Surface("floor", corners, np.array([0.0, 0.0, 1.0]), 0.5)
    q = np.zeros(robot.n)
    q[2] = 0.05
    body = replace(WholeBody.standing(robot, Scene(()), q, (), Aims(0.0)), has_default_costs=False)
    aims = [ContactAim(name, floor, np.array([x, 0.0, 0.0])) for name, x in (("left", 0.0), ("right", 1.5))]
    shape = Shape(q, WeightsRequest(posture=1.0))
    pose = PoseSolver(body, None).solve(aims, shape)
    # Both masses are at x = 0.5 and x = 1.5: moments about the left point give the right force.
    weight = 2.0 * GRAVITY
    expected = weight / 2.0 * (0.5 + 1.5) / 1.5
    np.testing.assert_allclose(pose.forces_n[:, 2], [weight - expected, expected], atol=0.02)
    np.testing.assert_allclose(pose.places[:, 0], [0.0, 1.5], atol=1e-4)


def test_a_pose_on_known_places_keeps_the_centre_of_mass_off_the_edge_of_where_they_hold_it(linked, monkeypatch):
    between, contacts = linked.transitions[-1], linked.stances[-2].contacts
    robot, aims = solver().body.robot, [ContactAim.at(contact) for contact in contacts]
    kept = [contact.planted for contact in contacts if contact.patch in between.kept]
    region = plan_contact_region(robot, kept).region.polygon

    def find_margin():
        pose = solver().solve(aims, stages()[LAST - 1].shapes[0], linked.poses[-2].q, between.kept)
        return region.margin(pin.centerOfMass(robot.model, robot.model.createData(), pose.q)[:2])[0]

    held = find_margin()
    monkeypatch.setattr("service.body.comfort.RESERVE_WEIGHT", 1e-9)
    assert held > find_margin() + 5e-3


def lower(surface: Surface, by: float) -> Surface:
    return replace(surface, corners=surface.corners - [0.0, 0.0, by])


def reach(aims):
    """The pose of the left foot's landing with other aims."""
    return solver().solve(aims, stages()[LAST].shapes[0])


def test_a_platform_too_low_is_named_with_its_distance():
    aims = [replace(a, surface=lower(a.surface, 0.35)) if a.patch == "left_foot" else a for a in stages()[LAST].aims]
    text = "; ".join(reach(aims).violations)
    assert "left_foot on platform" in text
    assert " m" in text


def test_a_patch_out_of_reach_is_named_with_its_distance():
    far = [
        replace(a, place=a.place + np.array([0.0, 1.5, 0.0])) if a.patch == "left_forearm" else a
        for a in stages()[LAST].aims
    ]
    assert any("left_forearm on bar_top" in line and " m" in line for line in reach(far).violations)


def test_a_surface_that_faces_away_is_named():
    aims = [
        replace(a, surface=Surface("below", a.surface.corners[::-1], -a.surface.normal, 0.6, a.surface.pieces))
        if a.patch == "left_foot"
        else a
        for a in stages()[LAST].aims
    ]
    assert any("left_foot" in line for line in reach(aims).violations)


def test_without_friction_the_missing_force_is_told_in_newtons():
    smooth = [replace(a, surface=replace(a.surface, friction=0.0)) for a in stages()[LAST].aims if a.patch != "chest"]
    quick = replace(solver(), settings=replace(solver().settings, max_iterations=8))
    tilted = [replace(a, surface=tilt(a.surface, 0.4)) if a.patch.endswith("foot") else a for a in smooth]
    pose = quick.solve(tilted, stages()[LAST].shapes[0])
    assert not pose.is_feasible
    assert pose.reserve_n < 0.0
    assert any("no forces at the contacts" in line for line in pose.violations)


def tilt(surface: Surface, angle: float) -> Surface:
    """The surface turned about the world's y axis through its middle."""
    turn = Rotation.from_rotvec([0.0, angle, 0.0]).as_matrix()
    corners = (surface.corners - surface.middle) @ turn.T + surface.middle
    return replace(surface, corners=corners, normal=turn @ surface.normal)


def test_a_chain_that_breaks_says_where_and_why():
    low = [
        replace(
            stage,
            aims=tuple(replace(a, surface=lower(a.surface, 0.5)) if a.patch == "left_foot" else a for a in stage.aims),
        )
        if stage.name == "left foot out"
        else stage
        for stage in stages()[LAST - 1 : LAST + 1]
    ]
    quick = replace(solver(), settings=replace(solver().settings, max_iterations=20))
    broken = link_poses(quick, low)
    assert isinstance(broken, BrokenChain)
    assert broken.stage == 1
    assert "left_foot on platform" in broken.reason


def test_stages_without_a_pose_are_explained():
    robot, scene = car()
    surfaces = dict(task().surfaces)
    bar = surfaces["bar_top"]
    surfaces["bar_top"] = replace(bar, corners=tuple((x, y, z - 0.9) for x, y, z in bar.corners))
    quick = replace(solver(), settings=replace(solver().settings, max_iterations=8))
    low = replace(task(), surfaces=surfaces, samples=1)
    poses = solve_poses(quick, make_all_stages(robot, scene, low, phases()[FIRST : FIRST + 1]))
    assert not poses.nodes
    assert any(line.startswith("no pose of 'arms on the bar'") for line in explain_missing(poses))
    assert list(find_sequences(solver(), poses)) == []
