"""Bounds of the turn of a contact's normal, against displaced cores: drawn at random, and by a search for the worst."""

from __future__ import annotations

from collections.abc import Callable

import coal
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from costs.primitive import Primitive
from costs.robot import LinkBody
from costs.robot.shapes import box, cylinder
from service.verify.forces.rounded import RoundedBody
from service.verify.forces.turning import bound_turns
from service.verify.solids import make_coal_convex


def bound_turn(
    core: Float[np.ndarray, "K 3"], solid: RoundedBody, normal: Float[np.ndarray, "3"], apart: float, e: float
) -> float:
    """Bound the turn from one pose."""
    return float(bound_turns(core[None], solid, normal[None], np.array([apart]), np.array([e]))[0])


NORMAL_ERROR = 3e-4  # of the normals here [rad]
ROD_M = 0.051


def make_body(kind: str, rng: np.random.Generator) -> LinkBody:
    if kind == "bar":
        radius, length = rng.uniform(0.008, 0.02), rng.uniform(0.03, 0.2)
        points, exact = cylinder(radius, length), Primitive("cylinder", radius, length, np.eye(4))
        return LinkBody("m/body", "m/link", 1, points, points, exact)
    points = box(rng.uniform(0.02, 0.2, size=3)) if kind == "box" else cylinder(rng.uniform(0.02, 0.05), 0.05)
    return LinkBody("m/body", "m/link", 1, points, points, None)


def make_core(body: LinkBody, rng: np.random.Generator, count: int) -> Float[np.ndarray, "K 3"]:
    """A rod, or the corners of a pad, a few millimetres from the body's surface, leaning as it happens."""
    towards = rng.normal(size=3)
    towards[2] *= rng.choice([0.0, 1.0])
    if rng.random() < 0.4:
        towards = np.eye(3)[rng.integers(3)] * rng.choice([-1.0, 1.0])
    towards /= np.linalg.norm(towards)
    turned = Rotation.random(random_state=int(rng.integers(1 << 30)))
    ends = np.array([[0.0, 0.0, -0.5], [0.0, 0.0, 0.5]]) * ROD_M
    pad = np.array([[x, y, 0.0] for x in (-0.01, 0.01) for y in (-0.015, 0.015)])
    core = turned.apply(ends if count == 2 else pad)
    reach = float((body.vertices @ towards).max()) + float(-(core @ towards).min())
    beside = np.cross(towards, rng.normal(size=3))
    return np.asarray(core + (reach + rng.uniform(0.003, 0.012)) * towards + rng.uniform(0.0, 0.03) * beside)


def find_normal(core: Float[np.ndarray, "K 3"], body: LinkBody) -> tuple[Float[np.ndarray, "3"], float]:
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    request.gjk_tolerance, request.epa_tolerance = 1e-12, 1e-12
    solid = RoundedBody.of_body(body)
    apart = coal.distance(make_coal_convex(core), coal.Transform3s(), solid.core, solid.pose, request, result)
    return np.array(result.normal), float(apart)


def measure_turn(first: Float[np.ndarray, "3"], second: Float[np.ndarray, "3"]) -> float:
    return float(np.arctan2(np.linalg.norm(np.cross(first, second)), first @ second))


def displace(core: Float[np.ndarray, "K 3"], e: float, rng: np.random.Generator) -> Float[np.ndarray, "K 3"]:
    """Corners moved by up to ``e``, each its own way: more than a rigid hand can do."""
    moves = rng.normal(size=core.shape)
    if rng.random() < 0.3:
        moves = np.tile(moves[0], (len(core), 1))
    return np.asarray(core + e * moves / np.linalg.norm(moves, axis=1, keepdims=True))


@pytest.mark.parametrize("kind", ["bar", "box", "hull"])
@pytest.mark.parametrize("count", [2, 4])
@given(seed=st.integers(0, 1_000_000))
@settings(max_examples=25, deadline=None)
def test_no_displacement_turns_a_normal_by_more_than_the_bound(kind: str, count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    body = make_body(kind, rng)
    core, e = make_core(body, rng, count), float(10.0 ** rng.uniform(-4.5, -2.3))
    normal, apart = find_normal(core, body)
    bound = bound_turn(core, RoundedBody.of_body(body), normal, apart, e)
    turns = [measure_turn(normal, find_normal(displace(core, e, rng), body)[0]) for _ in range(20)]
    assert max(turns) <= bound + NORMAL_ERROR


def climb(worst: Callable[[Float[np.ndarray, "K 3"]], float], core: Float[np.ndarray, "K 3"], e: float) -> float:
    """Return the largest turn that a search over displacements finds, from those along the rod and along the bar."""
    rng = np.random.default_rng(0)
    w = (core[1] - core[0]) / ROD_M
    starts = [core, *(core + sign * e * way for way in (w, np.array([0.0, 0.0, 1.0])) for sign in (-1.0, 1.0))]
    moved = max(starts, key=worst)
    best = worst(moved)
    for step in np.geomspace(1.0, 0.05, 30):
        tried = displace(moved, step * e, rng) - core
        sizes = np.linalg.norm(tried, axis=1, keepdims=True)
        tried = core + tried * np.minimum(1.0, e / np.maximum(sizes, 1e-12))
        turn = worst(tried)
        best, moved = (turn, tried) if turn > best else (best, moved)
    return best


@pytest.mark.parametrize("from_rod_end", [0.0255, 0.004, 0.001])
@pytest.mark.parametrize("from_bar_end", [0.05, 0.004, 0.001])
@pytest.mark.parametrize("angle_deg", [90.0, 25.0])
def test_a_search_for_the_worst_finds_nothing_near_the_ends_of_rod_and_bar(
    from_rod_end: float, from_bar_end: float, angle_deg: float
) -> None:
    """A rod across a bar, its end or the bar's ever nearer to the contact: the linear bound gives way in time."""
    exact = Primitive("cylinder", 0.008, 0.12, np.eye(4))
    body = LinkBody("m/body", "m/link", 1, cylinder(0.008, 0.12), cylinder(0.008, 0.12), exact)
    solid, angle = RoundedBody.of_body(body), np.deg2rad(angle_deg)
    bar = solid.find_bar()
    assert bar is not None
    w = np.array([0.0, np.sin(angle), np.cos(angle)])
    contact = np.array([exact.radius + 0.003, 0.0, bar[2] - from_bar_end])
    core = contact + np.array([[from_rod_end - ROD_M], [from_rod_end]]) * w
    normal, apart = find_normal(core, body)
    for e in (1e-3, 3e-3):
        bound = bound_turn(core, solid, normal, apart, e)
        assert climb(lambda moved: measure_turn(normal, find_normal(moved, body)[0]), core, e) <= bound + NORMAL_ERROR


def test_the_bounds_of_a_rod_across_a_bar_and_over_a_face_are_linear() -> None:
    """Square to a bar, with ends 1 mm away: c = 2 e / L. Over a face nothing turns. Any two cores: sqrt(2 e / d)."""
    rng = np.random.default_rng(0)
    bar, block = make_body("bar", rng), make_body("box", rng)
    assert bar.exact is not None
    across = np.array([[bar.exact.radius + 0.009, y, 0.0] for y in (-0.5 * ROD_M, 0.5 * ROD_M)])
    top = np.array([[0.0, 0.0, float(block.vertices[:, 2].max()) + z] for z in (0.009, 0.06)])
    for e in (1e-5, 1e-4, 1e-3):
        normal, apart = find_normal(across, bar)
        linear = bound_turn(across, RoundedBody.of_body(bar), normal, apart, e)
        assert linear == pytest.approx(np.arcsin(2.0 * e / ROD_M), rel=1e-3)
        normal, apart = find_normal(top, block)
        assert bound_turn(top, RoundedBody.of_body(block), normal, apart, e) <= 1e-4
        assert np.sqrt(e * (2.0 * apart + e)) / apart > 4.0 * linear
