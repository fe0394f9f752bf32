"""Every file of a result folder is checked, as it was written, refused, or named as unchecked."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from other_planners import make_request

from service import ResultError, parse_request, plan, write_result
from service.replay.replay import verify_result
from service.replay.simulation_claims import check_run
from service.result import manifest
from service.result.folder import check_folder
from service.result.manifest import forget_files, record_files, write_manifest

EARLIER = "which versions before 0.4 did not write"


@pytest.fixture(scope="module")
def honest(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("arm")
    return write_result(plan(parse_request(make_request(folder))), folder / "out").folder


@pytest.fixture
def folder(honest: Path, tmp_path: Path) -> Path:
    shutil.copytree(honest, tmp_path / "out")
    return tmp_path / "out"


def _notes(folder: Path) -> list[str]:
    summary = verify_result(folder)
    assert summary["verdict"] == "CERTIFIED"
    return [note for note in summary["notes"] if "checked: '" in note or "manifest" in note]


def _add(folder: Path, name: str, words: bytes = b"<!-- all is well -->") -> None:
    with (folder / name).open("ab") as file:
        file.write(words)


def _write_simulation(folder: Path, **changes: Any) -> None:
    """Write a report of a simulation that fits the folder's plan, with changes."""
    data = json.loads((folder / "result.json").read_text())
    plan = {key: data[key] for key in ("verdict", "request_hash")}
    run = {"verdict": "DONE", "explanation": [], "fell_at_s": None, "mechanism": []}
    report = {
        "format": "scopt-simulation/2",
        "plan": {**plan, "duration_s": data["trajectory"]["times"][-1]},
        **run,
        "runs": [{"hand_friction": 0.3, **run}],
        **changes,
    }
    (folder / "simulation.json").write_text(json.dumps(report))


def _remake_manifest(folder: Path) -> None:
    write_manifest(folder, json.loads((folder / "result.json").read_text()))


def test_nothing_is_left_unchecked_in_a_folder_as_it_was_written(folder: Path) -> None:
    assert _notes(folder) == []
    assert verify_result(folder)["unchecked"] == []
    listed = json.loads((folder / "manifest.json").read_text())["files"]
    assert {"viewer.html", "scene.glb", "openrave/environment.xml", "openrave/trajectory.xml", "robot/robot.urdf"} == (
        set(listed)
    )


@pytest.mark.parametrize("name", ["viewer.html", "scene.glb", "openrave/environment.xml", "openrave/trajectory.xml"])
def test_a_changed_drawing_is_an_error_of_the_folder(folder: Path, name: str) -> None:
    _add(folder, name)
    with pytest.raises(ResultError, match=f"'{name}' is not the file that was written: manifest.json has another hash"):
        verify_result(folder)


@pytest.mark.parametrize("name", ["viewer.html", "scene.glb", "openrave/trajectory.xml"])
def test_a_drawing_that_was_changed_with_its_hash_is_named(folder: Path, name: str) -> None:
    _add(folder, name)
    _remake_manifest(folder)
    (note,) = _notes(folder)
    assert note.startswith(f"'{name}': as manifest.json has it, but drawn here it differs")


def test_a_folder_without_a_manifest_is_as_checked_as_its_drawings_allow(folder: Path) -> None:
    (folder / "manifest.json").unlink()
    assert _notes(folder) == []  # the drawings are those of the motion
    _add(folder, "viewer.html")
    assert _notes(folder) == [f"not checked: 'viewer.html' (no manifest.json, {EARLIER})"]


def test_files_that_are_no_part_of_the_result_are_named(folder: Path) -> None:
    (folder / "robot" / "more.urdf").write_text("<robot/>")
    (folder / "read\nme").write_text("CERTIFIED")
    (folder / "elsewhere").symlink_to("/etc")
    names = ["elsewhere", "read\nme", "robot/more.urdf"]
    assert _notes(folder) == [
        "not checked: 'elsewhere', 'read\\nme', 'robot/more.urdf' (no part of the result)",
    ]
    assert verify_result(folder)["unchecked"] == names
    assert verify_result(folder, checked=["robot/more.urdf"])["unchecked"] == names[:2]


def test_missing_drawings_are_named_and_are_no_damage(folder: Path) -> None:
    (folder / "viewer.html").unlink()
    (folder / "trajectory.csv").unlink()
    assert _notes(folder) == ["missing, and not checked: 'trajectory.csv', 'viewer.html'"]


FORMAT = '{"format": "scopt-manifest/1", "files": []}'
OTHERS = {
    "no JSON": (lambda text: "no JSON", r"manifest\.json is no JSON"),
    "another format": (
        lambda text: text.replace("manifest/1", "x/1"),
        r"manifest\.json: format is 'scopt-x/1'; expected",
    ),
    "a list": (lambda text: FORMAT, r"expected the texts certificate_sha256 and files"),
    "another plan's": (
        lambda text: text.replace('"certificate_sha256": "', '"certificate_sha256": "0'),
        r"manifest\.json belongs to another certificate than that of result\.json",
    ),
    "another hash": (lambda text: text.replace('.html": "sha256:', '.html": "0'), "is not the file that was written"),
}


@pytest.mark.parametrize(("change", "words"), OTHERS.values(), ids=list(OTHERS))
def test_a_manifest_that_does_not_fit_is_an_error_of_the_folder(
    folder: Path, change: Callable[[str], str], words: str
) -> None:
    path = folder / "manifest.json"
    path.write_text(change(path.read_text()))
    with pytest.raises(ResultError, match=words):
        verify_result(folder)


def test_a_link_in_the_place_of_a_listed_file_is_an_error(folder: Path, honest: Path) -> None:
    (folder / "viewer.html").unlink()
    (folder / "viewer.html").symlink_to(honest / "viewer.html")
    with pytest.raises(ResultError, match=r"'viewer\.html' is no ordinary file, and was written as one"):
        verify_result(folder)


def test_what_a_simulation_adds_is_listed_and_an_interrupt_leaves_no_wrong_hash(folder: Path) -> None:
    names = ("simulation.json", "simulation.html")
    _write_simulation(folder)
    (folder / "simulation.html").write_text("first")
    record_files(folder, names)
    note = "'simulation.html', 'simulation.json': as manifest.json has it, not computed anew"
    assert _notes(folder) == [note]
    _write_simulation(folder, notes=["another"])
    with pytest.raises(ResultError, match=r"'simulation\.json' is not the file that was written"):
        verify_result(folder)
    forget_files(folder, names)
    assert _notes(folder) == ["not checked: 'simulation.html', 'simulation.json' (no part of the result)"]
    record_files(folder, names)
    assert _notes(folder) == [note]
    check_folder(folder)  # may be replaced by a new plan


def test_a_folder_of_an_earlier_version_gets_no_manifest_by_a_simulation(folder: Path) -> None:
    (folder / "manifest.json").unlink()
    _write_simulation(folder)
    forget_files(folder, ["simulation.json"])
    record_files(folder, ["simulation.json"])
    assert not (folder / "manifest.json").exists()
    assert _notes(folder) == [f"not checked: 'simulation.json' (no manifest.json, {EARLIER})"]


def test_a_folder_with_too_many_files_is_refused(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(manifest, "MAX_LISTED", 9)
    for number in range(3):
        (folder / str(number)).touch()
    with pytest.raises(ResultError, match="holds more than 9 files; a result folder holds a few hundred"):
        verify_result(folder)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"verdict": "STOOD"}, "the verdict is 'STOOD'; the worst of its runs is DONE"),
        ({"explanation": ["it fell"]}, "DONE, with 1 reasons against it"),
        ({"plan": {"verdict": "CERTIFIED", "request_hash": "sha256:0", "duration_s": 1.0}}, "plan.request_hash is "),
        ({"format": "scopt-simulation/9"}, "format 'scopt-simulation/9'; expected scopt-simulation/2"),
        ({"runs": []}, "is no report of a simulation"),
    ],
)
def test_a_simulation_that_contradicts_itself_or_its_plan_is_an_error_of_the_folder(
    folder: Path, changes: dict[str, Any], words: str
) -> None:
    _write_simulation(folder, **changes)
    record_files(folder, ["simulation.json"])
    with pytest.raises(ResultError, match=rf"simulation\.json: {words}"):
        verify_result(folder)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({}, None),
        ({"is_done": False}, "slide in phase 'move': not done, and the verdict is DONE"),
        ({"reached": 0.1}, "slide in phase 'move': share 1.000; 0.1 of 0.2 were reached"),
        ({"reached": 0.1, "share": 0.5, "end": 0.1}, "slide in phase 'move': done, with 50 % of its travel"),
        ({"planned": 0.1, "reached": 0.1}, "slide in phase 'move': planned 0.1; the plan has 0.2"),
    ],
)
def test_moves_of_a_simulation_are_those_of_its_plan(changes: dict[str, Any], words: str | None) -> None:
    move = {"planned": 0.2, "reached": 0.2, "share": 1.0, "planned_end": 0.2, "end": 0.2, "is_done": True}
    run = {"verdict": "DONE", "explanation": [], "fell_at_s": None, "hand_friction": None}
    told = [{"phase": "move", "joint": "slide", **move, **changes}]
    found = list(check_run({**run, "mechanism": told}, {("move", "slide"): 0.2}, set()))
    assert found == ([] if words is None else [words])
