"""Where ``scopt scene`` puts what it made: the scene's file, and the page beside it that shows it."""

from __future__ import annotations

import contextlib
import json
import os
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from service.errors import RequestError, ResultError, shown

if TYPE_CHECKING:
    from service.scan.make_scene import BuiltScene

_SCRATCH = ".scopt-"


def check_out(path: Path, inputs: Iterable[Path]) -> None:
    """Refuse a place for the scene that cannot be written, or where something is that it is made from.

    Raises:
        RequestError: the name does not end in .json, or is, as the page's may be, a folder or one of the inputs, or
            its folder takes no files.
    """
    if path.name.lower() == ".json":
        raise RequestError(f"--out: {path} has no name before its ending; one like scene.json would do")
    if path.suffix.lower() != ".json":
        raise RequestError(f"--out: {path} does not end in .json; a name that does, of a file for the pieces, would do")
    try:
        for written in (path, _page_beside(path)):
            if os.path.lexists(written) and written.is_dir():
                raise RequestError(f"--out: {written} is a folder; the name of a file would do")
        _try_folder(path)
    except OSError as error:
        why = error.strerror or error
        raise RequestError(f"--out: {shown(str(path))} cannot be written ({why}); another place would do") from None
    read = {os.path.realpath(one) for one in inputs}
    for written in (path, _page_beside(path)):
        if os.path.realpath(written) in read:
            raise RequestError(f"--out: {written} is read and would be overwritten; another name would do")


def _try_folder(path: Path) -> None:
    """Write a file, and take it away, in the innermost folder about the path that is there.

    Raises:
        OSError: that cannot be done, or no file can be called so.
    """
    with contextlib.suppress(FileNotFoundError):
        path.lstat()
    folder = next(folder for folder in path.absolute().parents if os.path.lexists(folder))
    with tempfile.NamedTemporaryFile(dir=folder, prefix=_SCRATCH):
        pass


def write_scene(seen: BuiltScene, path: Path) -> Path:
    """Write the scene as JSON, and beside it the page that shows it; each as a whole or not at all.

    Args:
        seen: what to write.
        path: a name that ``check_out`` accepts.

    Returns:
        The page's path.

    Raises:
        ResultError: a file cannot be written.
    """
    from service.viewer.scene import render_scene

    page = _page_beside(path)
    _replace(path, json.dumps(seen.data, allow_nan=False))
    _replace(page, render_scene(seen, path.stem))
    return page


def _page_beside(path: Path) -> Path:
    return path.with_suffix(".html")


def _replace(path: Path, text: str) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=_SCRATCH, dir=path.parent) as scratch:
            fresh = Path(scratch) / path.name
            fresh.write_text(text, encoding="utf-8")
            os.replace(fresh, path)
    except OSError as error:
        raise ResultError(f"{path} cannot be written: {error.strerror or error}") from None
