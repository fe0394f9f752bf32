"""A path to a scan: the reader for each kind of file, and one clear line for all that can go wrong in one."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from perception.errors import CloudError
from perception.files.bag import Message, read_bag
from perception.files.columns import shown
from perception.files.content import Content, content_of
from perception.files.e57 import read_e57
from perception.files.las import read_las
from perception.files.npz import read_npy, read_npz
from perception.files.pcd import read_pcd
from perception.files.ply import read_ply
from perception.files.ptx import read_ptx
from perception.files.scan import Scan
from perception.files.sniffing import HEAD_BYTES, a_file, kind_of, not_text, other_kind_of
from perception.files.table import read_text
from perception.files.thinning import bounded
from perception.limits import MAX_FILE_BYTES

_READERS: dict[str, Callable[[Content, str], Scan]] = {
    ".pcd": read_pcd,
    ".ply": read_ply,
    **dict.fromkeys((".xyz", ".txt", ".csv", ".asc", ".pts", ".xyzn", ".xyzi", ".xyzrgb"), read_text),
    ".ptx": read_ptx,
    ".npz": read_npz,
    ".npy": read_npy,
    ".las": read_las,
    ".laz": read_las,
}
_BAGS = (".mcap", ".db3", ".bag")
_BAG_FOLDER_HAS = "metadata.yaml"
_MESHES = (".stl", ".obj", ".dae", ".off", ".glb", ".gltf")
SUFFIXES = (*_READERS, ".e57", *_BAGS)
_OF_MAKERS = "is a maker's own kind of file; an export of it as .e57 or .las would do"
_REMEDIES = {
    ".bin": "has no header, so nobody can tell what its numbers are; if they are KITTI's x y z and reflectance, the "
    "file that np.save('cloud.npy', np.fromfile(FILE, 'f4').reshape(-1, 4)) writes would do",
    ".pcap": "holds packets of a sensor, not points; a bag of its driver, or a cloud that its maker's tool exports, "
    "would do",
    **dict.fromkeys((".fls", ".fws", ".lsproj", ".rcp", ".rcs", ".zfs", ".rdbx", ".rxp", ".imp"), _OF_MAKERS),
}

# Where the optional library of a kind is missing: what to install.
_EXTRAS = {"pye57": "scopt[e57]", "rosbags": "scopt[rosbag]"}


def parse_file(path: Path, topic: str | None = None, message: Message = 0) -> Scan:
    """Read a file of any kind in this process.

    Args:
        path: the file, or the folder of a ROS 2 bag; the kind follows from its suffix.
        topic: of a bag with several clouds, the one to read.
        message: of a bag, the number of the message to read, or ``all``.

    Raises:
        CloudError: naming the file, what is wrong and what would do.
        MemoryError: the file needs more memory than there is.
    """
    suffix = path.suffix.lower()
    is_one = is_bag(path)
    if not is_one and (topic is not None or message != 0):
        raise CloudError(f"{path}: is no bag, so it has no topic and message; leave them out")
    try:
        with np.errstate(all="ignore"):  # damaged numbers overflow; what is too large to be a place is dropped later
            if is_one:
                _check_file(path / _BAG_FOLDER_HAS if os.path.isdir(path) else path, None)
                if path.is_file():
                    _check_bag(path, suffix)
                return read_bag(path, str(path), topic, message)
            if os.path.isdir(path):
                raise CloudError(f"{path}: {_of_folder(path)}")
            _check_file(path, MAX_FILE_BYTES)
            kind, notes = _kind(path, suffix)
            scan = read_e57(path, str(path)) if kind == ".e57" else _READERS[kind](content_of(path), str(path))
            return bounded(replace(scan, notes=(*notes, *scan.notes)))
    except (CloudError, MemoryError, KeyboardInterrupt, SystemExit):
        raise
    except ImportError as error:
        extra = _EXTRAS.get((error.name or "").partition(".")[0])
        if extra is None:
            raise
        raise CloudError(f"{path}: reading this kind of file needs a further library: pip install '{extra}'") from None
    except BaseException as error:  # libraries raise of every kind on damaged files; a panic is not even an Exception
        words = shown(str(error).partition("****")[0]) or type(error).__name__
        raise CloudError(f"{path}: is damaged, or no {suffix.removeprefix('.') or 'bag'} file ({words})") from None


def parse_to_values(path: str, topic: str | None, message: Message) -> dict[str, Any]:
    """The attributes of the file's ``Scan`` by name, or ``error``: what is wrong with the file."""
    try:
        return vars(parse_file(Path(path), topic, message))
    except CloudError as error:
        return {"error": str(error)}


def is_bag(path: Path) -> bool:
    """Whether a path is one of a bag: of its file, or of the folder of a ROS 2 bag."""
    return path.suffix.lower() in _BAGS or (os.path.isdir(path) and (path / _BAG_FOLDER_HAS).is_file())


def _of_folder(path: Path) -> str:
    """What is wrong with a folder that is no bag, and what would do."""
    try:
        recorded = sorted(one.name for one in path.iterdir() if one.suffix.lower() in _BAGS)
    except OSError as error:
        return f"cannot be read ({error.strerror})"
    if recorded:
        return f"is a folder without {_BAG_FOLDER_HAS}; a file in it would do: {shown(', '.join(recorded))}"
    return f"is a folder; one of {', '.join(SUFFIXES)} or the folder of a ROS 2 bag is needed"


def _check_bag(path: Path, suffix: str) -> None:
    """Raises: CloudError: what a bag's name promises is not what the file holds."""
    with path.open("rb") as file:
        head = file.read(HEAD_BYTES)
    held = kind_of(head)
    if held and held != suffix:
        raise CloudError(f"{path}: holds {a_file(held)}; a name that ends in {held} would do")
    if other := other_kind_of(head):
        raise CloudError(f"{path}: is {other}; one of {', '.join(_BAGS)} is needed")


def _kind(path: Path, suffix: str) -> tuple[str, tuple[str, ...]]:
    """The kind of file this is by what it holds, and what to tell when its name says something else.

    Raises:
        CloudError: it is a bag of another name, no text though it is named so, or of a kind that is not read.
    """
    with path.open("rb") as file:
        head = file.read(HEAD_BYTES)
    held = kind_of(head)
    if held and _READERS.get(held, held) != _READERS.get(suffix, suffix):
        if held in _BAGS:
            raise CloudError(f"{path}: holds a bag; a name that ends in {held} would do")
        named = f"ends in {path.suffix}" if path.suffix else "has no ending"
        return held, (f"holds {a_file(held)}, and is read as one though its name {named}",)
    reader = _READERS.get(suffix)
    if not (reader is read_npz and head.startswith(b"PK")) and (other := other_kind_of(head)):
        raise CloudError(f"{path}: is {other}; one of {', '.join(SUFFIXES)} is needed")
    if reader in (read_text, read_ptx) and (sign := not_text(head)):
        raise CloudError(f"{path}: {sign}, and is no text; a table of numbers is needed")
    if suffix in _REMEDIES:
        raise CloudError(f"{path}: {_REMEDIES[suffix]}")
    if suffix not in SUFFIXES:
        raise CloudError(
            f"{path}: {_of_suffix(path)}; one of {', '.join(SUFFIXES)} or the folder of a ROS 2 bag is needed"
        )
    return suffix, ()


def _of_suffix(path: Path) -> str:
    if path.suffix.lower() in _MESHES:
        return f"suffix '{path.suffix}' is that of a mesh, no cloud"
    return f"suffix '{path.suffix}' is unknown" if path.suffix else "has no suffix"


def _check_file(path: Path, max_bytes: int | None) -> None:
    """Raises: CloudError: this is no readable regular file of a size that is read."""
    try:
        size = path.stat().st_size
        if not path.is_file():  # a pipe or a device would never end
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
