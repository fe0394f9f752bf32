"""Files of a result folder that were changed, replaced, added or deleted: refused, or named in a note."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.attack import bases
from benchmarks.attack.outcome import Answer, Attack
from service.errors import RequestError, ResultError
from service.replay.replay import verify_result
from service.result.manifest import record_files, write_manifest
from service.simulation.simulate import simulate

VIEWS = ("viewer.html", "scene.glb", "openrave/environment.xml", "openrave/trajectory.xml")
Change = Callable[[Path], object]


def attacks() -> list[Attack]:
    """Return lies about files, each with the file that has to be named, and honest changes of folders."""
    return [
        *(Attack("files", f"arm: {name}", partial(_lie, change, file)) for name, (file, change) in LIES.items()),
        *(Attack("harmless", f"arm: {name}", partial(_honest, change)) for name, change in HONEST.items()),
    ]


def _lie(change: Change, file: str, scratch: Path) -> tuple[Answer, str]:
    """Change a folder; the answer has to name the file."""
    folder = bases.copy_of("arm", scratch)
    change(folder)
    try:
        summary = verify_result(folder)
    except (ResultError, RequestError) as error:
        lines = [line.removeprefix(f"{folder}: ") for line in str(error).splitlines()]
        named = [line for line in lines if file in line]
        return (Answer.REFUSED, named[0]) if named else (Answer.CRASHED, f"{file} is not in: {lines[0]}")
    named = [note for note in summary["notes"] if repr(file) in note]
    if summary["verdict"] != "CERTIFIED":
        return Answer.REPORTED, str(summary["explanation"][0])
    return (Answer.REPORTED, named[0]) if named else (Answer.BELIEVED, f"CERTIFIED, and no note names {file}")


def _honest(change: Change, scratch: Path) -> tuple[Answer, str]:
    folder = bases.copy_of("arm", scratch)
    change(folder)
    try:
        summary = verify_result(folder)
    except (ResultError, RequestError) as error:
        return Answer.ALARM, str(error).splitlines()[0]
    is_fine = summary["verdict"] == "CERTIFIED" and not summary["unchecked"]
    return (Answer.TRUE if is_fine else Answer.ALARM), f"{summary['verdict']} {summary['unchecked']}"


def add_bytes(name: str) -> Change:
    """Return a change that appends a few bytes to a file."""

    def change(folder: Path) -> None:
        with (folder / name).open("ab") as file:
            file.write(b"<!-- 0.0 mm -->")

    return change


def _add_and_list(name: str) -> Change:
    def change(folder: Path) -> None:
        add_bytes(name)(folder)
        list_anew(folder)

    return change


def _add_without_manifest(name: str) -> Change:
    def change(folder: Path) -> None:
        add_bytes(name)(folder)
        (folder / "manifest.json").unlink()

    return change


def list_anew(folder: Path) -> None:
    write_manifest(folder, json.loads((folder / "result.json").read_text(encoding="utf-8")))


def _take_views(folder: Path, *, with_manifest: bool) -> None:
    """Replace the drawings by those of another plan of the same robot."""
    other = bases.original("untimed") / "result"
    for name in (*VIEWS, *(["manifest.json"] if with_manifest else [])):
        shutil.copyfile(other / name, folder / name)


def _put_link(folder: Path) -> None:
    (folder / "viewer.html").rename(folder.parent / "page.html")
    (folder / "viewer.html").symlink_to(folder.parent / "page.html")


def write_text(name: str, text: str) -> Change:
    return lambda folder: (folder / name).write_text(text, encoding="utf-8")


def _simulate(folder: Path) -> None:
    """Add the files of a simulation."""
    simulate(folder)


def _edit_simulation(folder: Path) -> None:
    _simulate(folder)
    (folder / "simulation.json").write_text('{"verdict": "STOOD"}', encoding="utf-8")


def _invent_simulation(folder: Path) -> None:
    (folder / "simulation.json").write_text('{"verdict": "STOOD"}', encoding="utf-8")
    record_files(folder, ["simulation.json"])


def _edit_manifest(change: Callable[[dict[str, Any]], object]) -> Change:
    def edit(folder: Path) -> None:
        path = folder / "manifest.json"
        manifest = json.loads(path.read_text(encoding="utf-8"))
        change(manifest)
        path.write_text(json.dumps(manifest), encoding="utf-8")

    return edit


def _change_and_leave_out(folder: Path) -> None:
    add_bytes("viewer.html")(folder)
    _edit_manifest(lambda manifest: manifest["files"].pop("viewer.html"))(folder)


NO_HASH = "sha256:" + 64 * "0"
LIES: dict[str, tuple[str, Change]] = {
    **{f"{name} changed": (name, add_bytes(name)) for name in VIEWS},
    **{f"{name} changed with its hash": (name, _add_and_list(name)) for name in VIEWS},
    **{f"{name} changed, and no manifest": (name, _add_without_manifest(name)) for name in VIEWS},
    "drawings of another plan": ("viewer.html", lambda folder: _take_views(folder, with_manifest=False)),
    "drawings of another plan with their manifest": (
        "manifest.json",
        lambda folder: _take_views(folder, with_manifest=True),
    ),
    "the page behind a link": ("viewer.html", _put_link),
    "a mesh of the robot changed": ("robot/hand.obj", add_bytes("robot/hand.obj")),
    "a page beside the page": ("proof.html", write_text("proof.html", "CERTIFIED")),
    "a mesh more in the robot's folder": ("robot/more.obj", write_text("robot/more.obj", "")),
    "a simulation without a hash": ("simulation.json", write_text("simulation.json", '{"verdict": "STOOD"}')),
    "a simulation edited": ("simulation.json", _edit_simulation),
    "a simulation invented with its hash": ("simulation.json", _invent_simulation),
    "the page changed and left out of the manifest": ("viewer.html", _change_and_leave_out),
    "a file in the manifest alone": (
        "proof.pdf",
        _edit_manifest(lambda manifest: manifest["files"].update({"proof.pdf": NO_HASH})),
    ),
    "a place outside in the manifest": (
        "../page.html",
        _edit_manifest(lambda manifest: manifest["files"].update({"../page.html": NO_HASH})),
    ),
    "the page without a hash": (
        "viewer.html",
        _edit_manifest(lambda manifest: manifest["files"].update({"viewer.html": ""})),
    ),
    "a manifest of another format": ("manifest.json", _edit_manifest(lambda manifest: manifest.update(format="x/9"))),
    "a manifest of another certificate": (
        "manifest.json",
        _edit_manifest(lambda manifest: manifest.update(certificate_sha256=NO_HASH)),
    ),
    "a manifest that is a list": ("manifest.json", write_text("manifest.json", "[]")),
    "a manifest that is no JSON": ("manifest.json", write_text("manifest.json", "all is well")),
    "an approval that nobody checks": ("approval.json", write_text("approval.json", "approved by ada")),
}
HONEST: dict[str, Change] = {
    "as it was written": lambda folder: None,
    "without a manifest, as before": lambda folder: (folder / "manifest.json").unlink(),
    "with a simulation": _simulate,
    "with a simulation made twice": lambda folder: (_simulate(folder), _simulate(folder)),
    "without its page": lambda folder: (folder / "viewer.html").unlink(),
}
