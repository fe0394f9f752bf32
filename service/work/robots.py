"""Robots that stay loaded between requests, and are loaded anew when a file they were made of has changed."""

from __future__ import annotations

import os
from collections import OrderedDict
from collections.abc import Iterable
from pathlib import Path

from costs.robot import RobotModel
from service.request.schema import PlanRequest, RobotRequest
from service.start.robot import load_requested_robot

MAX_ROBOTS = 8

Stamp = tuple[str, int, int]
"""A file's path, time of change [ns] and size [bytes]; -1 where it is not there."""


class WarmRobots:
    """The robots that were asked for last; those least recently used go first.

    Args:
        most: how many are kept.
    """

    def __init__(self, most: int = MAX_ROBOTS) -> None:
        self._most = most
        self._loaded: OrderedDict[tuple[RobotRequest, Path], tuple[tuple[Stamp, ...], RobotModel]] = OrderedDict()

    def get(self, request: PlanRequest) -> RobotModel:
        """The robot of a request.

        Raises:
            RequestError: it cannot be loaded.
        """
        key = (request.robot, request.folder)
        known = self._loaded.get(key)
        if known is None or known[0] != _stamps(path for path, _, _ in known[0]):
            # Stamped before and after: a file that changes while it is read is read again next time.
            before = _stamps(_named_files(request))
            robot = load_requested_robot(request)
            files = (str(path) for path in robot.source.files.values())
            self._loaded[key] = ((*before, *_stamps(files)), robot)
        self._loaded.move_to_end(key)
        while len(self._loaded) > self._most:
            self._loaded.popitem(last=False)
        return self._loaded[key][1]


def _named_files(request: PlanRequest) -> list[str]:
    """The files that a request itself names for its robot."""
    robot = request.robot
    return [str(request.resolve(path)) for path in (robot.urdf, robot.srdf) if path is not None]


def _stamps(paths: Iterable[str]) -> tuple[Stamp, ...]:
    return tuple(_stamp(path) for path in paths)


def _stamp(path: str) -> Stamp:
    try:
        stat = os.stat(path)  # of a hundred meshes with every request: a Path would double the time
    except OSError:
        return (path, -1, -1)
    return (path, stat.st_mtime_ns, stat.st_size)
