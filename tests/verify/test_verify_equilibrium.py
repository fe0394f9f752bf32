"""Proofs of equilibrium: honest regions are proven, and every kind of lie is refuted by its name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation

from benchmarks.tasks.stances import UP, foot, make_contacts, random_load, random_stance
from costs.contact import GRAVITY, WorldContacts
from costs.mechanism_wrench import list_arc_wrenches, list_slide_wrenches
from costs.static_region import StaticRegionError, find_static_region
from service.verify.forces.equilibrium import (
    EquilibriumProof,
    RecordedRegion,
    list_slid_loads,
    list_turned_loads,
    prove_equilibrium,
)

MASS = 150.0
WEIGHT = MASS * GRAVITY
FEET = make_contacts(np.concatenate([foot(0.0, 0.11), foot(0.0, -0.11)]), UP, 0.7, 2.0 * WEIGHT)
STANCE = WorldContacts.join([FEET, make_contacts([0.7, 0.2, 1.1], [-1.0, 0.0, 0.0], 0.7, 100.0)])
PUSH = np.array([-80.0, 0.0, 0.0])
LOADS = np.array([np.concatenate([PUSH, np.cross([0.6, 0.2, 1.0], PUSH)]), np.zeros(6)])


def record(contacts, region):
    return RecordedRegion(
        contacts.points,
        contacts.normals,
        contacts.friction,
        contacts.caps,
        region.wrenches.copy(),
        region.vertices.copy(),
        region.witnesses.copy(),
    )


@pytest.fixture(scope="module")
def honest() -> RecordedRegion:
    return record(STANCE, find_static_region(STANCE, MASS, LOADS))


@pytest.fixture(scope="module")
def drifting() -> RecordedRegion:
    return record(STANCE, find_static_region(STANCE, MASS, LOADS, drift_m=1e-3))


@given(seed=st.integers(0, 10_000))
@settings(max_examples=25)
def test_regions_of_random_stances_are_proven(seed):
    rng = np.random.default_rng(seed)
    contacts, mass = random_stance(rng)
    loads = np.array([random_load(rng, mass), random_load(rng, mass), np.zeros(6)][: rng.integers(1, 4)])
    drift, tilt = rng.choice([0.0, 1e-3]), rng.choice([0.0, 0.01])
    contacts = WorldContacts(contacts.points, contacts.normals, np.maximum(contacts.friction, 0.05), contacts.caps)
    try:
        region = find_static_region(contacts, mass, loads, drift_m=drift, tilt_rad=tilt)
    except StaticRegionError:
        return
    proof = prove_equilibrium(record(contacts, region), mass, loads, GRAVITY, drift, tilt)
    assert proof.is_proven, proof
    assert proof.shift_m == pytest.approx(region.shift_m)
    rounded = {name: np.round(getattr(region, name), 8) for name in ("vertices", "witnesses", "wrenches")}
    assert prove_equilibrium(record(contacts, replace(region, **rounded)), mass, loads, GRAVITY, drift, tilt).is_proven
    mixture = rng.dirichlet(np.ones(len(loads))) @ loads  # every mixture of the loads is held as well
    assert prove_equilibrium(record(contacts, region), mass, mixture[None], GRAVITY, 0.0, tilt).is_proven


def test_the_figures_of_an_honest_region_are_within_their_tolerances(honest):
    proof = prove_equilibrium(honest, MASS, LOADS)
    assert proof.is_proven
    assert max(proof.force_n, proof.moment_nm, proof.cone_n, proof.cap_n) <= 1e-6 * WEIGHT
    assert proof.overhang_m <= 1e-7
    assert proof.uncovered == 0.0
    assert proof.shift_m == 0.0
    assert proof.text.startswith(f"contact forces hold the robot at all {len(honest.vertices)} vertices")


def refute(region: RecordedRegion, *options, loads=LOADS) -> EquilibriumProof:
    proof = prove_equilibrium(region, MASS, loads, *options)
    assert not proof.is_proven
    return proof


def test_a_witness_outside_its_cone_is_refuted(honest):
    # 300 N more along x at one point and less at another of the same height: all sums stay
    witnesses = honest.witnesses.copy()
    witnesses[2, 1, 0, 0] += 300.0
    witnesses[2, 1, 2, 0] -= 300.0
    proof = refute(replace(honest, witnesses=witnesses))
    assert proof.force_n < 1e-3
    assert proof.cone_n > 100.0
    assert "for vertex 2 and wrench 1" in proof.text
    assert "outside its friction cone" in proof.text


def test_a_contact_that_pulls_is_refuted(honest):
    # two feet: pairs of points with equal sums; one of them pulls
    witnesses = honest.witnesses.copy()
    witnesses[1, 0, [0, 3], 2] -= 2.0 * WEIGHT
    witnesses[1, 0, [1, 2], 2] += 2.0 * WEIGHT
    proof = refute(replace(honest, witnesses=witnesses))
    assert proof.moment_nm < 1e-3
    assert "for vertex 1 and wrench 0" in proof.text
    assert "outside its friction cone" in proof.text


def test_a_smooth_contact_that_pulls_is_refuted():
    smooth = WorldContacts(FEET.points, FEET.normals, np.zeros(8), FEET.caps)
    region = record(smooth, find_static_region(smooth, MASS))
    assert prove_equilibrium(region, MASS, LOADS[1:]).is_proven
    region.witnesses[0, 0, [0, 3], 2] -= 10.0
    region.witnesses[0, 0, [1, 2], 2] += 10.0
    proof = refute(region, loads=LOADS[1:])
    assert proof.cone_n == pytest.approx(10.0)


def test_a_witness_over_its_cap_is_refuted(honest):
    proof = refute(replace(honest, caps=np.append(honest.caps[:8], 90.0)))
    assert proof.cap_n == pytest.approx(10.0, abs=1e-3)
    assert "contact point 8" in proof.text
    assert "10 N over its cap of 90 N" in proof.text


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("vertex", [0, 4])
def test_a_vertex_moved_by_a_millimetre_is_refuted(honest, vertex, axis):
    vertices = honest.vertices.copy()
    vertices[vertex, axis] += 1e-3
    proof = refute(replace(honest, vertices=vertices))
    assert proof.moment_nm == pytest.approx(1e-3 * WEIGHT, rel=1e-3)
    assert f"the moments at vertex {vertex} under wrench" in proof.text


def test_a_heavier_robot_is_refuted(honest):
    proof = prove_equilibrium(honest, MASS + 0.01, LOADS)
    assert not proof.is_proven
    assert "the forces at vertex" in proof.text


@pytest.mark.parametrize("left_out", [0, 1])
def test_a_wrench_left_out_is_refuted(honest, left_out):
    kept = 1 - left_out
    region = replace(honest, wrenches=honest.wrenches[[kept]], witnesses=honest.witnesses[:, [kept]])
    proof = refute(region)
    assert proof.text.startswith(f"load {left_out} is ")
    assert proof.uncovered >= 80.0
    assert prove_equilibrium(region, MASS, LOADS[[kept]]).is_proven


def test_a_region_without_yaw_moments_is_refuted_under_drift(honest, drifting):
    assert prove_equilibrium(drifting, MASS, LOADS, GRAVITY, 1e-3).is_proven
    proof = refute(honest, GRAVITY, 1e-3)
    assert "with what a drift of 1 mm adds" in proof.text
    assert not prove_equilibrium(drifting, MASS, LOADS, GRAVITY, 2e-3).is_proven
    one_sided = [0, *range(2, len(drifting.wrenches))]
    region = replace(drifting, wrenches=drifting.wrenches[one_sided], witnesses=drifting.witnesses[:, one_sided])
    assert "load 0" in refute(region, GRAVITY, 1e-3).text


def test_a_region_of_upright_normals_is_refuted_under_tilt(honest):
    proof = refute(honest, GRAVITY, 0.0, 0.02)
    assert proof.cone_n > 0.1  # a hand at 100 N on the edge of its cone
    assert proof.cap_n > 0.1
    assert "friction cone" in proof.text or "over its cap" in proof.text


def test_every_tilted_cone_holds_the_witnesses_of_a_proven_region():
    tilt = 0.05
    region = record(STANCE, find_static_region(STANCE, MASS, LOADS, tilt_rad=tilt))
    assert prove_equilibrium(region, MASS, LOADS, GRAVITY, 0.0, tilt).is_proven
    rng = np.random.default_rng(0)
    for _ in range(20):
        aside = np.cross(region.normals, rng.normal(size=region.normals.shape))
        aside *= np.tan(tilt) / np.linalg.norm(aside, axis=1, keepdims=True)
        normals = region.normals + aside
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        assert prove_equilibrium(replace(region, normals=normals), MASS, LOADS).is_proven


@pytest.mark.parametrize("name", ["points", "normals", "friction", "caps", "wrenches", "vertices", "witnesses"])
@pytest.mark.parametrize("value", [np.nan, np.inf, 1e300])
def test_numbers_that_are_none_are_refuted_by_name(honest, name, value):
    values = getattr(honest, name).copy()
    values.flat[-1] = value
    proof = refute(replace(honest, **{name: values}))
    assert proof.text.startswith(f"{name}[")
    assert "expected a finite number" in proof.text


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda r: {"vertices": r.vertices[::-1], "witnesses": r.witnesses[::-1]}, "not convex and counter-clockwise"),
        (
            lambda r: {"vertices": r.vertices[[1, 0, *range(2, 10)]], "witnesses": r.witnesses[[1, 0, *range(2, 10)]]},
            "not convex and counter-clockwise",
        ),
        (lambda r: {"vertices": r.vertices[[0, 0, 1]], "witnesses": r.witnesses[[0, 0, 1]]}, "are one point"),
        (lambda r: {"vertices": r.vertices[[0, 1, 0, 1]], "witnesses": r.witnesses[[0, 1, 0, 1]]}, "on one line"),
        (lambda r: {"vertices": r.vertices[:2], "witnesses": r.witnesses[:2]}, "three vertices"),
        (lambda r: {"vertices": r.vertices[:4]}, "vertices has shape"),
        (lambda r: {"wrenches": r.wrenches[:1]}, "wrenches has shape"),
        (lambda r: {"points": r.points[0]}, "points must have shape"),
        (lambda r: {"normals": 3.0 * r.normals}, "normal of contact point 0 is not a unit vector"),
        (lambda r: {"friction": -r.friction}, "friction of contact point 0 is negative"),
        (lambda r: {"caps": -r.caps}, "caps of contact point 0 is negative"),
    ],
)
def test_malformed_regions_are_refuted(honest, change, message):
    assert len(honest.vertices) >= 10
    assert message in refute(replace(honest, **change(honest))).text


@given(seed=st.integers(0, 10_000))
@settings(max_examples=60)
def test_random_edits_that_matter_are_refuted(honest, seed):
    """One number of a region is changed by 1 % of its range or more; a proof must then still be true."""
    rng = np.random.default_rng(seed)
    witnesses, vertices = honest.witnesses.copy(), honest.vertices.copy()
    if rng.random() < 0.5:
        at = tuple(rng.integers(0, size) for size in witnesses.shape)
        witnesses[at] += rng.choice([-1.0, 1.0]) * rng.uniform(0.01, 1.0) * WEIGHT
    else:
        vertices[rng.integers(len(vertices)), rng.integers(2)] += rng.choice([-1.0, 1.0]) * rng.uniform(1e-3, 0.1)
    refute(replace(honest, witnesses=witnesses, vertices=vertices))


def lies_in_hull(wrench, corners):
    """Whether some convex combination of the corners is the wrench, to 1e-6."""
    rows = np.hstack([np.vstack([corners.T, np.ones(len(corners))]), np.eye(7), -np.eye(7)])
    cost = np.concatenate([np.zeros(len(corners)), np.ones(14)])
    return linprog(cost, A_eq=rows, b_eq=np.append(wrench, 1.0), method="highs").fun < 1e-6


def random_mechanism(rng):
    axis = rng.normal(size=3)
    return rng.normal(size=3) * 40.0, rng.uniform(-1.0, 1.0, 3), axis / np.linalg.norm(axis), rng.uniform(-1.0, 1.0, 3)


@given(seed=st.integers(0, 10_000), first=st.floats(-3.0, 3.0), span=st.floats(-6.5, 6.5))
@settings(max_examples=30)
def test_loads_of_a_turn_contain_the_arc_and_lie_within_the_planners(seed, first, span):
    rng = np.random.default_rng(seed)
    force, point, axis, origin = random_mechanism(rng)
    loads = list_turned_loads(force, point, axis, origin, first, first + span)
    for angle in first + span * rng.random(3):
        rotation = Rotation.from_rotvec(angle * axis).as_matrix()
        acting = rotation @ force
        assert lies_in_hull([*acting, *np.cross(origin + rotation @ (point - origin), acting)], loads)
    planned = list_arc_wrenches(force, point, axis, origin, first, first + span)
    for load in loads:
        assert lies_in_hull(load, planned)


def test_loads_of_a_slide_are_the_planners():
    rng = np.random.default_rng(1)
    force, point, axis, _ = random_mechanism(rng)
    loads = list_slid_loads(force, point, axis, -0.1, 0.4)
    np.testing.assert_allclose(loads, list_slide_wrenches(force, point, axis, -0.1, 0.4), atol=1e-9)


def test_a_region_for_a_turn_is_proven_for_part_of_it_and_refuted_beyond():
    x, _, z = np.eye(3)
    turn = (40.0 * x, np.array([0.6, 0.2, 1.0]), z, np.array([0.6, 0.9, 0.0]))
    wrenches = np.vstack([list_arc_wrenches(*turn, 0.0, 0.8), np.zeros((1, 6))])
    region = record(FEET, find_static_region(FEET, MASS, wrenches, drift_m=1e-3))
    for first, last, is_held in ((0.0, 0.8, True), (0.1, 0.5, True), (0.0, 0.9, False), (-0.1, 0.5, False)):
        loads = np.vstack([list_turned_loads(*turn, first, last), np.zeros((1, 6))])
        assert prove_equilibrium(region, MASS, loads, GRAVITY, 1e-3).is_proven == is_held


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"mass": 0.0}, "mass must be positive and finite"),
        ({"gravity": np.nan}, "gravity must be positive and finite"),
        ({"drift_m": -1.0}, "drift_m must be finite and not negative"),
        ({"tilt_rad": np.inf}, "tilt_rad must be finite and not negative"),
        ({"loads": np.zeros((0, 6))}, "loads must be finite with shape"),
        ({"loads": np.full((1, 6), np.nan)}, "loads must be finite with shape"),
    ],
)
def test_questions_that_make_no_sense_are_refused(honest, options, message):
    with pytest.raises(ValueError, match=message):
        prove_equilibrium(honest, **({"mass": MASS, "loads": LOADS} | options))


def test_loads_that_make_no_sense_are_refused():
    x, zero = np.array([1.0, 0.0, 0.0]), np.zeros(3)
    with pytest.raises(ValueError, match="must be a unit vector"):
        list_turned_loads(x, x, zero, x, 0.0, 1.0)
    with pytest.raises(ValueError, match="must be finite"):
        list_turned_loads(x, x, x, x, 0.0, np.nan)
    with pytest.raises(ValueError, match="must be finite"):
        list_slid_loads(x, x, x, 0.0, np.inf)
    with pytest.raises(ValueError, match="must be a unit vector"):
        list_slid_loads(x, x, 2.0 * x, 0.0, 1.0)


def find_uncovered(wrenches, along, drift_m=0.01):
    """How far a region's wrenches are from holding no load at all under drift [N, Nm].

    Args:
        wrenches: force along x [N] and yaw moment [Nm] of each recorded wrench.
        along: force along the ground at one vertex of each wrench [N]; there is none at the others.
    """
    count = len(wrenches)
    witnesses = np.zeros((3, count, 2, 3))
    witnesses[..., 2] = 0.5 * WEIGHT  # what presses makes no yaw moment
    # 3 and 4 parts of 7 along x and y at two points: |f_xy| add up, their signs do not count
    witnesses[1, :, 0, 0], witnesses[1, :, 1, 1] = 3.0 / 7.0 * np.array(along), -4.0 / 7.0 * np.array(along)
    region = RecordedRegion(
        points=np.array([[0.0, 0.1, 0.0], [0.0, -0.1, 0.0]]),
        normals=np.tile(UP, (2, 1)),
        friction=np.full(2, 0.7),
        caps=np.full(2, WEIGHT),
        wrenches=np.array([[force, 0.0, 0.0, 0.0, 0.0, yaw] for force, yaw in wrenches]),
        vertices=np.array([[0.1, 0.0], [0.0, 0.1], [-0.1, 0.0]]),
        witnesses=witnesses,
    )
    return prove_equilibrium(region, MASS, np.zeros((1, 6)), GRAVITY, drift_m).uncovered


@pytest.mark.parametrize(
    ("low", "high", "missing"),
    [(-5.0, 5.0, 0.0), (-4.0, 5.0, 1.0), (-5.0, 3.0, 2.0), (-1.0, 9.0, 4.0), (-9.0, -1.0, 6.0)],
)
@pytest.mark.parametrize("along", [(100.0, 500.0), (500.0, 100.0)])
def test_the_line_of_yaw_moments_reaches_as_far_as_drift_does_where_forces_are_largest(low, high, missing, along):
    # 500 N along the ground, 10 mm off: the contacts may make 5 Nm of either sign, whichever wrench has them
    assert find_uncovered([(0.0, low), (0.0, high)], along) == pytest.approx(missing, abs=1e-6)


def test_a_wrench_between_the_ends_of_a_line_of_yaw_moments_adds_no_drift():
    # no load is a mixture of the ends alone: forces of the wrench between them never act
    assert find_uncovered([(0.0, -2.0), (0.0, 0.0), (0.0, 2.0)], (200.0, 900.0, 100.0)) == 0.0


@pytest.mark.parametrize(("half", "missing"), [(5.0, 0.0), (4.0, 1.0), (1.0, 4.0)])
def test_a_mixture_of_wrenches_reaches_as_far_as_drift_does_where_forces_are_largest(half, missing):
    # no wrench is without a force along x, so that no load is a mixture of all four
    wrenches = [(force, yaw) for force in (-10.0, 10.0) for yaw in (-half, half)]
    assert find_uncovered(wrenches, (100.0, 0.0, 500.0, 300.0)) == pytest.approx(missing, abs=1e-6)


def test_a_mixture_of_wrenches_must_reach_to_both_sides():
    # yaw moments of -1 to 9 Nm hold +5 Nm of drift but not -5 Nm
    wrenches = [(force, yaw) for force in (-10.0, 10.0) for yaw in (-1.0, 9.0)]
    assert find_uncovered(wrenches, (500.0,) * 4) == pytest.approx(4.0, abs=1e-6)
