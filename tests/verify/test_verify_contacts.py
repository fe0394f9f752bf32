"""Lies about contacts of a motion: the verifier refuses each, and says why."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from costs.allowance import Allowance, BodyRef
from costs.curve import Curve, TimeLaw
from costs.robot import load_robot
from costs.scene import ConvexPiece, Scene
from service.body.forces.loaded_regions import plan_contact_region
from service.demands.contacts.stances import place_patch_as_it_is
from service.demands.contacts.surfaces import make_surfaces
from service.verify import (
    Certificate,
    LoadedRegion,
    Motion,
    Phase,
    PlantedContact,
    Status,
    SupportPolygon,
    VerifyError,
    verify,
)

SIGNS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
Lie = Callable[[PlantedContact], PlantedContact]


@cache
def make_standing() -> Motion:
    """Return Atlas at rest on both feet for two seconds, with a region and its witnesses."""
    robot = load_robot("atlas")
    q = robot.postures["stand"]
    floor = ConvexPiece("floor", SIGNS * [2.0, 2.0, 0.05] - [0.0, 0.0, 0.05], "floor")
    scene = Scene((floor,))
    surface = make_surfaces({}, scene, "surfaces")["floor"]
    contacts = tuple(place_patch_as_it_is(robot, q, name, surface).planted for name in ("left_foot", "right_foot"))
    region = plan_contact_region(robot, contacts).region
    allowances = tuple(Allowance(BodyRef.of_link(c.link), BodyRef.of_piece("floor"), 4e-3) for c in contacts)
    curve = Curve(np.array([0.0, 1.0]), np.stack([q, q]), np.zeros((2, robot.n)))
    law = TimeLaw(np.array([0.0, 1.0, 2.0]), np.array([0.0, 0.5, 1.0]), np.array([0.0, 1.0, 0.0]))
    loaded = LoadedRegion(0.0, 1.0, region.vertices, region.wrenches, region.witnesses)
    phase = Phase("stand", 0.0, 1.0, contacts, allowances, regions=(loaded,), region_margin_m=0.02)
    return Motion(robot, scene, curve, law, (phase,), waived=frozenset())


def tell(motion: Motion, **lies: object) -> Certificate:
    """Return the certificate of a motion whose only phase is changed."""
    return verify(replace(motion, phases=(replace(motion.phases[0], **lies),)))  # type: ignore[arg-type]


def tell_of_contacts(motion: Motion, lie: Lie) -> Certificate:
    return tell(motion, contacts=tuple(lie(contact) for contact in motion.phases[0].contacts))


def list_failures(certificate: Certificate) -> str:
    return " ".join(check.text for check in certificate.checks if not check.ok or check.basis.value == "unproven")


def test_standing_on_both_feet_is_certified() -> None:
    certificate = verify(make_standing())
    assert certificate.status is Status.CERTIFIED, list_failures(certificate)


def test_contacts_that_bear_no_hand_s_load_are_held_though_they_press_against_each_other() -> None:
    # a hand leans on a wall, and the feet rub on the floor: forces along surfaces, and no load that drifts
    motion = make_standing()
    at = np.eye(4)
    at[:3, 3] = 0.7, 0.2, 1.1
    hand = PlantedContact("l_hand", at, np.zeros((1, 3)), force_cap_n=100.0, normal=np.array([-1.0, 0.0, 0.0]))
    contacts = (*motion.phases[0].contacts, hand)
    region = plan_contact_region(motion.robot, contacts).region
    assert np.abs(region.witnesses[..., :2]).max() > 10.0
    loaded = LoadedRegion(0.0, 1.0, region.vertices, region.wrenches, region.witnesses)
    (held,) = [c for c in tell(motion, contacts=contacts, regions=(loaded,)).checks if c.name.startswith("equilibrium")]
    assert held.ok, held.text


def tilt(angle: float) -> np.ndarray:
    return np.array([np.sin(angle), 0.0, np.cos(angle)])


REFUTED: dict[str, tuple[Lie, str]] = {
    "off its surface": (
        lambda c: replace(c, pose_world_link=c.pose_world_link + np.outer([0, 0, 1, 0], [0, 0, 0, 0.01])),
        "drifts",
    ),
    "tilted normal": (lambda c: replace(c, normal=tilt(0.2)), "leans 11.5 deg off its stated normal"),
    "tilted normal, stated tilt": (lambda c: replace(c, normal=tilt(0.35), tilt_rad=0.36), "outside its friction cone"),
    "normal turned round": (lambda c: replace(c, normal=np.array([0.0, 0.0, -1.0])), "behind the surface"),
    "horizontal normal": (lambda c: replace(c, normal=np.array([1.0, 0.0, 0.0])), "behind the surface"),
    "may slide": (lambda c: replace(c, tolerance_m=0.2, knot_tolerance_m=0.2), "centre of mass"),
    "hardly any force": (lambda c: replace(c, force_cap_n=50.0), "over its cap"),
    "wider than the foot": (lambda c: replace(c, sole=1.4 * c.sole), "off the link's shapes"),
}


@pytest.mark.parametrize("name", REFUTED)
def test_false_contacts_are_refuted(name: str) -> None:
    lie, words = REFUTED[name]
    certificate = tell_of_contacts(make_standing(), lie)
    assert certificate.status is Status.VIOLATED
    assert words in list_failures(certificate)


MALFORMED: dict[str, tuple[Lie, str]] = {
    "no unit normal": (lambda c: replace(c, normal=np.array([0.0, 0.0, 2.0])), "must be a unit vector"),
    "a normal that is no number": (lambda c: replace(c, normal=np.full(3, np.nan)), "must be a unit vector"),
    "a flat normal": (lambda c: replace(c, normal=np.array([0.0, 1.0])), "must be a unit vector"),
    "points twice": (lambda c: replace(c, sole=np.vstack([c.sole, c.sole])), "has a point twice"),
    **{
        f"{name} {value}": (
            lambda c, name=name, value=value: replace(c, **{name: value}),  # type: ignore[misc]
            f"{name} of the contact of 'l_foot' in phase 'stand' must be finite and not negative",
        )
        for name in ("tolerance_m", "knot_tolerance_m", "friction", "force_cap_n", "tilt_rad")
        for value in (-1.0, float("nan"), float("inf"))
    },
}


@pytest.mark.parametrize("name", MALFORMED)
def test_malformed_contacts_are_refused(name: str) -> None:
    lie, words = MALFORMED[name]
    with pytest.raises(VerifyError, match=words):
        tell_of_contacts(make_standing(), lie)


def test_two_contacts_of_one_link_are_refused() -> None:
    contacts = make_standing().phases[0].contacts
    with pytest.raises(VerifyError, match="'l_foot' has two contacts in phase 'stand'"):
        tell(make_standing(), contacts=(*contacts, *contacts))


def test_a_kept_contact_that_creeps_from_phase_to_phase_is_refused() -> None:
    motion = make_standing()
    whole, region = motion.phases[0], motion.phases[0].regions[0]
    curve = Curve(np.array([0.0, 0.5, 1.0]), motion.curve.positions[[0, 0, 1]], np.zeros((3, motion.robot.n)))

    def halve(creep: float) -> Motion:
        moved = []
        for contact in whole.contacts:
            pose = contact.pose_world_link.copy()
            pose[0, 3] += creep
            moved.append(replace(contact, pose_world_link=pose))
        first = replace(whole, last=0.5, regions=(replace(region, last=0.5),))
        last = replace(whole, name="on", first=0.5, contacts=tuple(moved), regions=(replace(region, first=0.5),))
        return replace(motion, curve=curve, phases=(first, last))

    assert verify(halve(0.0)).status is Status.CERTIFIED
    with pytest.raises(VerifyError, match=r"'l_foot' moves by 0\.05 mm between the phases 'stand' and 'on'"):
        verify(halve(5e-5))


def test_a_link_that_the_task_moves_carries_nothing() -> None:
    motion = replace(make_standing(), mechanism_links=frozenset({"r_foot"}))
    with pytest.raises(VerifyError, match="'r_foot' in phase 'stand' is moved by the task"):
        verify(motion)


@pytest.mark.parametrize("margin", [-1.0, -np.inf, np.nan, np.inf])
def test_margins_that_are_negative_or_no_numbers_are_refused(margin: float) -> None:
    with pytest.raises(VerifyError, match="region margin of phase 'stand' must be finite and not negative"):
        tell(make_standing(), region_margin_m=margin)


@pytest.mark.parametrize("missing", [{"regions": ()}, {"region_margin_m": None}])
def test_without_regions_or_a_margin_nothing_is_certified(missing: dict[str, object]) -> None:
    assert tell(make_standing(), **missing).status is Status.FEASIBLE_AT_SAMPLES


@pytest.mark.parametrize("grow", ["polygon", "polygon and forces"])
def test_an_enlarged_region_is_refuted(grow: str) -> None:
    region = make_standing().phases[0].regions[0]

    def enlarge(values: np.ndarray) -> np.ndarray:
        return np.asarray(values.mean(axis=0) + 1.5 * (values - values.mean(axis=0)))

    forces = enlarge(region.witnesses) if grow == "polygon and forces" else region.witnesses
    larger = replace(region, vertices=enlarge(region.vertices), witnesses=forces)
    certificate = tell(make_standing(), regions=(larger,))
    assert certificate.status is Status.VIOLATED
    assert "during stand" in list_failures(certificate)


def test_forces_at_a_contact_that_is_absent_are_refuted() -> None:
    motion = make_standing()
    assert tell(motion, contacts=motion.phases[0].contacts[:1]).status is Status.VIOLATED


def test_space_that_no_scan_has_seen_carries_nothing() -> None:
    motion = make_standing()
    unseen = Scene(tuple(replace(piece, kind="unknown") for piece in motion.scene.pieces))
    certificate = verify(replace(motion, scene=unseen))
    assert certificate.status is Status.VIOLATED
    assert "no surface is behind a contact point of l_foot" in list_failures(certificate)


def test_a_thin_plate_above_the_feet_does_not_pull_them() -> None:
    """A plate thinner than the tolerance of a contact: its lower side is near, its upper side is what is claimed."""
    motion = make_standing()
    soles = np.concatenate([contact.points for contact in motion.phases[0].contacts])
    top = ConvexPiece("plate", SIGNS * [1.0, 1.0, 1e-3] + [0.0, 0.0, float(soles[:, 2].max())])
    hung = replace(motion, scene=Scene((top,)))
    normal = np.array([0.0, 0.0, -1.0])
    certificate = tell_of_contacts(hung, lambda c: replace(c, normal=normal))
    assert "behind the surface that it presses on" in list_failures(certificate)


def make_support(contacts: tuple[PlantedContact, ...]) -> SupportPolygon:
    corners = np.concatenate([contact.points for contact in contacts])
    return SupportPolygon(corners[ConvexHull(corners[:, :2]).vertices, :2], 0.02, float(corners[:, 2].mean()))


def test_a_support_polygon_needs_soles_on_one_level() -> None:
    motion = make_standing()
    level = motion.phases[0].contacts
    lies = {"regions": (), "region_margin_m": None}
    assert tell(motion, support=make_support(level), **lies).status is Status.CERTIFIED
    for height, is_level in ((0.015, True), (0.03, False)):
        raised = level[1].pose_world_link.copy()
        raised[2, 3] += height
        contacts = (level[0], replace(level[1], pose_world_link=raised))
        certificate = tell(motion, contacts=contacts, support=make_support(contacts), **lies)
        assert ("on levels 30 mm apart" in list_failures(certificate)) is not is_level


def test_a_support_polygon_needs_level_soles() -> None:
    motion = make_standing()
    contacts = tuple(replace(contact, normal=tilt(0.3)) for contact in motion.phases[0].contacts)
    certificate = tell(motion, contacts=contacts, support=make_support(contacts), regions=(), region_margin_m=None)
    assert "leans 17.2 deg; a support polygon needs level ground" in list_failures(certificate)
