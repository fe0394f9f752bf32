"""Cloud files of any supported kind to a cloud."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from perception.cloud import Cloud, make_cloud, merged
from perception.errors import CloudError
from perception.files.bag import Message
from perception.files.oddities import rounding_note, without_empty_rows
from perception.files.placing import Pose, metres_per, moved, pose_of_viewpoint, rigid_pose
from perception.files.worker import parse_in_worker
from perception.limits import MAX_POINTS


def read_cloud(
    path: Path | str,
    *,
    unit: str = "m",
    transform: Pose | None = None,
    apply_viewpoint: bool = False,
    topic: str | None = None,
    message: Message = 0,
) -> Cloud:
    """Read a cloud file; the kind follows from its suffix.

    The file's numbers become metres first; then its viewpoint moves the points, if asked; then ``transform`` does.  The
    viewpoint's translation, taken along, is where the rays started.

    Args:
        path: the file.
        unit: of the file's lengths: m, cm, mm, km, in, ft.
        transform: pose_world_cloud, as ``rigid_pose`` takes it [m, rad]; None: the points are in the world.
        apply_viewpoint: move the points by the viewpoint pose, for files whose points are in the sensor's frame.
        topic: of a bag with several clouds, the one to read.
        message: of a bag, the number of the message to read, the first being 0 and the last -1, or ``all``, merged.

    Raises:
        CloudError: naming the file, what is wrong and what would do.
    """
    return _placed(Path(path), unit, transform, apply_viewpoint, topic, message)


def read_clouds(
    files: Sequence[tuple[Path | str, Pose | None]],
    *,
    unit: str = "m",
    apply_viewpoint: bool = False,
    topic: str | None = None,
    message: Message = 0,
) -> Cloud:
    """Read several files and merge them; every point knows where its own ray started.

    Args:
        files: each file with its pose_world_cloud (None: its points are in the world already).
        unit, apply_viewpoint, topic, message: of all files, as for ``read_cloud``.

    Raises:
        CloudError: no file, too many points together, or what ``read_cloud`` has to say of one of them.
    """
    if not files:
        raise CloudError("no cloud file is given; at least one is needed")
    clouds = []
    n_rays = 0
    for path, transform in files:
        cloud = _placed(Path(path), unit, transform, apply_viewpoint, topic, message)
        n_rays += len(cloud.points) + len(cloud.misses)
        if n_rays > MAX_POINTS:
            raise CloudError(
                f"{path}: brings the points of all files to {n_rays}; at most {MAX_POINTS} are read, downsample first"
            )
        clouds.append(cloud if len(files) == 1 else replace(cloud, notes=tuple(f"{path}: {n}" for n in cloud.notes)))
    return merged(clouds)


def _placed(
    path: Path, unit: str, transform: Pose | None, apply_viewpoint: bool, topic: str | None, message: Message
) -> Cloud:
    """One file's cloud in metres in the frame that is asked for."""
    scale = metres_per(unit)
    pose = np.eye(4) if transform is None else rigid_pose(transform)
    scan = without_empty_rows(parse_in_worker(path, topic, message), str(path))
    notes = (*scan.notes, *rounding_note(scan.points, scale))
    viewpoint = np.eye(4)
    if scan.viewpoint is not None:
        viewpoint = pose_of_viewpoint(scan.viewpoint)
        viewpoint[:3, 3] *= scale
    elif apply_viewpoint:
        raise CloudError(f"{path}: gives no viewpoint to apply; add one or leave apply_viewpoint off")
    elif scan.starts is None:
        notes = (*notes, "the file gives no sensor position; rays are taken to start at (0, 0, 0)")
    if transform is None and not apply_viewpoint:
        notes = (*notes, *_frame_hint(scale * scan.points, viewpoint))
    pose_world_rows = pose @ viewpoint if apply_viewpoint else pose
    at_viewpoint = moved(pose, viewpoint[:3, 3])
    return make_cloud(
        moved(pose_world_rows, scan.points, scale),
        at_viewpoint if scan.starts is None else moved(pose_world_rows, scan.starts, scale),
        notes,
        str(path),
        misses=moved(pose_world_rows, scan.misses, scale),
        miss_origin=None if scan.miss_starts is None else moved(pose_world_rows, scan.miss_starts, scale),
    )


def _frame_hint(points: Float[np.ndarray, "N 3"], viewpoint: Float[np.ndarray, "4 4"]) -> tuple[str, ...]:
    """A hint when the points would lie flatter (a floor shows) if the viewpoint were applied to them."""
    if np.allclose(viewpoint, np.eye(4), atol=1e-6):
        return ()
    sample = points[np.isfinite(points).all(axis=1)][:: max(1, len(points) // 20_000)]
    if not len(sample):
        return ()
    if _flatness(moved(viewpoint, sample)[:, 2]) > 1.5 * _flatness(sample[:, 2]):
        return ("looks sensor-framed: a floor shows only after the viewpoint is applied; use apply_viewpoint",)
    return ()


def _flatness(heights: Float[np.ndarray, "N"]) -> float:
    """Share of points in the fullest 4 cm layer of height."""
    layers = np.floor((heights - heights.min()) / 0.04)
    _, counts = np.unique(layers, return_counts=True)
    return float(counts.max() / len(heights))
