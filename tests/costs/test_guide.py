"""Ways of frames: closed forms of lines, arcs and screws, nearest points, and the term that keeps a frame on one."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from jacobian import check_jacobian
from scipy.spatial.transform import Rotation
from tiny_robots import SPATIAL, atlas, chain, contact_free_state, random_configurations

from costs.guide import Guide
from costs.kinematics import KinematicsEngine, locate_links
from costs.rotation import turn_towards
from costs.terms import OnGuide

Z = np.array([0.0, 0.0, 1.0])
SEEDS = st.integers(0, 2**31)


def draw(seed: int) -> Guide:
    rng = np.random.default_rng(seed)
    at, rotation = rng.normal(size=3), Rotation.random(random_state=seed).as_matrix()
    match seed % 5:
        case 0:
            return Guide.line(at, rotation, rng.normal(size=3), rng.normal(size=3))
        case 1:
            return Guide.screw(at, rotation, rng.normal(size=3), rng.normal(size=3), rng.uniform(0.3, 7.0))
        case 2:
            lead = rng.uniform(0.1, 1.0)
            return Guide.screw(at, rotation, rng.normal(size=3), rng.normal(size=3), -rng.uniform(0.3, 9.0), lead)
        case 3:
            angle = rng.uniform(0.3, 6.0)
            return Guide.screw(at, rotation, rng.normal(size=3), rng.normal(size=3), angle, turns=False)
        case _:
            return Guide.line(at, rotation, np.zeros(3), rng.normal(size=3))


def test_a_quarter_of_a_circle_is_where_geometry_has_it() -> None:
    guide = Guide.screw(np.array([1.0, 0.0, 0.0]), np.eye(3), np.zeros(3), 2.0 * Z, 0.5 * np.pi)
    np.testing.assert_allclose(guide.positions(np.array([0.0, 1.0])), [[1, 0, 0], [0, 1, 0]], atol=1e-12)
    np.testing.assert_allclose(guide.rotations(np.array([1.0]))[0], [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-12)
    assert guide.length == pytest.approx(0.5 * np.pi)


def test_a_turn_of_a_screw_leads_its_pitch_along_the_axis() -> None:
    guide = Guide.screw(np.array([0.3, 0.0, 0.0]), np.eye(3), np.zeros(3), Z, 2.0 * np.pi, 0.05)
    np.testing.assert_allclose(guide.positions(np.array([0.5, 1.0])), [[-0.3, 0, 0.025], [0.3, 0, 0.05]], atol=1e-12)
    assert guide.length == pytest.approx(np.hypot(2.0 * np.pi * 0.3, 0.05))


@given(seed=SEEDS)
def test_a_pose_of_a_way_is_found_again(seed: int) -> None:
    guide = draw(seed)
    share = np.random.default_rng(seed).uniform(0.02, 0.98, size=5)
    poses = guide.poses(share)
    near = guide.find_shares(poses[:, :3, 3], poses[:, :3, :3], share + 0.01)
    np.testing.assert_allclose(near, share, atol=1e-9)
    np.testing.assert_allclose(guide.find_shares(poses[:, :3, 3], poses[:, :3, :3]), share, atol=1e-9)


@given(seed=SEEDS)
def test_tangents_are_differences_of_places(seed: int) -> None:
    guide, share, step = draw(seed), np.linspace(0.0, 1.0, 7), 1e-6
    differences = (guide.positions(share + step) - guide.positions(share - step)) / (2.0 * step)
    np.testing.assert_allclose(guide.tangents(share), differences, atol=1e-7)


@given(seed=SEEDS)
def test_no_point_of_a_way_is_nearer_than_the_one_that_is_found(seed: int) -> None:
    guide = draw(seed - seed % 5 + 2)  # a screw
    rng = np.random.default_rng(seed)
    at = guide.positions(rng.uniform(0.3, 0.7, size=1)) + 0.01 * rng.normal(size=3)
    share = guide.find_shares(at, guide.rotations(np.full(1, 0.5)))
    found = np.linalg.norm(at - guide.positions(share))
    dense = share + np.linspace(-0.02, 0.02, 401)
    assert found <= np.linalg.norm(at - guide.positions(dense), axis=1).min() + 1e-9


@given(seed=SEEDS)
def test_no_turn_about_the_own_axis_is_nearer_than_the_one_that_is_found(seed: int) -> None:
    rotation, wanted = Rotation.random(2, random_state=seed).as_matrix()
    axis = np.random.default_rng(seed).normal(size=3)
    axis /= np.linalg.norm(axis)
    turned = turn_towards(rotation[None], wanted[None], axis)[0]
    np.testing.assert_allclose(turned @ axis, rotation @ axis, atol=1e-9)
    others = rotation @ Rotation.from_rotvec(np.outer(np.linspace(0.0, 2.0 * np.pi, 200), axis)).as_matrix()
    best = np.trace(others.transpose(0, 2, 1) @ wanted, axis1=1, axis2=2).max()
    assert np.trace(turned.T @ wanted) >= best - 1e-9


@pytest.mark.parametrize("make", [atlas, lambda: chain(SPATIAL)], ids=["atlas", "chain"])
@pytest.mark.parametrize("kind", range(5))
@pytest.mark.parametrize("free", ["none", "axis", "turn", "place"])
def test_the_derivative_on_the_way_is_exact(make, kind: int, free: str) -> None:
    robot = make()
    frame = "r_tool" if robot.is_floating else "tip"
    x = random_configurations(robot, np.random.default_rng(3), 2)
    pose = locate_links(KinematicsEngine(robot), x[0], [frame])[frame]
    drawn = draw(10 + kind)
    # The way passes the frame at a share of 0.4, so that the derivative there is that on the way.
    back = drawn.poses(np.array([0.4]))[0]
    move = pose @ np.linalg.inv(back)
    guide = Guide(
        move[:3, :3] @ drawn.position + move[:3, 3], move[:3, :3] @ drawn.rotation,
        move[:3, :3] @ drawn.centre + move[:3, 3], move[:3, :3] @ drawn.axis, drawn.angle,
        move[:3, :3] @ drawn.shift, move[:3, :3] @ drawn.turn,
    )  # fmt: skip
    axis = np.array([0.6, 0.0, 0.8]) if free == "axis" else None
    term = OnGuide(robot, frame, [0], guide, axis, turns_freely=free == "turn", moves_freely=free == "place")
    state = contact_free_state(robot)
    assert np.abs(term.value(state(x))).max(initial=0.0) < 1e-9
    step = 1e-5
    dense = term.linearize(state(x)).jacobian.toarray()
    # The basis of the rows may turn from pose to pose: lengths are compared.
    for column in np.flatnonzero(np.abs(dense).max(axis=0) > 1e-6)[:8]:
        moved = x.copy()
        moved.flat[column] += step
        assert np.linalg.norm(term.value(state(moved))) / step == pytest.approx(
            np.linalg.norm(dense[:, column]), rel=1e-3, abs=1e-4
        )


def test_a_way_that_stands_still_keeps_the_whole_pose() -> None:
    robot = chain(SPATIAL)
    x = random_configurations(robot, np.random.default_rng(5), 1)
    guide = Guide.line(np.array([0.4, 0.1, 0.3]), np.eye(3), np.zeros(3))
    assert check_jacobian(OnGuide(robot, "tip", [0], guide), contact_free_state(robot), x).shape[0] == 6
