"""The files of a problem as a request: problem, robot, scene and start."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from costs.robot import bundled_robots
from service.errors import RequestError, would_do
from service.request.file import load_section, parse_request
from service.request.scene import SceneRequest
from service.request.schema import PlanRequest, StartRequest
from service.trajopt.document import read_document
from service.trajopt.reader import robot_named_in


@dataclass(frozen=True)
class TrajoptFiles:
    """What a problem file does not hold.

    Attributes:
        robot: a bundled robot's name, or the path of a URDF; by default what the problem names.
        srdf: of a URDF; its groups are what ``manip`` may name.
        package_root: folder that package:// paths start at.
        is_floating: whether the robot's base is free; by default a bundled robot's is, another's is not.
        scene: file that holds what a request's ``scene`` holds.
        start: file that holds what a request's ``start`` holds.
        time_limit_s: for the whole plan.
    """

    robot: str | None = None
    srdf: Path | None = None
    package_root: Path | None = None
    is_floating: bool | None = None
    scene: Path | None = None
    start: Path | None = None
    time_limit_s: float = 60.0


def load_trajopt_request(problem: Path, files: TrajoptFiles) -> PlanRequest:
    """The request to solve a problem file; paths in the scene's file start at its folder.

    Raises:
        RequestError: one line per problem of a file; what only the robot can tell comes with ``prepare``.
    """
    document = read_document(problem)
    request = parse_request(
        {
            "robot": _robot(files, robot_named_in(document), problem.parent),
            "task": {"trajopt": document},
            # A file that asks for balance asks for no margin.
            "options": {"time_limit_s": files.time_limit_s, "balance_margin_m": 0.0},
        },
        problem.parent if files.scene is None else files.scene.parent,
    )
    if files.scene is not None:
        request = replace(request, scene=load_section(SceneRequest, files.scene))
    if files.start is not None:
        request = replace(request, start=load_section(StartRequest, files.start))
    return request


def _robot(files: TrajoptFiles, named: str, folder: Path) -> Mapping[str, Any]:
    """The ``robot`` section: as the command says, else as the problem says."""
    given, what = (named, "basic_info.robot") if files.robot is None else (files.robot, "--robot")
    if not given:
        raise RequestError(f"--robot is missing: expected a bundled robot ({', '.join(bundled_robots())}) or a URDF")
    root = {} if files.is_floating is None else {"root": "floating" if files.is_floating else "fixed"}
    if given in bundled_robots():
        if files.srdf is not None or files.package_root is not None:
            raise RequestError(f"--srdf and --package-root go with a URDF; {given} brings its own")
        return {"name": given, **root}
    path = folder / given if files.robot is None else Path(given)
    if not path.is_file():
        raise RequestError(
            f"{what}: {given!r} is neither a bundled robot nor a file; expected {would_do(given, bundled_robots())}"
        )
    section: dict[str, Any] = {"urdf": str(path.resolve()), **root}
    if files.srdf is not None:
        section["srdf"] = str(files.srdf.resolve())
    if files.package_root is not None:
        section["package_dirs"] = [str(files.package_root.resolve())]
    return section
