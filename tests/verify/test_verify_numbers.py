"""Every number that a certificate states of its targets, compared with kinematics of other code.

Links are placed by ``urdf_momentum``, which reads the URDF's text and has nothing of pinocchio; angles are scipy's.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from small_robots import random_curve, robot_of
from tiny_robots import Segment, chain_urdf
from urdf_momentum import place_frames, read_links

from costs.curve import Curve
from costs.scene import Scene
from service.verify import (
    AxisTarget,
    Basis,
    Check,
    CircleTarget,
    JointTarget,
    Motion,
    Phase,
    PoseTarget,
    RelativePoseTarget,
    Target,
    VerifyError,
    verify,
)
from service.verify.phase_proof import RESOLUTION_SHARE

SEEDS = st.integers(0, 2**32 - 1)
DENSE = 601  # samples of a curve
N_JOINTS = 4
TIP, MIDDLE = f"link{N_JOINTS}", "link2"
FREE = np.full(3, np.inf)
LAST_DIGIT = {"mm": 0.01, "deg": 0.001}
SHOWN = {"mm": 1e3, "deg": 180.0 / np.pi}


@dataclass(frozen=True)
class Claim:
    """A target, the check that is made of it, and its true errors at dense samples [m, rad]."""

    target: Target
    name: str
    errors: np.ndarray
    limit: float


@dataclass(frozen=True)
class Arm:
    """A random arm with a random curve, and its links at dense samples."""

    urdf: str
    curve: Curve
    s: np.ndarray
    turned: dict[str, np.ndarray]
    moved: dict[str, np.ndarray]

    @staticmethod
    def of(rng: np.random.Generator) -> Arm:
        segments = []
        for _ in range(N_JOINTS):
            kind = "prismatic" if rng.random() < 0.2 else "revolute"
            axis, origin = rng.normal(size=3), rng.uniform(-0.3, 0.3, size=3)
            segments.append(Segment(tuple(axis / np.linalg.norm(axis)), tuple(origin), kind=kind))
        urdf, curve = chain_urdf(segments), random_curve(rng, N_JOINTS, 3, size=1.0, spread=0.4)
        s = np.union1d(np.linspace(curve.knots[0], curve.knots[-1], DENSE), curve.knots)
        links, names = read_links(urdf), [f"joint{k}" for k in range(1, N_JOINTS + 1)]
        frames = [place_frames(links, np.eye(3), np.zeros(3), dict(zip(names, q, strict=True))) for q in curve(s)]
        turned = {link.name: np.array([frame[0][k] for frame in frames]) for k, link in enumerate(links)}
        moved = {link.name: np.array([frame[1][k] for frame in frames]) for k, link in enumerate(links)}
        return Arm(urdf, curve, s, turned, moved)

    def verify(self, *targets: Target) -> dict[str, Check]:
        robot = robot_of(pin.buildModelFromXML(self.urdf), [])
        phase = Phase("p", float(self.s[0]), float(self.s[-1]), targets=targets)
        return {check.name: check for check in verify(Motion(robot, Scene(), self.curve, phases=(phase,))).checks}


def angles(rotations: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Angles between rotations and a wanted one, by scipy."""
    return np.asarray((Rotation.from_matrix(wanted).inv() * Rotation.from_matrix(rotations)).magnitude())


def leans(directions: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Angles between directions and a wanted one."""
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(directions, wanted), axis=1), directions @ wanted))


def unit(rng: np.random.Generator) -> np.ndarray:
    v = rng.normal(size=3)
    return np.asarray(v / np.linalg.norm(v))


def make_claims(arm: Arm, rng: np.random.Generator, share: float) -> Iterator[Claim]:
    """One target of every kind along the curve, with limits a share of its largest error."""
    turned, moved = arm.turned[TIP], arm.moved[TIP]
    pose, place = Rotation.random(random_state=rng).as_matrix(), moved[0] + rng.normal(size=3) * 0.2
    wide = lambda errors: share * float(errors.max())  # noqa: E731
    angle = lambda errors: min(share * float(errors.max()), np.pi)  # noqa: E731

    off, turn = np.linalg.norm(moved - place, axis=1), angles(turned, pose)
    target = PoseTarget(TIP, place, pose, np.full(3, wide(off)), np.full(3, angle(turn)))
    yield Claim(target, f"target.p.{TIP}", off, wide(off))
    yield Claim(target, f"target.p.{TIP}.rotation", turn, angle(turn))

    along = np.abs((moved - place) @ pose)
    limits = np.array([wide(along[:, 0]), np.inf, wide(along[:, 2])])
    for axis in (0, 2):
        name = f"target.p.{TIP}.{'xyz'[axis]}"
        yield Claim(PoseTarget(TIP, place, pose, limits, FREE), name, along[:, axis], float(limits[axis]))

    own, direction = unit(rng), unit(rng)
    lean = leans(turned @ own, direction)
    yield Claim(AxisTarget(TIP, own, direction, angle(lean)), f"axis.p.{TIP}", lean, angle(lean))

    centre, normal, radius = moved[0] + rng.normal(size=3) * 0.3, unit(rng), 0.3
    height = (moved - centre) @ normal
    ring = np.hypot(height, np.linalg.norm(moved - centre - height[:, None] * normal, axis=1) - radius)
    yield Claim(CircleTarget(TIP, centre, normal, radius, wide(ring)), f"circle.p.{TIP}", ring, wide(ring))

    for reference, slide, free in ((None, None, None), (MIDDLE, rng.normal(size=3) * 0.1, None), (MIDDLE, None, own)):
        base = np.tile(np.eye(3), (len(arm.s), 1, 1)) if reference is None else arm.turned[MIDDLE]
        there = np.zeros_like(moved) if reference is None else arm.moved[MIDDLE]
        local = np.einsum("sji,sj->si", base, moved - there)
        rotation = np.einsum("sji,sjk->sik", base, turned)
        kept = local[0] + rng.normal(size=3) * 0.05
        far = np.linalg.norm(local - kept, axis=1)
        if slide is not None:
            part = np.clip((local - kept) @ slide / (slide @ slide), -1.0, 1.0)
            far = np.linalg.norm(local - kept - part[:, None] * slide, axis=1)
        bent = angles(rotation, pose) if free is None else leans(rotation @ free, pose @ free)
        keep = RelativePoseTarget(TIP, reference, kept, pose, wide(far), angle(bent), free, slide)
        name = f"keep.p.{TIP}.{reference or 'world'}"
        yield Claim(keep, name, far, wide(far))
        yield Claim(keep, f"{name}.rotation", bent, angle(bent))


def read_number(text: str) -> tuple[float, str]:
    ((number, name),) = re.findall(r"([\d.]+) (mm|deg)\b", text)
    return float(number), name


@settings(max_examples=25)
@given(SEEDS, st.floats(1.02, 4.0))
def test_stated_bounds_are_no_less_than_the_largest_error_and_near_to_it(seed: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    arm = Arm.of(rng)
    for claim in make_claims(arm, rng, share):
        check = arm.verify(claim.target)[claim.name]
        largest = float(claim.errors.max())
        room = RESOLUTION_SHARE * claim.limit
        number, unit_name = read_number(check.text)
        assert check.limit == claim.limit
        if largest > claim.limit - room:  # the proof may take more halvings than there are
            continue
        assert check.basis is Basis.PROOF, check.text
        assert largest <= check.value + 1e-9
        assert check.value <= largest + 1.01 * room, check.text
        assert check.value <= number / SHOWN[unit_name] + 1e-9
        assert number <= check.value * SHOWN[unit_name] + LAST_DIGIT[unit_name] + 1e-6


@settings(max_examples=15)
@given(SEEDS, st.floats(0.3, 0.95))
def test_a_refuted_claim_states_an_error_near_the_largest(seed: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    arm = Arm.of(rng)
    for claim in make_claims(arm, rng, share):
        check = arm.verify(claim.target)[claim.name]
        largest = float(claim.errors.max())
        number, unit_name = read_number(check.text)
        assert not check.ok
        assert claim.limit < check.value
        assert abs(check.value - largest) <= 1.01 * RESOLUTION_SHARE * claim.limit, check.text
        assert abs(number - check.value * SHOWN[unit_name]) <= LAST_DIGIT[unit_name] + 1e-6


@settings(max_examples=25)
@given(SEEDS, st.floats(0.0, 1.0))
def test_errors_at_one_pose_are_those_of_other_kinematics(seed: int, where: float) -> None:
    rng = np.random.default_rng(seed)
    arm = Arm.of(rng)
    row = int(where * (len(arm.s) - 1))
    at, turned, moved = float(arm.s[row]), arm.turned[TIP][row], arm.moved[TIP][row]
    pose, place, own, direction = (
        Rotation.random(random_state=rng).as_matrix(),
        rng.normal(size=3),
        unit(rng),
        unit(rng),
    )
    joint = JointTarget("joint0", 0.1, 10.0, at)
    checks = arm.verify(
        PoseTarget(TIP, place, pose, np.full(3, 9.0), np.full(3, np.pi), at),
        AxisTarget(TIP, own, direction, np.pi, at),
        joint,
    )
    true = {
        f"target.p.{TIP}": np.linalg.norm(moved - place),
        f"target.p.{TIP}.rotation": angles(turned[None], pose)[0],
        f"axis.p.{TIP}": leans((turned @ own)[None], direction)[0],
        "target.p.joint0": abs(arm.curve(np.array([at]))[0, 0] - joint.value),
    }
    for name, error in true.items():
        assert checks[name].ok
        assert checks[name].value == pytest.approx(error, abs=1e-7)
        if name != "target.p.joint0":
            number, unit_name = read_number(checks[name].text)
            assert 0.0 <= number - error * SHOWN[unit_name] + 1e-4 <= LAST_DIGIT[unit_name] + 2e-4


def make_turn(angle: float) -> Motion:
    """A link that turns about z from 0 to an angle."""
    urdf = chain_urdf((Segment((0.0, 0.0, 1.0)),))
    curve = Curve(np.array([0.0, 1.0]), np.array([[0.0], [angle]]), np.full((2, 1), angle))
    return Motion(robot_of(pin.buildModelFromXML(urdf), []), Scene(), curve)


@pytest.mark.parametrize("degrees", [55.0, 89.0, 91.0, 120.0, 150.0, 179.0, 180.0])
@pytest.mark.parametrize("is_at_end", [True, False])
def test_an_angle_up_to_half_a_turn_is_compared_with_its_tolerance(degrees: float, *, is_at_end: bool) -> None:
    # The largest component of the sine vector of 55 deg about (1, 1, 1) would be that of 28 deg.
    tilt = Rotation.from_rotvec(np.deg2rad(degrees) * np.ones(3) / np.sqrt(3.0)).as_matrix()
    motion = make_turn(1e-3)
    for tolerance, expected in ((degrees - 0.5, False), (min(degrees + 0.5, 180.0), True)):
        most = np.full(3, np.deg2rad(tolerance))
        target = PoseTarget("link1", np.zeros(3), tilt, FREE, most, 0.0 if is_at_end else None)
        phase = Phase("p", 0.0, 1.0, targets=(target,))
        (check,) = [
            check
            for check in verify(Motion(motion.robot, Scene(), motion.curve, phases=(phase,))).checks
            if check.name == "target.p.link1.rotation"
        ]
        assert check.ok is expected, check.text
        assert np.rad2deg(check.value) == pytest.approx(degrees, abs=0.6 if not is_at_end else 1e-6)


@pytest.mark.parametrize("seed", [3016, 3017, 3133, 3146])  # arms whose angles come within 12 deg of half a turn
def test_an_angle_that_comes_near_half_a_turn_is_bounded_closely(seed: int) -> None:
    rng = np.random.default_rng(seed)
    arm = Arm.of(rng)
    for claim in make_claims(arm, rng, rng.uniform(1.01, 5.0)):
        if claim.limit == np.pi:
            check, largest = arm.verify(claim.target)[claim.name], float(claim.errors.max())
            assert largest - 1e-9 <= check.value <= largest + 1.01 * RESOLUTION_SHARE * np.pi


def test_an_offset_along_all_axes_is_a_distance() -> None:
    motion = make_turn(0.0)
    place = np.full(3, -4.9e-3)
    target = PoseTarget("link1", place, None, np.full(3, 5e-3), FREE, 1.0)
    phase = Phase("p", 0.0, 1.0, targets=(target,))
    checks = verify(Motion(motion.robot, Scene(), motion.curve, phases=(phase,))).checks
    (check,) = [check for check in checks if check.name == "target.p.link1"]
    assert not check.ok
    assert check.text == "link1 is 8.49 mm off its target in p"


def test_tolerances_of_single_axes_are_checked_and_named_one_by_one() -> None:
    motion = make_turn(0.0)
    limits = np.array([5e-3, np.inf, 1e-3])
    target = PoseTarget("link1", np.full(3, -2e-3), np.eye(3), limits, FREE, 1.0)
    phase = Phase("p", 0.0, 1.0, targets=(target,))
    texts = {c.name: c for c in verify(Motion(motion.robot, Scene(), motion.curve, phases=(phase,))).checks}
    assert texts["target.p.link1.x"].text == "link1 is within 2.00 mm of its target along x of the target in p"
    assert texts["target.p.link1.z"].text == "link1 is 2.00 mm off its target along z of the target in p"
    assert texts["target.p.link1.x"].ok
    assert not texts["target.p.link1.z"].ok
    assert "target.p.link1" not in texts
    assert "target.p.link1.y" not in texts


def test_rotation_tolerances_of_single_axes_are_refused() -> None:
    motion = make_turn(0.0)
    target = PoseTarget("link1", np.zeros(3), np.eye(3), FREE, np.array([0.1, 0.1, np.inf]), 1.0)
    with pytest.raises(VerifyError, match="the rotation tolerance of the target of 'link1' is one angle"):
        verify(Motion(motion.robot, Scene(), motion.curve, phases=(Phase("p", 0.0, 1.0, targets=(target,)),)))
