"""The rotation bound: no point of the robot ever leaves its chord by more."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_robots import let_some_follow, random_curve, random_model

from costs.curve import Curve
from service.verify.curves.bounds import Rates, position_range
from service.verify.joint_chain import JointTree
from service.verify.motion import VerifyError
from service.verify.prepared_motion import ForwardKinematics

SEEDS = st.integers(0, 2**32 - 1)


def _tree(model: pin.Model, curve: Curve, *, is_floating: bool) -> JointTree:
    low, high = position_range(curve)
    return JointTree(model, np.maximum(np.abs(low).max(axis=0), np.abs(high).max(axis=0)), 6 if is_floating else 0)


def _relative_points(model: pin.Model, q: np.ndarray, holder: int, mover: int, points: np.ndarray) -> np.ndarray:
    data = model.createData()
    found = []
    for row in q:
        pin.forwardKinematics(model, data, row)
        placed = data.oMi[holder].actInv(data.oMi[mover])
        found.append(points @ placed.rotation.T + placed.translation)
    return np.array(found)


@settings(max_examples=150)
@given(SEEDS, st.booleans(), st.booleans(), st.booleans())
def test_no_point_leaves_its_chord_by_more_than_the_bound(
    seed: int, is_floating: bool, in_joint: bool, has_followers: bool
) -> None:
    rng = np.random.default_rng(seed)
    model = random_model(rng, int(rng.integers(1, 8)), is_floating=is_floating, branches=True)
    if has_followers:
        model = let_some_follow(rng, model)
    curve = random_curve(rng, model.nq, 2)
    tree = _tree(model, curve, is_floating=is_floating)
    mover = int(rng.integers(1, model.njoints))
    holder = int(rng.integers(1, model.njoints)) if in_joint else 0
    if holder == mover:
        return
    points = rng.uniform(-0.3, 0.3, size=(4, 3))
    chain = tree.chain(holder, mover, points)
    ends = np.sort(rng.uniform(curve.knots[0], curve.knots[-1], size=2))
    over = Rates(curve, None).over(ends[:1], ends[1:])
    s = np.linspace(ends[0], ends[1], 41)
    path = _relative_points(model, curve(s), holder, mover, points)
    along = np.linspace(0.0, 1.0, 41)[:, None, None]
    off = np.linalg.norm(path - (path[0] + along * (path[-1] - path[0])), axis=2).max()
    assert off <= chain.deviation(over)[0] + 1e-12

    middle = ForwardKinematics(model).at(curve(np.array([ends.mean()])))
    world = points @ middle.rotation[0, mover].T + middle.translation[0, mover]
    origins = middle.translation[0, chain.joints]
    distance = np.linalg.norm(origins[:, None] - world[None], axis=2).max(axis=1)
    reach = chain.local_reach(distance[None], over)
    assert off <= chain.deviation(over, reach)[0] + 1e-12


@settings(max_examples=100)
@given(SEEDS, st.booleans(), st.booleans())
def test_reach_bounds_every_distance_from_a_joint_to_the_body(seed: int, in_joint: bool, has_followers: bool) -> None:
    rng = np.random.default_rng(seed)
    model = random_model(rng, int(rng.integers(2, 8)), is_floating=False, branches=True)
    if has_followers:
        model = let_some_follow(rng, model)
    curve = random_curve(rng, model.nq, 2, spread=1.0)
    mover = int(rng.integers(1, model.njoints))
    holder = int(rng.integers(1, model.njoints)) if in_joint else 0
    if holder == mover:
        return
    points = rng.uniform(-0.1, 0.1, size=(4, 3))
    chain = _tree(model, curve, is_floating=False).chain(holder, mover, points)
    ends = np.sort(rng.uniform(curve.knots[0], curve.knots[-1], size=2))
    s = np.linspace(ends[0], ends[1], 41)
    placed = ForwardKinematics(model).at(curve(s))
    world = np.einsum("sij,cj->sci", placed.rotation[:, mover], points) + placed.translation[:, None, mover]
    distance = np.linalg.norm(placed.translation[:, chain.joints, None] - world[:, None], axis=3).max(axis=2)
    local = chain.local_reach(distance[20][None], Rates(curve, None).over(ends[:1], ends[1:]))[0]
    turns = chain.is_revolute
    assert np.all(distance[:, turns] <= chain.reach[turns] + 1e-12)
    assert np.all(distance[:, turns] <= local[turns] + 1e-12)


def test_the_bound_is_nearly_reached_by_a_stretched_arm() -> None:
    # Both joints turn alike: p'' = L1 a^2 + L2 (2 a)^2, which is what the pair terms add up to.
    model = pin.Model()
    first = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "first")
    model.addJoint(first, pin.JointModelRZ(), pin.SE3(np.eye(3), np.array([0.4, 0.0, 0.0])), "second")
    turn = 0.1
    curve = Curve(np.array([0.0, 1.0]), np.array([[-turn / 2] * 2, [turn / 2] * 2]), np.full((2, 2), turn))
    tip = np.array([[0.3, 0.0, 0.0]])
    bound = (
        _tree(model, curve, is_floating=False)
        .chain(0, 2, tip)
        .deviation(Rates(curve, None).over(np.zeros(1), np.ones(1)))[0]
    )
    path = _relative_points(model, curve(np.array([0.0, 0.5, 1.0])), 0, 2, tip)[:, 0]
    deviation = np.linalg.norm(path[1] - 0.5 * (path[0] + path[2]))
    assert bound == pytest.approx((0.4 + 4 * 0.3) * turn**2 / 8.0)
    assert 0.98 * bound < deviation <= bound


def test_a_base_read_by_slerp_uses_up_part_of_its_slack() -> None:
    rng = np.random.default_rng(1)
    model = random_model(rng, 1, is_floating=True, branches=False)
    turned = np.zeros((2, model.nq))
    turned[1, 3:6] = [0.6, 0.5, -0.6]
    curve = Curve(np.array([0.0, 1.0]), turned, np.tile(turned[1], (2, 1)))
    point = np.array([[0.5, 0.0, 0.0]])
    chain = _tree(model, curve, is_floating=True).chain(0, 1, point)
    slack = chain.sampling_slack(Rates(curve, np.array([0.0, 1.0])).over(np.zeros(1), np.ones(1)), 0.0)[0]
    last = pin.rpy.rpyToMatrix(*turned[1, 5:2:-1])
    halfway = pin.exp3(0.5 * pin.log3(last)) @ point[0]
    straight = pin.rpy.rpyToMatrix(*(0.5 * turned[1, 5:2:-1])) @ point[0]
    off = np.linalg.norm(halfway - straight)
    assert 0.02 * slack < off <= slack


@settings(max_examples=60)
@given(SEEDS)
def test_the_exported_samples_read_linearly_stay_within_the_slack(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = random_model(rng, int(rng.integers(1, 6)), is_floating=True, branches=False)
    curve = random_curve(rng, model.nq, 2)
    tree = _tree(model, curve, is_floating=True)
    points = rng.uniform(-0.3, 0.3, size=(4, 3))
    mover = model.njoints - 1
    chain = tree.chain(0, mover, points)
    samples = np.linspace(curve.knots[0], curve.knots[-1], int(rng.integers(2, 9)))
    cell = int(rng.integers(0, len(samples) - 1))
    over = Rates(curve, samples).over(samples[cell : cell + 1], samples[cell + 1 : cell + 2])
    slack = chain.sampling_slack(over, 0.0)[0]
    first, last = curve(samples[cell : cell + 2])
    turns = [pin.rpy.rpyToMatrix(q[5], q[4], q[3]) for q in (first, last)]
    for part in np.linspace(0.0, 1.0, 11):
        read = first + part * (last - first)
        turn = turns[0] @ pin.exp3(part * pin.log3(turns[0].T @ turns[1]))
        read[5], read[4], read[3] = pin.rpy.matrixToRpy(turn)
        true = curve(np.array([samples[cell] + part * (samples[cell + 1] - samples[cell])]))[0]
        pair = _relative_points(model, np.array([read, true]), 0, mover, points)
        assert np.linalg.norm(pair[0] - pair[1], axis=1).max() <= slack + 1e-9


def test_counter_rotating_joints_are_bounded_although_the_link_does_not_turn() -> None:
    # Two joints turn by +0.5 and -0.5: the second link only translates, yet leaves its chord by L (1 - cos 0.25).
    length, turn = 0.6, 0.5
    model = pin.Model()
    first = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "first")
    model.addJoint(first, pin.JointModelRZ(), pin.SE3(np.eye(3), np.array([length, 0.0, 0.0])), "second")
    curve = Curve(np.array([0.0, 1.0]), np.array([[0.0, 0.0], [turn, -turn]]), np.array([[turn, -turn]] * 2))
    chain = _tree(model, curve, is_floating=False).chain(0, 2, np.zeros((1, 3)))
    over = Rates(curve, None).over(np.array([0.0]), np.array([1.0]))
    bound = chain.deviation(over)[0]
    deviation = length * (1.0 - np.cos(turn / 2.0))
    assert bound == pytest.approx(length * turn**2 / 8.0)
    assert 0.9 * bound < deviation <= bound


def test_a_base_that_only_slides_leaves_no_chord() -> None:
    rng = np.random.default_rng(3)
    model = random_model(rng, 2, is_floating=True, branches=False)
    positions = np.zeros((2, model.nq))
    positions[1, :3] = [0.4, -0.2, 0.1]
    curve = Curve(np.array([0.0, 1.0]), positions, np.tile(positions[1], (2, 1)))
    chain = _tree(model, curve, is_floating=True).chain(0, model.njoints - 1, np.ones((1, 3)))
    assert chain.deviation(Rates(curve, None).over(np.zeros(1), np.ones(1)))[0] == pytest.approx(0.0, abs=1e-15)


@settings(max_examples=60)
@given(SEEDS)
def test_rates_and_ranges_hold_at_dense_samples_and_are_reached(seed: int) -> None:
    rng = np.random.default_rng(seed)
    curve = random_curve(rng, 3, 4)
    for k in range(3):
        low, high = np.sort(rng.uniform(curve.knots[k], curve.knots[k + 1], size=2))
        over = Rates(curve, None).over(np.array([low]), np.array([high]))
        s = np.linspace(low, high, 2001)
        speed, bend = np.abs(curve(s, 1)).max(axis=0), np.abs(curve(s, 2)).max(axis=0)
        assert np.all(speed <= over.speed[0] + 1e-12)
        assert np.allclose(speed, over.speed[0], rtol=1e-3, atol=1e-9)
        assert np.all(bend <= over.bend[0] + 1e-12)
        assert np.allclose(bend, over.bend[0], rtol=1e-9)
        q = curve(np.linspace(curve.knots[k], curve.knots[k + 1], 2001))
        least, most = position_range(curve)
        assert np.all(q >= least[k] - 1e-12)
        assert np.all(q <= most[k] + 1e-12)
        assert np.allclose(q.min(axis=0), least[k], atol=1e-6)
        assert np.allclose(q.max(axis=0), most[k], atol=1e-6)


def test_a_stretch_across_a_knot_is_refused() -> None:
    curve = random_curve(np.random.default_rng(0), 2, 3)
    with pytest.raises(VerifyError, match="between two neighbouring knots"):
        Rates(curve, None).over(curve.knots[:1], curve.knots[2:])


def test_samples_without_a_knot_are_refused() -> None:
    curve = random_curve(np.random.default_rng(0), 2, 3)
    with pytest.raises(VerifyError, match="every knot"):
        Rates(curve, np.linspace(curve.knots[0], curve.knots[-1], 7)).over(curve.knots[:1], curve.knots[1:2])


def test_a_joint_that_is_neither_revolute_nor_prismatic_is_refused() -> None:
    model = pin.Model()
    model.addJoint(0, pin.JointModelHelicalUnaligned(np.array([0.0, 0.0, 1.0]), 0.1), pin.SE3.Identity(), "screw")
    with pytest.raises(VerifyError, match="'screw'"):
        JointTree(model, np.ones(1), 0)


@settings(max_examples=60)
@given(SEEDS, st.booleans())
def test_a_chain_known_of_another_motion_is_the_one_of_this_motion(seed: int, is_floating: bool) -> None:
    rng = np.random.default_rng(seed)
    model = random_model(rng, int(rng.integers(2, 8)), is_floating=is_floating, branches=True)
    points = {joint: rng.uniform(-0.3, 0.3, size=(4, 3)) for joint in range(1, model.njoints)}
    for _ in range(3):
        tree = JointTree(model, rng.choice([0.1, 0.7], model.nq), 6 if is_floating else 0)
        for mover, own in points.items():
            for holder in range(model.njoints):
                found, wanted = tree.chain_of_body(holder, mover, own), tree.chain(holder, mover, own)
                assert found.coordinates.tolist() == wanted.coordinates.tolist()
                assert found.reach.tolist() == wanted.reach.tolist()
