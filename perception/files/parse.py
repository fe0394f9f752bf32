"""Parsing of a cloud file in this process, with a one-line message for every fault of the file."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from perception.errors import CloudError
from perception.files.bag import Message, read_bag
from perception.files.formats import (
    BAG_FOLDER_HAS,
    BAG_SUFFIXES,
    HEAD_BYTES,
    SUFFIXES,
    Format,
    describe_binary,
    describe_other_kind,
    explain_suffix,
    find_format_by_head,
    find_format_by_suffix,
)
from perception.files.scan import Scan, limit_scan, quote
from perception.limits import MAX_FILE_BYTES

# What to install if a format's optional library is missing.
_EXTRAS = {"pye57": "scopt[e57]", "rosbags": "scopt[rosbag]"}


def parse_file(path: Path, topic: str | None = None, message: Message = 0) -> Scan:
    """Read a cloud file of any supported format in this process.

    Args:
        path: the file, or the folder of a ROS 2 bag; its content, else its suffix gives the format.
        topic: topic to read from a bag with several.
        message: index of a bag's message to read, or ``all``.

    Raises:
        CloudError: the file cannot be used; the message names the file, the fault and what is expected.
        MemoryError: the file needs more memory than there is.
    """
    suffix = path.suffix.lower()
    if not is_bag(path) and (topic is not None or message != 0):
        raise CloudError(f"{path}: is no bag, so it has no topic and message; leave them out")
    try:
        with np.errstate(all="ignore"):  # damaged numbers overflow; too large coordinates are dropped later
            return _read(path, topic, message)
    except (CloudError, MemoryError, KeyboardInterrupt, SystemExit):
        raise
    except ImportError as error:
        extra = _EXTRAS.get((error.name or "").partition(".")[0])
        if extra is None:
            raise
        raise CloudError(f"{path}: reading this kind of file needs a further library: pip install '{extra}'") from None
    except BaseException as error:  # libraries raise any error on damaged files; a Rust panic is no Exception
        words = quote(str(error).partition("****")[0]) or type(error).__name__
        raise CloudError(f"{path}: is damaged, or no {suffix.removeprefix('.') or 'bag'} file ({words})") from None


def parse_to_values(path: str, topic: str | None, message: Message) -> dict[str, Any]:
    """Return the attributes of the file's ``Scan`` by name, or ``error`` with the file's fault."""
    try:
        return vars(parse_file(Path(path), topic, message))
    except CloudError as error:
        return {"error": str(error)}


def is_bag(path: Path) -> bool:
    """Return whether a path is a bag file or the folder of a ROS 2 bag."""
    return path.suffix.lower() in BAG_SUFFIXES or (os.path.isdir(path) and (path / BAG_FOLDER_HAS).is_file())


def _read(path: Path, topic: str | None, message: Message) -> Scan:
    if os.path.isdir(path):
        if not is_bag(path):
            raise CloudError(f"{path}: {_explain_folder(path)}")
        _check_file(path / BAG_FOLDER_HAS, None)
        return read_bag(path, str(path), topic, message)
    kind, notes = _check_format(path)
    scan = kind.read(path, topic, message)
    return scan if kind.is_bag else limit_scan(replace(scan, notes=(*notes, *scan.notes)))


def _check_format(path: Path) -> tuple[Format, tuple[str, ...]]:
    """Return the format of the file by its content, and a note if its suffix belongs to another format.

    Raises:
        CloudError: missing, too large, not a regular file, of an unsupported format, or a bag with another suffix.
    """
    named = find_format_by_suffix(path.suffix.lower())
    is_named_bag = named is not None and named.is_bag
    _check_file(path, None if is_named_bag else MAX_FILE_BYTES)
    with path.open("rb") as file:
        head = file.read(HEAD_BYTES)
    held = find_format_by_head(head)
    other = "" if held is not None else describe_other_kind(head)
    if held is not None and held is not named:
        if is_named_bag or held.is_bag:
            what = held if is_named_bag else "a bag"
            raise CloudError(f"{path}: holds {what}; give it a name that ends in {held.suffixes[0]}")
        ending = f"ends in {path.suffix}" if path.suffix else "has no ending"
        return held, (f"holds {held}, and is read as one though its name {ending}",)
    if other and not (path.suffix.lower() == ".npz" and head.startswith(b"PK")):
        raise CloudError(
            f"{path}: is {other}; one of {', '.join(BAG_SUFFIXES if is_named_bag else SUFFIXES)} is needed"
        )
    if named is None:
        raise CloudError(f"{path}: {explain_suffix(path.suffix)}")
    if named.is_text and (sign := describe_binary(head)):
        raise CloudError(f"{path}: {sign}, and is no text; a table of numbers is needed")
    return named, ()


def _explain_folder(path: Path) -> str:
    """Return an error text for a folder that is not a bag, with what is expected."""
    try:
        recorded = sorted(entry.name for entry in path.iterdir() if entry.suffix.lower() in BAG_SUFFIXES)
    except OSError as error:
        return f"cannot be read ({error.strerror})"
    if recorded:
        return f"is a folder without {BAG_FOLDER_HAS}; give a file in it: {quote(', '.join(recorded))}"
    return f"is a folder; one of {', '.join(SUFFIXES)} or the folder of a ROS 2 bag is needed"


def _check_file(path: Path, max_bytes: int | None) -> None:
    """Check that this is a readable regular file of at most ``max_bytes``.

    Raises:
        CloudError: it is not.
    """
    try:
        size = path.stat().st_size
        if not path.is_file():  # reading a pipe or a device might never end
            kind = "a folder" if path.is_dir() else "no regular file"
            raise CloudError(f"{path}: is {kind}; a cloud file is needed")
        if max_bytes is not None and size > max_bytes:
            raise CloudError(f"{path}: {size} bytes; at most {max_bytes} are read, downsample it first")
        with path.open("rb"):
            pass
    except OSError as error:
        raise CloudError(f"{path}: cannot be read ({error.strerror})") from None
    if not size:
        raise CloudError(f"{path}: is empty; a cloud with at least one point is needed")
