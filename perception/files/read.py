"""Cloud files of any supported kind to a cloud."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from perception.cloud import MAX_FILE_BYTES, Cloud, make_cloud
from perception.errors import CloudError
from perception.files.pcd import read_pcd
from perception.files.ply import read_ply
from perception.files.table import read_npz, read_text

_Reader = Callable[[bytes, str], tuple[Float[np.ndarray, "N 3"], tuple[float, ...] | None]]
_READERS: dict[str, _Reader] = {
    ".pcd": read_pcd,
    ".ply": read_ply,
    ".xyz": read_text,
    ".txt": read_text,
    ".csv": read_text,
    ".npz": read_npz,
}
SUFFIXES = tuple(_READERS)


def read_cloud(path: Path | str, apply_viewpoint: bool = False) -> Cloud:
    """Read a cloud file; the kind follows from its suffix (pcd, ply, xyz, txt, csv, npz).

    Points are taken as they stand and the viewpoint's translation is the ray origin.

    Args:
        path: the file.
        apply_viewpoint: move the points by the viewpoint pose, for files whose points are in the sensor's frame.

    Raises:
        CloudError: naming the file, what is wrong and what would do.
    """
    path = Path(path)
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise CloudError(f"{path}: suffix '{path.suffix}' is unknown; one of {', '.join(SUFFIXES)} is needed")
    points, viewpoint = reader(_content(path), str(path))
    if viewpoint is None:
        if apply_viewpoint:
            raise CloudError(f"{path}: gives no viewpoint to apply; add one or leave apply_viewpoint off")
        note = "the file gives no sensor position; rays are taken to start at (0, 0, 0)"
        return make_cloud(points, np.zeros(3), (note,), str(path))
    origin = np.array(viewpoint[:3])
    rotation = Rotation.from_quat(viewpoint[3:], scalar_first=True)
    if apply_viewpoint:
        return make_cloud(points @ rotation.as_matrix().T + origin, origin, (), str(path))
    return make_cloud(points, origin, _frame_hint(points, origin, rotation), str(path))


def _content(path: Path) -> bytes:
    try:
        size = path.stat().st_size
        if not path.is_file():  # a pipe or a device would never end
            kind = "a folder" if path.is_dir() else "no regular file"
            raise CloudError(f"{path}: is {kind}; a cloud file is needed")
        if size > MAX_FILE_BYTES:
            raise CloudError(f"{path}: {size} bytes; at most {MAX_FILE_BYTES} are read, downsample it first")
        data = path.read_bytes()
    except OSError as error:
        raise CloudError(f"{path}: cannot be read ({error.strerror})") from None
    if not data:
        raise CloudError(f"{path}: is empty; a cloud with at least one point is needed")
    return data


def _frame_hint(
    points: Float[np.ndarray, "N 3"], origin: Float[np.ndarray, "3"], rotation: Rotation
) -> tuple[str, ...]:
    """A hint when the points would lie flatter (a floor shows) if the viewpoint were applied to them."""
    if np.allclose(origin, 0.0) and rotation.magnitude() < 1e-6:
        return ()
    sample = points[np.isfinite(points).all(axis=1)][:: max(1, len(points) // 20_000)]
    if not len(sample):
        return ()
    moved = sample @ rotation.as_matrix().T + origin
    if _flatness(moved[:, 2]) > 1.5 * _flatness(sample[:, 2]):
        return ("looks sensor-framed: a floor shows only after the viewpoint is applied; use apply_viewpoint",)
    return ()


def _flatness(heights: Float[np.ndarray, "N"]) -> float:
    """Share of points in the fullest 4 cm layer of height."""
    layers = np.floor((heights - heights.min()) / 0.04)
    _, counts = np.unique(layers, return_counts=True)
    return float(counts.max() / len(heights))
