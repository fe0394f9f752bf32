"""Requests of clients as this server accepts them: validated, within its folders, robots and time budgets."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from costs.robot import bundled_robots
from service.errors import RequestError
from service.proto.planner.v1.request_pb2 import MotionRequest
from service.request.file import parse_request
from service.request.scene import MeshRequest, SceneRequest
from service.request.schema import PlanRequest, RobotRequest
from service.server.refusals import refuse_invalid
from service.server.settings import ServerSettings
from service.store import CloudStore, Scenes
from service.trust import BUILT, UPLOADED, AllowedFolders
from service.wire.plain import to_plain

if TYPE_CHECKING:
    from service.server.known_robots import KnownRobots

WITHIN = "request"  # the field of the wire's PlanRequest that the validator's paths start from
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
        if self.folder is None or Path(name).name != name:
            return None
        path = self.folder.resolve() / name
        return _robot_request(path) if (path / URDF_NAME).is_file() else None


def _robot_request(folder: Path) -> RobotRequest:
    srdf = folder / SRDF_NAME
    return RobotRequest(
        urdf=str(folder / URDF_NAME), srdf=str(srdf) if srdf.is_file() else None, package_dirs=(str(folder),)
    )


@dataclass(frozen=True)
class RequestReader:
    """Reader of planning requests.

    Attributes:
        settings: settings of the server.
        folders: folders whose files requests may name.
        clouds: uploaded files.
        scenes: built scenes.
        robots: own robots of the server.
        known: names that requests may use with a robot.
    """

    settings: ServerSettings
    folders: AllowedFolders
    clouds: CloudStore
    scenes: Scenes
    robots: RobotFolder
    known: KnownRobots

    def read(self, message: MotionRequest) -> PlanRequest:
        """Read and check a message.

        Raises:
            Refusal: INVALID_ARGUMENT naming every wrong field.
        """
        data = to_plain(message)
        names = self.known.find_problems(data)
        try:
            request = parse_request(data)
        except RequestError as error:
            raise refuse_invalid([*error.problems, *names], WITHIN) from None
        problems = [f"{field}: {problem}" for field, problem in self.folders.find_problems(request)]
        budget = self.settings.budget_s(kind_of(request))
        limit = request.options.time_limit_s
        if limit > budget:
            problems.append(f"options.time_limit_s: expected at most {budget:g} on this server, got {limit:g}")
        problems += names
        if problems:
            raise refuse_invalid(problems, WITHIN)
        return request

    @contextmanager
    def open_files(self, request: PlanRequest) -> Iterator[PlanRequest]:
        """Yield the request with paths of uploads, built scenes and own robots, which stay readable for the body.

        Raises:
            NotStoredError: a file has been deleted since the request was read.
        """
        with_robot = self.robots.insert_files(request)
        scene = request.scene
        ids = select_uploads(list_files(scene))
        with ExitStack() as stack:
            files = dict(stack.enter_context(self.clouds.open_files(ids))) if ids else {}
            if scene.file is not None and scene.file.startswith(BUILT):
                files[scene.file] = stack.enter_context(self.scenes.open_file(scene.file))
            yield replace(with_robot, scene=_insert_paths(scene, files)) if files else with_robot


def kind_of(request: PlanRequest) -> str:
    """Return the kind of a request, as budgets and metrics name it."""
    if request.goal is not None:
        goal = request.goal
        return "joint_goal" if goal.joints else "pose_goal" if goal.poses else "posture"
    names = ("valve", "door", "mechanism", "contacts", "egress", "trajopt")
    return next((name for name in names if getattr(request.task, name) is not None), "unknown")


def list_files(scene: SceneRequest) -> tuple[str, ...]:
    """List the clouds, meshes and the scene file of a scene, as the request names them."""
    meshes = (obstacle.file for obstacle in scene.obstacles if isinstance(obstacle, MeshRequest))
    return (*(cloud.file for cloud in scene.cloud_files), *meshes, *(() if scene.file is None else (scene.file,)))


def select_uploads(names: Iterable[str]) -> tuple[str, ...]:
    """Select the names that are ids of uploads."""
    return tuple(name for name in names if name.startswith(UPLOADED))


def _insert_paths(scene: SceneRequest, files: Mapping[str, Path]) -> SceneRequest:
    def path_of(name: str) -> str:
        return str(files.get(name, name))

    file = None if scene.file is None else path_of(scene.file)
    obstacles = tuple(
        replace(obstacle, file=path_of(obstacle.file)) if isinstance(obstacle, MeshRequest) else obstacle
        for obstacle in scene.obstacles
    )
    cloud = scene.cloud
    if isinstance(cloud, str):
        cloud = path_of(cloud)
    elif cloud is not None:
        cloud = tuple(replace(part, file=path_of(part.file)) for part in cloud)
    return replace(scene, obstacles=obstacles, cloud=cloud, file=file)


def _take_parts(own: RobotRequest, asked: RobotRequest) -> RobotRequest:
    """Return a robot of the server with what a request says about it."""
    return replace(own, root=asked.root, contacts=asked.contacts, hands=asked.hands)
