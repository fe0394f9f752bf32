"""Kept relative poses: what a request may ask, what the optimiser and the curve hold."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from jacobian import check_jacobian
from scipy.spatial.transform import Rotation
from tiny_robots import atlas, contact_free_state, random_configurations

from costs.kinematics import KinematicsEngine
from scopt import Sense
from service.body.holds import KeptPose, relative_pose
from service.body.kept import make_kept_poses
from service.errors import RequestError
from service.request.keep import KeepRequest

READY = "reach_ready"


def _kept(**more: Any) -> KeptPose:
    robot = atlas()
    (kept,) = make_kept_poses(robot, robot.postures[READY], [KeepRequest("l_hand", "r_hand", **more)])
    return kept


def _problems(*keep: KeepRequest) -> tuple[str, ...]:
    robot = atlas()
    with pytest.raises(RequestError) as caught:
        make_kept_poses(robot, robot.postures[READY], keep)
    return caught.value.problems


def _quaternion(rotation: Rotation) -> tuple[float, float, float, float]:
    w, x, y, z = rotation.as_quat(scalar_first=True)
    return (w, x, y, z)


def test_by_default_the_pose_at_the_start_is_kept() -> None:
    kept = _kept()
    np.testing.assert_array_equal(kept.wanted, kept.held)
    # the posture is symmetric: the hands stand side by side
    assert np.linalg.norm(kept.held[:3, 3]) == pytest.approx(0.642, abs=1e-3)


def test_a_given_pose_is_what_is_certified_and_the_start_what_is_held() -> None:
    held = _kept().held
    turned = Rotation.from_rotvec([0.0, 0.0, 0.008]) * Rotation.from_matrix(held[:3, :3])
    kept = _kept(position=tuple(held[:3, 3] + [0.0, 0.002, 0.0]), quaternion_wxyz=_quaternion(turned))
    np.testing.assert_array_equal(kept.held, held)
    assert kept.errors(kept.held) == pytest.approx((0.002, 0.008), abs=1e-9)
    np.testing.assert_array_equal(kept.target().position, kept.wanted[:3, 3])


def test_a_start_that_is_not_as_asked_says_by_how_much() -> None:
    held = _kept().held
    turned = Rotation.from_rotvec([0.0, 0.1, 0.0]) * Rotation.from_matrix(held[:3, :3])
    moved = tuple(held[:3, 3] + [0.03, 0.0, 0.0])
    assert _problems(KeepRequest("l_hand", "r_hand", moved, _quaternion(turned))) == (
        "keep[0]: at the start l_hand relative to r_hand is 30.0 mm off the requested position; "
        "expected at most 2.5 mm, half of position_tolerance_m",
        "keep[0]: at the start l_hand relative to r_hand is 5.7 deg off the requested orientation; "
        "expected at most 0.5 deg, half of rotation_tolerance_deg",
    )


def test_about_the_free_axis_the_start_may_be_turned() -> None:
    held = _kept().held
    turned = Rotation.from_matrix(held[:3, :3]) * Rotation.from_rotvec([0.0, 0.7, 0.0])
    kept = _kept(quaternion_wxyz=_quaternion(turned), free_axis="y")
    assert kept.errors(kept.held)[1] == pytest.approx(0.0, abs=1e-9)
    assert "is 40.1 deg off" in _problems(
        KeepRequest("l_hand", "r_hand", quaternion_wxyz=_quaternion(turned), free_axis="x")
    )[0]  # fmt: skip


def test_what_no_joint_moves_and_what_is_kept_twice_is_refused() -> None:
    rigid, twice = KeepRequest("l_hand", "l_tool"), KeepRequest("l_hand", "r_hand")
    assert _problems(rigid) == ("keep[0]: no joint moves l_hand relative to l_tool; leave it out",)
    assert _problems(twice, KeepRequest("r_hand", "l_hand")) == (
        "keep[1]: r_hand relative to l_hand is kept by keep[0] already; leave one out",
    )


@pytest.mark.parametrize("free_axis", ["none", "y"])
@pytest.mark.parametrize("reference", ["r_hand", None])
def test_the_constraints_have_true_jacobians_and_vanish_at_the_start(reference: str | None, free_axis: Any) -> None:
    robot = atlas()
    start = robot.postures[READY]
    (kept,) = make_kept_poses(robot, start, [KeepRequest("l_hand", reference, free_axis=free_axis)])
    x = start + 0.1 * random_configurations(robot, np.random.default_rng(5), 3)
    for constraint in kept.constraints(robot, np.arange(3)):
        check_jacobian(constraint.residual, contact_free_state(robot), x)
        at_start = constraint.residual.value(contact_free_state(robot)(start[None].repeat(3, axis=0)))
        np.testing.assert_allclose(at_start, 0.0, atol=1e-12)


@pytest.mark.parametrize("free_axis", ["none", "y"])
@pytest.mark.parametrize("reference", ["r_hand", None])
def test_wide_tolerances_are_regions_with_true_jacobians(reference: str | None, free_axis: Any) -> None:
    robot = atlas()
    start, wide = robot.postures[READY], {"position_tolerance_m": 0.1, "rotation_tolerance_deg": 150.0}
    (kept,) = make_kept_poses(robot, start, [KeepRequest("l_hand", reference, free_axis=free_axis, **wide)])
    assert kept.holds(robot) == ()
    x = start + 0.3 * random_configurations(robot, np.random.default_rng(5), 6)
    state = contact_free_state(robot)(x)
    for constraint, errors, most in zip(
        kept.constraints(robot, np.arange(6)),
        zip(*(kept.errors(relative_pose(robot, q, "l_hand", reference)) for q in x), strict=True),
        (0.1, np.deg2rad(150.0)),
        strict=True,
    ):
        assert constraint.sense is Sense.AT_MOST_ZERO
        check_jacobian(constraint.residual, contact_free_state(robot), x)
        np.testing.assert_allclose(constraint.residual.value(state), np.subtract(errors, 0.9 * most), atol=1e-9)
    engine = KinematicsEngine(robot)
    for q in x:
        distance, angle = kept.errors(relative_pose(robot, q, "l_hand", reference))
        inside = distance <= 0.09 and angle <= np.deg2rad(135.0)
        assert kept.are_within(robot, engine.place(q[None])) == inside


def test_a_region_of_the_place_leaves_the_orientation_held() -> None:
    kept = _kept(position_tolerance_m=0.5)
    position, orientation = kept.constraints(atlas(), np.arange(2))
    assert (position.sense, orientation.sense) == (Sense.AT_MOST_ZERO, Sense.EQUAL_ZERO)
    assert len(kept.holds(atlas())) == 1
    assert kept.drift == pytest.approx(0.0005)


def test_errors_are_those_of_the_poses_by_hand() -> None:
    kept = KeptPose("l_hand", "r_hand", np.eye(4), np.eye(4), 0.01, 0.01, np.array([1.0, 0.0, 0.0]))
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("xz", [0.5, 0.3]).as_matrix()
    pose[:3, 3] = [0.0, 3.0, 4.0]
    # turned about its x axis, which is free, and then by 0.3 about z, which takes the x axis along
    assert kept.errors(pose) == pytest.approx((5.0, 0.3))


def test_the_relative_pose_is_that_of_the_frames() -> None:
    robot = atlas()
    q = robot.postures[READY]
    left, right = (relative_pose(robot, q, hand, None) for hand in ("l_hand", "r_hand"))
    np.testing.assert_allclose(right @ relative_pose(robot, q, "l_hand", "r_hand"), left, atol=1e-12)
