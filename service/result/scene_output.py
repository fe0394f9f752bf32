"""Output of ``scopt scene``: the scene's file and its page."""

from __future__ import annotations

import contextlib
import json
import os
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from service.errors import RequestError, ResultError, shown
from service.viewer.files import SCRATCH_PREFIX, replace_file

if TYPE_CHECKING:
    from service.scan.make_scene import BuiltScene


def check_out(path: Path, inputs: Iterable[Path]) -> None:
    """Check that scene and page can be written.

    Raises:
        RequestError: the name does not end in .json, one of the two names is a folder or an input, or the folder
            cannot be written.
    """
    if path.name.lower() == ".json":
        raise RequestError(f"--out: {path} has no name before its ending; expected one like scene.json")
    if path.suffix.lower() != ".json":
        raise RequestError(f"--out: {path} does not end in .json; expected a name that does, of a file for the pieces")
    try:
        for output in (path, path.with_suffix(".html")):
            if os.path.lexists(output) and output.is_dir():
                raise RequestError(f"--out: {output} is a folder; expected the name of a file")
        _try_folder(path)
    except OSError as error:
        why = error.strerror or error
        raise RequestError(f"--out: {shown(str(path))} cannot be written ({why}); expected another place") from None
    read = {os.path.realpath(file) for file in inputs}
    for output in (path, path.with_suffix(".html")):
        if os.path.realpath(output) in read:
            raise RequestError(f"--out: {output} is read and would be overwritten; expected another name")


def _try_folder(path: Path) -> None:
    """Create and delete a file in the innermost existing parent of a path.

    Raises:
        OSError: the folder cannot be written, or the name is invalid.
    """
    with contextlib.suppress(FileNotFoundError):
        path.lstat()
    folder = next(folder for folder in path.absolute().parents if os.path.lexists(folder))
    with tempfile.NamedTemporaryFile(dir=folder, prefix=SCRATCH_PREFIX):
        pass


def write_scene(scene: BuiltScene, path: Path) -> Path:
    """Write the scene as JSON to a path that ``check_out`` accepts, and its page beside it; return the page's path.

    Raises:
        ResultError: a file cannot be written.
    """
    from service.viewer.scene import render_scene

    page = path.with_suffix(".html")
    for file, text in ((path, json.dumps(scene.data, allow_nan=False)), (page, render_scene(scene, path.stem))):
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            replace_file(file, text.encode())
        except OSError as error:
            raise ResultError(f"{file} cannot be written: {error.strerror or error}") from None
    return page
