"""Contacts of hands in the viewer: where they are, their normals and ways, and what the page says of them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import Browser, open_browser
from given_mechanisms import BAR, cabinet_request, drawer_request
from shared_plans import plan_once
from viewer_results import VALVE, make_result

from service.planner import plan
from service.request.file import parse_request
from service.result.motion_json import sample_times, samples_of
from service.result.output import write_result
from service.result.result import PlanResult
from service.viewer import trace_hand_contacts, write_viewer

GREEN, RED = (5, 150, 105), (220, 38, 38)


@pytest.fixture(scope="module")
def pulled() -> PlanResult:
    """A drawer that is pulled by 0.1 m along -x, by a rod behind a bar along y."""
    return plan_once(parse_request(drawer_request(to=0.1)))


def trace(result: PlanResult, phase: str = "move slide", **more: Any) -> dict[str, Any]:
    motion = result.motion
    assert motion is not None
    assert result.certificate is not None
    data = {
        "trajectory": {"times": sample_times(motion).tolist()},
        "waypoints": [int(np.abs(samples_of(motion) - knot).argmin()) for knot in motion.curve.knots],
        "checks": [{"name": check.name} for check in result.certificate.checks],
        **more,
    }
    traced = trace_hand_contacts(motion, samples_of(motion), data)
    names = [phase.name for phase in motion.phases]
    assert [name for name, found in zip(names, traced, strict=True) if found] == [phase]
    (entry,) = traced[names.index(phase)]
    return entry


def test_a_rod_behind_a_bar_touches_it_from_behind_all_along_its_way(pulled: PlanResult) -> None:
    entry = trace(pulled)
    assert (entry["joint"], entry["surface"], entry["body"]) == ("slide", "the rod", "mechanism/drawer/handle")
    assert entry["friction"] == [0.3, 0.6]
    points, normals, ways = (np.array(entry[key]) for key in ("points", "normals", "ways"))
    assert len(points) == len(entry["times"]) >= 3
    assert all(entry["touches"])
    np.testing.assert_allclose(ways, np.tile([-1.0, 0.0, 0.0], (len(ways), 1)), atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-4)
    # Across the bar, and from it to the rod: the bar's axis comes out along -x from x = 0.69 at height 0.95.
    np.testing.assert_allclose(normals[:, 1], 0.0, atol=1e-2)
    axis = points - BAR * -normals
    np.testing.assert_allclose(axis[:, 2], 0.95, atol=1e-3)
    assert axis[0, 0] == pytest.approx(0.69, abs=1e-3)
    assert axis[-1, 0] == pytest.approx(0.59, abs=1e-3)


def test_the_way_of_a_door_turns_with_it() -> None:
    """A door 0.4 m wide that opens by 0.3 rad about a vertical hinge at (0.75, 0.1), towards the robot."""
    result = plan(parse_request(cabinet_request(to=0.3)))
    assert result.motion is not None, result.explanation
    entry = trace(result, "move hinge")
    points, normals, ways = (np.array(entry[key]) for key in ("points", "normals", "ways"))
    arm = points[:, :2] - [0.75, 0.1]
    across = np.column_stack([arm[:, 1], -arm[:, 0]]) / np.linalg.norm(arm, axis=1)[:, None]
    np.testing.assert_allclose(ways, np.column_stack([across, np.zeros(len(across))]), atol=1e-4)
    turned = np.arccos(arm[0] @ arm[-1] / np.linalg.norm(arm[0]) / np.linalg.norm(arm[-1]))
    assert turned == pytest.approx(0.3, abs=0.02)
    assert np.all(np.einsum("wi,wi->w", normals, ways) > 0.7)


def test_the_entry_names_the_check_of_its_push(pulled: PlanResult) -> None:
    assert pulled.certificate is not None
    names = [check.name for check in pulled.certificate.checks]
    assert names[trace(pulled)["check"]] == "hand_contact.move slide.slide"
    assert trace(pulled, checks=[])["check"] is None


def test_the_written_page_has_the_contacts_in_place_of_the_pushes(pulled: PlanResult, tmp_path: Path) -> None:
    page = write_result(pulled, tmp_path / "out").viewer.read_text("utf-8")
    data = json.loads(page.split('id="payload">')[1].split("</script>")[0])
    phases = {phase["name"]: phase for phase in data["phases"]}
    assert all("pushes" not in phase for phase in phases.values())
    assert phases["reach"]["hand_contacts"] == []
    assert phases["move slide"]["hand_contacts"] == [trace(pulled)]


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Any:
    with open_browser(tmp_path_factory.mktemp("profile"), (1100, 760)) as browser:
        yield browser


def write_page(folder: Path, ok: bool, basis: str, touches: bool = True) -> str:
    """A page whose wheel is pressed downwards, against a way that leans by 20 degrees from it."""
    result, placements = make_result()
    name = "hand_contact.turn.valve_turn"
    result["checks"] = [{**result["checks"][0], "name": name, "ok": ok, "basis": basis}]
    way = [0.0, float(np.sin(np.deg2rad(20.0))), -float(np.cos(np.deg2rad(20.0)))]
    point = (VALVE - np.array([0.1, 0.0, 0.0])).tolist()
    entry = {
        "joint": "valve_turn", "surface": "the rod", "body": "rim/0", "friction": [0.3, 0.6], "force_n": 20.0,
        "check": 0, "times": [3.0, 6.0], "touches": [touches] * 2, "points": [point] * 2,
        "normals": [[0.0, 0.0, -1.0]] * 2, "ways": [way] * 2,
    }  # fmt: skip
    path = folder / f"{ok}-{basis}-{touches}.html"
    write_viewer(result, placements, path, hand_contacts=[[], [entry]])
    return path.as_uri() + "#theme=light&camera=front&layers=hand-contacts&t="


def count(browser: Browser, colour: tuple[int, int, int]) -> int:
    """Number of pixels near a colour, without labels."""
    browser.run("document.body.classList.add('unlabelled')")
    browser.settle()
    return int(np.count_nonzero(np.abs(browser.picture().astype(int) - colour).max(axis=2) <= 40))


def legends(browser: Browser) -> list[str]:
    return list(browser.run("[...document.querySelectorAll('.scales:not([hidden]) div')].map((e) => e.textContent)"))


def test_a_push_that_holds_is_green_while_its_phase_lasts_and_z_hides_it(browser: Browser, tmp_path: Path) -> None:
    page = write_page(tmp_path, ok=True, basis="proof")
    browser.open(page + "1&bars=0")
    assert legends(browser) == []
    assert count(browser, GREEN) == 0
    browser.turn(page + "4&bars=0")
    assert legends(browser) == [
        "the rod on rim/0: friction 0.3 (cone) to 0.6 (outline), normal 20° off the way of joint valve_turn (arrow)"
    ]
    rows = browser.run("[...document.querySelectorAll('.now dd')].map((e) => e.textContent)")
    assert "the rod on rim/0 moves valve_turn, friction 0.3 to 0.6" in rows
    assert count(browser, GREEN) > 60
    browser.key("z")
    assert count(browser, GREEN) == 0
    assert legends(browser) == []
    assert browser.complaints() == []


@pytest.mark.parametrize(("ok", "basis", "ending"), [(False, "proof", "; fails"), (True, "unproven", "; not proven")])
def test_a_push_that_fails_or_is_not_proven_says_so(
    browser: Browser, tmp_path: Path, ok: bool, basis: str, ending: str
) -> None:
    browser.open(write_page(tmp_path, ok, basis) + "4&bars=0")
    (text,) = legends(browser)
    assert text.endswith(f"(arrow){ending}")
    assert (count(browser, RED) > 60) == (not ok)
    assert count(browser, GREEN) == 0


def test_without_contact_there_is_no_cone(browser: Browser, tmp_path: Path) -> None:
    browser.open(write_page(tmp_path, ok=False, basis="proof") + "4&bars=0")
    touching = count(browser, RED)
    browser.open(write_page(tmp_path, ok=False, basis="proof", touches=False) + "4&bars=0")
    assert count(browser, RED) < 0.7 * touching


def test_a_plan_without_a_motion_has_its_reason_as_headline(browser: Browser, tmp_path: Path) -> None:
    result, placements = make_result(verdict="INFEASIBLE")
    for key in ("trajectory", "waypoints", "phases", "checks", "support_polygons", "com", "zmp", "movables"):
        result[key] = None
    start = type(placements)(placements.links, placements.poses[:1])
    write_viewer(result, start, tmp_path / "refused.html")
    browser.open((tmp_path / "refused.html").as_uri(), is_drawn=False)
    assert browser.run("document.querySelector('.says').textContent") == "l_hand enters 'crate' by 12 mm"
