"""Hostile files: clouds with a false size or decompression bombs, robots that name harmful files."""

from __future__ import annotations

import io
import pickle
import struct
import zipfile
from collections.abc import Mapping
from pathlib import Path
from random import Random

import numpy as np

GIB = 2**30
CLAIMED = 2_000_000_000  # points claimed by a header, not in the file
CHAIN, DEEP = 5000, 200_000


def clouds(seed: int) -> Mapping[str, tuple[str, bytes]]:
    """Return format and bytes of each hostile cloud, by what is wrong with it."""
    random = Random(seed)
    nan = np.full((2000, 3), np.nan, dtype=np.float32)
    found = {
        "pcd of 2e9 points": ("pcd", _pcd(CLAIMED, "binary") + b"\0" * 120),
        "compressed pcd of 2e9 points": ("pcd", _pcd(CLAIMED, "binary_compressed") + struct.pack("<II", 16, 2**32 - 1)),
        "pcd of negative width": ("pcd", _pcd(-5, "ascii") + b"1 2 3\n"),
        "pcd of size 0": ("pcd", _pcd(10, "binary", size=0) + b"\0" * 120),
        "pcd of nothing but NaN": ("pcd", _pcd(len(nan), "binary") + nan.tobytes()),
        "ply of 2e9 points": ("ply", _ply(CLAIMED) + b"\0" * 120),
        "ply of a negative count": ("ply", _ply(-1)),
        "ply with endless lists": ("ply", _ply(1000, "property list uint int index\n") + b"\xff" * 4000),
        "npz that claims 5.6 GiB": ("npz", _npz(_npy((500_000_000, 3), b""))),
        "npz that is 2 GiB of zeros": ("npz", _npz(_npy((2 * GIB // 12, 3), b""), zeros=2 * GIB)),
        "npy that is a pickle": ("npy", _pickled()),
        "npy of NaN": ("npy", _npy(nan.shape, nan.tobytes())),
        "xyz of one endless line": ("xyz", b"1 " * 2_000_000),
        "xyz of NaN and inf": ("xyz", b"nan inf -inf\n" * 2000),
        "csv of numbers without end": ("csv", b"x,y,z\n" + b"9" * 3_000_000),
        "nothing": ("pcd", b"\n"),
    }  # fmt: skip
    for suffix in ("pcd", "ply", "npz", "npy", "las", "laz", "e57", "mcap", "bag", "db3", "txt"):
        found[f"{suffix} of noise"] = (suffix, random.randbytes(20_000))
    found["las of 4e9 points"] = ("las", _las())
    return found


def robots(folder: Path) -> Mapping[str, Path]:
    """Write hostile robots to a folder; return them by what is wrong with them."""
    box = '<collision><geometry><box size="1 1 1"/></geometry></collision>'
    links = "".join(f'<link name="l{k}">{box}</link>' for k in range(CHAIN))
    joints = "".join(
        f'<joint name="j{k}" type="revolute"><parent link="l{k}"/><child link="l{k + 1}"/><axis xyz="0 0 1"/>'
        '<limit lower="-1" upper="1" velocity="1" effort="1"/></joint>'
        for k in range(CHAIN - 1)
    )
    entities = "".join(f'<!ENTITY a{k} "{f"&a{k - 1};" * 10}">' for k in range(1, 12))
    texts = {
        "chain of 5,000 links": f'<robot name="r">{links}{joints}</robot>',
        "bomb of entities": f'<!DOCTYPE robot [<!ENTITY a0 "lol">{entities}]><robot name="&a11;"/>',
        "entity of a file": '<!DOCTYPE robot [<!ENTITY x SYSTEM "file:///etc/passwd">]><robot name="&x;"/>',
        "200,000 elements deep": f'<robot name="r">{"<a>" * DEEP}{"</a>" * DEEP}</robot>',
        **{f"mesh at {path}": _with_mesh(path) for path in (
            "file:///etc/passwd", "/etc/passwd", "package://../../../etc/passwd", "../../../../../../etc/passwd",
        )},
        "no XML": "\0\1\2" * 1000,
    }  # fmt: skip
    folder.mkdir(parents=True, exist_ok=True)
    found = {}
    for number, (name, text) in enumerate(texts.items()):
        found[name] = folder / f"robot{number}.urdf"
        found[name].write_text(text, encoding="utf-8")
    return found


def _with_mesh(path: str) -> str:
    mesh = f'<collision><geometry><mesh filename="{path}"/></geometry></collision>'
    return (
        f'<robot name="r"><link name="a">{mesh}</link><link name="b"/><joint name="j" type="revolute">'
        '<parent link="a"/><child link="b"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="1" effort="1"/>'
        "</joint></robot>"
    )


def _pcd(points: int, data: str, size: int = 4) -> bytes:
    return (
        "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z\n"
        f"SIZE {size} {size} {size}\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {points}\nHEIGHT 1\n"
        f"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {points}\nDATA {data}\n"
    ).encode()


def _ply(points: int, more: str = "") -> bytes:
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {points}\nproperty float x\nproperty float y\n"
    return f"{head}property float z\n{more}end_header\n".encode()


def _npy(shape: tuple[int, ...], data: bytes) -> bytes:
    header = f"{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}".encode()
    header += b" " * (63 - (len(header) + 10) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + data


def _npz(member: bytes, zeros: int = 0) -> bytes:
    file = io.BytesIO()
    with (
        zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
        archive.open("points.npy", "w", force_zip64=True) as entry,
    ):
        entry.write(member)
        for _ in range(zeros // 2**24):
            entry.write(bytes(2**24))
    return file.getvalue()


class _Gotcha:
    def __reduce__(self) -> tuple[object, tuple[str]]:
        return exec, ("import os; os.abort()",)


def _pickled() -> bytes:
    header = b"{'descr': '|O', 'fortran_order': False, 'shape': (1, 3), }"
    header += b" " * (63 - (len(header) + 10) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + pickle.dumps(_Gotcha())


def _las() -> bytes:
    """Return a header of version 1.4 whose point count is wrong."""
    head = bytearray(375)
    head[0:4] = b"LASF"
    head[24:26] = bytes((1, 4))
    struct.pack_into("<HIIBHI", head, 94, 375, 375, 0, 6, 30, 0)
    struct.pack_into("<Q", head, 247, 2**32 - 1)
    struct.pack_into("<ddd", head, 131, 0.001, 0.001, 0.001)
    return bytes(head) + b"\0" * 60
