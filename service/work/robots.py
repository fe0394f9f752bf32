"""Cache of loaded robots; a robot is loaded again when one of its files has changed."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from costs.robot import RobotModel
from service.request.schema import PlanRequest, RobotRequest
from service.start.robot import load_requested_robot

MAX_ROBOTS = 8

Stamp = tuple[str, int, int]
"""A file's path, time of change [ns] and size [bytes]; -1 for a missing file."""


@dataclass(frozen=True)
class _Loaded:
    """A loaded robot.

    Attributes:
        request: the part of a request that names it.
        folder: from which the paths in there start.
        stamps: of its files before and after they were read.
        robot: the robot.
    """

    request: RobotRequest
    folder: Path
    stamps: tuple[Stamp, ...]
    robot: RobotModel


class RobotCache:
    """The most recently used robots.

    Args:
        max_robots: size of the cache.
    """

    def __init__(self, max_robots: int = MAX_ROBOTS) -> None:
        self._max_robots = max_robots
        self._loaded: list[_Loaded] = []  # the most recently used one first

    def get(self, request: PlanRequest) -> RobotModel:
        """Return the robot of a request.

        Raises:
            RequestError: it cannot be loaded.
        """
        known = self._find(request)
        if known is not None:
            self._loaded.remove(known)
        if known is None or not _is_current(known):
            known = _load(request)
        self._loaded = [known, *self._loaded[: self._max_robots - 1]]
        return known.robot

    def _find(self, request: PlanRequest) -> _Loaded | None:
        """Return the loaded robot of an equal request; to compare is faster than to hash."""
        for known in self._loaded:
            if known.request == request.robot and known.folder == request.folder:
                return known
        return None


def _load(request: PlanRequest) -> _Loaded:
    """Load the robot of a request.

    Raises:
        RequestError: it cannot be loaded.
    """
    # Stamps of before and after, so that a file that changes meanwhile is read again next time.
    named = (request.robot.urdf, request.robot.srdf)
    before = _read_stamps(str(request.resolve(path)) for path in named if path is not None)
    robot = load_requested_robot(request)
    files = (str(path) for path in robot.source.files.values())
    return _Loaded(request.robot, request.folder, (*before, *_read_stamps(files)), robot)


def _is_current(known: _Loaded) -> bool:
    """Whether the files of a robot are as they were; those of a bundled robot always are."""
    if known.request.urdf is None and known.request.srdf is None:
        return True
    return known.stamps == _read_stamps(path for path, _, _ in known.stamps)


def _read_stamps(paths: Iterable[str]) -> tuple[Stamp, ...]:
    return tuple(_read_stamp(path) for path in paths)


def _read_stamp(path: str) -> Stamp:
    try:
        stat = os.stat(path)  # for a hundred meshes per request; a Path would double the time
    except OSError:
        return (path, -1, -1)
    return (path, stat.st_mtime_ns, stat.st_size)
