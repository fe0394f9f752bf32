"""Contacts of hands worked out by hand: normals from shapes, cones, held joints, caps; and the bound between poses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from costs.primitive import Primitive
from costs.robot import LinkBody
from costs.robot.shapes import box, cylinder
from service.verify import HandContact, HandPush, HeldJoint
from service.verify.forces.hand_balance import (
    HELD_SHARE,
    TOUCH_GAP_M,
    Meeting,
    _find_last,
    find_jamming_angle,
    measure_excess,
    measure_excesses,
    meet,
)
from service.verify.forces.hand_contacts import describe_failure, describe_push
from service.verify.forces.rounded import (
    MOST_ROUNDING_M,
    ROUND_ROUNDING_M,
    RoundedBody,
    measure_beyond_hull,
    shrink_hull,
)

ROD = np.array([[0.0, 0.0, -0.06], [0.0, 0.0, -0.009]])  # the rod's axis, its tip at the frame's origin
RADIUS = 0.009
BLOCK = box(np.array([0.04, 0.1, 0.2]))
ALONG_X = (np.array([1.0, 0.0, 0.0]), np.zeros(3))
UP, OUT = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
FRICTION = (0.3, 0.6)


def make_body(vertices: Float[np.ndarray, "V 3"], exact: Primitive | None = None) -> LinkBody:
    return LinkBody("m/body", "m/link", 1, vertices, vertices, exact)


def make_bar(radius: float, turned: Rotation) -> LinkBody:
    pose = np.eye(4)
    pose[:3, :3] = turned.as_matrix()
    points = cylinder(radius, 0.2) @ pose[:3, :3].T
    return make_body(points, Primitive("cylinder", radius, 0.2, pose))


def make_rod() -> HandContact:
    return HandContact("tool", "the rod", ROD, RADIUS, "m/link", "m/body")


def make_push(*contacts: HandContact, force: float = 30.0, held: tuple[HeldJoint, ...] = ()) -> HandPush:
    return HandPush("slide", 1.0, force, contacts or (make_rod(),), FRICTION, held)


def at(x: float, y: float, z: float, turned: Rotation | None = None) -> tuple[np.ndarray, np.ndarray]:
    return (Rotation.identity() if turned is None else turned).as_matrix(), np.array([x, y, z])


def make_meeting(normal: np.ndarray, way: np.ndarray = OUT, held: tuple[np.ndarray, ...] = ()) -> Meeting:
    unit = normal / np.linalg.norm(normal)
    return Meeting(0.014, 0.0, unit, way, np.array(held).reshape(-1, 3), np.zeros(3))


# --- one hold worked out by hand for each kind of contact ---------------------------------------------------


def test_the_side_of_a_rod_presses_a_flat_face_along_its_normal_however_the_rod_leans() -> None:
    for lean in (0.0, 15.0, 40.0):
        turned = Rotation.from_euler("x", lean, degrees=True)  # in the plane of the face
        met = meet(make_rod(), make_body(BLOCK), at(-0.02 - RADIUS, 0.0, 0.03, turned), 1.0, (ALONG_X,))
        np.testing.assert_allclose(met.normal, OUT, atol=1e-6)
        assert met.gap == pytest.approx(0.0, abs=1e-6)
        assert met.angle == pytest.approx(0.0, abs=1e-5)
        assert measure_excess(make_push(), (met,)) == pytest.approx(-find_jamming_angle(make_push()), abs=1e-5)


def test_a_rod_behind_a_face_would_have_to_pull_it() -> None:
    met = meet(make_rod(), make_body(BLOCK), at(0.02 + RADIUS, 0.0, 0.03), 1.0, (ALONG_X,))
    assert met.angle == pytest.approx(np.pi, abs=1e-5)
    assert measure_excess(make_push(), (met,)) > 0.5 * np.pi
    assert "would have to pull m/body: the contact's normal is 180 deg off" in describe_failure(make_push(), met.angle)


def test_a_rod_that_crosses_a_bar_presses_along_the_common_perpendicular_of_both_axes() -> None:
    """Rod along z leaning by 30 deg towards x, bar along y: the normal leans by the same angle."""
    bar, lean = make_bar(0.01, Rotation.from_euler("x", 90.0, degrees=True)), np.deg2rad(30.0)
    rod = Rotation.from_rotvec([0.0, lean, 0.0])
    normal = np.array([np.cos(lean), 0.0, -np.sin(lean)])
    middle = -(0.01 + RADIUS) * normal
    place = middle - rod.as_matrix() @ ROD.mean(axis=0)
    met = meet(make_rod(), bar, (rod.as_matrix(), place), 1.0, (ALONG_X,))
    np.testing.assert_allclose(met.normal, normal, atol=1e-4)
    assert met.gap == pytest.approx(0.0, abs=1e-6)
    assert met.angle == pytest.approx(lean, abs=1e-4)


def test_the_tip_of_a_rod_presses_a_face_that_a_joint_moves_along_its_normal_and_cannot_turn_it() -> None:
    turned = Rotation.from_rotvec([0.0, 0.5 * np.pi, 0.0])  # z of the tool along x
    pose = at(-0.02, 0.0, 0.05, turned)
    pressed = meet(make_rod(), make_body(BLOCK), pose, 1.0, (ALONG_X,))
    np.testing.assert_allclose(pressed.normal, OUT, atol=1e-6)
    assert measure_excess(make_push(), (pressed,)) < 0.0
    about_x = (np.zeros(3), OUT)  # the face turns in its own plane
    turning = meet(make_rod(), make_body(BLOCK), pose, 1.0, (about_x,))
    assert turning.angle == pytest.approx(0.5 * np.pi, abs=1e-5)
    assert measure_excess(make_push(), (turning,)) > 0.0
    assert "jams" in describe_failure(make_push(), turning.angle)


@pytest.mark.parametrize(("force", "holds"), [(119.0, True), (121.0, False)])
def test_two_fingers_carry_twice_their_squeeze_times_the_least_friction(force: float, holds: bool) -> None:
    """Pads from either side, the bar drawn along itself: 2 * 0.3 * 200 N, inside pyramids whose edge is along it."""
    pads = tuple(replace(make_rod(), surface=f"pad {k}", cap_n=200.0) for k in range(2))
    way = np.array([0.0, 1.0, 0.0])
    met = (make_meeting(OUT, way), make_meeting(-OUT, way))
    assert (measure_excess(make_push(*pads, force=force), met) <= 0.0) is holds
    push, square = make_push(*pads, force=force), 0.5 * np.pi
    assert describe_push(push, square).startswith("pad 0 and pad 1 together push m/body the way of joint slide")
    assert "pad 0 and pad 1 together do not push m/body" in describe_failure(push, square)


# --- rules --------------------------------------------------------------------------------------------------


def test_a_single_contact_jams_where_less_than_two_fifths_of_its_pressure_is_along_the_way() -> None:
    """N (n - mu v): the part along the way is N (cos a - 0.6 sin a), 0.4 N at 39.0 deg."""
    limit = find_jamming_angle(make_push())
    assert np.rad2deg(limit) == pytest.approx(38.98, abs=0.05)
    for off, sign in ((-1e-3, -1.0), (1e-3, 1.0)):
        angle = limit + off
        met = make_meeting(np.array([np.cos(angle), np.sin(angle), 0.0]))
        assert np.sign(measure_excess(make_push(), (met,))) == sign
        assert np.sign(np.cos(angle) - 0.6 * np.sin(angle) - 0.4) == -sign


def test_a_joint_that_stays_must_bear_what_the_contact_exerts_along_it() -> None:
    """A normal 9 deg off: without friction of its own the other slide stays if a third of the friction angle is 9."""
    lean = np.deg2rad(9.0)
    normal, across = np.array([np.cos(lean), np.sin(lean), 0.0]), np.array([0.0, 1.0, 0.0])
    met = make_meeting(normal, held=(across,))
    free = HeldJoint("other", 0.0, 0.0)
    assert measure_excess(make_push(held=(free,)), (met,)) > 0.0  # atan 0.3 is 16.7 deg
    assert "would move other besides slide" in describe_failure(make_push(held=(free,)), lean)
    rough = replace(make_push(held=(free,)), friction=(0.6, 0.6))  # atan 0.6 is 31 deg
    assert measure_excess(rough, (met,)) <= 0.0
    # At friction 0.3 the force is at the edge of the narrower cone: 30 N along, 30 tan(9 deg - 5.6 deg) across.
    least = 30.0 * np.tan(lean - HELD_SHARE * np.arctan(0.3))
    for high, sign in ((least - 0.1, 1.0), (least + 0.1, -1.0)):
        bears = make_push(held=(HeldJoint("other", 0.0, high),))
        assert np.sign(measure_excess(bears, (met,))) == sign
    assert measure_excess(make_push(held=(HeldJoint("other", -np.inf, np.inf),)), (met,)) < 0.0


def test_surfaces_that_do_not_touch_push_nothing() -> None:
    far = meet(make_rod(), make_body(BLOCK), at(-0.03 - RADIUS, 0.0, 0.03), 1.0, (ALONG_X,))
    assert far.gap == pytest.approx(0.01, abs=1e-6)
    assert far.gap > TOUCH_GAP_M
    assert measure_excess(make_push(), (far,)) == np.pi
    assert "does not touch" in describe_failure(make_push(), np.inf)


def test_a_force_beyond_the_cap_of_a_contact_is_not_carried() -> None:
    met = make_meeting(OUT)
    weak = replace(make_rod(), cap_n=29.0)
    assert measure_excess(make_push(weak), (met,)) == np.pi
    assert measure_excess(make_push(replace(weak, cap_n=31.0)), (met,)) < 0.0


@pytest.mark.parametrize(("first_deg", "second_deg", "holds"), [(30, 30, False), (30, -30, True), (12, 12, True)])
def test_two_contacts_that_lean_to_one_side_push_along_the_way_by_friction_alone(
    first_deg: float, second_deg: float, holds: bool
) -> None:
    """What both press across the way sums to zero: leaning apart they balance; friction 0.3 makes up 16.7 deg."""
    normals = [np.array([np.cos(lean), np.sin(lean), 0.0]) for lean in np.deg2rad([first_deg, second_deg])]
    met = tuple(make_meeting(normal) for normal in normals)
    pads = tuple(replace(make_rod(), surface=f"pad {k}") for k in range(2))
    assert (measure_excess(make_push(*pads), met) <= 0.0) is holds


# --- cores and bounds ---------------------------------------------------------------------------------------


@given(count=st.integers(1, 130), last=st.integers(-1, 129), near=st.one_of(st.none(), st.integers(-1, 129)))
def test_a_search_from_a_guess_finds_what_a_search_of_all_angles_does(count: int, last: int, near: int | None) -> None:
    last, near = min(last, count - 1), None if near is None else min(near, count - 1)
    assert _find_last(lambda at: at <= last, range(count), near) == last


@settings(max_examples=15)
@given(seed=st.integers(0, 2**32 - 1))
def test_poses_that_are_measured_together_have_the_excess_that_each_has_alone(seed: int) -> None:
    """Two pads and a joint that stays; some poses touch with both, some with one, some with none."""
    rng = np.random.default_rng(seed)
    push = make_push(make_rod(), replace(make_rod(), surface="pad", cap_n=90.0), held=(HeldJoint("other", -2.0, 2.0),))

    def draw() -> Meeting:
        meeting = make_meeting(OUT + 0.6 * rng.normal(size=3), held=(0.3 * rng.normal(size=3),))
        return replace(meeting, gap=float(rng.choice([0.0, 0.0, 2.0 * TOUCH_GAP_M])))

    poses = [(draw(), draw()) for _ in range(12)]
    alone = [measure_excess(push, met) for met in poses]
    np.testing.assert_allclose(measure_excesses(push, poses), alone, atol=1e-12)


@given(st.integers(0, 10_000))
@settings(max_examples=40, deadline=None)
def test_a_shrunken_hull_is_inside_by_its_radius(seed: int) -> None:
    rng = np.random.default_rng(seed)
    vertices = rng.normal(size=(rng.integers(5, 20), 3)) * rng.uniform(0.01, 0.2, size=3)
    core, radius = shrink_hull(vertices)
    assert 0.0 < radius <= MOST_ROUNDING_M
    assert measure_beyond_hull(core, vertices) == pytest.approx(-radius, abs=1e-9)


def test_a_round_body_has_the_normal_of_its_axis_whatever_polygon_stands_for_it() -> None:
    bar = make_bar(0.01, Rotation.identity())
    for angle in np.linspace(0.0, 2.0 * np.pi, 23):
        outwards = np.array([np.cos(angle), np.sin(angle), 0.0])
        place = (0.01 + RADIUS) * outwards - ROD.mean(axis=0)
        met = meet(make_rod(), bar, at(*place), 1.0, (ALONG_X,))
        np.testing.assert_allclose(
            met.normal, -outwards, atol=np.sqrt(2e-6 / met.apart)
        )  # the distance is known to 1 um
    assert RoundedBody.of_body(bar).radius == pytest.approx(ROUND_ROUNDING_M)
