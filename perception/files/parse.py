"""A path to a scan: the reader for each kind of file, and one clear line for all that can go wrong in one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

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
from perception.files.scan import Scan
from perception.files.sniffing import HEAD_BYTES, binary_start, kind_of, other_kind_of
from perception.files.table import read_text
from perception.files.thinning import bounded
from perception.limits import MAX_FILE_BYTES

_READERS: dict[str, Callable[[Content, str], Scan]] = {
    ".pcd": read_pcd,
    ".ply": read_ply,
    ".xyz": read_text,
    ".txt": read_text,
    ".csv": read_text,
    ".npz": read_npz,
    ".npy": read_npy,
    ".las": read_las,
    ".laz": read_las,
}
_BAGS = (".mcap", ".db3", ".bag")
_BAG_FOLDER_HAS = "metadata.yaml"
SUFFIXES = (*_READERS, ".e57", *_BAGS)

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
    is_bag = suffix in _BAGS or (path / _BAG_FOLDER_HAS).is_file()
    if not is_bag and (topic is not None or message != 0):
        raise CloudError(f"{path}: is no bag, so it has no topic and message; leave them out")
    if not is_bag and suffix not in SUFFIXES:
        kind = f"suffix '{path.suffix}' is unknown" if not path.is_dir() else "is a folder"
        raise CloudError(f"{path}: {kind}; one of {', '.join(SUFFIXES)} or the folder of a ROS 2 bag is needed")
    try:
        with np.errstate(all="ignore"):  # damaged numbers overflow; what is too large to be a place is dropped later
            if is_bag:
                _check_file(path / _BAG_FOLDER_HAS if path.is_dir() else path, None)
                if path.is_file():
                    _check_bag(path, suffix)
                return read_bag(path, str(path), topic, message)
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


def _check_bag(path: Path, suffix: str) -> None:
    """Raises: CloudError: what a bag's name promises is not what the file holds."""
    with path.open("rb") as file:
        held = kind_of(file.read(HEAD_BYTES))
    if held and held != suffix:
        raise CloudError(f"{path}: holds a {held.removeprefix('.').upper()} file; a name that ends in {held} would do")


def _kind(path: Path, suffix: str) -> tuple[str, tuple[str, ...]]:
    """The kind of file this is by what it holds, and what to tell when its name says something else.

    Raises:
        CloudError: it is a bag of another name, or no text though it is named so.
    """
    with path.open("rb") as file:
        head = file.read(HEAD_BYTES)
    held = kind_of(head)
    if held and _READERS.get(held, held) != _READERS.get(suffix, suffix):
        what = held.removeprefix(".").upper()
        if held in _BAGS:
            raise CloudError(f"{path}: holds a bag; a name that ends in {held} would do")
        return held, (f"holds a {what} file, and is read as one though its name ends in {path.suffix}",)
    reader = _READERS.get(suffix)
    if reader is not read_npz and (other := other_kind_of(head)):
        raise CloudError(f"{path}: is {other}; one of {', '.join(SUFFIXES)} is needed")
    if reader is read_text and (start := binary_start(head)):
        raise CloudError(f"{path}: begins with the bytes {start} and is no text; a table of numbers is needed")
    return suffix, ()


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
