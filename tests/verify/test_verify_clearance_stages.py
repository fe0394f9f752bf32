"""The stages of the clearance proof: each is a bound from below of what dense sampling finds."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pinocchio as pin
import pytest
from hull_reference import hull_distance
from hypothesis import given, settings
from hypothesis import strategies as st
from small_robots import CUBE, box, random_crowd, robot_of

from costs.curve import Curve
from costs.robot import LinkBody
from costs.scene import Scene
from service.verify import Motion, Phase, Status, VerifyError, VerifySettings, verify
from service.verify.clearance.broad_phase import bound_clearances, find_open_intervals, refine_edges
from service.verify.clearance.pair_poses import PairPoses
from service.verify.clearance.pairs import PairIntervals, PairTable, collect_pairs
from service.verify.clearance.search import examine_pairs
from service.verify.joint_chain import JointChain
from service.verify.prepared_motion import ForwardKinematics, PreparedMotion

SEEDS = st.integers(0, 2**32 - 1)


def _prepare(motion: Motion) -> tuple[PreparedMotion, PairTable, np.ndarray, np.ndarray]:
    prepared = PreparedMotion(motion)
    table = collect_pairs(motion, prepared.tree)
    edges, phase = refine_edges(prepared, table, motion.curve.knots, np.zeros(len(motion.curve.knots) - 1, dtype=int))
    return prepared, table, edges, phase


def _distance(motion: Motion, table: PairTable, pair: int, s: float) -> float:
    placed = ForwardKinematics(motion.robot.model).at(motion.curve(np.array([s])))
    sets = []
    for k in (table.mover[pair], table.holder[pair]):
        solid = table.solids[k]
        sets.append(solid.vertices @ placed.rotation[0, solid.joint].T + placed.translation[0, solid.joint])
    return hull_distance(*sets)


@settings(max_examples=30)
@given(SEEDS)
def test_pairs_left_out_follow_the_checked_ones_as_a_robot_has_them_that_checks_no_others(seed: int) -> None:
    motion = random_crowd(seed)
    prepared, table, _, _ = _prepare(motion)
    every = list(combinations(sorted({body.link for body in motion.robot.bodies}), 2))
    rng = np.random.default_rng(seed)
    chosen = [pair for pair in every if rng.random() < 0.5]
    alone = replace(motion, robot=replace(motion.robot, ignored_pairs=frozenset(every) - set(chosen)), scene=Scene(()))
    both, wanted = table.with_left_out(chosen), collect_pairs(alone, prepared.tree)
    n = len(table.mover)
    assert [both.names(pair) for pair in range(n, len(both.mover))] == [
        wanted.names(pair) for pair in range(len(wanted.mover))
    ]
    assert {both.link_names(pair) for pair in range(n, len(both.mover))} == set(chosen)
    assert both.is_left_out.tolist() == [False] * n + [True] * len(wanted.mover)
    assert np.isnan(both.allowed[n:]).all()
    assert not both.demanded[n:].any()
    again = both.without_left_out()
    for name in ("mover", "holder", "allowed", "demanded", "chain", "is_left_out"):
        np.testing.assert_array_equal(getattr(again, name), getattr(table, name))


@settings(max_examples=20)
@given(SEEDS)
def test_what_is_known_of_checked_pairs_does_not_depend_on_the_pairs_left_out(seed: int) -> None:
    motion = random_crowd(seed)
    prepared, table, _, _ = _prepare(motion)
    every = list(combinations(sorted({body.link for body in motion.robot.bodies}), 2))
    of_pieces = replace(motion, robot=replace(motion.robot, ignored_pairs=frozenset(every)))
    table = collect_pairs(of_pieces, prepared.tree)
    knots, phase = motion.curve.knots, np.zeros(len(motion.curve.knots) - 1, dtype=int)
    alone = examine_pairs(prepared, table, knots, phase, VerifySettings())
    both = examine_pairs(prepared, table.with_left_out(every), knots, phase, VerifySettings())
    own = both.without_left_out()
    np.testing.assert_array_equal(own.floors, alone.floors)
    assert set(own.proof.refuted) == set(alone.proof.refuted)
    for found, wanted in ((own.proof.proven, alone.proof.proven), (own.proof.unproven, alone.proof.unproven)):
        order = [np.lexsort([part.last, part.first, part.pair]) for part in (found, wanted)]
        np.testing.assert_array_equal(found.take(order[0]).lower, wanted.take(order[1]).lower)
    # A robot that checks the pairs finds the same ones in touch.
    checked = examine_pairs(prepared, collect_pairs(motion, prepared.tree), knots, phase, VerifySettings())
    inside = {checked.table.link_names(pair) for pair, _ in checked.proof.refuted if _is_of_links(checked.table, pair)}
    touching = both.list_touching()
    assert inside <= set(touching)
    assert {links for links, (depth, _) in touching.items() if depth > 0.0} == inside


def _is_of_links(table: PairTable, pair: int) -> bool:
    return bool(table.holder[pair] < table.n_bodies)


@settings(max_examples=40)
@given(SEEDS)
def test_floors_are_below_the_distance_at_every_pose(seed: int) -> None:
    motion = random_crowd(seed)
    prepared, table, edges, _ = _prepare(motion)
    floors = bound_clearances(prepared, table, edges, VerifySettings())
    rng = np.random.default_rng(seed)
    for _ in range(60):
        interval, pair = int(rng.integers(len(edges) - 1)), int(rng.integers(len(table.mover)))
        s = rng.uniform(edges[interval], edges[interval + 1])
        assert floors[interval, pair] <= _distance(motion, table, pair, s) + 1e-6


@pytest.mark.parametrize("is_swapped", [False, True])
def test_floors_of_two_links_count_the_arcs_of_both(is_swapped: bool) -> None:
    # A rod swings about z; at both ends its box is 1 - cos(0.3) = 0.0447 farther from the other link than half-way.
    model = pin.Model()
    turn = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "turn")
    slide = model.addJoint(0, pin.JointModelPY(), pin.SE3.Identity(), "slide")
    rod = CUBE * np.array([0.5, 1e-4, 1e-4]) + np.array([0.5, 0.0, 0.0])
    block = CUBE * np.array([0.1, 0.5, 0.1]) + np.array([1.11, 0.0, 0.0])
    bodies = [LinkBody("rod", "rod", turn, rod, rod), LinkBody("block", "block", slide, block, block)]
    robot = robot_of(model, bodies[::-1] if is_swapped else bodies)
    curve = Curve(np.arange(2.0), np.array([[-0.3, 0.0], [0.3, 0.01]]), np.array([[0.6, 0.01]] * 2))
    prepared = PreparedMotion(Motion(robot, Scene(), curve))
    table = collect_pairs(prepared.motion, prepared.tree)
    floor = bound_clearances(prepared, table, curve.knots, VerifySettings())[0, 0]
    assert 0.0 < floor <= 0.01
    assert floor == pytest.approx(0.01, abs=5e-3)


@settings(max_examples=40)
@given(SEEDS)
def test_every_pair_has_the_chain_of_its_mover_in_the_frame_of_its_holder(seed: int) -> None:
    motion = random_crowd(seed)
    prepared, table, _, _ = _prepare(motion)
    near = np.flatnonzero(np.random.default_rng(seed).random(len(table.mover)) < 0.7)
    found = table.with_chains(prepared.tree, near)
    assert np.all(found.chain[near] >= 0)
    for c in near.tolist():
        assert {found.mover[c], found.holder[c]} == {table.mover[c], table.holder[c]}
        mover, holder = found.solids[found.mover[c]], found.solids[found.holder[c]]
        expected = prepared.tree.chain(holder.joint, mover.joint, mover.vertices)
        row, m = found.chains.take(found.chain[c]), len(expected.coordinates)
        assert row.coordinates[:m].tolist() == expected.coordinates.tolist()
        assert row.joints[:m].tolist() == expected.joints.tolist()
        assert row.is_revolute[:m].tolist() == expected.is_revolute.tolist()
        assert np.allclose(row.reach[:m], expected.reach, rtol=1e-12)
        assert not np.any(row.reach[m:])


def test_floors_of_what_stands_still_far_away_are_nearly_the_distance() -> None:
    model = pin.Model()
    model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "slide")
    robot = robot_of(model, [LinkBody("slider", "slider", 1, 0.1 * CUBE, CUBE)])
    curve = Curve(np.arange(2.0), np.array([[0.0], [0.2]]), np.full((2, 1), 0.2))
    prepared, table, edges, _ = _prepare(Motion(robot, Scene((box("wall", (1.0, 0.0, 0.0), (0.1, 1.0, 1.0)),)), curve))
    assert bound_clearances(prepared, table, edges, VerifySettings()) == pytest.approx(0.6, abs=1e-8)


@settings(max_examples=40)
@given(SEEDS)
def test_a_look_separates_no_more_than_the_poses_between_and_its_bound_allow(seed: int) -> None:
    motion, rng = random_crowd(seed), np.random.default_rng(seed)
    prepared, table, edges, phase = _prepare(motion)
    floors = np.full((len(edges) - 1, len(table.mover)), -np.inf)
    start = find_open_intervals(table, edges, phase, floors, 0.1)
    start = start.take(rng.integers(len(start), size=30))
    table = table.with_chains(prepared.tree, np.unique(start.pair))
    poses = PairPoses.at(prepared, table, start, VerifySettings())
    directions = rng.normal(size=(len(start), 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    lower = poses.separation(np.arange(len(start)), directions) - poses.bound
    for row in range(len(start)):
        for s in rng.uniform(start.first[row], start.last[row], size=2):
            assert lower[row] <= _distance(motion, table, int(start.pair[row]), s) + 1e-6


def test_a_direction_that_is_not_finite_separates_nothing() -> None:
    motion = random_crowd(1)
    prepared, table, edges, phase = _prepare(motion)
    floors = np.full((len(edges) - 1, len(table.mover)), -np.inf)
    start = find_open_intervals(table, edges, phase, floors, 0.1).take(slice(0, 3))
    poses = PairPoses.at(prepared, table.with_chains(prepared.tree, np.unique(start.pair)), start, VerifySettings())
    assert np.all(poses.separation(np.arange(3), np.full((3, 3), np.nan)) == -np.inf)


def test_a_floor_that_is_not_a_number_leaves_its_pair_open() -> None:
    motion = random_crowd(2)
    _, table, edges, phase = _prepare(motion)
    floors = np.full((len(edges) - 1, len(table.mover)), 1.0)
    floors[0, 1] = np.nan
    start = find_open_intervals(table, edges, phase, floors, 0.1)
    assert start.pair.tolist() == [1]
    assert start.first.tolist() == [edges[0]]


def test_refined_edges_hold_the_old_ones_and_their_phases() -> None:
    model = pin.Model()
    model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "turn")
    robot = robot_of(model, [LinkBody("rod", "rod", 1, CUBE * 0.5, CUBE)])
    curve = Curve(np.array([0.0, 1.0, 3.0]), np.array([[0.0], [3.0], [3.0]]), np.zeros((3, 1)))
    prepared = PreparedMotion(Motion(robot, Scene(), curve))
    edges, phase = refine_edges(prepared, collect_pairs(prepared.motion, prepared.tree), curve.knots, np.array([4, 7]))
    assert set(curve.knots) <= set(edges)
    assert np.all(np.diff(edges) > 0.0)
    # Where the rod turns by 3 rad the interval is parted as far as it may be, where it stands still not at all.
    assert phase.tolist() == [4] * 8 + [7]
    assert np.array_equal(edges[:9], np.linspace(0.0, 1.0, 9))


@settings(max_examples=40)
@given(SEEDS)
def test_stacked_chains_bound_what_each_of_them_bounds(seed: int) -> None:
    motion, rng = random_crowd(seed), np.random.default_rng(seed)
    prepared, knots = PreparedMotion(motion), motion.curve.knots
    joints = rng.integers(0, motion.robot.model.njoints, size=(6, 2))
    points = rng.uniform(-0.2, 0.2, size=(6, 4, 3))
    chains = [prepared.tree.chain(int(a), int(b), p) for (a, b), p in zip(joints, points, strict=True)]
    rows = rng.integers(6, size=20)
    first = rng.uniform(knots[0], knots[1], size=20)
    over = prepared.over(first, 0.5 * (first + knots[1]))
    stacked = JointChain.stack(chains).take(rows)
    for k, row in enumerate(rows.tolist()):
        one, alone = over.take(slice(k, k + 1)), chains[row]
        assert stacked.deviation(over)[k] == pytest.approx(float(alone.deviation(one)[0]), rel=1e-12, abs=1e-15)
        assert stacked.sampling_slack(over, 1e-8)[k] == pytest.approx(float(alone.sampling_slack(one, 1e-8)[0]))


def test_placements_stay_right_as_more_are_asked_for() -> None:
    motion = random_crowd(3)
    prepared, forward = PreparedMotion(motion), ForwardKinematics(motion.robot.model)
    rng = np.random.default_rng(3)
    asked = rng.uniform(motion.curve.knots[0], motion.curve.knots[-1], size=200)
    for count in (1, 5, 3, 60, 200, 60):
        s = rng.permutation(asked[:count])
        placed, rows = prepared.at(s)
        expected = forward.at(motion.curve(s))
        assert np.array_equal(placed.rotation[rows], expected.rotation)
        assert np.array_equal(placed.translation[rows], expected.translation)


def test_halves_cover_their_interval_and_hand_on_what_is_known() -> None:
    whole = PairIntervals.unknown(np.array([7]), np.array([1.0]), np.array([3.0]), np.array([2]), np.array([0.4]))
    whole.ends[0] = [0.1, 0.3]
    halves = whole.halves(np.array([[0.0, 1.0, 0.0]]), np.array([0.2]))
    assert halves.first.tolist() == [1.0, 2.0]
    assert halves.last.tolist() == [2.0, 3.0]
    assert halves.pair.tolist() == [7, 7]
    assert halves.phase.tolist() == [2, 2]
    assert halves.halved.tolist() == [1, 1]
    assert halves.ends.tolist() == [[0.1, 0.2], [0.2, 0.3]]
    assert halves.hint.tolist() == [[0.0, 1.0, 0.0]] * 2
    assert np.all(halves.floor == -np.inf)  # the floor was that of the whole interval with its own bound


@settings(max_examples=20)
@given(SEEDS)
def test_the_columns_and_floors_of_a_proof_leave_out_nothing(seed: int) -> None:
    motion = random_crowd(seed)
    motion = Motion(
        motion.robot, motion.scene, motion.curve, phases=(Phase("all", 0.0, float(motion.curve.knots[-1])),)
    )
    certificate = verify(motion)
    if certificate.status is not Status.CERTIFIED:
        return
    prepared = PreparedMotion(motion)
    table = collect_pairs(motion, prepared.tree)
    rows = certificate.stretches
    names = [frozenset(pair) for pair in rows.pairs]
    rng = np.random.default_rng(seed)
    for _ in range(30):
        pair, s = int(rng.integers(len(table.mover))), float(rng.uniform(motion.curve.knots[0], rows.edges[-1]))
        broad = int(np.searchsorted(rows.edges, s, side="right")) - 1
        own = [
            (a, b, distance - bound)
            for row_pair, a, b, distance, bound in zip(
                rows.pair, rows.first, rows.last, rows.distance, rows.bound, strict=True
            )
            if names[row_pair] == frozenset(table.names(pair)) and rows.edges[broad] <= a and b <= rows.edges[broad + 1]
        ]
        claimed = [lower for a, b, lower in own if a <= s <= b] if own else [rows.floors[broad]]
        # An interval of the broad phase is either covered by the pair's rows, or the floor holds for the pair.
        assert claimed
        assert claimed[0] <= _distance(motion, table, pair, s) + 1e-6
        assert certificate.min_clearance_m <= claimed[0] + 2e-7


def test_configurations_that_are_not_finite_are_refused() -> None:
    motion = random_crowd(4)
    with pytest.raises(VerifyError, match="must be finite"):
        ForwardKinematics(motion.robot.model).at(np.full((1, motion.robot.n), np.nan))
