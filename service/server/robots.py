"""Robots that a server knows by name besides those of the package: a folder each, read anew when its files change."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from costs.robot import bundled_robots
from service.request.schema import PlanRequest, RobotRequest

URDF_NAME, SRDF_NAME = "robot.urdf", "robot.srdf"
UNKNOWN = re.compile(r"(\S*robot: )?unknown robot ")


@dataclass(frozen=True)
class RobotFolder:
    """Subfolders named like their robot, with ``robot.urdf`` and perhaps ``robot.srdf`` and meshes.

    Attributes:
        folder: that holds them; None where there are none.
    """

    folder: Path | None

    def requests(self) -> Mapping[str, RobotRequest]:
        """The robots by name, as a request would ask for their files."""
        if self.folder is None or not self.folder.is_dir():
            return {}
        found = sorted(path for path in self.folder.resolve().iterdir() if (path / URDF_NAME).is_file())
        return {path.name: _request(path) for path in found}

    @property
    def replaced(self) -> tuple[str, ...]:
        """The robots that have the name of one of the package, in whose place they are."""
        return tuple(name for name in self.requests() if name in bundled_robots())

    def as_named(self, problems: Iterable[str]) -> list[str]:
        """Problems in words of who asks: names of robots, not where they are kept here."""
        here = "" if self.folder is None else f"{self.folder.resolve()}{os.sep}"
        also = ", ".join(self.requests())
        return [
            f"{problem}; this server also has {also}" if also and UNKNOWN.match(problem) else problem
            for problem in (problem.replace(here, "") if here else problem for problem in problems)
        ]

    def placed(self, request: PlanRequest) -> PlanRequest:
        """The request with the files of a robot that it names and that is here."""
        own = None if request.robot.name is None else self.own(request.robot.name)
        return request if own is None else replace(request, robot=replace(own, root=request.robot.root))

    def own(self, name: str) -> RobotRequest | None:
        """A robot of this folder; None where it has none of that name."""
        return self.requests().get(name)


def _request(folder: Path) -> RobotRequest:
    srdf = folder / SRDF_NAME
    return RobotRequest(
        urdf=str(folder / URDF_NAME), srdf=str(srdf) if srdf.is_file() else None, package_dirs=(str(folder),)
    )
