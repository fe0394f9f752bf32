"""VTK files: the points of legacy files (ascii and binary) and of XML files (.vtp, .vtu, .vts)."""

from __future__ import annotations

import base64
import binascii
import lzma
import re
import zlib
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from perception.errors import CloudError
from perception.files.content import Content
from perception.files.scan import Scan, parse_natural, quote
from perception.limits import MAX_FILE_POINTS, MAX_WHOLE_BYTES

if TYPE_CHECKING:
    from jaxtyping import Float

_HEADER_LIMIT = 65536
_LEGACY_TYPES = {
    "float": "f4", "double": "f8", "int": "i4", "unsigned_int": "u4", "short": "i2", "unsigned_short": "u2",
    "char": "i1", "unsigned_char": "u1", "long": "i8", "unsigned_long": "u8", "vtkidtype": "i8",
}  # fmt: skip
_XML_TYPES = {
    "Float32": "f4", "Float64": "f8", "Int8": "i1", "UInt8": "u1", "Int16": "i2", "UInt16": "u2", "Int32": "i4",
    "UInt32": "u4", "Int64": "i8", "UInt64": "u8",
}  # fmt: skip
_GRIDS = ("structured_points", "rectilinear_grid", "field")
_POINTS = re.compile(rb"<Points\b[^>]*>(.*?)</Points>", re.DOTALL)
_ARRAY = re.compile(rb"<DataArray\b([^>]*?)(/>|>(.*?)</DataArray>)", re.DOTALL)
_PIECE = re.compile(rb"<Piece\b([^>]*)>")
_FILE = re.compile(rb"<VTKFile\b([^>]*)>")
_APPENDED = re.compile(rb"<AppendedData\b([^>]*)>\s*_", re.DOTALL)
_ATTRIBUTE = re.compile(rb"([A-Za-z_]+)\s*=\s*[\"']([^\"']*)[\"']")
_UNPACK: Mapping[str, Callable[[], Any]] = {
    "vtkZLibDataCompressor": zlib.decompressobj,
    "vtkLZMADataCompressor": lzma.LZMADecompressor,
}


def read_vtk(data: Content, name: str) -> Scan:
    """Read the points of a legacy file; its cells and other data are left out.

    Raises:
        CloudError: the file cannot be used; the message names ``name`` and the fault.
    """
    head = bytes(data[:_HEADER_LIMIT])
    lines = head.split(b"\n", 3)
    if not head.startswith(b"# vtk DataFile") or len(lines) < 4:
        raise CloudError(f"{name}: does not begin with '# vtk DataFile', a title and ASCII or BINARY")
    encoding = lines[2].strip().upper()
    if encoding not in (b"ASCII", b"BINARY"):
        raise CloudError(f"{name}: encoding '{quote(encoding.decode('latin-1'))}' is unknown; expected ASCII or BINARY")
    found = re.search(rb"^\s*DATASET\s+(\S+)", head, re.MULTILINE | re.IGNORECASE)
    kind = "" if found is None else found[1].decode("latin-1").lower()
    if kind in _GRIDS:
        raise CloudError(f"{name}: holds a grid of cells ({kind}), no points; expected POLYDATA or UNSTRUCTURED_GRID")
    start = re.search(rb"^\s*POINTS[ \t]+(\S+)[ \t]+(\S+)[ \t]*\r?\n", head, re.MULTILINE | re.IGNORECASE)
    if start is None:
        raise CloudError(f"{name}: has no line 'POINTS count type' in its first {_HEADER_LIMIT} bytes")
    n_points = _check_count(start[1], name)
    word = start[2].decode("latin-1").lower()
    if word not in _LEGACY_TYPES:
        raise CloudError(f"{name}: points are of type '{quote(word)}'; expected one of {', '.join(_LEGACY_TYPES)}")
    if encoding == b"ASCII":
        return Scan(_parse_text(data[start.end() :], n_points, name))
    kinds = np.dtype(">" + _LEGACY_TYPES[word])
    there = len(data) - start.end()
    if there < 3 * n_points * kinds.itemsize:
        raise CloudError(
            f"{name}: {n_points} points of {3 * kinds.itemsize} bytes are announced, {there} bytes are there"
        )
    values = np.frombuffer(data, kinds, 3 * n_points, start.end())
    return Scan(values.reshape(-1, 3).astype(np.float64))


def read_vtk_xml(data: Content, name: str) -> Scan:
    """Read the points of all pieces of an XML file, stored as text, base64 or raw, with zlib or lzma.

    The markup is searched, not parsed as XML, so that entities have no effect and raw data may follow it.

    Raises:
        CloudError: the file cannot be used; the message names ``name`` and the fault.
    """
    whole = bytes(data)
    root = _FILE.search(whole[:_HEADER_LIMIT])
    if root is None:
        raise CloudError(f"{name}: is XML without <VTKFile>; a VTK file is needed")
    options = _parse_attributes(root[1])
    appended = _APPENDED.search(whole)
    markup = whole if appended is None else whole[: appended.start()]
    tail = b"" if appended is None else whole[appended.end() :]
    is_raw = appended is not None and _parse_attributes(appended[1]).get("encoding", "raw") == "raw"
    counts = [
        _check_count(_parse_attributes(piece[1]).get("NumberOfPoints", "0"), name) for piece in _PIECE.finditer(markup)
    ]
    blocks = [_ARRAY.search(block[1]) for block in _POINTS.finditer(markup)]
    parts = [
        _read_array(array[1], array[3] or b"", tail, options, is_raw, n_points, name)
        for array, n_points in zip(blocks, counts, strict=False)
        if array is not None and n_points
    ]
    if not parts:
        raise CloudError(f"{name}: has no <Points> with a <DataArray>; a PolyData or UnstructuredGrid is needed")
    if sum(len(part) for part in parts) > MAX_FILE_POINTS:
        raise CloudError(f"{name}: its pieces hold more than {MAX_FILE_POINTS} points; downsample it first")
    return Scan(np.concatenate(parts))


def _check_count(word: bytes | str, name: str) -> int:
    text = word if isinstance(word, str) else word.decode("latin-1")
    count = parse_natural(text)
    if count is None or count > MAX_FILE_POINTS:
        raise CloudError(f"{name}: announces '{quote(text)}' points; expected a number up to {MAX_FILE_POINTS}")
    return count


def _parse_attributes(text: bytes) -> Mapping[str, str]:
    return {key.decode("latin-1"): value.decode("latin-1") for key, value in _ATTRIBUTE.findall(text)}


def _parse_text(text: bytes, n_points: int, name: str) -> Float[np.ndarray, "N 3"]:
    """Return the first ``3 * n_points`` numbers of a text."""
    if len(text) > 4 * MAX_WHOLE_BYTES:
        raise CloudError(f"{name}: more than {4 * MAX_WHOLE_BYTES} bytes of text; save it as binary")
    words = text.split(None, 3 * n_points)[: 3 * n_points]
    if len(words) < 3 * n_points:
        raise CloudError(f"{name}: {n_points} points are announced, {len(words) // 3} are there")
    try:
        return np.array(words, dtype=np.float64).reshape(-1, 3)
    except ValueError as error:
        raise CloudError(f"{name}: a coordinate is no number ({quote(str(error))})") from None


def _read_array(
    attributes: bytes, inline: bytes, tail: bytes, options: Mapping[str, str], is_raw: bool, n_points: int, name: str
) -> Float[np.ndarray, "N 3"]:
    """Return the (N, 3) numbers of one <DataArray>."""
    array = _parse_attributes(attributes)
    kind = _XML_TYPES.get(array.get("type", ""), "")
    if not kind or array.get("NumberOfComponents") != "3":
        raise CloudError(f'{name}: its points are no numbers in threes; expected NumberOfComponents="3"')
    form = array.get("format", "ascii")
    if form == "ascii":
        return _parse_text(inline, n_points, name)
    order = ">" if options.get("byte_order") == "BigEndian" else "<"
    head = np.dtype(order + _XML_TYPES.get(options.get("header_type", "UInt32"), "u4"))
    n_bytes = 3 * n_points * np.dtype(kind).itemsize
    packed = options.get("compressor", "")
    if packed and packed not in _UNPACK:
        raise CloudError(f"{name}: is compressed with {quote(packed)}; expected zlib or lzma, or no compression")
    source = tail[parse_natural(array.get("offset", "0")) or 0 :] if form == "appended" else inline.strip()
    try:
        raw = _decode(source, form == "appended" and is_raw, head, packed, n_bytes)
    except (ValueError, binascii.Error, zlib.error, lzma.LZMAError) as error:
        raise CloudError(f"{name}: its points cannot be decoded ({quote(str(error))})") from None
    if len(raw) < n_bytes:
        raise CloudError(f"{name}: {n_points} points of {n_bytes} bytes are announced, {len(raw)} bytes are there")
    return np.frombuffer(raw, order + kind, 3 * n_points).reshape(-1, 3).astype(np.float64)


def _decode(source: bytes, is_raw: bool, head: np.dtype[np.unsignedinteger], packed: str, n_bytes: int) -> bytes:
    """Return the bytes behind a header: their number or, where packed, number and sizes of the blocks."""
    if not packed:
        raw = source if is_raw else _from_base64(source, head.itemsize + n_bytes)
        return raw[head.itemsize : head.itemsize + n_bytes]
    lead = source if is_raw else _from_base64(source, 3 * head.itemsize)
    n_blocks = int(np.frombuffer(lead, head, 1)[0])
    if n_blocks > n_bytes:
        raise ValueError(f"{n_blocks} blocks for {n_bytes} bytes")
    size = (3 + n_blocks) * head.itemsize
    lead = source if is_raw else _from_base64(source, size)
    sizes = np.frombuffer(lead, head, n_blocks, 3 * head.itemsize).astype(np.int64)
    if is_raw:
        rest = source[size : size + int(sizes.sum())]
    else:
        at = 4 * (-(-size // 3))  # the header is encoded on its own
        rest = _from_base64(source[at:], int(sizes.sum()))
    parts, start = [], 0
    for length in sizes.tolist():
        parts.append(_UNPACK[packed]().decompress(rest[start : start + length], n_bytes + 1))
        start += length
    return b"".join(parts)


def _from_base64(text: bytes, n_bytes: int) -> bytes:
    """Return the first bytes of a base64 text; padding ends it."""
    n_characters = 4 * (-(-n_bytes // 3))
    return base64.b64decode(text[:n_characters])[:n_bytes]
