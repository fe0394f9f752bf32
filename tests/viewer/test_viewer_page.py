"""The viewer in a real browser: drawing, text, and no network access."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
from browser import open_browser
from viewer_results import TURN, VALVE, make_result

from service.viewer import LinkPlacements, write_viewer

PAGE = Path(__file__).parents[2] / "service" / "viewer" / "page"


def test_the_bundle_was_built_from_these_sources():
    digest = hashlib.sha256()
    sources = sorted((PAGE / "src").iterdir(), key=lambda path: path.name)
    for path in [PAGE / "build.mjs", PAGE / "package.json", *sources]:
        digest.update(f"{path.relative_to(PAGE).as_posix()}\n".encode() + path.read_bytes())
    built = (PAGE / "dist" / "sources.sha256").read_text().strip()
    assert digest.hexdigest() == built, "run `npm install && npm run build` in service/viewer/page"


def test_the_bundle_carries_the_licence_of_three():
    version = json.loads((PAGE / "package.json").read_text())["devDependencies"]["three"]
    text = (PAGE / "dist" / "LICENSES.txt").read_text()
    assert f"three.js {version}" in text
    assert "Permission is hereby granted" in text


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with open_browser(tmp_path_factory.mktemp("profile"), (1000, 700)) as browser:
        yield browser


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """Addresses of the pages of a certified result, an unsolved one, and a scene without a trajectory."""
    folder = tmp_path_factory.mktemp("pages")
    scene, _ = make_result(verdict="INFEASIBLE")
    for key in ("trajectory", "phases", "waypoints", "support_polygons", "com", "zmp", "movables", "cloud", "checks"):
        scene[key] = None
    bare = scene, LinkPlacements((), np.zeros((0, 0, 7)))
    results = {"certified": make_result(), "unsolved": make_result(verdict="NOT_FOUND"), "scene": bare}
    for name, (result, placements) in results.items():
        write_viewer(result, placements, folder / f"{name}.html")
    return {name: (folder / f"{name}.html").as_uri() for name in results}


def colour_at(browser, what, width=3):
    """Return the mean colour of the picture around the projected point."""
    browser.settle()
    x, y = (round(value) for value in browser.run(f"window.__viewer.project({json.dumps(what)})"))
    return browser.picture()[y - width : y + width + 1, x - width : x + width + 1].reshape(-1, 3).mean(axis=0)


def test_the_page_draws_every_kind_of_thing_without_complaint(browser, pages):
    browser.open(pages["certified"])
    browser.settle()
    counts = browser.run("window.__viewer.counts")
    assert counts == {
        "robot": 6,
        "ghosts": 7,
        "pieces": 2,
        "movables": 1,
        "hand-contacts": 0,
        "targets": 2,
        "balance": 1,
        "contacts": 2,
        "cones": 0,
        "regions": 0,
        "forces": 0,
        "loads": 0,
        "goal": 0,
        "shapeless": 0,
        "checks": 0,
        "cloud": 500,
        "floor": 1,
    }
    assert browser.run("window.__viewer.verdict") == "CERTIFIED"
    assert "CERTIFIED" in browser.run("document.querySelector('.verdict').textContent")
    assert browser.complaints() == []
    assert browser.requests() == [pages["certified"]]


def test_robot_pixels_are_where_the_hands_are_projected(browser, pages):
    browser.turn(pages["certified"] + "#t=0&theme=dark&layers=robot,floor&camera=front")
    left, right = (colour_at(browser, link) for link in ("l_hand", "r_hand"))
    assert left[1] > left[0] + 40  # teal: more green than red
    assert right[0] > right[2] + 60  # amber: more red than blue


def test_ghosts_colour_the_picture_and_can_be_switched_off(browser, pages):
    browser.turn(pages["certified"] + "#t=0&theme=dark&camera=side&layers=robot,ghosts")
    browser.settle()
    with_ghosts = browser.picture().astype(int)
    browser.key("g")
    browser.settle()
    without = browser.picture().astype(int)
    assert np.count_nonzero(np.abs(with_ghosts - without).max(axis=2)[60:600, :650] > 12) > 300


def test_a_sole_is_filled_whatever_the_order_of_its_corners(browser, pages):
    browser.turn(pages["certified"] + "#t=1&theme=light&camera=top&layers=contacts")
    ground = colour_at(browser, [0.0, 0.0, 0.0])
    for place in ([0.0, 0.14, 0.0], [0.0, 0.08, 0.0], [0.1, 0.11, 0.0], [-0.1, 0.11, 0.0]):
        assert np.abs(colour_at(browser, place, width=1) - ground).max() > 20, place


def test_the_ground_is_below_a_robot_without_floor_and_soles(browser, tmp_path):
    grounds = []
    for shift in (-1.0, -3.0, 50.0):
        result, placements = make_result()
        result["phases"] = [{**phase, "contacts": []} for phase in result["phases"]]
        result["pieces"] = [piece for piece in result["pieces"] if piece["kind"] != "floor"]
        poses = placements.poses + np.array([0, 0, shift, 0, 0, 0, 0])
        write_viewer(result, LinkPlacements(placements.links, poses), tmp_path / "page.html")
        browser.open((tmp_path / "page.html").as_uri(), is_drawn=False)
        grounds.append(browser.run("window.__viewer.ground"))
    assert grounds[0] < 0.0
    assert grounds[1] == pytest.approx(grounds[0] - 2.0, abs=0.01)
    assert grounds[2] == 0.0


def test_the_hand_leaves_its_place_as_time_goes_on(browser, pages):
    browser.open(pages["certified"] + "#t=0&theme=dark&layers=robot,floor&camera=side", is_drawn=False)
    before = browser.run("window.__viewer.project('l_hand')")
    browser.run("window.__viewer.setTime(3)")
    after = browser.run("window.__viewer.project('l_hand')")
    assert np.hypot(*np.subtract(after, before)) > 30.0
    place = browser.run("window.__viewer.project([0.55, 0.3, 1.15])")
    np.testing.assert_allclose(after, place, atol=1.0)


def test_the_valve_turns_with_its_angle(browser, pages):
    browser.open(pages["certified"] + "#t=6", is_drawn=False)
    assert browser.run("window.__viewer.angle(0)") == pytest.approx(TURN, abs=1e-3)
    assert "115°" in browser.run("document.querySelector('.label.spot').textContent")


def test_a_click_on_a_check_jumps_to_its_time_and_marks_its_place(browser, pages):
    browser.open(pages["unsolved"] + "#t=0")
    assert browser.run("window.__viewer.counts.checks") == 1
    camera = browser.run("window.__viewer.camera")
    browser.run("document.querySelector('.check.fail').click()")
    browser.settle()
    assert browser.run("window.__viewer.time") == pytest.approx(4.0)
    moved = browser.run("window.__viewer.camera")
    assert not np.allclose(moved, camera)
    np.testing.assert_allclose(moved[3:], [0.4, -0.5, 0.6], atol=1e-6)
    assert "crate ↔ l_hand −12 mm" in browser.run("document.querySelector('.label.bad:not([hidden])').textContent")
    red = colour_at(browser, "crate")
    assert red[0] > red[1] + 60


def test_a_check_of_a_moved_joint_leads_to_what_moves(browser, tmp_path):
    result, placements = make_result()
    result["checks"][0]["where"] = {"time_s": 5.0, "position": None, "names": ["valve_turn"]}
    write_viewer(result, placements, tmp_path / "joint.html")
    browser.open((tmp_path / "joint.html").as_uri(), is_drawn=False)
    browser.run("[...document.querySelectorAll('.check')].find((e) => e.innerText.includes('joint limits')).click()")
    browser.settle()
    assert browser.run("window.__viewer.time") == pytest.approx(5.0)
    np.testing.assert_allclose(browser.run("window.__viewer.camera")[3:], VALVE, atol=5e-5)
    assert browser.run("document.querySelector('.label.good:not([hidden])').textContent") == "joint limits 5.73°"


def test_a_phase_tells_on_one_line_what_may_be_touched_alike(browser, pages):
    browser.open(pages["certified"] + "#t=5", is_drawn=False)
    rows = browser.run("[...document.querySelectorAll('.now dd')].map((e) => e.textContent)")
    assert "l_hand ↔ rim/0 … rim/1 (2), to 4 mm" in rows
    browser.open(pages["certified"] + "#t=1", is_drawn=False)
    assert "may touch" not in browser.run("document.querySelector('.now').textContent")


def test_an_unsolved_result_says_what_stands_in_the_way(browser, pages):
    browser.open(pages["unsolved"], is_drawn=False)
    text = browser.run("document.body.innerText")
    assert "NOT FOUND" in text
    assert "l_hand enters 'crate' by 12 mm" in text
    assert browser.run("document.querySelectorAll('.flag').length") == 1
    assert browser.run("document.querySelectorAll('.check')[0].className").endswith("fail")


def test_labels_do_not_cover_each_other_and_three_failed_checks_have_one(browser, tmp_path):
    result, placements = make_result(verdict="NOT_FOUND")
    failed = result["checks"][1]
    result["checks"] = [{**failed, "name": f"clearance {i}", "value": (1 + i) * failed["value"]} for i in range(5)]
    write_viewer(result, placements, tmp_path / "crowd.html")
    browser.open((tmp_path / "crowd.html").as_uri(), is_drawn=False)
    browser.settle()
    boxes = browser.run(
        "[...document.querySelectorAll('.label.bad:not([hidden]) span')].map((e) => e.getBoundingClientRect().toJSON())"
    )
    assert len(boxes) == 3
    for i, a in enumerate(boxes):
        for b in boxes[:i]:
            apart = (
                a["left"] >= b["right"] or b["left"] >= a["right"] or a["top"] >= b["bottom"] or b["top"] >= a["bottom"]
            )
            assert apart


def test_a_scene_without_trajectory_shows_its_pieces_and_no_time_bar(browser, pages):
    browser.open(pages["scene"], is_drawn=False)
    browser.settle()
    counts = browser.run("window.__viewer.counts")
    assert (counts["robot"], counts["ghosts"], counts["pieces"]) == (0, 0, 2)
    assert browser.run("getComputedStyle(document.querySelector('.timeline')).display") == "none"
    assert browser.complaints() == []


KEYS = [
    ("2", "document.querySelector('.segmented .on').textContent", "Front"),
    ("?", "document.querySelector('.help').hidden", False),
    ("Escape", "document.querySelector('.help').hidden", True),
    ("d", "document.documentElement.dataset.theme", "light"),
    ("ArrowRight", "window.__viewer.time.toFixed(3)", "1.000"),
    (".", "window.__viewer.time.toFixed(3)", "1.100"),
    ("End", "window.__viewer.time.toFixed(3)", "6.000"),
    ("[", "window.__viewer.time.toFixed(3)", "3.000"),
    ("Home", "window.__viewer.time.toFixed(3)", "0.000"),
    ("x", "[...document.querySelectorAll('.tools > button')].at(0).className", "on"),
    ("i", "getComputedStyle(document.querySelector('.panel')).display", "none"),
    ("+", "document.querySelector('.speed').value", "2"),
]


def test_keys_do_what_the_help_says(browser, pages):
    browser.open(pages["certified"] + "#theme=dark&t=0", is_drawn=False)
    for key, expression, expected in KEYS:
        browser.key(key)
        assert browser.run(expression) == expected, key


def test_space_plays_and_the_page_rests_when_paused(browser, pages):
    browser.open(pages["certified"], is_drawn=False)
    browser.settle()
    frames = browser.run("window.__viewer.frames")
    assert browser.run("new Promise((done) => setTimeout(() => done(window.__viewer.frames), 300))") == frames
    browser.key(" ")
    look = "const look = () => window.__viewer.time > 0.05 ? done(true) : setTimeout(look, 20)"
    assert browser.run(f"new Promise((done) => {{ {look}; look(); }})")


def test_both_themes_keep_text_readable(browser, pages):
    for theme in ("dark", "light"):
        browser.open(pages["certified"] + f"#theme={theme}", is_drawn=False)
        style = "getComputedStyle(document.querySelector('{}')).{}"
        text = browser.run(style.format(".check .name", "color"))
        card = browser.run(style.format(".panel", "backgroundColor"))
        levels = [np.array(c[c.index("(") + 1 : -1].split(",")[:3], dtype=float).mean() for c in (text, card)]
        assert abs(levels[0] - levels[1]) > 120, theme


def test_a_hostile_name_stays_text(browser, tmp_path):
    result, placements = make_result()
    result["robot"]["name"] = "<img src=x onerror='window.bad=1'>"
    result["checks"][0]["name"] = "</script><script>window.bad=1</script>"
    result["pieces"][1]["name"] = "<b>crate</b>"
    path = tmp_path / "hostile.html"
    write_viewer(result, placements, path)
    browser.open(path.as_uri(), is_drawn=False)
    assert browser.run("window.bad === undefined")
    assert browser.run("document.querySelectorAll('img, b:not(.chip b)').length") == 0
    assert browser.complaints() == []


def test_a_long_name_of_a_robot_does_not_run_into_the_figures(browser, tmp_path):
    result, placements = make_result()
    result["robot"]["name"] = "a robot with very many words in its name " * 3
    path = tmp_path / "long.html"
    write_viewer(result, placements, path)
    browser.size(1200, 800)
    browser.open(path.as_uri(), is_drawn=False)
    assert browser.run("(h => h.scrollWidth > h.clientWidth)(document.querySelector('.what h1'))")
    style = browser.run("getComputedStyle(document.querySelector('.what h1')).overflow")
    right = browser.run("document.querySelector('.what h1').getBoundingClientRect().right")
    assert style == "hidden"
    assert right <= browser.run("document.querySelector('.chips').getBoundingClientRect().left")
