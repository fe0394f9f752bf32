"""Cloud files of any supported kind to a cloud."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from perception.cloud import Cloud, make_cloud, merge_clouds
from perception.errors import CloudError
from perception.files.bag import Message
from perception.files.oddities import rounding_note, without_empty_rows
from perception.files.parse import is_bag
from perception.files.placing import Pose, metres_per, moved, pose_of_viewpoint, rigid_pose
from perception.files.scan import Scan
from perception.files.thinning import taken
from perception.files.worker import parse_in_worker
from perception.limits import LARGEST_COORDINATE, MAX_POINTS

# No ray is that long.
_MAP_DISTANCE = 1_000.0


def read_cloud(
    path: Path | str,
    *,
    unit: str = "m",
    transform: Pose | None = None,
    apply_viewpoint: bool = False,
    sensor: Sequence[float] | None = None,
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
        sensor: where the rays of a file that does not say so started, in the world [m]; None: at the file's zero.  A
            viewpoint that is the identity does not say so, since it is what writers put that know none.
        topic: of a bag with several clouds, the one to read.
        message: of a bag, the number of the message to read, the first being 0 and the last -1, or ``all``, merged.

    Raises:
        CloudError: naming the file, what is wrong and what would do.
    """
    return read_clouds(
        [(path, transform)], unit=unit, apply_viewpoint=apply_viewpoint, sensor=sensor, topic=topic, message=message
    )


def read_clouds(
    files: Sequence[tuple[Path | str, Pose | None]],
    *,
    unit: str = "m",
    apply_viewpoint: bool = False,
    sensor: Sequence[float] | None = None,
    topic: str | None = None,
    message: Message = 0,
) -> Cloud:
    """Read several files and merge them, thinned to as many points as are used; every one knows where its ray started.

    Args:
        files: each file with its pose_world_cloud (None: its points are in the world already).
        unit, apply_viewpoint, sensor: of all files, as for ``read_cloud``.
        topic, message: of all bags among them.

    Raises:
        CloudError: no file, or what ``read_cloud`` has to say of one of them.
    """
    if not files:
        raise CloudError("no cloud file is given; at least one is needed")
    clouds: list[Cloud] = []
    step = 1
    has_bag = any(is_bag(Path(path)) for path, _ in files)
    for path, transform in files:
        of_bag = (topic, message) if is_bag(Path(path)) or not has_bag else (None, 0)
        scan = parse_in_worker(Path(path), *of_bag)
        cloud = _placed(scan, str(path), unit, transform, apply_viewpoint, sensor)
        if len(files) > 1:
            cloud = replace(cloud, notes=tuple(f"{path}: {note}" for note in cloud.notes))
        clouds.append(_thinned(cloud, step))
        while sum(len(one.points) + len(one.misses) for one in clouds) > MAX_POINTS:
            clouds, step = [_thinned(one, 2) for one in clouds], 2 * step
    whole = merge_clouds(clouds)
    if step == 1:
        return whole
    note = f"took 1 of every {step} points of all files, since at most {MAX_POINTS} are used together"
    return replace(whole, notes=(*whole.notes, note))


def _thinned(cloud: Cloud, step: int) -> Cloud:
    """One of every ``step`` points and rays."""
    if step == 1:
        return cloud
    points, misses = (np.arange(n)[taken(n, step)] for n in (len(cloud.points), len(cloud.misses)))
    behind = cloud.miss_origin
    if behind is not None and behind.ndim == 2:
        behind = behind[misses]
    return replace(cloud.selected(points), misses=cloud.misses[misses], miss_origin=behind)


def _placed(
    scan: Scan,
    name: str,
    unit: str,
    transform: Pose | None,
    apply_viewpoint: bool,
    sensor: Sequence[float] | None,
) -> Cloud:
    """One file's cloud in metres in the frame that is asked for."""
    scale = metres_per(unit)
    pose = np.eye(4) if transform is None else rigid_pose(transform)
    scan = without_empty_rows(scan, name)
    notes = (*scan.notes, *rounding_note(scan.points, scale))
    if scan.unit and scan.unit != unit:
        notes = (f"its header says {scan.unit}, but it was read as {unit}: give the unit {scan.unit}", *notes)
    viewpoint = np.eye(4)
    if scan.viewpoint is not None:
        viewpoint = pose_of_viewpoint(scan.viewpoint)
        viewpoint[:3, 3] *= scale
    elif apply_viewpoint:
        raise CloudError(f"{name}: gives no viewpoint to apply; add one, or leave the points as they are")
    if transform is None and not apply_viewpoint:
        notes = (*notes, *_frame_hint(scale * scan.points, viewpoint))
    pose_world_rows = pose @ viewpoint if apply_viewpoint else pose
    points = moved(pose_world_rows, scan.points, scale)
    # Writers that know no sensor leave the identity for a viewpoint.
    is_told = scan.starts is not None or not np.array_equal(viewpoint, np.eye(4))
    if is_told and sensor is not None:
        notes = (*notes, "the file says where its rays started; the sensor's position that is given is not used")
    if scan.starts is not None:
        origin = moved(pose_world_rows, scan.starts, scale)
    elif is_told:
        origin = moved(pose, viewpoint[:3, 3])
    else:
        origin, more = _unknown_sensor(points, pose[:3, 3], sensor)
        if scan.viewpoint is None or not np.array_equal(origin, pose[:3, 3]):
            notes = (*notes, *more)
    return make_cloud(
        points,
        origin,
        notes,
        name,
        misses=moved(pose_world_rows, scan.misses, scale),
        miss_origin=None if scan.miss_starts is None else moved(pose_world_rows, scan.miss_starts, scale),
    )


def _unknown_sensor(
    points: Float[np.ndarray, "N 3"], zero: Float[np.ndarray, "3"], sensor: Sequence[float] | None
) -> tuple[Float[np.ndarray, "3"], tuple[str, ...]]:
    """Where rays are taken to start when the file does not say, and what to tell about it.

    Args:
        points: in the world [m].
        zero: the file's zero in the world [m].
        sensor: what the user says [m].
    """
    if sensor is not None:
        position = np.asarray(sensor, dtype=np.float64)
        if position.shape != (3,) or not (np.abs(position) <= LARGEST_COORDINATE).all():
            raise CloudError(
                f"sensor {list(sensor)} is no position; three numbers, at most {LARGEST_COORDINATE:g} m, are needed"
            )
        return position, ()
    valid = points[np.isfinite(points).all(axis=1)]
    distance = float(np.linalg.norm(np.median(valid, axis=0) - zero)) if len(valid) else 0.0
    if distance > _MAP_DISTANCE and np.any(zero):
        note = (
            f"the file gives no sensor position, and its zero lies {distance:.0f} m away; "
            "rays are taken to start at the world's (0, 0, 0), give the sensor's position"
        )
        return np.zeros(3), (note,)
    where = ", ".join(f"{value:g}" for value in np.round(zero, 3) + 0.0)
    return zero, (f"the file gives no sensor position; rays are taken to start at ({where}), give it if they did not",)


def _frame_hint(points: Float[np.ndarray, "N 3"], viewpoint: Float[np.ndarray, "4 4"]) -> tuple[str, ...]:
    """A hint when the points would lie flatter (a floor shows) if the viewpoint were applied to them."""
    if np.allclose(viewpoint, np.eye(4), atol=1e-6):
        return ()
    sample = points[np.isfinite(points).all(axis=1)][:: max(1, len(points) // 20_000)]
    if not len(sample):
        return ()
    if _flatness(moved(viewpoint, sample)[:, 2]) > 1.5 * _flatness(sample[:, 2]):
        return ("looks sensor-framed: a floor shows only after the viewpoint is applied to the points; ask for that",)
    return ()


def _flatness(heights: Float[np.ndarray, "N"]) -> float:
    """Share of points in the fullest 4 cm layer of height."""
    layers = np.floor((heights - heights.min()) / 0.04)
    _, counts = np.unique(layers, return_counts=True)
    return float(counts.max() / len(heights))
