"""Forces shared between contacts, against an exact program with friction cones (CVXPY and Clarabel)."""

from __future__ import annotations

import cvxpy as cp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from service.verify import PlantedContact
from service.verify.forces.contact_forces import TOLERANCE, ContactShare, Joints, is_held
from service.verify.forces.loaded_balance import Ground

WEIGHT = 1500.0
INSIDE = 0.9 * np.cos(np.pi / 8.0)  # pyramids of eight edges are inside their cones


def make_ground(rng: np.random.Generator, n_links: int) -> Ground:
    """Return contacts of 1 to 4 points each within a metre, that push upwards or sideways."""
    parts = []
    for _ in range(n_links):
        count = int(rng.integers(1, 5))
        normal = rng.normal(size=3) + np.array([0.0, 0.0, 1.5])
        normal /= np.linalg.norm(normal)
        points = rng.uniform(-0.5, 0.5, 3) + rng.uniform(-0.1, 0.1, (count, 3))
        friction, cap = rng.uniform(0.2, 1.0), rng.uniform(200.0, 2000.0)
        parts.append((points, np.tile(normal, (count, 1)), np.full(count, friction), np.full(count, cap)))
    return Ground(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def make_wrench(ground: Ground, forces: np.ndarray) -> np.ndarray:
    """Return the wrench of forces about the world's origin."""
    return np.concatenate([forces.sum(axis=0), np.cross(ground.points, forces).sum(axis=0)])


def draw_forces(ground: Ground, rng: np.random.Generator, inside: float) -> np.ndarray:
    """Return forces inside the shrunk cones and caps."""
    sideways = rng.normal(size=ground.points.shape)
    sideways -= (sideways * ground.normals).sum(axis=1, keepdims=True) * ground.normals
    sideways /= np.linalg.norm(sideways, axis=1, keepdims=True)
    pressed = inside * ground.caps * rng.uniform(0.0, 1.0, len(ground.caps))
    slid = inside * ground.friction * pressed * rng.uniform(0.0, 1.0, len(ground.caps))
    return np.asarray(pressed[:, None] * ground.normals + slid[:, None] * sideways)


def make_rules(ground: Ground, forces: cp.Variable) -> list[cp.Constraint]:
    """Return exact cones and caps."""
    pressed = cp.sum(cp.multiply(forces, ground.normals), axis=1)
    rules = [pressed <= ground.caps]
    for k, normal in enumerate(ground.normals):
        rules.append(cp.norm(forces[k] - pressed[k] * normal) <= ground.friction[k] * pressed[k])
    return rules


def measure_off(ground: Ground, forces: cp.Variable, wrench: cp.Expression | np.ndarray) -> cp.Expression:
    """Return what forces miss of a wrench about the world's origin, with moments about the middle of the points."""
    middle = ground.points.mean(axis=0)
    moment = sum(np.cross(arm, np.eye(3)).T @ forces[k] for k, arm in enumerate(ground.points - middle))
    shift = np.cross(middle, np.eye(3)).T
    return cp.hstack([cp.sum(forces, axis=0) - wrench[:3], moment - (wrench[3:] - shift @ wrench[:3])])


def measure_missing(ground: Ground, wrench: np.ndarray) -> float:
    """Return the least sum of what is missing of a wrench with exact cones [N, Nm]."""
    forces = cp.Variable(ground.points.shape)
    missing = cp.norm1(measure_off(ground, forces, wrench)) / WEIGHT
    problem = cp.Problem(cp.Minimize(missing), make_rules(ground, forces))
    problem.solve(solver=cp.CLARABEL)
    return float(problem.value) * WEIGHT


def find_exact_part(ground: Ground, rest: np.ndarray, more: np.ndarray) -> float:
    """Return the largest x in [0, 1] for which exact cones hold ``rest + x more``."""
    forces, part = cp.Variable(ground.points.shape), cp.Variable()
    rules = [*make_rules(ground, forces), part >= 0.0, part <= 1.0]
    rules.append(measure_off(ground, forces, rest + part * more) / WEIGHT == 0.0)
    cp.Problem(cp.Maximize(part), rules).solve(solver=cp.CLARABEL)
    return float(part.value)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10**6), n_links=st.integers(1, 4))
def test_wrenches_of_forces_inside_the_cones_are_held(seed: int, n_links: int) -> None:
    rng = np.random.default_rng(seed)
    ground = make_ground(rng, n_links)
    wrenches = np.stack([make_wrench(ground, draw_forces(ground, rng, INSIDE)) for _ in range(3)])
    held = ContactShare(ground, WEIGHT).hold(wrenches)
    assert is_held(held).all()


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10**6), n_links=st.integers(1, 4), reach=st.floats(0.5, 4.0))
def test_what_is_held_obeys_cones_caps_and_wrench_and_the_exact_program_agrees(
    seed: int, n_links: int, reach: float
) -> None:
    rng = np.random.default_rng(seed)
    ground = make_ground(rng, n_links)
    wrench = make_wrench(ground, reach * draw_forces(ground, rng, 1.0) + rng.normal(size=ground.points.shape) * 20.0)
    held = ContactShare(ground, WEIGHT).hold(wrench[None])
    exact = measure_missing(ground, wrench)
    tolerance = TOLERANCE * WEIGHT
    if held.missing_n[0] > 0.0:  # pyramids are smaller than cones: what they miss may still be held
        return
    assert exact <= 10.0 * tolerance
    force = held.forces[0]
    pressed = (force * ground.normals).sum(axis=1)
    slid = np.linalg.norm(force - pressed[:, None] * ground.normals, axis=1)
    assert (slid - ground.friction * pressed).max() <= tolerance
    assert (pressed - ground.caps).max() <= tolerance
    off = make_wrench(ground, force) - wrench
    off[3:] -= np.cross(ground.points.mean(axis=0), off[:3])
    assert np.abs(off).max() <= tolerance


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10**6), n_links=st.integers(1, 3))
def test_a_wrench_that_cones_cannot_make_is_missed(seed: int, n_links: int) -> None:
    rng = np.random.default_rng(seed)
    ground = make_ground(rng, n_links)
    wrench = np.concatenate([rng.normal(size=3) * WEIGHT, rng.normal(size=3) * 300.0])
    if measure_missing(ground, wrench) > 10.0 * TOLERANCE * WEIGHT:
        assert ContactShare(ground, WEIGHT).hold(wrench[None]).missing_n[0] > 0.0


def test_torque_limits_move_the_load_to_the_other_foot() -> None:
    ground = Ground(
        np.array([[0.1, 0.1, 0.0], [-0.1, 0.1, 0.0], [0.1, -0.1, 0.0], [-0.1, -0.1, 0.0]]),
        np.tile([0.0, 0.0, 1.0], (4, 1)),
        np.full(4, 0.6),
        np.full(4, 1000.0),
    )
    wrench = np.array([[0.0, 0.0, 800.0, 20.0, 0.0, 0.0]])
    lever = np.zeros((1, 1, 12))
    lever[0, 0, [2, 5]] = 0.5  # of the vertical forces at the points with y = 0.1
    share = ContactShare(ground, 800.0)
    for effort, is_possible in ((260.0, True), (200.0, False)):
        held = share.hold(wrench, Joints(np.zeros((1, 1)), lever, np.array([effort])))
        assert bool(is_held(held)[0]) is is_possible
        if is_possible:
            assert np.abs(held.forces[0, :2, 2].sum() * 0.5) <= effort + 1e-6


@pytest.mark.parametrize(("torque", "expected"), [(100.0, -150.0), (-100.0, -350.0), (400.0, 150.0)])
def test_contact_forces_take_off_a_torque_what_they_do_at_their_levers(torque: float, expected: float) -> None:
    # 800 N and 20 Nm about x, from points 0.2 m apart: 500 N act on the left ones, at levers of 0.5 m
    ground = Ground(
        np.array([[0.1, 0.1, 0.0], [-0.1, 0.1, 0.0], [0.1, -0.1, 0.0], [-0.1, -0.1, 0.0]]),
        np.tile([0.0, 0.0, 1.0], (4, 1)),
        np.full(4, 0.6),
        np.full(4, 1000.0),
    )
    lever = np.zeros((1, 1, 12))
    lever[0, 0, [2, 5]] = 0.5
    joints = Joints(np.array([[torque]]), lever, np.array([1000.0]))
    held = ContactShare(ground, 800.0).hold(np.array([[0.0, 0.0, 800.0, 20.0, 0.0, 0.0]]), joints)
    assert held.forces[0, :2, 2].sum() == pytest.approx(500.0, abs=1e-3)
    assert np.abs(held.shares[0]) == pytest.approx([abs(expected) / 1000.0], abs=1e-5)
    np.testing.assert_allclose(joints.measure_shares(held.forces.reshape(1, -1)), [[expected / 1000.0]], atol=1e-5)


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_the_part_of_a_motion_that_is_held_is_that_of_the_exact_cones_within_their_pyramids(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ground = make_ground(rng, 3)
    share = ContactShare(ground, WEIGHT)
    rest = make_wrench(ground, draw_forces(ground, rng, 0.5 * INSIDE))
    more = np.concatenate([rng.normal(size=3) * WEIGHT, rng.normal(size=3) * 200.0])
    part = share.find_part(rest, more, None)
    wider = ContactShare(ground._replace(friction=ground.friction / np.cos(np.pi / 8.0)), WEIGHT)
    # Pyramids are inside the cones; those of this wider friction contain them.
    assert part - 1e-4 <= find_exact_part(ground, rest, more) <= wider.find_part(rest, more, None) + 1e-4


def test_cones_within_a_tilt_are_inside_every_tilted_cone_and_below_every_cap() -> None:
    friction, cap, tilt = 0.5, 300.0, 0.2
    sole = np.array([[0.0, 0.0, 0.0]])
    contact = PlantedContact(
        "hand", np.eye(4), sole, friction=friction, force_cap_n=cap, normal=np.array([0.0, 0.0, 1.0]), tilt_rad=tilt
    )
    ground = Ground.within_tilt((contact,))
    for angle in np.linspace(0.0, 2.0 * np.pi, 9):
        side = np.array([np.cos(angle), np.sin(angle), 0.0])
        force = ground.caps[0] * (np.array([0.0, 0.0, 1.0]) + ground.friction[0] * side)
        for turn in np.linspace(0.0, 2.0 * np.pi, 17):
            for lean in (0.5 * tilt, tilt):
                normal = np.array([np.sin(lean) * np.cos(turn), np.sin(lean) * np.sin(turn), np.cos(lean)])
                pressed = force @ normal
                assert np.linalg.norm(force - pressed * normal) <= friction * pressed + 1e-9
                assert pressed <= cap + 1e-9


def test_a_contact_that_leans_more_than_its_friction_carries_nothing() -> None:
    contact = PlantedContact(
        "hand", np.eye(4), np.zeros((1, 3)), friction=0.1, normal=np.array([0.0, 0.0, 1.0]), tilt_rad=0.2
    )
    ground = Ground.within_tilt((contact,))
    assert ground.caps[0] == pytest.approx(0.0)
    level = Ground.within_tilt((PlantedContact("foot", np.eye(4), np.eye(3) * 0.1),))
    assert level.friction == pytest.approx(np.full(3, 0.6))
    assert level.caps == pytest.approx(np.full(3, 5000.0))
