"""Robots of a server: those of its own folder, and the names that requests may use with those of the package."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from costs.robot import bundled_robots
from service.request.known_names import RobotNames, find_name_problems, find_robot_name
from service.request.schema import PlanRequest, RobotRequest

URDF_NAME, SRDF_NAME = "robot.urdf", "robot.srdf"
UNKNOWN_ROBOT = re.compile(r"(\S*robot(\.name)?: )?unknown robot ")


@dataclass(frozen=True)
class RobotFolder:
    """Robots of this server beside those of the package: subfolders named like their robot, read at every request.

    A subfolder holds ``robot.urdf``, and may hold ``robot.srdf`` and meshes.

    Attributes:
        folder: parent of the subfolders; None without own robots.
    """

    folder: Path | None

    def requests(self) -> Mapping[str, RobotRequest]:
        """Return the request for each robot's files, by name."""
        if self.folder is None or not self.folder.is_dir():
            return {}
        paths = sorted(path for path in self.folder.resolve().iterdir() if (path / URDF_NAME).is_file())
        return {path.name: _robot_request(path) for path in paths}

    @property
    def overriding(self) -> tuple[str, ...]:
        """Names of own robots that hide a robot of the package."""
        return tuple(name for name in self.requests() if name in bundled_robots())

    def hide_paths(self, problems: Iterable[str]) -> list[str]:
        """Name own robots instead of their paths in messages, and list them where a robot is unknown."""
        prefix = "" if self.folder is None else f"{self.folder.resolve()}{os.sep}"
        names = ", ".join(self.requests())
        return [
            f"{problem}; this server also has {names}" if names and UNKNOWN_ROBOT.match(problem) else problem
            for problem in (problem.replace(prefix, "") if prefix else problem for problem in problems)
        ]

    def insert_files(self, request: PlanRequest) -> PlanRequest:
        """Replace the name of an own robot by its files."""
        own = None if request.robot.name is None else self.get(request.robot.name)
        return request if own is None else replace(request, robot=_take_parts(own, request.robot))

    def get(self, name: str) -> RobotRequest | None:
        """Return an own robot; None if there is none of that name."""
        if self.folder is None or os.path.basename(name) != name:
            return None
        if not os.path.isfile(os.path.join(self.folder, name, URDF_NAME)):  # a Path would take four times as long
            return None
        return _robot_request(self.folder.resolve() / name)


def _robot_request(folder: Path) -> RobotRequest:
    srdf = folder / SRDF_NAME
    return RobotRequest(
        urdf=str(folder / URDF_NAME), srdf=str(srdf) if srdf.is_file() else None, package_dirs=(str(folder),)
    )


def _take_parts(own: RobotRequest, asked: RobotRequest) -> RobotRequest:
    """Return a robot of the server with what a request says about it."""
    return replace(own, root=asked.root, contacts=asked.contacts, hands=asked.hands)


class KnownRobots:
    """Names of the package's robots, as a worker has described them; nothing is known before.

    Robots of the server's own folder may change at any time, and only their own names are known.
    """

    def __init__(self, folder: RobotFolder) -> None:
        self._folder = folder
        self._names: dict[str, RobotNames] = {}

    def learn(self, robots: Iterable[RobotNames]) -> None:
        """Take the names of the package's robots."""
        self._names = {names.name: names for names in robots}

    def find_problems(self, data: Mapping[str, Any]) -> list[str]:
        """Return one line per name in a request's plain data that no robot of this server has."""
        name = find_robot_name(data)
        if name is not None and self._folder.get(name) is not None:
            return []
        robots = bundled_robots()
        own = () if name in robots else self._folder.requests()
        return find_name_problems(data, [*robots, *(name for name in own if name not in robots)], self._names)
