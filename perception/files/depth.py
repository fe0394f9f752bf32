"""Depth images: a PNG with the camera's intrinsics in a JSON or YAML file beside it, and images of ROS."""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from perception.errors import CloudError
from perception.files.scan import Scan, parse_viewpoint, quote
from perception.limits import MAX_POINTS, MAX_WHOLE_BYTES

if TYPE_CHECKING:
    from jaxtyping import Float, UInt

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_MOST_SIDE = 16_384
_SIDECARS = (".json", ".yaml", ".yml")
_NAMES = ("camera_info", "intrinsics", "camera")
# Depth units per metre of cameras that write 16-bit images, where the file does not say.
_PER_METRE = 1000.0


@dataclass(frozen=True)
class Intrinsics:
    """Pinhole camera.

    Attributes:
        fx, fy, cx, cy: focal lengths and principal point [pixels].
        per_metre: depth units per metre.
        viewpoint: camera pose x y z qw qx qy qz (z forward); None if unknown.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    per_metre: float = _PER_METRE
    viewpoint: tuple[float, ...] | None = None


def read_depth_png(path: Path, name: str) -> Scan:
    """Read a 16-bit grey PNG as points in the camera's frame (x right, y down, z forward).

    The intrinsics are in a JSON or YAML file of the same name, or in ``camera_info``, ``intrinsics`` or ``camera`` of
    its folder: ``fx fy cx cy``, or a matrix ``K`` (ROS) or ``intrinsic_matrix`` (Open3D); ``depth_scale``: depth units
    per metre (1000 by default), or metres per unit if it is below 1; ``viewpoint`` or ``pose``.

    Raises:
        CloudError: the file cannot be used; the message names ``name`` and the fault.
    """
    camera = _find_intrinsics(path, name)
    if path.stat().st_size > MAX_WHOLE_BYTES:
        raise CloudError(f"{name}: more than {MAX_WHOLE_BYTES} bytes; a depth image is smaller")
    depth = _read_png(path.read_bytes(), name).astype(np.float64) / camera.per_metre
    return make_depth_scan(depth, camera, name)


def make_depth_scan(depth: Float[np.ndarray, "H W"], camera: Intrinsics, name: str) -> Scan:
    """Return the points of a depth image [m] in the camera's frame; pixels of no depth are left out."""
    rows, columns = np.nonzero(np.isfinite(depth) & (depth > 0.0))
    if not len(rows):
        raise CloudError(f"{name}: no pixel has a depth; at least one is needed")
    z = depth[rows, columns]
    points = np.column_stack([(columns - camera.cx) / camera.fx * z, (rows - camera.cy) / camera.fy * z, z])
    n_empty = depth.size - len(z)
    share = f"{n_empty} of {depth.size} pixels have no depth"
    return Scan(points, camera.viewpoint, notes=(f"a depth image in the camera's frame; {share}",))


def parse_intrinsics(values: Mapping[str, Any], name: str) -> Intrinsics:
    """Return the intrinsics in a mapping, as Open3D, RealSense and ROS name them.

    Raises:
        CloudError: they are missing or impossible.
    """
    values = {str(key).lower(): value for key, value in values.items()}
    values = {**values, **_lower(values.get("intrinsics")), **_lower(values.get("intrinsic"))}
    matrix = values.get("k", values.get("camera_matrix", values.get("intrinsic_matrix")))
    matrix = matrix.get("data") if isinstance(matrix, Mapping) else matrix
    numbers = _flatten(matrix)
    if len(numbers) == 9:  # Open3D writes columns, ROS rows
        fx, fy = numbers[0], numbers[4]
        cx, cy = (numbers[6], numbers[7]) if numbers[6] > 0.0 else (numbers[2], numbers[5])
    else:
        keys = (("fx",), ("fy",), ("cx", "ppx"), ("cy", "ppy"))
        found = [_flatten([next((values[key] for key in names if key in values), None)]) for names in keys]
        if not all(found):
            raise CloudError(f"{name}: has no intrinsics; fx, fy, cx and cy, or a matrix K of nine numbers, are needed")
        fx, fy, cx, cy = (one[0] for one in found)
    scale = _flatten([values.get("depth_scale", values.get("depth_units", _PER_METRE))])
    per_metre = scale[0] if scale else 0.0
    per_metre = 1.0 / per_metre if 0.0 < per_metre < 1.0 else per_metre
    if not (np.isfinite([fx, fy, cx, cy, per_metre]).all() and min(fx, fy, per_metre) > 0.0):
        raise CloudError(
            f"{name}: fx {fx:g}, fy {fy:g} and depth_scale {per_metre:g} are no camera's; expected above 0"
        )
    pose = values.get("viewpoint", values.get("pose"))
    viewpoint = None if pose is None else parse_viewpoint([str(value) for value in _flatten(pose)], name)
    return Intrinsics(fx, fy, cx, cy, per_metre, viewpoint)


def _lower(values: object) -> dict[str, Any]:
    return {str(key).lower(): value for key, value in values.items()} if isinstance(values, Mapping) else {}


def _flatten(values: object) -> list[float]:
    """Return the numbers of a nested list; empty if anything else is in it."""
    try:
        return [] if values is None else np.asarray(values, dtype=np.float64).ravel().tolist()
    except (TypeError, ValueError):
        return []


def _find_intrinsics(path: Path, name: str) -> Intrinsics:
    beside = [path.with_suffix(suffix) for suffix in _SIDECARS]
    beside += [path.parent / f"{stem}{suffix}" for stem in _NAMES for suffix in _SIDECARS]
    file = next((file for file in beside if file.is_file()), None)
    if file is None:
        beside_it = path.with_suffix(".json").name
        raise CloudError(f"{name}: a picture; as a depth image it needs fx, fy, cx, cy and depth_scale in {beside_it}")
    text = file.read_bytes()[:MAX_WHOLE_BYTES].decode("utf-8", "replace")
    try:
        if file.suffix == ".json":
            values = json.loads(text)
        else:
            import yaml

            values = yaml.safe_load(text)
    except Exception as error:  # a YAML of an unusual form raises several types
        raise CloudError(f"{name}: {file.name} cannot be read ({quote(str(error))})") from None
    if not isinstance(values, Mapping):
        raise CloudError(f"{name}: {file.name} holds no mapping; fx, fy, cx and cy are needed")
    return parse_intrinsics(values, f"{name}: {file.name}")


def _read_png(data: bytes, name: str) -> UInt[np.ndarray, "H W"]:
    """Return a grey PNG of 16 bits that is not interlaced."""
    if not data.startswith(_SIGNATURE) or data[12:16] != b"IHDR" or len(data) < 33:
        raise CloudError(f"{name}: is no PNG with a header")
    width, height, depth, colour, _, _, interlaced = struct.unpack_from(">IIBBBBB", data, 16)
    if depth != 16 or colour != 0 or interlaced:
        raise CloudError(
            f"{name}: is a picture of {depth} bits and colour type {colour}; a grey one of 16 bits is needed"
        )
    if not (0 < width <= _MOST_SIDE and 0 < height <= _MOST_SIDE and width * height <= MAX_POINTS):
        raise CloudError(f"{name}: has {width} x {height} pixels; expected at most {MAX_POINTS} in all")
    packed = b"".join(_list_chunks(data, b"IDAT"))
    stride = 2 * width
    try:
        raw = zlib.decompressobj().decompress(packed, height * (stride + 1))
    except zlib.error as error:
        raise CloudError(f"{name}: its pixels cannot be unpacked ({quote(str(error))})") from None
    if len(raw) < height * (stride + 1):
        raise CloudError(f"{name}: {height} rows are announced, {len(raw) // (stride + 1)} are there")
    rows = np.frombuffer(raw, np.uint8).reshape(height, stride + 1)
    image = np.zeros((height, stride), np.uint8)
    before = np.zeros(stride, np.uint8)
    for i, row in enumerate(rows):
        before = image[i] = _unfilter(int(row[0]), row[1:], before, name)
    return image.view(">u2").astype(np.uint16)


def _list_chunks(data: bytes, kind: bytes) -> list[bytes]:
    chunks, at = [], len(_SIGNATURE)
    while at + 8 <= len(data):
        length = struct.unpack_from(">I", data, at)[0]
        if data[at + 4 : at + 8] == kind:
            chunks.append(data[at + 8 : at + 8 + length])
        at += 12 + length
    return chunks


def _unfilter(kind: int, row: UInt[np.ndarray, "B"], above: UInt[np.ndarray, "B"], name: str) -> UInt[np.ndarray, "B"]:
    """Undo a filter of PNG (ISO/IEC 15948, section 9) for pixels of two bytes."""
    if kind == 0:
        return row
    if kind == 1:
        return np.cumsum(row.reshape(-1, 2), axis=0, dtype=np.uint8).reshape(-1)
    if kind == 2:
        return np.asarray(row + above)
    if kind not in (3, 4):
        raise CloudError(f"{name}: row filter {kind} is unknown; 0 to 4 are possible")
    done = [0, 0, *row.tolist()]
    up: Sequence[int] = [0, 0, *above.tolist()]
    for i in range(2, len(done)):
        left, over, corner = done[i - 2], up[i], up[i - 2]
        if kind == 3:
            guess = (left + over) // 2
        else:
            p = left + over - corner
            pa, pb, pc = abs(p - left), abs(p - over), abs(p - corner)
            guess = left if pa <= pb and pa <= pc else over if pb <= pc else corner
        done[i] = (done[i] + guess) & 255
    return np.array(done[2:], np.uint8)
