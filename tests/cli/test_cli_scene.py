"""``scopt scene`` and ``scopt detect``: output, refused input, and the page in a real browser."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import Browser, open_browser
from cloud_files import write_bag
from little_scan import crate_scan, little_scan, scopt

from perception import Cloud, rigid_pose, write_npz, write_pcd
from service.scan import make_scene as scene_file
from service.scan.cloud import CloudInput, parse_numbers
from service.scan.detect import TimeOver
from service.scan.make_scene import SceneInput, build_scene
from service.viewer.html import render_page
from service.viewer.payload import quantize
from service.viewer.scene import make_scene_payload

SCAN = Path(__file__).parents[2] / "examples" / "data" / "valve_scan.pcd"


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scan") / "little <b>scan.pcd"
    cloud = little_scan()
    write_pcd(path, cloud.points, (*cloud.origin.tolist(), 1.0, 0.0, 0.0, 0.0))
    return path


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """Scene of the bundled scan with its valve, and the printed text."""
    out = tmp_path_factory.mktemp("scene") / "valve.json"
    result = scopt("scene", SCAN, "--out", out, "--reach", 2, "--detect", "valve", "--json")
    assert result.exit_code == 0, result.stderr
    return out, json.loads(result.stdout)


def test_a_scene_holds_pieces_floor_detections_and_figures(written: tuple[Path, dict[str, Any]]) -> None:
    out, printed = written
    data = json.loads(out.read_text())
    keys = {
        "format",
        "settings",
        "pieces",
        "floor",
        "searched",
        "unfinished",
        "detections",
        "meshes",
        "figures",
        "timings",
        "notes",
    }
    assert keys == data.keys()
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
    result = scopt("detect", "valve", SCAN, "--reach", 2, "--hint", *place, "--json")
    assert result.exit_code == 0, result.stderr
    data = json.loads(result.stdout)
    assert data["kind"] == "valve"
    confidences = [hit["confidence"] for hit in data["hits"]]
    assert confidences == sorted(confidences, reverse=True)
    assert 0.0 <= min(confidences) <= max(confidences) <= 1.0
    found = [row[3] for row in data["hits"][0]["pose_world_object"][:3]]
    np.testing.assert_allclose(found, place, atol=0.02)


def test_detect_without_a_hit_says_so_and_ends_well(scan: Path) -> None:
    told = scopt("detect", "valve", scan)
    assert told.exit_code == 0, told.stderr
    listed = scopt("detect", "valve", scan, "--json")
    assert all(hit["confidence"] < 0.5 for hit in json.loads(listed.stdout)["hits"])


def test_units_and_poses_bring_several_clouds_together(scan: Path, tmp_path: Path) -> None:
    shift = (0.4, -0.2, 0.1)
    moved = little_scan(tuple(-value for value in shift))  # type: ignore[arg-type]
    write_pcd(tmp_path / "b.pcd", moved.points * 1000.0, (*(moved.origin * 1000.0).tolist(), 1.0, 0.0, 0.0, 0.0))
    write_pcd(tmp_path / "a.pcd", little_scan().points * 1000.0, (0.0, 0.0, 1600.0, 1.0, 0.0, 0.0, 0.0))
    poses = ("--transform", "0 0 0 0 0 0", "--transform", "0.4,-0.2,0.1,1,0,0,0")
    both = scopt(
        "scene", tmp_path / "a.pcd", tmp_path / "b.pcd", "--unit", "mm", *poses, "--out", tmp_path / "s.json", "--json"
    )
    assert both.exit_code == 0, both.stderr
    data = json.loads(both.stdout)
    assert data["figures"]["points"] == 2 * len(little_scan().points)
    assert abs(data["floor"][0]["offset"]) < 0.01
    assert data["figures"]["floor_levels"] == 1


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (("detect", "unicorn", "scan.pcd"), "KIND: unknown kind 'unicorn'; expected valve"),
        (("detect", "valve", "missing.pcd"), "missing.pcd: cannot be read"),
        (("scene", "scan.pcd", "--out", "s.json", "--detect", "unicorn"), "--detect: unknown kind 'unicorn'"),
        (("scene", "a.pcd", "b.pcd", "c.pcd", *(("--transform", "0 0 0 0 0 0") * 2), "--out", "s.json"),
         "--transform is given 2 times for 3 clouds"),
        (("scene", "a.pcd", "--transform", "1 2 x", "--out", "s.json"),
         "--transform: expected numbers separated by spaces or"),
        (("scene", "a.pcd", "--transform", "1 2 3", "--out", "s.json"), "--transform: transform of 3 numbers"),
        (("scene", "a.pcd", "--transform", "nan 0 0 0 0 0", "--out", "s.json"), "--transform: transform holds NaN"),
        (("scene", "a.pcd", "--transform", "0 0 0 90 0 0", "--out", "s.json"), "--transform: transform turns by 90"),
        (("scene", "a.pcd", "--top", "-1", "--out", "s.json"), "--top: -1 m is not above --bottom -0.5 m"),
        (("scene", "a.pcd", "--top", "nan", "--out", "s.json"), "--top: nan m is no height; expected a finite number"),
        (("detect", "valve", "a.pcd", "--bottom", "-inf"), "--bottom: -inf m is no height; expected a finite number"),
        (("scene", "a.pcd", "--out", ".json"),
         "--out: .json has no name before its ending; expected one like scene.json"),
        (("scene", "a.pcd", "--message", "last", "--out", "s.json"),
         "--message: expected a whole number, -1 for the last, or"),
        (("detect", "valve", "a.pcd", "--hint", "nan", "0", "0"),
         "--hint: nan 0 0 is no place; expected three finite numbers"),
        (("scene", "a.pcd", "--sensor", "1 2", "--out", "s.json"),
         "--sensor: expected three numbers 'X Y Z' (in quotes)"),
        (("scene", "a.pcd", "--unit", "furlong", "--out", "s.json"), "--unit: unknown unit 'furlong'; expected m, cm"),
    ],
)  # fmt: skip
def test_what_cannot_be_used_is_one_line_and_exit_code_3(arguments: tuple[str, ...], problem: str) -> None:
    result = scopt(*arguments, "--json")
    assert result.exit_code == 3
    assert result.stderr.splitlines()[-1].startswith(problem)
    assert json.loads(result.stdout)["verdict"] == "INVALID_REQUEST"


@pytest.mark.parametrize(
    "arguments",
    [
        ("--hint", "1", "2", "3"),
        ("--unknown", "maybe"),
        ("--method", "magic"),
        ("--posture", "p.yaml"),
        ("--detect",),
        ("--unit", "m", "--unit", "mm"),
        ("--sensor", "0 0 1", "--sensor", "0 0 2"),
    ],
)
def test_options_that_do_not_go_together_are_usage_errors(arguments: tuple[str, ...]) -> None:
    assert scopt("scene", "scan.pcd", "--out", "s.json", *arguments).exit_code == 2


@pytest.mark.parametrize("text", ["[[1 0 0 2]\n [0 1 0 3]\n [0 0 1 4]\n [0 0 0 1]]", "(2, 3, 4); (0, 0, 0)"])
def test_a_matrix_may_be_given_as_programs_print_it(text: str) -> None:
    pose = rigid_pose(parse_numbers(text, "--transform"))
    np.testing.assert_array_equal(pose[:3, 3], [2, 3, 4])
    np.testing.assert_array_equal(pose[:3, :3], np.eye(3))


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("file/s.json", "Not a directory"),
        ("file/deep/s.json", "Not a directory"),
        ("lost/s.json", "No such file or directory"),
        ("x" * 300 + ".json", "File name too long"),
        ("/proc/s.json", "No such file or directory"),
    ],
)
def test_a_place_that_cannot_be_written_is_told_before_anything_is_read(tmp_path: Path, name: str, why: str) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "lost").symlink_to(tmp_path / "gone")
    result = scopt("scene", tmp_path / "missing.pcd", "--out", tmp_path / name)
    assert result.exit_code == 3
    line = result.stderr.splitlines()[-1]
    assert line.startswith("--out: ")
    assert line.endswith(f" cannot be written ({why}); expected another place")
    assert {path.name for path in tmp_path.iterdir()} == {"file", "lost"}


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        (("loop.pcd",), "loop.pcd: cannot be read (Too many levels of symbolic links)"),
        (("scan.pcd", "--mesh", "x" * 300 + ".obj"), " is not there; expected FILE, 'FILE near X Y Z'"),
        (("scan.pcd", "--mesh", "x" * 300 + ".obj at 1 2 3"), " is not there; expected FILE, 'FILE near X Y Z'"),
        (("scan.pcd", "--robot", "x" * 300 + ".urdf"), " is not there; expected a URDF that exists, or a robot of"),
        (("scan.pcd", "--robot", "atlas", "--posture", "x" * 300), "expected at most 200 characters"),
        (
            ("scan.pcd", "--update", "pipe.json"),
            "pipe.json is no regular file; expected the file that 'scopt scene' writes",
        ),
        (
            ("scan.pcd", "--update", "/dev/zero"),
            "/dev/zero is no regular file; expected the file that 'scopt scene' writes",
        ),
    ],
)
def test_names_of_what_is_no_file_are_one_line(
    scan: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: tuple[str, ...], problem: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("scan.pcd").symlink_to(scan)
    Path("loop.pcd").symlink_to("loop.pcd")
    os.mkfifo("pipe.json")
    result = scopt("scene", *options, "--out", "s.json")
    assert result.exit_code == 3
    assert problem in result.stderr.splitlines()[-1]


def test_a_scene_is_written_into_folders_that_are_made(scan: Path, tmp_path: Path) -> None:
    out = tmp_path / "new" / "deep" / f"{'x' * 240}.json"
    result = scopt("scene", scan, "--out", out)
    assert result.exit_code == 0, result.stderr
    assert {path.name for path in out.parent.iterdir()} == {out.name, out.with_suffix(".html").name}


def _scaled(path: Path, scale: float, shift: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Path:
    cloud = little_scan(shift)
    write_npz(path, Cloud(scale * cloud.points, scale * cloud.origin))
    return path


@pytest.mark.parametrize(
    ("scale", "shift", "told"),
    [
        (1000.0, (0.0, 0.0, 0.0), "is its unit mm (it would be 2.5 m)"),
        (1.0, (412_345.0, 5_318_008.0, 512.0), "; -412346 -5318008 -512.00 0 0 0 would bring"),
        (1.0, (500.0, 0.0, 0.0), "; -501 0 0 0 0 0 would bring"),
        (1.0, (0.0, 9.0, 0.0), "the transform -1 -9 0 0 0 0 would bring their middle into reach"),
    ],
)
def test_a_cloud_out_of_reach_is_told_what_would_help(
    tmp_path: Path, scale: float, shift: tuple[float, float, float], told: str
) -> None:
    path = _scaled(tmp_path / "far.npz", scale, shift)
    result = scopt("detect", "valve", path)
    assert result.exit_code == 3
    (line,) = [line for line in result.stderr.splitlines() if line.startswith(f"{path}: none of 5")]
    assert told in line


@pytest.mark.parametrize(
    ("scale", "told"),
    [
        (100.0, "is its unit cm (it would be 2.5 m)"),
        (1 / 0.0254, "they span 97 m: is its unit in (inches, it would be 2.5 m)?"),
    ],
)
def test_a_wrong_unit_is_told_when_hardly_anything_is_in_reach(tmp_path: Path, scale: float, told: str) -> None:
    path = _scaled(tmp_path / "small.npz", scale)
    result = scopt("scene", path, "--out", tmp_path / "s.json", "--json")
    assert result.exit_code == 0, result.stderr
    data = json.loads(result.stdout)
    assert scale < 50.0 or data["figures"]["covered_points"] is None
    (note,) = [note for note in data["notes"] if note.startswith("only ")]
    assert told in note


def test_a_wide_place_is_not_taken_for_one_in_another_unit(tmp_path: Path) -> None:
    path = _scaled(tmp_path / "wide.npz", 54.0 / 2.5)
    (note,) = [note for note in json.loads(scopt("detect", "hose", path, "--json").stdout)["notes"] if "only" in note]
    assert "unit" not in note
    assert "metres in the robot's start frame (z up, floor at 0) are needed" in note


def test_what_became_of_all_points_is_told(tmp_path: Path) -> None:
    cloud = little_scan()
    write_npz(tmp_path / "a.npz", Cloud(cloud.points, cloud.origin, (), np.array([[0.0, 9.0, 2.0]])))
    options = ("--reach", 1.6, "--top", 1.5, "--bottom", -1, "--json")
    result = scopt("scene", tmp_path / "a.npz", "--out", tmp_path / "s.json", *options)
    assert result.exit_code == 0, result.stderr
    data = json.loads(result.stdout)
    figures = data["figures"]
    assert (figures["reach_m"], figures["top_m"], figures["bottom_m"]) == (1.6, 1.5, -1.0)
    assert figures["rays_without_return"] == 1
    beside = np.hypot(*cloud.points.T[:2]) > 1.6
    above = ~beside & (cloud.points[:, 2] > 1.5)
    assert figures["cropped_points"] == beside.sum() + above.sum()
    parts = ("copied", "cropped", "robot", "floor", "stray", "obstacle")
    assert figures["points"] == len(cloud.points) == sum(figures[f"{part}_points"] for part in parts)
    where = f"{beside.sum()} farther than 1.6 m from (0, 0), {above.sum()} above 1.5 m"
    assert any(note.startswith("left out ") and note.endswith(where) for note in data["notes"])
    detected = json.loads(scopt("detect", "hose", tmp_path / "a.npz", *options).stdout)
    assert {key: detected["figures"][key] for key in detected["figures"] if key.endswith("_points")} == {
        f"{part}_points": figures[f"{part}_points"] for part in parts
    }


def test_a_hint_where_nothing_was_seen_is_told(scan: Path) -> None:
    result = scopt("detect", "hose", scan, "--hint", 0, 0, 2.5, "--json")
    assert any(
        note.startswith("no points within 0.5 m of the hint (0, 0, 2.5)") for note in json.loads(result.stdout)["notes"]
    )
    assert "no hose was found near (0, 0, 2.5)\n" in scopt("detect", "hose", scan, "--hint", 0, 0, 2.5).stdout
    result = scopt("detect", "hose", scan, "--hint", 1.4, 0, 1, "--json")
    assert not any("hint" in note for note in json.loads(result.stdout)["notes"])


def test_topic_and_message_choose_the_cloud_of_a_bag(tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    points = little_scan().points
    write_bag(tmp_path / "bag", {"/a": [(points[:50], "map")], "/b": [(points[:90], "map"), (points, "map")]})
    refused = scopt("detect", "hose", tmp_path / "bag")
    assert refused.exit_code == 3
    assert "has clouds on 2 topics; name one: /a, /b" in refused.stderr
    options = ("--topic", "/b", "--message", "-1", "--sensor", "0 0 1.6", "--transform", "0 0 0 0 0 0", "--json")
    result = scopt("detect", "hose", tmp_path / "bag", *options)
    assert result.exit_code == 0, result.stderr
    data = json.loads(result.stdout)
    assert data["figures"]["points"] == len(points)
    assert not any("viewpoint" in note or "so give a transform" in note for note in data["notes"])
    out = tmp_path / "s.json"
    merged = scopt("scene", tmp_path / "bag", "--topic", "/b", "--message", "all", "--out", out, "--json")
    assert json.loads(merged.stdout)["figures"]["points"] == len(points) + 90


def test_a_viewpoint_is_applied_when_asked(tmp_path: Path) -> None:
    cloud = little_scan((0.0, 0.0, -1.6))
    path = tmp_path / "sensor.pcd"
    write_pcd(path, cloud.points, (0.0, 0.0, 1.6, 1.0, 0.0, 0.0, 0.0))
    applied = json.loads(scopt("scene", path, "--apply-viewpoint", "--out", tmp_path / "s.json", "--json").stdout)
    assert abs(applied["floor"][0]["offset"]) < 0.01
    assert "cropped_points" in applied["figures"]
    assert applied["figures"]["cropped_points"] == 0


def test_pieces_of_coacd_and_of_unknown_space_are_written_when_asked(scan: Path, tmp_path: Path) -> None:
    pytest.importorskip("coacd")
    out = tmp_path / "s.json"
    options = ("--method", "coacd", "--unknown", "occupied", "--reach", 1.8)
    result = scopt("scene", scan, "--out", out, *options, "--json")
    assert result.exit_code == 0, result.stderr
    names = [piece["name"] for piece in json.loads(out.read_text())["pieces"]]
    assert any(name.startswith("unknown/") for name in names)
    assert json.loads(result.stdout)["figures"]["covered_points"] > 0.9


def test_a_scene_never_overwrites_what_it_is_made_from(scan: Path, tmp_path: Path) -> None:
    cloud, posture = tmp_path / "packed.pcd", tmp_path / "start.json"
    cloud.write_bytes(scan.read_bytes())
    posture.write_text("{}")
    table = tmp_path / "scan.html"
    table.write_text("1 2 3")
    (tmp_path / "link.json").symlink_to(cloud)
    (tmp_path / "folder.json").mkdir()
    before = {path: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()}
    for arguments, says in [
        ((cloud, "--out", cloud), "does not end in .json"),
        ((cloud, "--out", tmp_path / "s.html"), "does not end in .json"),
        ((cloud, "--out", tmp_path / "s"), "does not end in .json"),
        (
            (cloud, "--out", tmp_path / "folder.json"),
            f"{tmp_path / 'folder.json'} is a folder; expected the name of a file",
        ),
        ((cloud, "--out", tmp_path / "link.json"), f"{tmp_path / 'link.json'} is read and would be overwritten"),
        ((table, "--out", tmp_path / "scan.json"), f"{table} is read and would be overwritten"),
        ((cloud, "--robot", "atlas", "--posture", posture, "--out", posture), f"{posture} is read and"),
    ]:
        result = scopt("scene", *arguments)
        assert result.exit_code == 3
        assert says in result.stderr
        assert {path: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()} == before


def test_help_imports_no_library_of_the_planner() -> None:
    program = (
        "import sys\nfrom typer.testing import CliRunner\nfrom service.cli.app import app\n"
        "assert CliRunner().invoke(app, ['scene', '--help']).exit_code == 0\n"
        "print([name for name in ('numpy', 'perception', 'pinocchio', 'scipy') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Any:
    with open_browser(tmp_path_factory.mktemp("profile"), (1000, 700)) as browser:
        yield browser


def test_the_page_tells_residuals_in_their_units_and_where_the_origin_is(browser: Browser, tmp_path: Path) -> None:
    write_npz(tmp_path / "a.npz", little_scan())
    seen = build_scene(SceneInput(CloudInput((tmp_path / "a.npz",)), unknown="occupied"), lambda _: None)
    residuals = {"rms": 0.002, "axis_spread_rad": 0.01, "air_share": 0.5, "n_ends_seen": 2.0, "rival_ratio": 0.25}
    hit = {"kind": "beam", "confidence": 1.0, "pose_world_object": np.eye(4).tolist(), "sizes": {"length": 1.5}}
    payload = make_scene_payload(seen, "a") | {
        "detections": [{**hit, "residuals": residuals, "points": quantize(np.zeros((1, 3)))}]
    }
    (tmp_path / "a.html").write_text(render_page(payload, "a", "scene"))
    browser.open((tmp_path / "a.html").as_uri(), is_drawn=False)
    browser.settle()
    text = browser.run("document.querySelector('.check .residuals').innerText")
    assert text == "residuals: rms 2 mm · axis spread 0.573° · air 50 % · ends seen 2 · rival ratio 0.25"
    n_unseen = sum(piece["kind"] == "unknown" for piece in seen.data["pieces"])
    n_seen = len(seen.data["pieces"]) - n_unseen
    assert n_unseen > 0
    says = browser.run("document.querySelector('.says').innerText")
    assert f"points · {n_seen} pieces and {n_unseen} of unseen space · one floor" in says
    assert browser.run("window.__viewer.counts.origin") == 1
    assert browser.complaints() == []


def test_the_page_outlines_what_is_there_to_be_gripped_and_pressed(browser: Browser, tmp_path: Path) -> None:
    write_npz(tmp_path / "a.npz", little_scan())
    seen = build_scene(SceneInput(CloudInput((tmp_path / "a.npz",))), lambda _: None)
    handle = {"handle_x": 0.8, "handle_y": 0.06, "handle_z": 1.0, "lever_direction": -1.0}
    button = {"button_0_x": 0.05, "button_0_y": -0.02, "button_0_radius": 0.01}
    sizes = {
        "door": {"width": 0.9, "height": 2.0, "ajar": 0.1, "side": 1.0, **handle},
        "panel": {"width": 0.2, "height": 0.3, "n_buttons": 1.0, **button},
        "drill": {"grip_length": 0.12, "body_length": 0.21},
    }
    hit = {"confidence": 1.0, "pose_world_object": np.eye(4).tolist(), "residuals": {}}
    hits = [{**hit, "kind": kind, "sizes": of, "points": quantize(np.zeros((1, 3)))} for kind, of in sizes.items()]
    (tmp_path / "a.html").write_text(render_page(make_scene_payload(seen, "a") | {"detections": hits}, "a", "scene"))
    browser.open((tmp_path / "a.html").as_uri(), is_drawn=False)
    browser.settle()
    door, panel, drill = (np.reshape(browser.run(f"window.__viewer.outlineOf({i})"), (-1, 2, 3)) for i in range(3))
    for outline, line in [
        (door, [[0.8, 0.06, 1.0], [0.68, 0.06, 1.0]]),
        (door, [[0.8, 0.0, 1.0], [0.8, 0.06, 1.0]]),
        (drill, [[0.0, 0.0, -0.06], [0.0, 0.0, 0.06]]),
        (drill, [[-0.07, 0.0, 0.06], [0.14, 0.0, 0.06]]),
    ]:
        assert np.isclose(outline, line, atol=1e-6).all(axis=(1, 2)).any()
    on_button = np.isclose(np.linalg.norm(panel[:, :, :2] - [0.05, -0.02], axis=2), 0.01, atol=1e-6).all(axis=1)
    assert np.count_nonzero(on_button) == 64
    text = browser.run("document.querySelector('.check .sizes').innerText")
    assert "lever direction towards the hinge" in text
    assert browser.complaints() == []


def test_a_click_on_a_hit_looks_at_it(browser: Browser, written: tuple[Path, dict[str, Any]]) -> None:
    out, printed = written
    browser.open(out.with_suffix(".html").as_uri(), is_drawn=False)
    browser.run("document.querySelector('.check').click()")
    browser.settle()
    place = [row[3] for row in printed["detections"][0]["pose_world_object"][:3]]
    assert np.linalg.norm(np.subtract(browser.run("window.__viewer.target"), place)) < 0.2  # it is in the middle


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


def test_the_slice_moves_and_tells_free_occupied_and_unseen(
    browser: Browser, written: tuple[Path, dict[str, Any]]
) -> None:
    out, _ = written
    browser.turn(out.with_suffix(".html").as_uri() + "#theme=dark&layers=free&camera=top&slice=z:0.9&cut=0")
    browser.settle()
    axis, at = browser.run("window.__viewer.slice")
    assert (axis, at) == (2, pytest.approx(0.9))
    seen = [browser.run(f"window.__viewer.sightAt([{x}, 0.3, 0.9])") for x in (0.35, 0.88, 1.1)]
    assert seen == ["free", "occupied", "unseen"]  # half way from the sensor to the wall, at it, behind it
    legend = browser.run("document.querySelector('.slice .legend').innerText")
    assert legend.split() == ["free", "occupied", "unseen"]
    before = browser.picture().astype(int)
    browser.run("window.__viewer.moveSlice(2, 0.1)")
    browser.settle()
    assert browser.run("window.__viewer.slice")[1] == pytest.approx(0.1)
    assert np.count_nonzero(np.abs(browser.picture().astype(int) - before).max(axis=2)[60:, :650] > 20) > 1000


def test_what_is_above_the_slice_can_be_cut_off(browser: Browser, written: tuple[Path, dict[str, Any]]) -> None:
    out, printed = written
    browser.turn(out.with_suffix(".html").as_uri() + "#theme=dark&layers=points,pieces&camera=ahead&slice=z:0.6&cut=0")
    browser.settle()
    whole = browser.picture().astype(int)
    browser.run("document.querySelector('.slice .layer input').click()")
    browser.settle()
    assert browser.run("window.__viewer.isCut") is True
    changed = np.abs(browser.picture().astype(int) - whole).max(axis=2)[60:, :650] > 20
    x, y, _ = [row[3] for row in printed["detections"][0]["pose_world_object"][:3]]
    row = int(browser.run(f"window.__viewer.project([{x}, {y}, 0.55])")[1]) - 60  # a little below the slice
    assert np.count_nonzero(changed[:row]) > 1000
    assert np.count_nonzero(changed[row:]) < 0.01 * np.count_nonzero(changed[:row])


def test_pieces_can_be_coloured_by_what_rays_say_of_them(
    browser: Browser, written: tuple[Path, dict[str, Any]]
) -> None:
    out, _ = written
    browser.turn(out.with_suffix(".html").as_uri() + "#theme=dark&layers=pieces&cut=0")
    browser.settle()
    before = browser.picture().astype(int)
    browser.run("window.dispatchEvent(new KeyboardEvent('keydown', { key: 'k' }))")
    browser.settle()
    assert browser.run("window.__viewer.colouring") == "kind"
    legends = []
    for _ in range(4):
        legends.append(browser.run("document.querySelector('.colours').innerText").split("  "))
        browser.run("window.dispatchEvent(new KeyboardEvent('keydown', { key: 'k' }))")
    kinds, free, beside, own = ([entry.strip() for entry in legend if entry.strip()] for legend in legends)
    assert set(kinds) <= {"plane", "wall", "clutter"}
    assert free == ["none of it", "1 %", "2 % and more"]
    assert beside == ["all of it", "half", "none"]
    assert own == []
    assert np.count_nonzero(np.abs(browser.picture().astype(int) - before).max(axis=2)[60:, :650] > 20) > 1000


def test_a_hostile_name_is_only_text(browser: Browser, scan: Path, tmp_path: Path) -> None:
    out = tmp_path / "<img src=x onerror=alert(1)>.json"
    assert scopt("scene", scan, "--out", out).exit_code == 0
    browser.open(out.with_suffix(".html").as_uri(), is_drawn=False)
    assert browser.run("document.querySelector('h1').textContent") == out.stem
    assert browser.run("document.querySelectorAll('img').length") == 0
    assert browser.complaints() == []


def test_posture_of_the_robot_is_named_or_a_file(tmp_path: Path) -> None:
    cloud, out = crate_scan(tmp_path / "scan.npz"), tmp_path / "scene.json"
    for posture in ("reach_ready", str(tmp_path / "start.yaml")):
        (tmp_path / "start.yaml").write_text("posture: reach_ready")
        assert scopt("scene", cloud, "--robot", "atlas", "--posture", posture, "--out", out).exit_code == 0
    result = scopt("scene", cloud, "--robot", "atlas", "--posture", "nap", "--out", out)
    assert "unknown posture 'nap'" in result.stderr
    result = scopt("scene", cloud, "--robot", tmp_path / "none.urdf", "--out", out)
    assert "none.urdf is not there" in result.stderr


def _late(*_: object) -> None:
    raise TimeOver


def test_a_scene_is_written_when_the_time_ends_the_search(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scene_file, "search_objects", _late)
    cloud, out = crate_scan(tmp_path / "a.npz"), tmp_path / "scene.json"
    result = scopt("scene", cloud, "--out", out, "--detect", "valve", "--detect", "door", "--time-limit", 60)
    assert result.exit_code == 5
    line = "TIME_LIMIT  60 s were over before these were looked for to the end: valve, door"
    assert result.stdout.splitlines()[-1] == line
    assert json.loads(out.read_text())["unfinished"] == ["valve", "door"]


def test_a_time_that_is_over_before_there_are_pieces_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scene_file, "read_input", _late)
    cloud, out = crate_scan(tmp_path / "a.npz"), tmp_path / "scene.json"
    result = scopt("scene", cloud, "--out", out, "--time-limit", 0.5)
    assert result.exit_code == 5
    assert result.stderr.splitlines()[-1] == "--time-limit: 0.5 s were over before the pieces were made; expected more"
    assert not out.exists()
