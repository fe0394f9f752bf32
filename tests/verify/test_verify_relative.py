"""Kept relative poses: bounded along the whole curve by the joints between the two frames, and refuted where broken."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_robots import dense_points, random_curve, random_model, robot_of

from costs.curve import Curve
from costs.robot.model import RobotModel
from costs.scene import Scene
from service.verify import Basis, Check, Motion, Phase, RelativePoseTarget, Status, VerifyError, verify

Z = np.array([0.0, 0.0, 1.0])
APART = np.array([0.0, 0.5, 0.0])  # of the two shoulders [m]


def _two_arms(length: float = 0.4) -> RobotModel:
    """A waist about z and two arms beside it that turn about z, each with a frame at its end."""
    model = pin.Model()
    waist = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "waist")
    for name, side in (("left", 0.5), ("right", -0.5)):
        arm = model.addJoint(waist, pin.JointModelRZ(), pin.SE3(np.eye(3), side * APART), name)
        model.appendBodyToJoint(arm, pin.Inertia(1.0, np.zeros(3), 1e-3 * np.eye(3)), pin.SE3.Identity())
        model.addFrame(pin.Frame(name, arm, 0, pin.SE3(np.eye(3), length * np.eye(3)[0]), pin.FrameType.OP_FRAME))
    return robot_of(model, [])


def _side_by_side(**more: object) -> RelativePoseTarget:
    """The left end 0.5 m to the left of the right one, both looking the same way."""
    wanted = {"position": APART, "rotation": np.eye(3), "position_tolerance_m": 1e-3, "rotation_tolerance_rad": 1e-2}
    return RelativePoseTarget("left", "right", **{**wanted, **more})  # type: ignore[arg-type]


def _motion(positions: list[list[float]], tangents: list[list[float]], target: RelativePoseTarget) -> Motion:
    curve = Curve(np.arange(float(len(positions))), np.array(positions), np.array(tangents))
    phase = Phase("carry", 0.0, len(positions) - 1.0, targets=(target,))
    return Motion(_two_arms(), Scene(), curve, phases=(phase,))


def _checks(motion: Motion) -> tuple[Check, Check]:
    """Of the place, of the rotation."""
    checks = {check.name: check for check in verify(motion).checks}
    return checks["keep.carry.left.right"], checks["keep.carry.left.right.rotation"]


def test_what_moves_both_frames_does_not_count() -> None:
    # The waist turns by two radians, which carries both ends along.
    place, rotation = _checks(_motion([[-1.0, 0.3, 0.3], [1.0, 0.3, 0.3]], [[2.0, 0.0, 0.0]] * 2, _at_angle(0.3)))
    for check in (place, rotation):
        assert check.ok
        assert check.basis is Basis.PROOF
        assert check.value < 1e-9


def _at_angle(angle: float, **more: object) -> RelativePoseTarget:
    """As kept by two arms that are both turned by ``angle``."""
    return _side_by_side(position=pin.exp3(-angle * Z) @ APART, **more)


def test_a_frame_that_leaves_its_place_only_between_the_knots_is_found() -> None:
    # Both knots are right; the tangents turn the left arm by 0.02 / 4 half-way, 2 sin(0.0025) 0.4 m off its place.
    positions, tangents = [[0.0] * 3, [0.0] * 3], [[0.0, 0.02, 0.0], [0.0, -0.02, 0.0]]
    turn = 0.02 / 4.0
    drift = 0.4 * 2.0 * np.sin(0.5 * turn)
    for share, expected in ((1.02, True), (0.98, False)):
        target = _side_by_side(position_tolerance_m=share * drift, rotation_tolerance_rad=share * turn)
        place, rotation = _checks(_motion(positions, tangents, target))
        assert place.ok is rotation.ok is expected
        assert place.value == pytest.approx(drift, rel=0.06)
        assert rotation.value == pytest.approx(turn, rel=0.06)
        assert (place.limit, rotation.limit) == (target.position_tolerance_m, target.rotation_tolerance_rad)


def test_a_broken_pose_says_by_how_much_and_where() -> None:
    motion = _motion([[0.0, 0.0, 0.0], [0.0, 0.1, 0.0]], [[0.0, 0.1, 0.0]] * 2, _side_by_side())
    assert verify(motion).status is Status.VIOLATED
    place, rotation = _checks(motion)
    assert place.text.startswith("left is ")
    assert place.text.endswith("mm off its place relative to right during carry")
    assert rotation.text == "left turns by 5.730 deg relative to right during carry"
    assert rotation.value == pytest.approx(0.1)
    assert rotation.where is not None
    assert rotation.where.names == ("left", "right")
    # where the left end is in the world then
    np.testing.assert_allclose(rotation.where.position, [0.4 * np.cos(0.1), 0.25 + 0.4 * np.sin(0.1), 0.0], atol=1e-9)


def test_about_its_free_axis_a_frame_may_turn() -> None:
    positions, tangents = [[0.0, 0.0, 0.0], [0.0, 0.1, 0.0]], [[0.0, 0.1, 0.0]] * 2
    for axis, expected in ((Z, 0.0), (np.eye(3)[0], 0.1)):
        _, rotation = _checks(_motion(positions, tangents, _side_by_side(free_axis=axis)))
        assert rotation.ok is (expected == 0.0)
        assert rotation.value == pytest.approx(
            expected, abs=0.01 / 20.0
        )  # bounds are sharpened to a share of the limit


def test_half_a_turn_is_no_small_error() -> None:
    _, rotation = _checks(_motion([[0.0, np.pi, 0.0]] * 2, [[0.0] * 3] * 2, _side_by_side()))
    assert not rotation.ok
    assert rotation.value == pytest.approx(np.pi)


def test_an_unknown_reference_is_refused_by_name() -> None:
    with pytest.raises(VerifyError, match="unknown frame 'wrong'"):
        verify(_motion([[0.0] * 3] * 2, [[0.0] * 3] * 2, replace(_side_by_side(), reference="wrong")))


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1), st.booleans())
def test_proven_errors_hold_at_dense_samples(seed: int, is_in_world: bool) -> None:
    rng = np.random.default_rng(seed)
    model = random_model(rng, 6, is_floating=True, branches=True)
    curve = random_curve(rng, model.nq, 2, spread=0.15)
    first, second = (int(joint) for joint in rng.choice(np.arange(1, model.njoints), 2, replace=False))
    s = np.linspace(curve.knots[0], curve.knots[-1], 201)
    corners = np.array([np.zeros(3), *np.eye(3)])
    path = dense_points(model, curve, s, first, corners)
    other = np.tile(corners, (len(s), 1, 1)) if is_in_world else dense_points(model, curve, s, second, corners)
    axes = other[:, 1:] - other[:, :1]  # rows: the reference's axes in the world
    local = np.einsum("sik,sck->sci", axes, path - other[:, :1])
    rotation = (local[:, 1:] - local[:, :1]).transpose(0, 2, 1)
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    shift = np.linalg.norm(local[:, 0] - local[0, 0], axis=1).max()
    turn = max(np.linalg.norm(pin.log3(rotation[0].T @ now)) for now in rotation)
    lean = np.arccos(np.clip(rotation @ axis @ (rotation[0] @ axis), -1.0, 1.0)).max()
    reference = None if is_in_world else f"frame{second}"
    for free, angle in ((None, turn), (axis, lean)):
        target = RelativePoseTarget(f"frame{first}", reference, local[0, 0], rotation[0], 10.0, np.pi, free)
        phase = Phase("p", curve.knots[0], curve.knots[-1], targets=(target,))
        checks = {
            check.name: check for check in verify(Motion(robot_of(model, []), Scene(), curve, None, (phase,))).checks
        }
        name = f"keep.p.frame{first}.{reference or 'world'}"
        assert shift <= checks[name].value + 1e-9
        assert angle <= checks[f"{name}.rotation"].value + 1e-6
