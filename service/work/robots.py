"""Cache of loaded robots; a robot is loaded again when one of its files has changed."""

from __future__ import annotations

import os
from collections import OrderedDict
from collections.abc import Iterable
from pathlib import Path

from costs.robot import RobotModel
from service.request.file import adapter_of
from service.request.schema import PlanRequest, RobotRequest
from service.start.robot import load_requested_robot

MAX_ROBOTS = 8

Stamp = tuple[str, int, int]
"""A file's path, time of change [ns] and size [bytes]; -1 for a missing file."""


class RobotCache:
    """The most recently used robots.

    Args:
        max_robots: size of the cache.
    """

    def __init__(self, max_robots: int = MAX_ROBOTS) -> None:
        self._max_robots = max_robots
        self._loaded: OrderedDict[tuple[str, Path], tuple[tuple[Stamp, ...], RobotModel]] = OrderedDict()

    def get(self, request: PlanRequest) -> RobotModel:
        """Return the robot of a request.

        Raises:
            RequestError: it cannot be loaded.
        """
        key = (adapter_of(RobotRequest).dump_json(request.robot).decode(), request.folder)
        known = self._loaded.get(key)
        is_bundled = request.robot.urdf is None and request.robot.srdf is None  # its files stay as they are
        if known is None or not (is_bundled or known[0] == _read_stamps(path for path, _, _ in known[0])):
            # Stamps of before and after, so that a file that changes meanwhile is read again next time.
            named = (request.robot.urdf, request.robot.srdf)
            before = _read_stamps(str(request.resolve(path)) for path in named if path is not None)
            robot = load_requested_robot(request)
            files = (str(path) for path in robot.source.files.values())
            self._loaded[key] = ((*before, *_read_stamps(files)), robot)
        self._loaded.move_to_end(key)
        while len(self._loaded) > self._max_robots:
            self._loaded.popitem(last=False)
        return self._loaded[key][1]


def _read_stamps(paths: Iterable[str]) -> tuple[Stamp, ...]:
    return tuple(_read_stamp(path) for path in paths)


def _read_stamp(path: str) -> Stamp:
    try:
        stat = os.stat(path)  # for a hundred meshes per request; a Path would double the time
    except OSError:
        return (path, -1, -1)
    return (path, stat.st_mtime_ns, stat.st_size)
