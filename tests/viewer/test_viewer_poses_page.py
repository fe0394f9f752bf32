"""The graph of poses on the page: its picture in the panel, and the poses of a phase in the scene."""

from __future__ import annotations

import re

import numpy as np
import pytest
from browser import open_browser
from posed_results import COSTS, PATH, SENTENCES, make_posed_result, place_graph

from service.viewer import LinkPlacements, write_viewer

SHOWN = "#theme=dark&t=0&camera=front&layers=robot"
DOT = "document.querySelector('.graph [data-pose=\"{}\"]')"
CLICK = DOT + ".dispatchEvent(new MouseEvent('click', {{bubbles: true}}))"
HOVER = DOT + ".dispatchEvent(new MouseEvent('pointermove', {{bubbles: true}}))"
HEAD = "document.querySelectorAll('.head-of')[{}]"
SAID = "document.querySelector('.graph-said').innerText"
DOTS = """[...document.querySelectorAll('.graph circle')].map((e) => [Number(e.dataset.pose),
    Number(e.getAttribute('cx')), Number(e.getAttribute('cy')), e.classList.contains('chosen')])"""
COLUMNS = """[...document.querySelectorAll('.graph .column')].map((e) =>
    [Number(e.getAttribute('x')), Number(e.getAttribute('x')) + Number(e.getAttribute('width'))])"""
LAYER = """[...document.querySelectorAll('.layer')].find((e) => e.innerText.includes('Poses of a phase'))
    .querySelector('input').checked"""


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with open_browser(tmp_path_factory.mktemp("profile"), (840, 400)) as browser:
        yield browser


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """Address of the page of a result with a graph of poses."""
    path = tmp_path_factory.mktemp("page") / "viewer.html"
    write_viewer(*make_posed_result(), path, place_graph())
    return path.as_uri()


def picture_around(browser, pose, half=3):
    """The picture around the torso of a pose."""
    browser.settle()
    x, y = (round(v) for v in browser.run(f"window.__viewer.project({place_graph().poses[pose, 1, :3].tolist()})"))
    return browser.picture()[y - half : y + half + 1, x - half : x + half + 1].astype(int)


def shows_solid(browser, pose):
    """Whether the colour of poses fills the place of a torso."""
    red, _, blue = picture_around(browser, pose).reshape(-1, 3).mean(axis=0)
    return bool(blue > red + 60)


def test_each_pose_is_a_dot_in_the_column_of_its_phase_and_the_path_leads_through_the_chosen_ones(browser, page):
    browser.open(page, is_drawn=False)
    dots = browser.run(DOTS)
    assert sorted(dot[0] for dot in dots) == list(range(len(COSTS)))
    assert sorted(dot[0] for dot in dots if dot[3]) == PATH
    places = {dot[0]: np.array(dot[1:3]) for dot in dots}
    columns = browser.run(COLUMNS)
    for pose, phase in enumerate((0, 1, 1, 1, 1, 2)):
        assert columns[phase][0] < places[pose][0] < columns[phase][1]
    line = browser.run("document.querySelector('.graph .chosen-path').getAttribute('d')")
    corners = np.array(re.findall(r"[ML]([\d.]+) ([\d.]+)", line), dtype=float)
    np.testing.assert_allclose(corners, [places[pose] for pose in PATH], atol=0.05)
    assert places[4][1] > places[2][1] > places[1][1] > places[3][1]  # to the end 60, 94, 95, nowhere
    browser.run("document.querySelectorAll('.graph-title button')[1].click()")
    heights = {dot[0]: dot[2] for dot in browser.run(DOTS)}
    assert heights[4] < heights[5] < heights[0] < heights[3] < heights[1] < heights[2]  # the dearest is highest
    assert browser.complaints() == []


def test_counts_sentences_and_costs_are_told(browser, page):
    browser.open(page, is_drawn=False)
    browser.settle()  # the graph is drawn once its size is known
    text = browser.run("document.querySelector('.poses').innerText")
    cells = browser.run("[...document.querySelectorAll('.graph-table b')].map((e) => Number(e.textContent))")
    assert cells == [1, 9, 1, 1, 5, 1, 0, 1, 0]
    assert browser.run("[...document.querySelectorAll('.not-linked li')].map((e) => e.textContent)") == SENTENCES
    assert "2 sequences could not be linked" in text
    assert "costs 100.5; kept contacts move 0.2 mm" in text
    browser.run(HOVER.format(2))
    assert browser.run(SAID) == "crouch · place 1\ncost 0.002 · to the end 94"
    browser.run(HOVER.format(3))
    assert browser.run(SAID) == "crouch · place 4\ncost 0.005 · no sequence to the end"
    browser.run("document.querySelector('.graph').focus()")
    for expected in (0, 1, 5):  # the path
        browser.key("ArrowRight")
        assert browser.run("Number(document.querySelector('.graph .selected').dataset.pose)") == expected
    assert browser.run("window.__viewer.time") == 0.0


def test_a_click_on_a_dot_shows_its_pose_and_on_a_name_all_poses_of_the_phase(browser, page):
    browser.open(page + SHOWN)
    empty = picture_around(browser, 4, half=20)
    assert browser.run(LAYER) is False
    browser.run(CLICK.format(4))
    assert browser.run(LAYER) is True
    assert shows_solid(browser, 4)
    assert not shows_solid(browser, 1)
    assert browser.run("document.querySelector('.graph .strong').dataset.pose") == "4"
    assert "crouch · place 7" in browser.run(SAID)
    assert "solid: place 7" in browser.run("document.querySelector('.scales').innerText")
    browser.run(CLICK.format(4))  # no longer selected: that of the path is solid, this one a ghost
    assert shows_solid(browser, 1)
    assert not shows_solid(browser, 4)
    assert np.count_nonzero(np.abs(picture_around(browser, 4, half=20) - empty).max(axis=2) > 4) > 50
    browser.run(HEAD.format(0) + ".click()")  # its only pose stands elsewhere
    np.testing.assert_array_equal(picture_around(browser, 4, half=20), empty)
    browser.key("Escape")
    assert browser.run(LAYER) is False
    assert not shows_solid(browser, 0)
    browser.key("q")
    assert browser.run("document.querySelector('.head-of.on').textContent") == "sit"
    assert shows_solid(browser, 0)


def test_a_failed_search_says_which_phase_has_no_pose(browser, tmp_path):
    result, moved = make_posed_result()
    graph = {**result["pose_graph"], "poses": [], "path": [], "cost": None, "slip_m": None, "not_linked": []}
    graph["phases"][1] |= {"feasible": 0, "failures": {"pose: the seat is in the way": 9}}
    nothing = LinkPlacements(("pelvis",), np.zeros((0, 1, 7)))
    write_viewer({**result, "pose_graph": graph}, moved, tmp_path / "failed.html", nothing)
    browser.open((tmp_path / "failed.html").as_uri(), is_drawn=False)
    assert "No sequence: no pose of 'crouch' holds." in browser.run("document.querySelector('.poses').innerText")
    browser.run(HEAD.format(1) + ".dispatchEvent(new PointerEvent('pointerenter'))")
    assert "pose: the seat is in the way (9 times)" in browser.run(SAID)
    browser.run(HEAD.format(1) + ".click()")
    assert browser.complaints() == []


def test_hostile_names_and_sentences_stay_text(browser, tmp_path):
    result, moved = make_posed_result()
    evil, script = "<img src=x onerror='window.bad=1'>", "</script><script>window.bad=1</script>"
    graph = result["pose_graph"]
    graph["phases"][1] |= {"name": evil, "failures": {script: 4}}
    for pose in graph["poses"]:
        pose["phase"] = evil if pose["phase"] == "crouch" else pose["phase"]
    graph["not_linked"] = [evil, "<b>no way</b>"]
    write_viewer(result, moved, tmp_path / "hostile.html", place_graph())
    browser.open((tmp_path / "hostile.html").as_uri(), is_drawn=False)
    assert browser.run(HEAD.format(1) + ".textContent") == evil
    browser.run(CLICK.format(2))
    assert evil in browser.run(SAID)
    assert evil in browser.run("document.querySelector('.scales').innerText")
    browser.run(HEAD.format(1) + ".dispatchEvent(new PointerEvent('pointerenter'))")
    assert script in browser.run(SAID)
    assert browser.run("window.bad === undefined")
    assert browser.run("document.querySelectorAll('img, .not-linked b').length") == 0
    assert browser.complaints() == []
