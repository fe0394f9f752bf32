"""Regions: what is proven of them holds at dense samples, and what breaks them anywhere on their part is found."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_robots import dense_points, random_curve, random_model, robot_of

from costs.curve import Curve
from costs.scene import Scene
from service.verify import Basis, Check, Motion, Phase, RegionTarget, VerifyError, verify

FREE = {"lower": np.full(3, -np.inf), "upper": np.full(3, np.inf), "radius_m": np.inf, "distance_m": np.inf}
FREE |= {"turn_rad": np.inf, "turns_rad": np.full(3, np.inf), "axis": None, "look": None, "lean_rad": np.inf}


def _region(frame: str, **limits: Any) -> RegionTarget:
    """A region in the world that limits nothing but what is given."""
    given_limits = {"reference": None, "position": np.zeros(3), "rotation": np.eye(3), "during": np.array([0.0, 1.0])}
    return RegionTarget(frame, **{**FREE, **given_limits, **limits})  # type: ignore[arg-type]


def _slide() -> pin.Model:
    """A frame that slides along x."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "slide")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    model.addFrame(pin.Frame("tip", joint, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    return model


def _check(model: pin.Model, curve: Curve, target: RegionTarget) -> list[Check]:
    phase = Phase("p", float(curve.knots[0]), float(curve.knots[-1]), targets=(target,))
    checks = verify(Motion(robot_of(model, []), Scene(), curve, None, (phase,))).checks
    return [check for check in checks if check.name.startswith("region.")]


@pytest.mark.parametrize(("during", "is_kept"), [((0.0, 1.0), False), ((0.0, 0.45), True), ((0.55, 1.0), False)])
def test_a_region_holds_on_its_part_of_the_path_alone(during: tuple[float, float], is_kept: bool) -> None:
    # Evenly from 0 to 1 m: below 0.5 m on the first half.
    curve = Curve(np.array([0.0, 2.0]), np.array([[0.0], [1.0]]), np.full((2, 1), 0.5))
    (check,) = _check(_slide(), curve, _region("tip", upper=np.array([0.5, np.inf, np.inf]), during=np.array(during)))
    assert check.ok is is_kept
    assert (check.basis is Basis.PROOF) is is_kept
    if is_kept:  # 0.45 m at the end of the part
        assert check.value == pytest.approx(-0.05, abs=2e-3)


def test_a_bound_that_is_crossed_between_two_knots_is_found() -> None:
    # Both knots are at 0; in the middle it is 0.25 m away.
    curve = Curve(np.array([0.0, 1.0]), np.zeros((2, 1)), np.array([[1.0], [-1.0]]))
    for most, is_kept in ((0.26, True), (0.24, False)):
        target = _region("tip", lower=np.array([-most, -1.0, -1.0]), upper=np.array([most, 1.0, 1.0]))
        assert _check(_slide(), curve, target)[0].ok is is_kept


def test_a_region_that_no_pose_is_in_is_refused() -> None:
    curve = Curve(np.array([0.0, 1.0]), np.zeros((2, 1)), np.zeros((2, 1)))
    with pytest.raises(VerifyError, match="empty"):
        _check(_slide(), curve, _region("tip", lower=np.ones(3), upper=np.zeros(3)))
    with pytest.raises(VerifyError, match="shares"):
        _check(_slide(), curve, _region("tip", upper=np.ones(3), during=np.array([0.6, 0.2])))


@settings(max_examples=8)
@given(st.integers(0, 2**32 - 1), st.booleans())
def test_proven_limits_hold_at_dense_samples(seed: int, is_in_world: bool) -> None:
    rng = np.random.default_rng(seed)
    model = random_model(rng, 5, is_floating=False, branches=True)
    curve = random_curve(rng, model.nq, 2, spread=0.15)
    first, second = (int(joint) for joint in rng.choice(np.arange(1, model.njoints), 2, replace=False))
    s = np.linspace(curve.knots[0], curve.knots[-1], 101)
    corners = np.array([np.zeros(3), *np.eye(3)])
    path = dense_points(model, curve, s, first, corners)
    other = np.tile(corners, (len(s), 1, 1)) if is_in_world else dense_points(model, curve, s, second, corners)
    local = np.einsum("sik,sck->sci", other[:, 1:] - other[:, :1], path - other[:, :1])
    rotation = (local[:, 1:] - local[:, :1]).transpose(0, 2, 1)
    wanted, origin, look = pin.exp3(0.5 * rng.normal(size=3)) @ rotation[0], local[0, 0] + 0.1, rng.normal(size=3)
    offset = (local[:, 0] - origin) @ wanted
    axis = np.eye(3)[int(rng.integers(3))]
    sight = origin + wanted @ look - local[:, 0]
    cosine = np.einsum("sk,sk->s", rotation @ axis, sight) / np.linalg.norm(sight, axis=1)
    turned = np.abs([pin.log3(wanted.T @ now) for now in rotation])
    true = {
        "x": np.abs(offset[:, 0]).max(),
        "radius": np.linalg.norm(offset[:, :2], axis=1).max(),
        "distance": np.linalg.norm(offset, axis=1).max(),
        "rotation": np.linalg.norm(turned, axis=1).max(),
        "about_y": turned[:, 1].max(),
        "look": np.arccos(np.clip(cosine, -1.0, 1.0)).max(),
    }
    target = _region(
        f"frame{first}",
        reference=None if is_in_world else f"frame{second}",
        position=origin,
        rotation=wanted,
        lower=np.array([-9.0, -np.inf, -np.inf]),
        upper=np.array([9.0, np.inf, np.inf]),
        radius_m=9.0,
        distance_m=9.0,
        turn_rad=3.0,
        turns_rad=np.array([np.inf, 3.0, np.inf]),
        axis=axis,
        look=look,
        lean_rad=3.0,
    )
    found = {check.name.rsplit(".", 1)[1]: check for check in _check(model, curve, target)}
    assert found.keys() == true.keys()
    for name, largest in true.items():
        assert largest <= found[name].value + 1e-6, name
    # Limits below the samples are refuted.
    tight = replace(target, radius_m=0.9 * float(true["radius"]), lean_rad=0.9 * float(true["look"]))
    refuted = {check.name.rsplit(".", 1)[1] for check in _check(model, curve, tight) if not check.ok}
    assert refuted == {"radius", "look"}
