"""Names that requests may use with the robots of the package, so that wrong ones are refused before they wait."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from costs.robot import bundled_robots
from service.request.known_names import RobotNames, find_name_problems, find_robot_name
from service.server.requests import RobotFolder


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
