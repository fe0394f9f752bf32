"""Viewer page of an infeasible goal, of links without shapes, and on a phone."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
from browser import open_browser
from told_results import told_results

from service.result.output import write_result
from service.result.result_json import links_without_shape

PHONE = (390, 844)
REFUSED = ["into a wall", "out of reach", "to a place in a block", "an arm into a table", "atlas in a table"]


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    made = told_results(tmp_path_factory.mktemp("robots"))
    return {name: made[name]() for name in (*REFUSED, "through a wall", "atlas waves")}


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with open_browser(tmp_path_factory.mktemp("profile")) as browser:
        yield browser


@pytest.fixture(scope="module")
def pages(results, tmp_path_factory):
    folder = tmp_path_factory.mktemp("pages")
    return {name: write_result(result, folder / name).viewer.as_uri() for name, result in results.items()}


def box(browser, selector):
    return browser.run(f"document.querySelector({json.dumps(selector)}).getBoundingClientRect().toJSON()")


def labels(browser):
    browser.settle()
    return browser.run("[...document.querySelectorAll('.label:not([hidden]) span')].map((e) => e.textContent)")


@pytest.mark.parametrize("name", REFUSED)
def test_a_result_without_motion_says_where_it_should_have_ended(results, name):
    obstruction = results[name].obstruction
    assert results[name].verdict.value == "INFEASIBLE"
    assert obstruction["targets"]
    assert obstruction["links"]
    told = " ".join(results[name].explanation)
    assert ("collision" in told) == bool(obstruction["overlaps"])
    if obstruction["overlaps"]:
        deepest = obstruction["overlaps"][0]
        assert deepest["link"] in told
        assert deepest["other"] in told


def test_the_depth_of_a_goal_in_a_wall_is_the_one_of_the_explanation(results):
    result = results["into a wall"]
    told = [re.search(r"(\S+) is ([\d.]+) (mm|m) inside (\S+)", line) for line in result.explanation]
    depths = {(one[1], one[4]): float(one[2]) * {"mm": 1e-3, "m": 1.0}[one[3]] for one in told if one}
    assert len(depths) == len(result.obstruction["overlaps"]) == 3
    for pair in result.obstruction["overlaps"]:
        assert depths[pair["link"], pair["other"]] == pytest.approx(pair["depth_m"], abs=5.1e-4)


def test_links_at_a_joint_goal_stand_where_the_joints_put_them(results):
    obstruction = results["into a wall"].obstruction
    places = {one["link"]: np.array(one["position"]) for one in obstruction["links"]}
    along = np.array([np.cos(0.8), np.sin(0.8), 0.0])
    np.testing.assert_allclose(places["l0"], 0.0, atol=1e-9)
    np.testing.assert_allclose(places["l1"], 0.2 * along, atol=1e-9)
    np.testing.assert_allclose(places["l2"], 0.4 * along, atol=1e-9)
    assert obstruction["configuration"] == pytest.approx([0.8, 0.0, 0.0])


def test_a_result_with_a_motion_has_no_such_end(results):
    assert results["through a wall"].obstruction is None
    assert results["atlas waves"].obstruction is None


@pytest.mark.parametrize("name", REFUSED)
def test_the_page_draws_the_goal_and_names_what_it_is_in(browser, pages, results, name):
    browser.size(800, 600)
    browser.open(pages[name] + "#theme=light", is_drawn=False)
    obstruction = results[name].obstruction
    counts = browser.run("window.__viewer.counts")
    drawn = {one["link"] for one in obstruction["links"]}
    assert counts["goal"] == sum(body.link in drawn for body in results[name].robot.bodies)
    assert counts["targets"] == sum("position" in target for target in obstruction["targets"])
    shown = labels(browser)
    for pair in obstruction["overlaps"]:
        (text,) = [line for line in shown if line.startswith(f"{pair['link']} ↔ {pair['other']}")]
        if pair["depth_m"] is not None:
            printed = float(text.split()[-2].replace("−", "-"))
            assert printed == pytest.approx(-1e3 * pair["depth_m"], rel=5e-3)
    assert browser.complaints() == []


def test_the_links_in_collision_are_red_at_the_goal(browser, pages):
    browser.size(800, 600)
    browser.open(pages["into a wall"] + "#theme=light&layers=goal&camera=top")
    browser.run("document.body.classList.add('unlabelled')")
    browser.settle()
    x, y = (round(value) for value in browser.run("window.__viewer.project('l1 at the goal')"))
    red, green, blue = browser.picture()[y - 2 : y + 3, x - 2 : x + 3].reshape(-1, 3).mean(axis=0)
    assert red > green + 80
    assert red > blue + 80


@pytest.mark.parametrize("name", ["atlas waves", "atlas in a table", "into a wall"])
def test_links_without_a_shape_are_listed_and_crossed(browser, pages, results, name):
    browser.size(800, 600)
    browser.open(pages[name], is_drawn=False)
    expected = links_without_shape(results[name].robot)
    shaped = {body.link for body in results[name].robot.bodies}
    assert shaped.isdisjoint(expected)
    assert browser.run("window.__viewer.counts.shapeless") == len(expected) > 0
    text = browser.run("document.querySelector('.panel').innerText")
    assert f"{len(expected)} LINK" in text.upper()
    assert all(link in text for link in expected)
    # A cross is drawn on top of everything in front of it.
    browser.run("document.body.classList.add('unlabelled')")
    places = [browser.run(f"window.__viewer.project({json.dumps(link)})") for link in expected]
    assert all(place is not None for place in places)


@pytest.mark.parametrize("name", ["atlas waves", "through a wall", "into a wall"])
def test_on_a_phone_the_panel_is_below_the_view_and_everything_fits(browser, pages, name):
    browser.size(*PHONE)
    browser.open(pages[name], is_drawn=False)
    browser.settle()
    view, panel = box(browser, ".viewport"), box(browser, ".panel")
    assert panel["top"] >= view["bottom"]
    assert panel["width"] == PHONE[0]
    assert view["width"] == PHONE[0]
    assert view["height"] > 250
    assert panel["height"] > 200
    assert panel["bottom"] <= PHONE[1] + 0.5
    assert browser.run("document.documentElement.scrollWidth") == PHONE[0]
    assert browser.complaints() == []


def test_on_a_phone_every_button_can_be_reached_and_the_menu_opens_and_closes(browser, pages):
    browser.size(*PHONE)
    browser.open(pages["atlas waves"], is_drawn=False)
    rects = browser.run("[...document.querySelectorAll('.top button')].map((e) => e.getBoundingClientRect().toJSON())")
    assert len(rects) == 9
    for rect in rects:
        assert rect["left"] >= 0
        assert rect["right"] <= PHONE[0]
        assert rect["height"] >= 26
    menu = "[...document.querySelectorAll('.top button')].at(-1)"
    browser.run(f"{menu}.click()")
    assert browser.run("getComputedStyle(document.querySelector('.panel')).display") == "none"
    browser.settle()
    assert box(browser, ".viewport")["height"] > 500
    browser.run(f"{menu}.click()")
    assert box(browser, ".panel")["height"] > 200


def test_on_a_phone_names_are_not_cut_off(browser, pages):
    browser.size(*PHONE)
    browser.open(pages["atlas waves"], is_drawn=False)
    cut = browser.run(
        "[...document.querySelectorAll("
        "'.check .name, .notes li, .layer .name, .chip b, .chip small, .curve .note, dd')]"
        ".filter((e) => e.scrollWidth > e.clientWidth + 1 || e.getBoundingClientRect().right > innerWidth)"
        ".map((e) => e.textContent)"
    )
    assert cut == []
    assert browser.run("document.querySelector('.phase-name').textContent") == "reach · "
    assert browser.run("getComputedStyle(document.querySelector('.phase-name')).display") == "inline"


def test_on_a_phone_a_check_is_shown_in_the_view_while_the_list_stays(browser, pages):
    browser.size(*PHONE)
    browser.open(pages["through a wall"], is_drawn=False)
    browser.run("document.querySelector('.check.fail').click()")
    browser.settle()
    view, label = box(browser, ".viewport"), box(browser, ".label.bad:not([hidden])")
    assert view["top"] <= label["top"] <= view["bottom"]
    assert box(browser, ".check.chosen")["bottom"] <= PHONE[1]
