"""The result folder: its file names, its replacement as a whole, and the reader of ``result.json``."""

from __future__ import annotations

import json
import os
import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from service.errors import ResultError, shown
from service.request.formats import FORMAT as VERSION
from service.result.versions import NAME, add_missing_keys, find_format

FORMAT = f"{NAME}/{VERSION}"
RESULT_NAME = "result.json"
TRAJECTORY_NAME = "trajectory.csv"
VIEWER_NAME = "viewer.html"
GLB_NAME = "scene.glb"
OPENRAVE_NAME = "openrave"
ROBOT_NAME = "robot"
MANIFEST_NAME = "manifest.json"
APPROVAL_NAME, REVOCATION_NAME = "approval.json", "revocation.json"  # signed by a server
SIMULATION_NAME, SIMULATION_PAGE = "simulation.json", "simulation.html"  # written by `scopt simulate`
WRITTEN = {
    RESULT_NAME, TRAJECTORY_NAME, VIEWER_NAME, GLB_NAME, OPENRAVE_NAME, ROBOT_NAME, SIMULATION_NAME, SIMULATION_PAGE,
    APPROVAL_NAME, REVOCATION_NAME, MANIFEST_NAME,
}  # fmt: skip
MAX_RESULT_BYTES = 512 * 2**20
BEGINNING = b'{"format": "' + NAME.encode()


@dataclass(frozen=True)
class ResultFiles:
    """Paths of a result's files."""

    folder: Path

    @property
    def result(self) -> Path:
        """Everything needed to check the motion."""
        return self.folder / RESULT_NAME

    @property
    def trajectory(self) -> Path:
        """The samples as a table: time, then one column per coordinate."""
        return self.folder / TRAJECTORY_NAME

    @property
    def viewer(self) -> Path:
        """The page that shows the motion."""
        return self.folder / VIEWER_NAME

    def to_json(self) -> dict[str, str]:
        """Return the paths that ``--json`` prints."""
        return {"result": str(self.result), "viewer": str(self.viewer)}


def write_files(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write the files of a result, given by path, into a folder.

    Raises:
        ResultError: a path leads out of the folder, or cannot be one of a file.
    """
    for name, content in files.items():
        try:
            path = (folder / name).resolve()
            if not path.is_relative_to(folder.resolve()):
                raise ResultError(f"{shown(name)} is outside the result folder")
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        except (OSError, ValueError):
            raise ResultError(f"{shown(name)} is no path of a file") from None


def check_folder(folder: Path) -> None:
    """Check that a result may replace a folder.

    Raises:
        ResultError: it is a file or holds something other than an earlier result.
    """
    if not folder.exists():
        return
    if not folder.is_dir():
        raise ResultError(f"{folder} is a file; name a folder for the result")
    names = {path.name for path in folder.iterdir()}
    if names and not (folder / RESULT_NAME).is_file():
        raise ResultError(f"{folder} holds other files and no {RESULT_NAME}; name a new or empty folder")
    if names and not _is_result(folder / RESULT_NAME):
        raise ResultError(f"{folder} holds a {RESULT_NAME} of something else; name a new or empty folder")
    if names - WRITTEN:
        first = min(names - WRITTEN)
        raise ResultError(f"{folder} holds {first}, which is of no result; move it or name a new or empty folder")


@contextmanager
def replace_folder(folder: Path) -> Iterator[Path]:
    """Yield a new folder that replaces ``folder`` if the body succeeds and put something into it."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f".{folder.name}.", dir=folder.parent) as scratch:
        fresh, earlier = Path(scratch) / "fresh", Path(scratch) / "earlier"
        fresh.mkdir()
        yield fresh
        if not any(fresh.iterdir()):
            return
        try:
            if folder.exists():
                os.rename(folder, earlier)
            os.rename(fresh, folder)
        except BaseException:
            if earlier.exists() and not folder.exists():
                os.rename(earlier, folder)
            raise


def write_whole(path: Path, text: str) -> None:
    """Write a text file as a whole, also when interrupted.

    Raises:
        ResultError: the file cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{path.name}.", dir=path.parent) as scratch:
            fresh = Path(scratch) / path.name
            fresh.write_text(text, encoding="utf-8")
            os.replace(fresh, path)
    except OSError as error:
        raise ResultError(f"{path} cannot be written: {error.strerror or error}") from None


def read_result(path: str | Path) -> dict[str, Any]:
    """Return the content of a ``result.json``; ``path`` is the file or its folder.

    Results of earlier formats get the keys of later ones (``service.result.versions``).

    Raises:
        ResultError: the file is missing, not JSON, or of another format.
    """
    path = result_path(path)
    try:
        size = path.stat().st_size
        if size > MAX_RESULT_BYTES:
            raise ResultError(f"{path} has {size} bytes; at most {MAX_RESULT_BYTES} are read")
        data = json.loads(
            path.read_text(encoding="utf-8"), parse_constant=_refuse_constant, object_pairs_hook=_make_object
        )
    except OSError as error:
        raise ResultError(f"{path} cannot be read: {error.strerror}") from None
    except (ValueError, RecursionError) as error:
        raise ResultError(f"{path} is no JSON: {shown(str(error))}") from None
    if not isinstance(data, dict) or find_format(data) is None:
        name = data.get("format") if isinstance(data, dict) else data
        raise ResultError(f"{path}: format is {shown(name)}; expected {FORMAT!r}, or that of an earlier version")
    add_missing_keys(data)
    return data


def result_path(path: str | Path) -> Path:
    """Return the ``result.json`` of a folder, or the file itself."""
    path = Path(path)
    return path / RESULT_NAME if path.is_dir() else path


def _is_result(path: Path) -> bool:
    """Return whether a file begins like a ``result.json`` of any version."""
    with path.open("rb") as file:
        return file.read(len(BEGINNING)) == BEGINNING


def _make_object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Refuse a repeated key: JSON readers differ in which of its values they take."""
    members = dict(pairs)
    if len(members) < len(pairs):
        repeated = next(key for key, count in Counter(key for key, _ in pairs).items() if count > 1)
        raise ValueError(f"an object has the key {shown(repeated)} twice")
    return members


def _refuse_constant(name: str) -> float:
    raise ValueError(f"{name} is no number that JSON has")
