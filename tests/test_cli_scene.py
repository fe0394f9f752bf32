"""``scopt scene`` and ``scopt detect``: what they write and print, what they refuse, and the page in a real browser."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import Browser, find_chromium
from click.testing import Result
from typer.testing import CliRunner

from perception import Cloud, write_pcd
from service.cli import app

SCAN = Path(__file__).parents[1] / "examples" / "data" / "valve_scan.pcd"


def _scopt(*arguments: object) -> Result:
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def _little_scan(shift: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Cloud:
    """Floor, a wall 1.5 m ahead and a crate before it, seen from 1.6 m up."""
    rng = np.random.default_rng(0)
    floor = np.column_stack([rng.uniform(-1, 1.5, 2500), rng.uniform(-1.2, 1.2, 2500), rng.normal(0, 0.004, 2500)])
    wall = np.column_stack([rng.normal(1.5, 0.004, 2500), rng.uniform(-1.2, 1.2, 2500), rng.uniform(0, 2, 2500)])
    crate = np.column_stack([rng.normal(1.0, 0.004, 900), rng.uniform(-0.3, 0.2, 900), rng.uniform(0.0, 0.6, 900)])
    hidden = (wall[:, 2] < 0.55) & (np.abs(wall[:, 1] + 0.05) < 0.4)
    points = np.concatenate([floor, wall[~hidden], crate])
    return Cloud(points + shift, np.array([0.0, 0.0, 1.6]) + shift)


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scan") / "little <b>scan.pcd"
    cloud = _little_scan()
    write_pcd(path, cloud.points, (*cloud.origin.tolist(), 1.0, 0.0, 0.0, 0.0))
    return path


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """The bundled scan as a scene with its valve, and what was printed."""
    out = tmp_path_factory.mktemp("scene") / "valve.json"
    result = _scopt("scene", SCAN, "--out", out, "--reach", 2, "--detect", "valve", "--json")
    assert result.exit_code == 0, result.stderr
    return out, json.loads(result.stdout)


def test_a_scene_holds_pieces_floor_detections_and_figures(written: tuple[Path, dict[str, Any]]) -> None:
    out, printed = written
    data = json.loads(out.read_text())
    assert {"format", "pieces", "floor", "detections", "figures", "timings", "notes"} == data.keys()
    assert "pieces" not in printed
    assert printed["viewer"] == str(out.with_suffix(".html"))
    assert {key: printed[key] for key in ("floor", "detections", "figures")} == {
        key: data[key] for key in ("floor", "detections", "figures")
    }
    (floor,) = data["floor"]
    assert abs(floor["offset"]) < 0.02
    assert floor["slope_deg"] < 1.0
    assert data["figures"]["detections"] == len(data["detections"]) >= 1
    best = data["detections"][0]
    assert best["confidence"] >= 0.5
    assert np.array(best["pose_world_object"]).shape == (4, 4)
    assert best["sizes"]["outer_radius"] > 0.05
    assert best["residuals"]
    assert {path.name for path in out.parent.iterdir()} == {"valve.json", "valve.html"}


def test_detect_lists_hits_best_first(written: tuple[Path, dict[str, Any]]) -> None:
    place = [row[3] for row in written[1]["detections"][0]["pose_world_object"][:3]]
    result = _scopt("detect", "valve", SCAN, "--reach", 2, "--hint", *place, "--json")
    assert result.exit_code == 0, result.stderr
    data = json.loads(result.stdout)
    assert data["kind"] == "valve"
    confidences = [hit["confidence"] for hit in data["hits"]]
    assert confidences == sorted(confidences, reverse=True)
    assert 0.0 <= min(confidences) <= max(confidences) <= 1.0
    found = [row[3] for row in data["hits"][0]["pose_world_object"][:3]]
    np.testing.assert_allclose(found, place, atol=0.02)


def test_detect_without_a_hit_says_so_and_ends_well(scan: Path) -> None:
    told = _scopt("detect", "valve", scan)
    assert told.exit_code == 0, told.stderr
    listed = _scopt("detect", "valve", scan, "--json")
    assert all(hit["confidence"] < 0.5 for hit in json.loads(listed.stdout)["hits"])


def test_units_and_poses_bring_several_clouds_together(scan: Path, tmp_path: Path) -> None:
    shift = (0.4, -0.2, 0.1)
    moved = _little_scan(tuple(-value for value in shift))  # type: ignore[arg-type]
    write_pcd(tmp_path / "b.pcd", moved.points * 1000.0, (*(moved.origin * 1000.0).tolist(), 1.0, 0.0, 0.0, 0.0))
    write_pcd(tmp_path / "a.pcd", _little_scan().points * 1000.0, (0.0, 0.0, 1600.0, 1.0, 0.0, 0.0, 0.0))
    poses = ("--transform", "0 0 0 0 0 0", "--transform", "0.4,-0.2,0.1,1,0,0,0")
    both = _scopt(
        "scene", tmp_path / "a.pcd", tmp_path / "b.pcd", "--unit", "mm", *poses, "--out", tmp_path / "s.json", "--json"
    )
    assert both.exit_code == 0, both.stderr
    data = json.loads(both.stdout)
    assert data["figures"]["points"] == 2 * len(_little_scan().points)
    assert abs(data["floor"][0]["offset"]) < 0.01
    assert data["figures"]["floor_levels"] == 1


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (("detect", "unicorn", "scan.pcd"), "KIND: unknown kind 'unicorn'; valve"),
        (("detect", "valve", "missing.pcd"), "missing.pcd: cannot be read"),
        (("scene", "scan.pcd", "--out", "s.json", "--detect", "unicorn"), "--detect: unknown kind 'unicorn'"),
        (("scene", "a.pcd", "b.pcd", "c", "--transform", "0 0 0 0 0 0", "--transform", "0 0 0 0 0 0", "--out", "s.json"),
         "--transform is given 2 times for 3 clouds"),
        (("scene", "a.pcd", "--transform", "1 2 x", "--out", "s.json"), "--transform: numbers separated by spaces or"),
        (("scene", "a.pcd", "--transform", "1 2 3", "--out", "s.json"), "--transform: transform of 3 numbers"),
        (("scene", "a.pcd", "--sensor", "1 2", "--out", "s.json"), "--sensor: three numbers X Y Z would do, got '1 2'"),
        (("scene", "a.pcd", "--unit", "furlong", "--out", "s.json"), "--unit: unknown unit 'furlong'; m, cm"),
    ],
)  # fmt: skip
def test_what_cannot_be_used_is_one_line_and_exit_code_3(arguments: tuple[str, ...], problem: str) -> None:
    result = _scopt(*arguments, "--json")
    assert result.exit_code == 3
    assert result.stderr.splitlines()[-1].startswith(problem)
    assert json.loads(result.stdout)["verdict"] == "INVALID_REQUEST"


@pytest.mark.parametrize(
    "arguments",
    [("--hint", "1", "2", "3"), ("--unknown", "maybe"), ("--method", "magic"), ("--posture", "p.yaml"), ("--detect",)],
)
def test_options_that_do_not_go_together_are_usage_errors(arguments: tuple[str, ...]) -> None:
    assert _scopt("scene", "scan.pcd", "--out", "s.json", *arguments).exit_code == 2


def test_a_scene_never_overwrites_what_it_is_made_from(scan: Path, tmp_path: Path) -> None:
    cloud, posture = tmp_path / "packed.pcd", tmp_path / "start.json"
    cloud.write_bytes(scan.read_bytes())
    posture.write_text("{}")
    table = tmp_path / "scan.html"
    table.write_text("1 2 3")
    (tmp_path / "link.json").symlink_to(cloud)
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    for arguments, says in [
        ((cloud, "--out", cloud), "does not end in .json"),
        ((cloud, "--out", tmp_path / "s.html"), "does not end in .json"),
        ((cloud, "--out", tmp_path / "s"), "does not end in .json"),
        ((cloud, "--out", tmp_path / "link.json"), f"{tmp_path / 'link.json'} is read and would be overwritten"),
        ((table, "--out", tmp_path / "scan.json"), f"{table} is read and would be overwritten"),
        ((cloud, "--robot", "atlas", "--posture", posture, "--out", posture), f"{posture} is read and"),
    ]:
        result = _scopt("scene", *arguments)
        assert result.exit_code == 3
        assert says in result.stderr
        assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_help_imports_no_library_of_the_planner() -> None:
    program = (
        "import sys\nfrom typer.testing import CliRunner\nfrom service.cli import app\n"
        "assert CliRunner().invoke(app, ['scene', '--help']).exit_code == 0\n"
        "print([name for name in ('numpy', 'perception', 'pinocchio', 'scipy') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Any:
    program = find_chromium()
    if program is None:
        pytest.skip("no chromium on this machine")
    browser = Browser(program, tmp_path_factory.mktemp("profile"))
    browser.size(1000, 700)
    yield browser
    browser.close()


def test_the_page_draws_everything_and_talks_to_nobody(browser: Browser, written: tuple[Path, dict[str, Any]]) -> None:
    out, printed = written
    address = out.with_suffix(".html").as_uri()
    browser.open(address)
    browser.settle()
    counts = browser.run("window.__viewer.counts")
    assert counts["pieces"] + counts["floor"] == printed["figures"]["pieces"]
    assert counts["detections"] == printed["figures"]["detections"]
    assert counts["points"] > 5_000
    assert browser.complaints() == []
    assert browser.requests() == [address]
    text = browser.run("document.querySelector('.check').innerText")
    assert "valve" in text
    assert "residuals: " in text


def test_a_click_on_a_hit_looks_at_it(browser: Browser, written: tuple[Path, dict[str, Any]]) -> None:
    out, printed = written
    browser.open(out.with_suffix(".html").as_uri())
    browser.run("document.querySelector('.check').click()")
    browser.settle()
    place = [row[3] for row in printed["detections"][0]["pose_world_object"][:3]]
    np.testing.assert_allclose(browser.run("window.__viewer.target"), place, atol=1e-3)


def test_the_slice_moves_and_colours_what_rays_saw_free(browser: Browser, written: tuple[Path, dict[str, Any]]) -> None:
    out, _ = written
    browser.open(out.with_suffix(".html").as_uri() + "#theme=dark&layers=free&camera=top&slice=z:0.9")
    browser.settle()
    axis, at = browser.run("window.__viewer.slice")
    assert (axis, at) == (2, pytest.approx(0.9))
    # Half way from the sensor to the wall is free; behind the wall nobody has looked.
    assert browser.run("window.__viewer.isFreeAt([0.35, 0.3, 0.9])") is True
    before = browser.picture().astype(int)
    browser.run("window.__viewer.moveSlice(2, 0.1)")
    browser.settle()
    assert browser.run("window.__viewer.slice")[1] == pytest.approx(0.1)
    assert np.count_nonzero(np.abs(browser.picture().astype(int) - before).max(axis=2)[60:, :650] > 20) > 1000


def test_a_hostile_name_is_only_text(browser: Browser, scan: Path, tmp_path: Path) -> None:
    out = tmp_path / "<img src=x onerror=alert(1)>.json"
    assert _scopt("scene", scan, "--out", out).exit_code == 0
    browser.open(out.with_suffix(".html").as_uri())
    assert browser.run("document.querySelector('h1').textContent") == out.stem
    assert browser.run("document.querySelectorAll('img').length") == 0
    assert browser.complaints() == []
