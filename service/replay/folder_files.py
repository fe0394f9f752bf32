"""Every file of a result folder: checked by its content, as it was written, changed, missing, or not checked."""

from __future__ import annotations

import tempfile
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from costs.robot import RobotModel
from service.errors import ResultError, shown
from service.replay.simulation_claims import check_simulation
from service.result.folder import (
    APPROVAL_NAME,
    GLB_NAME,
    MANIFEST_NAME,
    OPENRAVE_NAME,
    RESULT_NAME,
    REVOCATION_NAME,
    SIMULATION_NAME,
    TRAJECTORY_NAME,
    VIEWER_NAME,
)
from service.result.manifest import Manifest, hash_certificate, hash_file, list_files, read_manifest
from service.result.output import draw_views
from service.verify import Motion

SHOWN = 10  # names in a sentence


@dataclass(frozen=True)
class FileFindings:
    """Findings about the files of a folder.

    Attributes:
        differences: sentences on files that are not what was written.
        notes: sentences on files that are missing, not computed anew, or not checked.
        unchecked: names of the files about which nothing is said.
    """

    differences: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    unchecked: tuple[str, ...] = ()


def check_files(
    folder: Path, data: Mapping[str, Any], robot: RobotModel, motion: Motion, checked: Collection[str] = ()
) -> FileFindings:
    """Compare the files of a result folder with its manifest, and its drawings with the motion.

    The drawings are made once more from ``result.json``.  Where they are the same byte by byte, nothing rests on the
    manifest; another version, or another machine, may draw otherwise.

    Args:
        folder: the folder.
        data: content of its ``result.json``.
        robot: its robot, without the joints that the task moves.
        motion: its motion.
        checked: names of files that the caller has checked by their content.

    Raises:
        ResultError: the folder is no result folder by its size.
    """
    there = list_files(folder)
    try:
        manifest = read_manifest(folder)
    except ResultError as error:
        return FileFindings((str(error),), (), tuple(name for name in there if name not in checked))
    used = {RESULT_NAME, MANIFEST_NAME, *_list_robot_files(data, robot), *checked}
    views = [name for name in there if name in (VIEWER_NAME, GLB_NAME) or name.startswith(f"{OPENRAVE_NAME}/")]
    redrawn = _find_redrawn(folder, data, robot, motion, views) if views else frozenset()
    listed: Mapping[str, str] = {} if manifest is None else manifest.files
    differences = [] if manifest is None else list(_compare(there, manifest, data))
    if SIMULATION_NAME in there:
        differences += check_simulation(folder, data, motion)
    rest = [name for name in there if name not in used and name not in redrawn]
    unchecked = [name for name in rest if name not in listed]
    kept = [name for name in rest if name in listed]
    notes = _note_missing(there, listed)
    drawn_otherwise = [name for name in kept if name in views]
    if drawn_otherwise:
        notes.append(
            f"{_join(drawn_otherwise)}: as {MANIFEST_NAME} has it, but drawn here it differs (another version or "
            "machine, meshes that are only drawn, or changed together with its hash)"
        )
    computed = [name for name in kept if name not in views]
    if computed:
        notes.append(f"{_join(computed)}: as {MANIFEST_NAME} has it, not computed anew")
    if unchecked:
        notes.append(_describe_unchecked(unchecked, manifest))
    return FileFindings(tuple(differences), tuple(notes), tuple(unchecked))


def _list_robot_files(data: Mapping[str, Any], robot: RobotModel) -> list[str]:
    """Return the paths of the robot's files, from which its bodies and hashes were computed anew."""
    own = [data["robot"]["urdf"], data["robot"]["srdf"]]
    return [str(name) for name in own if name is not None] + [
        f"{package}/{name}" for package in data["robot"]["package_dirs"] for name in robot.source.files
    ]


def _find_redrawn(
    folder: Path, data: Mapping[str, Any], robot: RobotModel, motion: Motion, views: Sequence[str]
) -> frozenset[str]:
    """Return the drawings that are, byte by byte, those of the motion."""
    with tempfile.TemporaryDirectory(prefix="scopt-views-") as scratch:
        fresh = Path(scratch)
        try:
            draw_views(robot, motion, motion.curve.positions[0], data, fresh)
        except (ValueError, KeyError, TypeError, IndexError, AttributeError, ArithmeticError):
            return frozenset()  # data that cannot be drawn; the manifest still says whether the files were changed
        return frozenset(name for name in views if _is_same(folder / name, fresh / name))


def _is_same(path: Path, fresh: Path) -> bool:
    """Return whether a file of the folder is an ordinary one with the bytes of a new file."""
    if not fresh.is_file() or path.is_symlink() or not path.is_file():
        return False
    try:
        return path.stat().st_size == fresh.stat().st_size and path.read_bytes() == fresh.read_bytes()
    except OSError:
        return False


def _compare(there: Mapping[str, Path], manifest: Manifest, data: Mapping[str, Any]) -> list[str]:
    """Return a sentence for each file that is not the listed one."""
    problems = []
    if manifest.certificate_sha256 != hash_certificate(data):
        problems.append(f"{MANIFEST_NAME} belongs to another certificate than that of {RESULT_NAME}")
    for name, value in manifest.files.items():
        path = there.get(name)
        if path is None:
            continue
        if path.is_symlink() or not path.is_file():
            problems.append(f"{shown(name)} is no ordinary file, and was written as one")
            continue
        try:
            is_same = hash_file(path) == value
        except OSError as error:
            problems.append(f"{shown(name)} cannot be read: {error.strerror}")
            continue
        if not is_same:
            problems.append(f"{shown(name)} is not the file that was written: {MANIFEST_NAME} has another hash")
    return problems


def _note_missing(there: Mapping[str, Path], listed: Mapping[str, str]) -> list[str]:
    missing = [name for name in (TRAJECTORY_NAME, *listed) if name not in there]
    return [f"missing, and not checked: {_join(missing)}"] if missing else []


def _describe_unchecked(names: Sequence[str], manifest: Manifest | None) -> str:
    """Return a sentence that names the files that were not checked, and why."""
    own = [name for name in names if name in (APPROVAL_NAME, REVOCATION_NAME)]
    others = [name for name in names if name not in own]
    clauses = []
    if others:
        reason = (
            f"no {MANIFEST_NAME}, which versions before 0.4 did not write"
            if manifest is None
            else "no part of the result"
        )
        clauses.append(f"{_join(others)} ({reason})")
    if own:
        clauses.append(f"{_join(own)} (--trust KEY checks the signature)")
    return f"not checked: {'; '.join(clauses)}"


def _join(names: Sequence[str]) -> str:
    more = len(names) - SHOWN
    return ", ".join(shown(name) for name in names[:SHOWN]) + (f" and {more} more" if more > 0 else "")
