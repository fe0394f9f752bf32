"""Paths of a request, where they start here: what can be asked of a server, and under which name."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

from service.client.clouds import is_sent
from service.errors import RequestError, shown
from service.request.scene import MeshRequest, SceneRequest
from service.request.schema import PlanRequest, RobotRequest, check_planned
from service.trust.folders import BUILT, UPLOADED, paths_of

NOT_UPLOADED = (
    "it is not uploaded; put it where the server looks (`scopt serve --allow FOLDER`) and give its absolute path there"
)


def askable(request: PlanRequest, is_this_machine: bool) -> PlanRequest:
    """The request as a server can understand it, uploads aside: it does not know where paths start.

    Args:
        is_this_machine: whether the server runs here, where a path that starts here can be told from the root.

    Raises:
        RequestError: a file that is not there, or that would not be found there; a task without a planner.
    """
    check_planned(request)
    problems = []
    for field, path, kind in sorted(
        paths_of(request), key=lambda one: one[2] in ("file", "mesh")
    ):  # what is uploaded first
        if kind in ("cloud", "scene") or (kind == "mesh" and is_sent(path)):
            problem = cloud_problem(field, path, request.resolve(path))
            problems += [] if problem is None else [problem]
        elif os.path.isabs(path):
            continue
        elif not request.resolve(path).exists():
            problems.append(missing(field, path))
        elif not is_this_machine:
            problems.append(f"{field}: {shown(path)} is a path of this machine; {NOT_UPLOADED}")
    if problems:
        raise RequestError(problems)
    return replace(request, robot=_robot(request), scene=_scene(request)) if is_this_machine else request


def cloud_problem(field: str, name: str, path: Path) -> str | None:
    """Why a cloud or scene cannot be sent; None where it can, or where it is the server's to find.

    Args:
        name: as the user wrote it; path: what it means here.
    """
    if path.is_dir() and not os.path.isabs(name):
        would_do = "name a file in it, or its path from the root there"
        return f"{field}: {shown(name)} is a folder, and files are uploaded one by one; {would_do}"
    if path.exists() or os.path.isabs(name) or name.startswith((UPLOADED, BUILT)):
        return None
    return missing(field, name)


def missing(field: str, name: str) -> str:
    """That a file is not there."""
    return f"{field}: {shown(name)} is not there; name a file that is"


def _robot(request: PlanRequest) -> RobotRequest:
    robot = request.robot
    urdf, srdf = (None if path is None else _absolute(request, path) for path in (robot.urdf, robot.srdf))
    folders = tuple(_absolute(request, path) for path in robot.package_dirs)
    return replace(robot, urdf=urdf, srdf=srdf, package_dirs=folders)


def _scene(request: PlanRequest) -> SceneRequest:
    obstacles = tuple(
        replace(one, file=_absolute(request, one.file))
        if isinstance(one, MeshRequest) and not is_sent(one.file)
        else one
        for one in request.scene.obstacles
    )
    return replace(request.scene, obstacles=obstacles)


def _absolute(request: PlanRequest, path: str) -> str:
    return os.path.abspath(request.resolve(path))
