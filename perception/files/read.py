"""Reading of cloud files: each is parsed in a sandbox, transformed to the world and merged with the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from perception.cloud import Cloud, merge_clouds
from perception.errors import CloudError
from perception.files.bag import Message
from perception.files.parse import is_bag, parse_to_values
from perception.files.placing import PoseInput, place_scan
from perception.files.scan import Scan, pick_rows
from perception.levelling.level import make_level, propose_level
from perception.limits import MAX_PARSER_BYTES, MAX_PARSER_CPU_S, MAX_PARSER_WALL_S, MAX_POINTS
from perception.noise import AUTO
from perception.sandbox import Cause, ProcessLimits, SandboxError, run_in_sandbox

_KINDS = {".png": "depth", ".e57": "survey", ".ptx": "survey"}
PARSER_LIMITS = ProcessLimits(MAX_PARSER_BYTES, MAX_PARSER_WALL_S, MAX_PARSER_CPU_S)


def read_cloud(
    path: Path | str,
    *,
    unit: str = "m",
    transform: PoseInput | None = None,
    apply_viewpoint: bool = False,
    sensor: Sequence[float] | None = None,
    topic: str | None = None,
    message: Message = 0,
    level: bool = False,
    sensor_model: str = AUTO,
    sensor_sigma: float = 0.0,
) -> Cloud:
    """Read a cloud file; its content, else its suffix gives the format.

    The points are converted to metres, then transformed by the viewpoint (with ``apply_viewpoint``), then by
    ``transform``.  The rays start at the viewpoint's translation, transformed in the same way.

    Args:
        unit: length unit of the file: m, cm, mm, km, in, ft.
        transform: pose_world_cloud, as ``rigid_pose`` takes it [m, rad]; None: the points are in the world.
        apply_viewpoint: transform the points by the viewpoint, for files whose points are in the sensor's frame.
        sensor: start of the rays in the world [m] for a file that does not give it; None: the file's origin.  An
            identity viewpoint does not count, since writers without a sensor pose write it.
        topic: topic to read from a bag with several.
        message: index of a bag's message to read (0 the first, -1 the last), or ``all`` to merge them.
        level: turn the cloud z up and lift its floor to zero; without, a cloud that is not level gets a note.
        sensor_model: kind of sensor, a name of ``noise.MODELS``; ``auto``: by the file, or estimated when it is needed.
        sensor_sigma: standard deviation of the start of the rays [m].

    Raises:
        CloudError: the file cannot be used; the message names the file, the fault and what is expected.
    """
    return read_clouds(
        [(path, transform)],
        unit=unit,
        apply_viewpoint=apply_viewpoint,
        sensor=sensor,
        topic=topic,
        message=message,
        level=level,
        sensor_model=sensor_model,
        sensor_sigma=sensor_sigma,
    )


def read_clouds(
    files: Sequence[tuple[Path | str, PoseInput | None]],
    *,
    unit: str = "m",
    apply_viewpoint: bool = False,
    sensor: Sequence[float] | None = None,
    topic: str | None = None,
    message: Message = 0,
    level: bool = False,
    sensor_model: str = AUTO,
    sensor_sigma: float = 0.0,
) -> Cloud:
    """Read several files and merge them, thinned to at most ``MAX_POINTS``; each point keeps the start of its ray.

    Args:
        files: each file with its pose_world_cloud (None: its points are already in the world).
        unit, apply_viewpoint, sensor: as for ``read_cloud``, for all files.
        topic, message: as for ``read_cloud``, for all bags.
        level, sensor_model, sensor_sigma: as for ``read_cloud``, for the merged cloud.

    Raises:
        CloudError: no file given, or a file cannot be used.
    """
    if not files:
        raise CloudError("no cloud file is given; at least one is needed")
    clouds: list[Cloud] = []
    step = 1
    has_bag = any(is_bag(Path(path)) for path, _ in files)
    for path, transform in files:
        of_bag = (topic, message) if is_bag(Path(path)) or not has_bag else (None, 0)
        scan = parse_in_sandbox(Path(path), *of_bag)
        cloud = place_scan(scan, str(path), unit, transform, apply_viewpoint, sensor)
        if len(files) > 1:
            cloud = replace(cloud, notes=tuple(f"{path}: {note}" for note in cloud.notes))
        clouds.append(_thin(cloud, step))
        while sum(len(part.points) + len(part.misses) for part in clouds) > MAX_POINTS:
            clouds, step = [_thin(part, 2) for part in clouds], 2 * step
    whole = merge_clouds(clouds)
    if step > 1:
        note = f"took 1 of every {step} points of all files, since at most {MAX_POINTS} are used together"
        whole = replace(whole, notes=(*whole.notes, note))
    known = sensor_model if sensor_model != AUTO else _find_kind([path for path, _ in files])
    whole = replace(whole, sensor=known, origin_sigma=sensor_sigma)
    if level:
        return make_level(whole)
    return replace(whole, notes=(*whole.notes, *propose_level(whole)))


def _find_kind(paths: Sequence[Path | str]) -> str:
    """Return the kind of sensor that writes such files; empty if several do."""
    kinds = {_KINDS.get(Path(path).suffix.lower(), "") for path in paths}
    return kinds.pop() if len(kinds) == 1 else ""


def _thin(cloud: Cloud, step: int) -> Cloud:
    """Return one of every ``step`` points and rays without a return."""
    if step == 1:
        return cloud
    points, misses = (np.arange(n)[pick_rows(n, step)] for n in (len(cloud.points), len(cloud.misses)))
    behind = cloud.miss_origin
    if behind is not None and behind.ndim == 2:
        behind = behind[misses]
    return replace(cloud.select(points), misses=cloud.misses[misses], miss_origin=behind)


def parse_in_sandbox(
    path: Path, topic: str | None = None, message: Message = 0, limits: ProcessLimits = PARSER_LIMITS
) -> Scan:
    """Parse a file as ``parse_file`` does, in a process sandbox.

    Raises:
        CloudError: the reader crashed, or the file cannot be used; the message names the file and the fault.
        Stopped: the caller was asked to stop; the process is killed.
    """
    try:
        values = run_in_sandbox(parse_to_values, {"path": str(path), "topic": topic, "message": message}, limits)
    except SandboxError as error:
        raise CloudError(f"{path}: {_explain(error)}") from None
    if "error" in values:
        raise CloudError(values["error"])
    viewpoint = values.pop("viewpoint")
    return Scan(viewpoint=None if viewpoint is None else tuple(viewpoint), notes=tuple(values.pop("notes")), **values)


def _explain(error: SandboxError) -> str:
    needs_memory = f"needs more than {error.limit} to read; is it damaged, or much larger than it looks?"
    if error.cause is Cause.MEMORY:
        return needs_memory
    if error.cause is Cause.CPU_TIME:
        return f"took more than {error.limit} to read; is it damaged, or much larger than it looks?"
    if error.cause is Cause.WALL_TIME:
        return f"took more than {error.limit} to read; is it damaged, or the machine busy?"
    more = f" or it {needs_memory}" if error.ending == "SIGABRT" else ""
    return f"made its reader stop ({error.ending}); is it damaged?{more}"
