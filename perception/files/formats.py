"""Registry of cloud file formats: suffixes, reader and first bytes of each.

A new format is one module with its reader, and one entry in ``FORMATS``.
"""

from __future__ import annotations

import codecs
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from perception.files.bag import Message, read_bag
from perception.files.content import Content, open_content
from perception.files.depth import read_depth_png
from perception.files.e57 import read_e57
from perception.files.las import read_las
from perception.files.npz import read_npy, read_npz
from perception.files.pcd import read_pcd
from perception.files.ply import read_ply
from perception.files.ptx import read_ptx
from perception.files.scan import Scan
from perception.files.table import read_text
from perception.files.vtk import read_vtk, read_vtk_xml

HEAD_BYTES = 4096


@dataclass(frozen=True)
class Format:
    """One kind of cloud file.

    Attributes:
        suffixes: suffixes in lower case; the first names the format.
        read: reads a scan from a path; for a bag, from a topic and message of it.
        beginning: pattern of the first bytes; empty if they do not identify the format.
        is_text: whether such a file contains no zero byte.
        is_bag: whether it holds messages of topics.
    """

    suffixes: tuple[str, ...]
    read: Callable[[Path, str | None, Message], Scan]
    beginning: bytes = b""
    is_text: bool = False
    is_bag: bool = False

    def __str__(self) -> str:
        """Return ``a PLY file`` or ``an E57 file``."""
        name = self.suffixes[0].removeprefix(".").upper()
        return f"{'an' if name[0] in 'EMN' else 'a'} {name} file"


def _of_content(read: Callable[[Content, str], Scan]) -> Callable[[Path, str | None, Message], Scan]:
    return lambda path, topic, message: read(open_content(path), str(path))


def _of_bag(suffix: str, beginning: bytes) -> Format:
    return Format((suffix,), lambda path, *of_bag: read_bag(path, str(path), *of_bag), beginning, is_bag=True)


# Each scan of a PTX file begins with ten lines of these numbers of values.
_PTX = rb"\s*\d+\s*\n\s*\d+\s*\n" + 4 * (rb"\s*" + rb"[^\s]+[ \t]+" * 2 + rb"[^\s]+\s*\n")
FORMATS = (
    Format((".pcd",), _of_content(read_pcd), rb"# \.PCD|VERSION(?s:.*)\nFIELDS"),
    Format((".ply",), _of_content(read_ply), rb"ply[\n\r]"),
    Format((".xyz", ".txt", ".csv", ".asc", ".pts", ".xyzn", ".xyzi", ".xyzrgb"), _of_content(read_text), is_text=True),
    Format((".ptx",), _of_content(read_ptx), _PTX, is_text=True),
    Format((".npz",), _of_content(read_npz), rb"PK\x03\x04(?s:.{26,86})\.npy"),
    Format((".npy",), _of_content(read_npy), rb"\x93NUMPY"),
    Format((".las", ".laz"), _of_content(read_las), rb"LASF"),
    Format((".e57",), lambda path, *_: read_e57(path, str(path)), rb"ASTM-E57"),
    Format((".vtk",), _of_content(read_vtk), rb"# vtk DataFile"),
    Format((".vtp", ".vtu", ".vts"), _of_content(read_vtk_xml), rb"(<\?xml(?s:.{0,400}?))?<VTKFile"),
    Format((".png",), lambda path, *_: read_depth_png(path, str(path)), rb"\x89PNG"),
    _of_bag(".mcap", rb"\x89MCAP0\r\n"),
    _of_bag(".db3", rb"SQLite format 3\0"),
    _of_bag(".bag", rb"#ROSBAG"),
)
SUFFIXES = tuple(suffix for kind in FORMATS for suffix in kind.suffixes)
BAG_SUFFIXES = tuple(suffix for kind in FORMATS if kind.is_bag for suffix in kind.suffixes)
BAG_FOLDER_HAS = "metadata.yaml"

_OTHERS = (
    (b"\xff\xd8\xff", "a JPEG picture"), (b"GIF8", "a GIF picture"),
    (b"%PDF", "a PDF document"), (b"\x1f\x8b", "a gzip archive; unpack it"), (b"PK\3\4", "a zip archive; unpack it"),
    (b"\x28\xb5\x2f\xfd", "a zstd archive; unpack it"), (b"glTF", "a glTF model"),
    (b"{\\rtf", "an RTF document"), (b"<?xml", "XML"),
    (b"version https://git-lfs", "a pointer of Git LFS in place of the file; 'git lfs pull' brings it"),
)  # fmt: skip
_PAGES = (b"<!doctype", b"<html")
# Names of the first entries of a zip archive that is a spreadsheet.
_SHEETS = (b"[Content_Types].xml", b"xl/", b"mimetypeapplication/vnd.oasis.opendocument.spreadsheet")
_UTF16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
_MESHES = (".stl", ".obj", ".dae", ".off", ".glb", ".gltf")
_PROPRIETARY = "is a manufacturer's own kind of file; export it as .e57 or .las"
_REMEDIES = {
    ".bin": "has no header that says what its numbers are; if they are KITTI's x y z and reflectance, give the file "
    "that np.save('cloud.npy', np.fromfile(FILE, 'f4').reshape(-1, 4)) writes",
    ".pcap": "holds packets of a sensor, not points; "
    "give a bag of its driver, or a cloud that its maker's tool exports",
    **dict.fromkeys((".fls", ".fws", ".lsproj", ".rcp", ".rcs", ".zfs", ".rdbx", ".rxp", ".imp"), _PROPRIETARY),
}


def find_format_by_suffix(suffix: str) -> Format | None:
    """Return the format with this suffix, or None."""
    return next((kind for kind in FORMATS if suffix in kind.suffixes), None)


def find_format_by_head(head: bytes) -> Format | None:
    """Return the format of a file with these first bytes; None if they do not identify it."""
    return next((kind for kind in FORMATS if kind.beginning and re.match(kind.beginning, head)), None)


def describe_other_kind(head: bytes) -> str:
    """Return the name of a known format without a cloud that has these first bytes; else ''."""
    if head.lstrip()[:16].lower().startswith(_PAGES):
        return "a web page"
    if head.startswith(b"PK\3\4") and any(entry in head for entry in _SHEETS):
        return "a spreadsheet; save it as CSV"
    return next((words for magic, words in _OTHERS if head.startswith(magic)), "")


def describe_binary(head: bytes) -> str:
    """Return the reason why a file with these first bytes is not text; empty if it may be text."""
    if head.startswith(_UTF16) or b"\0" not in head:
        return ""
    return f"holds the byte 00 at {head.index(0)}, after {head[:4].hex(' ').upper()} at its beginning"


def explain_suffix(suffix: str) -> str:
    """Return an error text for an unsupported suffix, with the expected ones."""
    if suffix.lower() in _REMEDIES:
        return _REMEDIES[suffix.lower()]
    wrong = f"suffix '{suffix}' is unknown" if suffix else "has no suffix"
    if suffix.lower() in _MESHES:
        wrong = f"suffix '{suffix}' is that of a mesh, no cloud"
    return f"{wrong}; one of {', '.join(SUFFIXES)} or the folder of a ROS 2 bag is needed"
