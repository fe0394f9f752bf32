"""Pads as patches, worked out by hand: a beam between two fingers that hangs off its middle, and what twists it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import Delaunay

from costs.robot import LinkBody
from costs.robot.shapes import box
from service.verify import HandContact, HandPush, HeldJoint
from service.verify.forces.hand_balance import HELD_SHARE, Meeting, measure_excess, meet
from service.verify.forces.pads import PATCH_DEPTH_M, find_patch

PAD_M, BEAM_M = 0.02, np.array([0.6, 0.04, 0.05])  # sides of a square pad, and of a beam along x
UP = (np.array([0.0, 0.0, 1.0]), np.zeros(3))
TILT = (np.zeros(3), np.array([0.0, 1.0, 0.0]))  # about the line between the pads
SQUARE = PAD_M * np.array([[x, 0.0, z] for x in (-0.5, 0.5) for z in (-0.5, 0.5)])


def make_pads(cap_n: float = 100.0) -> tuple[HandContact, HandContact]:
    first = HandContact("finger", "a pad", SQUARE, 1e-3, "m/beam", "m/beam", cap_n)
    return first, replace(first, surface="the other pad")


def grip(pads: tuple[HandContact, HandContact], beam: np.ndarray = BEAM_M) -> tuple[Meeting, Meeting]:
    vertices = box(beam)
    body = LinkBody("m/beam", "m/beam", 1, vertices, vertices)
    places = [np.array([0.0, side * (0.5 * beam[1] + 1e-3), 0.0]) for side in (-1.0, 1.0)]
    first, second = (meet(pad, body, (np.eye(3), at), 1.0, (UP, TILT)) for pad, at in zip(pads, places, strict=True))
    return first, second


def holds(torque_nm: float, cap_n: float = 100.0) -> bool:
    """Whether the grip lifts a beam with little force that needs a torque about the pads' normals."""
    pads = make_pads(cap_n)
    push = HandPush("lift", 1.0, 0.1, pads, (0.3, 0.6), (HeldJoint("tilt", torque_nm, torque_nm),))
    return measure_excess(push, grip(pads)) <= 0.0


def test_two_pads_resist_the_torsion_of_their_friction_and_no_more() -> None:
    """Four triangles with centroids 20 / 3 mm from the middle, 200 N, tan(atan(0.3) / 3) = 0.0975 as a joint stays.

    These are 0.13 N m, 0.4 with all of the friction: a beam of 10 kg gripped 1 cm off its middle needs 1.
    """
    most = 2.0 * 100.0 * np.tan(HELD_SHARE * np.arctan(0.3)) * PAD_M / 3.0
    assert most == pytest.approx(0.130, abs=1e-3)
    without_stay = 2.0 * 100.0 * 0.3 * PAD_M / 3.0
    assert without_stay == pytest.approx(0.4, abs=1e-9)
    assert holds(0.98 * most)
    assert not holds(1.02 * most)
    assert not holds(10.0 * 9.81 * 0.01)


def test_twice_the_squeeze_resists_twice_the_torsion() -> None:
    assert not holds(0.16)
    assert holds(0.16, cap_n=200.0)


def test_a_pad_counts_only_where_it_lies_on_the_body() -> None:
    """A beam 5 mm high between pads of 20 mm: triangles of one area, centroids 20 / 3 and 5 / 3 mm from the middle."""
    (low, _) = grip(make_pads(), np.array([0.6, 0.04, 0.005]))
    spots = low.spot_held[:, 0]
    np.testing.assert_allclose(np.linalg.norm(spots, axis=1), 0.025 / 6.0, atol=1e-6)
    (full, _) = grip(make_pads())
    np.testing.assert_allclose(np.linalg.norm(full.spot_held[:, 0], axis=1), PAD_M / 3.0, atol=1e-6)


def test_points_and_lines_are_no_patches() -> None:
    beam, normal = box(BEAM_M) + np.array([0.0, 0.03, 0.0]), np.array([0.0, 1.0, 0.0])
    assert len(find_patch(SQUARE, beam, normal)) == 4
    assert not len(find_patch(SQUARE[:2], beam, normal))
    leant = SQUARE + np.outer(SQUARE[:, 0], normal)  # one edge touches
    assert not len(find_patch(leant, beam, normal))
    assert not len(find_patch(SQUARE, beam + np.array([0.4, 0.0, 0.0]), normal))


@given(st.integers(0, 100_000))
@settings(max_examples=60, deadline=None)
def test_no_patch_twists_more_than_an_even_pressure_does(seed: int) -> None:
    """The farthest point, against the mean distance of the pad's points from their middle."""
    rng = np.random.default_rng(seed)
    outline = rng.normal(size=(int(rng.integers(3, 9)), 2)) * rng.uniform(0.002, 0.02, size=2)
    pad = np.column_stack([outline[:, 0], np.zeros(len(outline)), outline[:, 1]])
    body = box(np.array([0.5, 0.04, 0.5])) + np.array([0.0, 0.02 + 0.5 * PATCH_DEPTH_M, 0.0])
    spots = find_patch(pad, body, np.array([0.0, 1.0, 0.0]))
    if not len(spots):
        return
    inside = _draw_inside(outline, rng)
    even = np.linalg.norm(inside - inside.mean(axis=0), axis=1).mean()
    assert np.linalg.norm(spots[:, [0, 2]] - inside.mean(axis=0), axis=1).max() <= 1.05 * even


def _draw_inside(outline: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Points spread evenly over the hull of an outline."""
    hull = Delaunay(outline)
    drawn = rng.uniform(outline.min(axis=0), outline.max(axis=0), size=(6000, 2))
    return drawn[hull.find_simplex(drawn) >= 0]
