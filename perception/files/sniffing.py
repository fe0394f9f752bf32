"""What a file holds by its first bytes, whatever its name says."""

from __future__ import annotations

import codecs
import re

HEAD_BYTES = 4096
# Beginnings of files, and the suffix of what begins so.
_CLOUDS = (
    (b"ply\n", ".ply"), (b"ply\r", ".ply"), (b"# .PCD", ".pcd"), (b"LASF", ".las"), (b"ASTM-E57", ".e57"),
    (b"\x93NUMPY", ".npy"), (b"\x89MCAP0\r\n", ".mcap"), (b"SQLite format 3\0", ".db3"), (b"#ROSBAG", ".bag"),
)  # fmt: skip
_OTHERS = (
    (b"\xff\xd8\xff", "a JPEG picture"), (b"\x89PNG", "a PNG picture"), (b"GIF8", "a GIF picture"),
    (b"%PDF", "a PDF document"), (b"\x1f\x8b", "a gzip archive; unpack it"), (b"PK\3\4", "a zip archive; unpack it"),
    (b"\x28\xb5\x2f\xfd", "a zstd archive; unpack it"), (b"glTF", "a glTF model"),
    (b"{\\rtf", "an RTF document"), (b"<?xml", "XML"),
    (b"version https://git-lfs", "a pointer of Git LFS in place of the file; 'git lfs pull' brings it"),
)  # fmt: skip
_PAGES = (b"<!doctype", b"<html")
# What a zip archive's first entries are named in spreadsheets.
_SHEETS = (b"[Content_Types].xml", b"xl/", b"mimetypeapplication/vnd.oasis.opendocument.spreadsheet")
# Ten lines of so many numbers each, with which every scan of a PTX file begins.
_PTX = re.compile(rb"\s*\d+\s*\n\s*\d+\s*\n" + 4 * (rb"\s*" + rb"[^\s]+[ \t]+" * 2 + rb"[^\s]+\s*\n"))
_UTF16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def kind_of(head: bytes) -> str:
    """The suffix of the kind of cloud file that begins so; empty when the beginning says nothing."""
    kind = next((suffix for magic, suffix in _CLOUDS if head.startswith(magic)), "")
    if not kind and head.startswith(b"VERSION") and b"\nFIELDS" in head:
        return ".pcd"
    if not kind and head.startswith(b"PK\3\4") and b".npy" in head[30 : 64 + 30]:
        return ".npz"
    if not kind and _PTX.match(head):
        return ".ptx"
    return kind


def a_file(suffix: str) -> str:
    """``a PLY file``, ``an E57 file``: a kind of file as a sentence names it."""
    name = suffix.removeprefix(".").upper()
    return f"{'an' if name[0] in 'EMN' else 'a'} {name} file"


def other_kind_of(head: bytes) -> str:
    """What a file is that begins so, if that is a known kind of file without a cloud; else empty."""
    if head.lstrip()[:16].lower().startswith(_PAGES):
        return "a web page"
    if head.startswith(b"PK\3\4") and any(entry in head for entry in _SHEETS):
        return "a spreadsheet; save it as CSV"
    return next((words for magic, words in _OTHERS if head.startswith(magic)), "")


def not_text(head: bytes) -> str:
    """What shows that a file which begins so is no text; empty where it may be text."""
    if head.startswith(_UTF16) or b"\0" not in head:
        return ""
    return f"holds the byte 00 at {head.index(0)}, after {head[:4].hex(' ').upper()} at its beginning"
