"""Mechanisms in the certificate: clearance of their links, and joints that are locked until a latch releases them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from small_robots import CUBE, box, robot_of

from costs.curve import Curve
from costs.robot import MechanismJoint, Release, RobotModel, with_mechanism
from costs.robot.model import LinkBody
from costs.scene import Scene
from service.demands.neighbours import make_neighbour_allowances
from service.verify import Basis, Check, Motion, Phase, Status, VerifyError, verify
from service.verify.hashes import promises_hash
from service.verify.mechanism_checks import RELEASE_TOLERANCE, _find_roots

UP = np.array([0.0, 0.0, 1.0])
LATCH_AT, FREE = 0.4, np.deg2rad(5.0)
RELEASE = Release("opening", "press", LATCH_AT, FREE)


def _door() -> RobotModel:
    """A slider far away, and a leaf with a lever that stands 2 cm off."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPX(), pin.SE3(np.eye(3), np.array([0.0, -5.0, 0.0])), "slide")
    slider = LinkBody("slider", "slider", joint, 0.05 * CUBE, 0.05 * CUBE)
    slab = np.array([0.4, 0.0, 0.0]) + np.array([0.4, 0.02, 0.5]) * CUBE
    lever = np.array([0.7, -0.06, 0.0]) + np.array([0.06, 0.02, 0.01]) * CUBE
    axis = np.array([0.0, 1.0, 0.0])
    return with_mechanism(
        robot_of(model, [slider]),
        [
            MechanismJoint("opening", "leaf", np.zeros(3), UP, {"leaf/slab": slab}, lower=-1.0, upper=2.0),
            MechanismJoint(
                "press", "lever", np.array([0.76, -0.06, 0.0]), axis, {"lever/bar": lever}, parent="leaf", upper=1.0
            ),
        ],
    )


DOOR = _door()


def _moves(*steps: tuple[float, float], pieces: Scene | None = None, releases: tuple[Release, ...] = (RELEASE,)):
    """A motion of leaf and lever through these values, at rest at each."""
    scene = Scene() if pieces is None else pieces
    q = np.column_stack([np.zeros(len(steps)), np.array(steps)])
    knots = np.arange(len(steps), dtype=float)
    neighbours = make_neighbour_allowances(DOOR, scene, q[0])
    phase = Phase("open", 0.0, knots[-1], allowances=neighbours)
    samples = np.linspace(0.0, knots[-1], 40 * (len(steps) - 1) + 1)
    return Motion(
        DOOR, scene, Curve(knots, q, np.zeros_like(q)), None, (phase,), samples, DOOR.mechanism_links, None, releases
    )


def _check(motion: Motion) -> Check:
    (check,) = (check for check in verify(motion).checks if check.name.startswith("release."))
    return check


HONEST = ((0.0, 0.0), (0.0, 0.5), (0.5, 0.5), (0.5, 0.0), (0.9, 0.0))


def test_a_leaf_that_opens_while_its_lever_is_turned_is_certified() -> None:
    motion = _moves(*HONEST)
    assert verify(motion).status is Status.CERTIFIED
    check = _check(motion)
    assert (check.name, check.ok, check.basis, check.value) == ("release.opening", True, Basis.PROOF, 0.0)


REFUTED = {
    "the lever stays at rest": ((0.0, 0.0), (0.5, 0.0)),
    "the lever is not turned far enough": ((0.0, 0.0), (0.0, 0.39), (0.5, 0.39)),
    "the lever springs back at 4 degrees": ((0.0, 0.0), (0.0, 0.5), (0.07, 0.5), (0.07, 0.0), (0.5, 0.0)),
    "the lever is turned while the leaf opens": ((0.0, 0.0), (0.5, 0.5)),
    "the leaf opens the other way": ((0.0, 0.0), (-0.5, 0.0)),
    "the leaf is shut and opens again": (*HONEST[:4], (0.0, 0.0), (0.5, 0.0)),
    "an ajar leaf moves": ((0.05, 0.0), (0.08, 0.0)),
}


@pytest.mark.parametrize("name", REFUTED)
def test_a_leaf_that_opens_while_it_is_locked_is_refuted(name: str) -> None:
    motion = _moves(*REFUTED[name])
    assert verify(motion).status is Status.VIOLATED
    check = _check(motion)
    assert not check.ok
    assert check.where is not None
    assert check.where.names == ("opening", "press")
    latch = float(motion.curve(np.array([check.where.s]))[0, 2])
    assert check.value == pytest.approx(LATCH_AT - latch, abs=1e-3)


ALLOWED = {
    "a leaf that closes": (*HONEST, (0.0, 0.0)),
    "a leaf that was ajar beyond the latch": ((0.2, 0.0), (0.6, 0.0)),
    "an ajar leaf that stays": ((0.05, 0.0), (0.05, 0.5), (0.3, 0.5), (0.3, 0.0)),
    "a shut leaf whose lever is turned": ((0.0, 0.0), (0.0, 0.5), (0.0, 0.0)),
    "a leaf that trembles by less than a millirad": ((0.0, 0.0), (0.0009, 0.0), (0.0, 0.0)),
}


@pytest.mark.parametrize("name", ALLOWED)
def test_what_a_latch_permits_is_proven(name: str) -> None:
    assert _check(_moves(*ALLOWED[name])).ok


def test_a_latch_that_releases_at_a_negative_value_counts_by_its_sign() -> None:
    down = (replace(RELEASE, latch_at=-LATCH_AT),)
    assert not _check(_moves(*HONEST, releases=down)).ok
    assert _check(_moves((0.0, 0.0), (0.0, -0.5), (0.5, -0.5), releases=down)).ok


@settings(max_examples=40, deadline=None)
@given(
    values=st.lists(st.tuples(st.floats(-0.02, 0.2), st.floats(0.0, 0.9)), min_size=2, max_size=5),
    slopes=st.lists(st.tuples(st.floats(-0.3, 0.3), st.floats(-1.0, 1.0)), min_size=5, max_size=5),
)
def test_what_dense_samples_show_is_found(values, slopes) -> None:
    rows = np.column_stack([np.zeros(len(values)), np.array([(0.0, 0.0), *values[1:]])])
    tangents = np.column_stack([np.zeros(len(values)), np.array(slopes[: len(values)])])
    knots = np.arange(len(values), dtype=float)
    motion = replace(_moves(*values), curve=Curve(knots, rows, tangents), samples=None, phases=())
    s = np.linspace(0.0, knots[-1], 4001)
    leaf, lever = motion.curve(s)[:, 1:].T
    # Samples may step over a place at which the leaf gets free, or is shut again.
    assume(not np.any((np.abs(leaf) > FREE - 1e-3) & (np.abs(leaf) < FREE)))
    is_free, worst = False, 0.0
    for x, y in zip(leaf, lever, strict=True):
        is_free = abs(x) > RELEASE_TOLERANCE and (is_free or abs(x) >= FREE)
        if not is_free and abs(x) > RELEASE_TOLERANCE + 1e-6:
            worst = max(worst, LATCH_AT - y)
    check = _check(motion)
    assert check.value >= worst - 1e-9
    assert check.ok == (check.value <= RELEASE_TOLERANCE)
    if worst > 0.0:
        assert check.value <= worst + 2e-2


def test_exported_samples_that_cut_the_corner_are_refuted() -> None:
    motion = _moves(*HONEST)
    assert _check(motion).ok
    # The curve turns the lever before the leaf moves; a line from the first sample to the last moves both at once.
    coarse = replace(motion, curve=Curve(motion.curve.knots[:3], motion.curve.positions[:3], np.zeros((3, 3))))
    law = replace(coarse, phases=(), samples=np.array([0.0, 1.0, 2.0]))
    assert _check(law).ok
    bent = Curve(np.array([0.0, 1.0]), np.array([[0.0, 0.0, 0.0], [0.0, 0.3, 0.5]]), np.array([[0, 0, 3], [0, 0, 0.0]]))
    bent_motion = replace(motion, curve=bent, phases=())
    values = [_check(replace(bent_motion, samples=s)).value for s in (None, np.array([0.0, 1.0]))]
    assert values[0] < values[1]


@pytest.mark.parametrize(
    ("release", "text"),
    [
        (Release("gate", "press", 0.4), "release of 'gate' by 'press' needs two joints"),
        (Release("opening", "opening", 0.4), "release of 'opening' by 'opening' needs two joints"),
        (Release("opening", "press", 0.0), "needs a latch_at other than 0"),
        (Release("opening", "press", float("nan")), "release of 'opening' has values that are not finite"),
        (Release("opening", "press", 0.4, -0.1), "free_beyond >= 0"),
    ],
)
def test_rules_without_meaning_are_refused(release: Release, text: str) -> None:
    with pytest.raises(VerifyError, match=text):
        verify(_moves(*HONEST, releases=(release,)))
    with pytest.raises(VerifyError, match="two releases are of the same joint"):
        verify(_moves(*HONEST, releases=(RELEASE, RELEASE)))


def test_the_hash_of_the_promises_covers_the_releases() -> None:
    motion = _moves(*HONEST)
    hashes = {
        promises_hash(motion.phases),
        promises_hash(motion.phases, (RELEASE,)),
        promises_hash(motion.phases, (replace(RELEASE, latch_at=0.3),)),
        promises_hash(motion.phases, (replace(RELEASE, free_beyond=0.05),)),
        promises_hash(motion.phases, (replace(RELEASE, latch="slide"),)),
    }
    assert len(hashes) == 5
    assert verify(motion).promises_sha256 == promises_hash(motion.phases, (RELEASE,))


def test_a_leaf_that_swings_into_a_piece_is_refuted() -> None:
    post = Scene((box("post", (0.0, 0.7, 0.0), (0.05, 0.05, 0.05)),))
    assert verify(_moves(*HONEST, pieces=post)).status is Status.CERTIFIED
    certificate = verify(_moves(*HONEST, (1.6, 0.0), pieces=post))
    assert certificate.status is Status.VIOLATED
    assert any(set(c.where.names) == {"leaf/slab", "post"} for c in certificate.checks if not c.ok and c.where)


def test_a_leaf_that_clears_the_floor_and_grows_out_of_its_frame_is_certified() -> None:
    floor = box("floor", (0.0, 0.0, -0.61), (3.0, 3.0, 0.1))  # 1 cm below the leaf
    jamb = box("jamb", (0.845, 0.0, 0.0), (0.05, 0.02, 0.5))  # the free edge is 5 mm inside it
    other = box("patch", (0.0, 0.8, -0.61), (0.3, 0.3, 0.105))  # 5 mm below the leaf, where it comes only later
    certificate = verify(_moves(*HONEST, (1.6, 0.0), pieces=Scene((floor, jamb, other))))
    assert certificate.status is Status.CERTIFIED
    assert not any(check.name.startswith("start.") for check in certificate.checks)
    raised = box("patch", (0.0, 0.8, -0.61), (0.3, 0.3, 0.12))
    assert verify(_moves(*HONEST, (1.6, 0.0), pieces=Scene((floor, jamb, raised)))).status is Status.VIOLATED


def test_links_of_a_mechanism_that_meet_are_refuted() -> None:
    assert verify(_moves((0.0, 0.0), (0.0, 0.5))).status is Status.CERTIFIED
    # A gate beside the door stands in its way.
    gate = MechanismJoint("gate_turn", "gate", np.array([0.0, 0.9, 0.0]), UP, {"gate/g": [0.0, 0.9, 0.0] + 0.1 * CUBE})
    robot = with_mechanism(DOOR, [gate])
    motion = _moves(*HONEST, (1.6, 0.0), releases=())
    q = np.column_stack([motion.curve.positions, np.zeros(len(motion.curve.knots))])
    through = replace(
        motion, robot=robot, curve=Curve(motion.curve.knots, q, np.zeros_like(q)), mechanism_links=robot.mechanism_links
    )
    certificate = verify(through)
    assert certificate.status is Status.VIOLATED
    assert any(set(c.where.names) == {"leaf/slab", "gate/g"} for c in certificate.checks if not c.ok and c.where)


@given(
    root=st.floats(0.05, 0.95),
    others=st.lists(st.floats(-5.0, 5.0), min_size=1, max_size=2),
    length=st.floats(0.01, 10.0),
    size=st.floats(1e-4, 1e3),
)
def test_a_root_inside_an_interval_is_found(root: float, others: list[float], length: float, size: float) -> None:
    roots = length * np.array([root, *others])
    coefficients = size * np.poly(roots)[::-1]
    found = _find_roots(coefficients, length)
    assert np.abs(found - roots[0]).min() < 1e-3 * length, "also a double or triple one"
