"""Forces, static regions, friction cones and the joints of mechanisms in the viewer."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from browser import Browser, open_browser
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull
from viewer_results import HINGE, door, make_result, unpack

from costs.contact import GRAVITY, WorldContacts
from costs.static_region import find_static_region
from service.verify.forces.equilibrium import list_turned_loads
from service.viewer import write_viewer
from service.viewer.forces import find_holding_forces, find_weights, list_contact_points, share_wrenches, sum_loads
from service.viewer.movables import place_movables
from service.viewer.payload import make_payload

N = 61
MASS, FRICTION = 80.0, 0.6
FORCE, PLACE = np.array([40.0, 0.0, 0.0]), np.array([-0.02, 0.6, 1.0])
"""Largest force of the hand on the leaf [N], and where it acts in the leaf [m]."""


@given(st.integers(0, 2**32 - 1), st.integers(3, 9))
@settings(deadline=None)
def test_weights_are_positive_and_their_mean_is_the_point(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(n, 2))
    polygon = points[ConvexHull(points).vertices]
    inside = rng.dirichlet(np.ones(len(polygon)), 5) @ polygon
    edge = 0.3 * polygon[0] + 0.7 * polygon[1]
    wanted = np.vstack([inside, edge, polygon[2]])
    for corners in (polygon, polygon[::-1]):
        weights = find_weights(corners, wanted)
        assert weights.min() >= -1e-9
        np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-9)
        np.testing.assert_allclose(weights @ corners, wanted, atol=1e-6)


def test_a_point_outside_or_unknown_has_no_weights() -> None:
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    weights = find_weights(square, np.array([[0.5, 0.5], [1.1, 0.5], [np.nan, 0.0]]))
    np.testing.assert_allclose(weights[0], 0.25)
    assert np.isnan(weights[1:]).all()


def test_shares_of_wrenches_add_to_the_wanted_one_or_are_missing() -> None:
    wrenches = np.array([[0.0] * 6, [-40.0, 0, 0, 0, -40, 24], [-30.0, -20, 0, 20, -30, 10]])
    wanted = np.array([[0.2, 0.5, 0.3], [0.0, 1.0, 0.0]]) @ wrenches
    shares = share_wrenches(wrenches, np.vstack([wanted, [50.0, 0, 0, 0, 0, 0]]))
    np.testing.assert_allclose(shares[:2] @ wrenches, wanted, atol=1e-3)
    assert np.isnan(shares[2]).all()


def with_door(**changes: Any) -> tuple[dict[str, Any], Any]:
    """The result of ``make_result`` with a door, a load on its leaf, and a static region while it opens."""
    result, placements = make_result(n_samples=N)
    result["movables"] = door(N)
    phase = result["phases"][1]
    for contact in phase["contacts"]:
        contact.update(friction=FRICTION, force_cap_n=2000.0)
    phase["loads"] = [
        {"tool": "l_hand", "link": "door/leaf", "place": list(PLACE), "force_n": list(FORCE), "slide": [0, 0, 0.1]}
    ]
    first, last = phase["first"], phase["last"]
    points = list_contact_points(phase)
    up = np.tile([0.0, 0.0, 1.0], (len(points), 1))
    contacts = WorldContacts(points, up, np.full(len(points), FRICTION), np.full(len(points), 2000.0))
    angles, axis = door(N)[0]["angles"], np.array([0.0, 0.0, -1.0])
    turned = list_turned_loads(-FORCE, PLACE + HINGE, axis, HINGE, angles[first], angles[last])
    region = find_static_region(contacts, MASS, np.vstack([np.zeros(6), turned]))
    phase["regions"] = [
        {
            "first": first,
            "last": last,
            "polygon": region.vertices.tolist(),
            "wrenches": region.wrenches.tolist(),
            "witnesses": region.witnesses.tolist(),
            **changes,
        }
    ]
    return result, placements


def test_the_wrench_of_a_load_turns_with_its_link() -> None:
    result, _ = with_door()
    wrench = sum_loads(result["phases"][1], place_movables(door(N), N))
    for sample in (0, 30, N - 1):
        angle = -door(N)[0]["angles"][sample]
        turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
        force, point = -turn @ FORCE, turn @ PLACE + HINGE
        np.testing.assert_allclose(wrench[sample], [*force, *np.cross(point, force)], atol=1e-9)
    with pytest.raises(ValueError, match="'door/knob', which is no movable"):
        sum_loads({"loads": [{"link": "door/knob"}]}, place_movables(door(N), N))


def test_the_forces_balance_weight_and_load_inside_the_cones_at_every_frame() -> None:
    result, placements = with_door()
    phase = make_payload(result, placements)["phases"][1]
    (region,) = phase["regions"]
    forces, places = unpack(region["forces"]).astype(float), np.array(region["places"])
    samples = np.arange(30, N)
    assert forces.shape == (len(samples), 8, 3)
    assert (region["start"], region["end"]) == (3.0, 6.0)
    wrench = sum_loads(result["phases"][1], place_movables(door(N), N))[samples]
    com, weight = np.array(result["com"])[samples], np.array([0.0, 0.0, -MASS * GRAVITY])
    np.testing.assert_allclose(forces.sum(axis=1) + wrench[:, :3] + weight, 0.0, atol=1e-3)
    moment = np.cross(places, forces).sum(axis=1) + wrench[:, 3:] + np.cross(com, weight)
    np.testing.assert_allclose(moment, 0.0, atol=1e-3)
    assert np.all(np.hypot(forces[..., 0], forces[..., 1]) <= FRICTION * forces[..., 2] + 1e-3)


def test_without_witnesses_for_the_soles_a_region_has_no_forces() -> None:
    region = with_door()[0]["phases"][1]["regions"][0]
    for witnesses in (
        [],
        [[[[0.0, 0.0, 1.0]]]],
        [[corners[:4] for corners in vertex] for vertex in region["witnesses"]],
    ):
        result, placements = with_door(witnesses=witnesses)
        (made,) = make_payload(result, placements)["phases"][1]["regions"]
        assert unpack(made["forces"]).size == 0
        assert made["polygon"] == region["polygon"]


def test_outside_the_region_there_are_no_forces() -> None:
    region = with_door()[0]["phases"][1]["regions"][0]
    forces = find_holding_forces(region, np.array([[0.0, 0.0], [2.0, 0.0]]), np.zeros((2, 6)))
    assert np.isfinite(forces[0]).all()
    assert np.isnan(forces[1]).all()


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Any:
    with open_browser(tmp_path_factory.mktemp("profile"), (900, 640)) as browser:
        yield browser


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("pages") / "door.html"
    write_viewer(*with_door(), path)
    return path.as_uri()


def count(browser: Browser, colour: tuple[int, int, int], tolerance: int = 12) -> int:
    """Number of pixels of a colour."""
    browser.settle()
    return int(np.count_nonzero(np.abs(browser.picture().astype(int) - colour).max(axis=2) <= tolerance))


def labels(browser: Browser) -> list[str]:
    browser.settle()
    return list(browser.run("[...document.querySelectorAll('.label:not([hidden]) span')].map((e) => e.textContent)"))


def legends(browser: Browser) -> list[str]:
    return list(browser.run("[...document.querySelectorAll('.scales:not([hidden]) div')].map((e) => e.textContent)"))


def test_the_page_draws_loads_regions_forces_and_cones_without_complaint(browser: Browser, page: str) -> None:
    browser.open(page)
    counts = browser.run("window.__viewer.counts")
    assert {key: counts[key] for key in ("movables", "loads", "regions", "forces", "cones", "contacts")} == {
        "movables": 2, "loads": 1, "regions": 1, "forces": 1, "cones": 8, "contacts": 4,
    }  # fmt: skip
    assert browser.complaints() == []


def test_a_load_is_drawn_while_its_phase_lasts_and_says_its_newtons(browser: Browser, page: str) -> None:
    cyan = (8, 145, 178)
    browser.turn(page + "#t=1&theme=light&layers=loads")
    assert count(browser, cyan) == 0
    assert not any("N on" in text for text in labels(browser))
    browser.turn(page + "#t=4&theme=light&layers=loads")
    assert "up to 40 N on door/leaf" in labels(browser)
    assert legends(browser) == ["largest force of a hand on what it moves; 10 cm: 20 N"]
    browser.run("document.body.classList.add('unlabelled')")
    assert count(browser, cyan) > 40
    place = place_movables(door(N), N).poses[40]
    angle = -door(N)[0]["angles"][40]
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    # 40 N are 20 cm; the arrow covers the middle of that way.
    middle = turn @ PLACE + place[0, :3] + 0.1 * turn @ [1.0, 0.0, 0.0]
    x, y = (round(value) for value in browser.run(f"window.__viewer.project({json.dumps(middle.tolist())})"))
    np.testing.assert_allclose(browser.picture()[y, x], cyan, atol=25)
    rows = browser.run("[...document.querySelectorAll('.now dd')].map((e) => e.textContent)")
    assert "l_hand on door/leaf, up to 40 N" in rows
    assert "l_foot (friction 0.6, to 2000 N), r_foot (friction 0.6, to 2000 N)" in rows


def test_cones_are_off_until_switched_on(browser: Browser, page: str) -> None:
    browser.turn(page + "#t=4&theme=light&camera=hand&without=cones")
    browser.settle()
    assert not any("friction" in text for text in legends(browser))
    before = browser.picture().astype(int)
    browser.key("j")
    browser.settle()
    assert np.count_nonzero(np.abs(browser.picture().astype(int) - before).max(axis=2) > 8) > 50
    assert any(text.startswith("cones of friction") for text in legends(browser))


def test_region_and_contact_forces_are_drawn_and_told_what_they_are(browser: Browser, page: str) -> None:
    green, violet = (77, 124, 15), (124, 58, 237)
    browser.turn(page + "#t=4.5&theme=light&layers=regions&camera=top")
    assert count(browser, green, 30) > 40
    assert legends(browser) == ["static region: contact forces hold the robot with its centre of mass above it"]
    browser.turn(page + "#t=4.5&theme=light&bars=0&layers=forces&camera=side")
    assert count(browser, violet, 30) > 40
    (text,) = legends(browser)
    assert text.startswith(
        "contact forces that hold the robot at rest here under the largest loads; others may too; 10 cm: "
    )
    browser.turn(page + "#t=1&theme=light&bars=0&layers=forces,regions")
    assert count(browser, green, 30) == count(browser, violet, 30) == 0
    assert legends(browser) == []


@pytest.mark.parametrize("time", [3.5, 5.0])
def test_the_bar_rides_on_the_leaf(browser: Browser, page: str, time: float) -> None:
    browser.open(page + f"#t={time}&camera=top", is_drawn=False)
    placed = place_movables(door(N), N)
    for column, link in enumerate(placed.links):
        expected = browser.run(f"window.__viewer.project({placed.poses[int(10 * time), column, :3].tolist()})")
        np.testing.assert_allclose(browser.run(f"window.__viewer.project('{link}')"), expected, atol=0.5)
    assert f"door/leaf {np.degrees(time / 6.0):.0f}°" in labels(browser)
    assert f"door/bar {30.0 * time / 6.0:.0f} mm" in labels(browser)


def test_the_joints_of_what_is_moved_are_curves_under_the_time_bar(browser: Browser, page: str) -> None:
    browser.open(page, is_drawn=False)
    notes = browser.run("[...document.querySelectorAll('.curve.moved .note')].map((e) => e.textContent)")
    assert notes == ["door/leaf joint: 11.5° to 68.8°", "door/bar joint: 0 mm to 30 mm"]
    lines = {line["name"]: line["points"] for plot in browser.run("window.__viewer.plots") for line in plot}
    np.testing.assert_allclose(np.array(lines["door/leaf_joint"])[[0, -1], 1], np.degrees([0.2, 1.2]), atol=1e-4)
    np.testing.assert_allclose(np.array(lines["door/bar_joint"])[[0, -1], 1], [0.0, 30.0], atol=1e-4)


def test_without_bars_the_scene_fills_the_page(browser: Browser, page: str) -> None:
    browser.open(page + "#bars=0", is_drawn=False)
    browser.settle()
    box = browser.run("document.querySelector('.viewport').getBoundingClientRect().toJSON()")
    assert (box["width"], box["height"]) == (900, 640)
    for name in (".top", ".timeline", ".panel", ".scales"):
        assert browser.run(f"getComputedStyle(document.querySelector('{name}')).display") == "none"
