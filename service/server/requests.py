"""Requests of clients as this server accepts them: validated, within its folders, robots and time budgets; warnings."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, replace
from pathlib import Path

from service.errors import RequestError
from service.proto.planner.v1.request_pb2 import MotionRequest
from service.request.file import list_mesh_files, parse_request, replace_mesh_files
from service.request.schema import PlanRequest
from service.server.refusals import refuse_invalid
from service.server.robots import KnownRobots, RobotFolder
from service.server.settings import ServerSettings
from service.store import CloudStore, Scenes
from service.trust import BUILT, UPLOADED, AllowedFolders
from service.wire.plain import to_plain

_WARNINGS: ContextVar[tuple[str, ...]] = ContextVar("warnings", default=())  # about the message of a call
WITHIN = "request"  # the field of the wire's PlanRequest that the validator's paths start from


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

    def read(self, message: MotionRequest, within: str = WITHIN) -> PlanRequest:
        """Read and check a message, the field ``within`` of the one that was sent.

        Raises:
            Refusal: INVALID_ARGUMENT naming every wrong field.
        """
        data = to_plain(message)
        names = self.known.find_problems(data)
        try:
            request = parse_request(data)
        except RequestError as error:
            raise refuse_invalid([*error.problems, *names], within) from None
        problems = [f"{field}: {problem}" for field, problem in self.folders.find_problems(request)]
        budget = self.settings.budget_s(kind_of(request))
        limit = request.limit_s
        if limit > budget:
            problems.append(f"options.time_limit_s: expected at most {budget:g} on this server, got {limit:g}")
        problems += names
        if problems:
            raise refuse_invalid(problems, within)
        return request

    @contextmanager
    def open_files(self, request: PlanRequest) -> Iterator[PlanRequest]:
        """Yield the request with paths of uploads, built scenes and own robots, which stay readable for the body.

        Raises:
            NotStoredError: a file has been deleted since the request was read.
        """
        with_robot = self.robots.insert_files(request)
        scene = request.scene
        ids = select_uploads(list_files(request))
        with ExitStack() as stack:
            files = dict(stack.enter_context(self.clouds.open_files(ids))) if ids else {}
            if scene.file is not None and scene.file.startswith(BUILT):
                files[scene.file] = stack.enter_context(self.scenes.open_file(scene.file))
            yield _insert_paths(with_robot, files) if files else with_robot


def set_warnings(warnings: tuple[str, ...]) -> None:
    """Set the warnings of the call that this task answers."""
    _WARNINGS.set(warnings)


def current_warnings() -> tuple[str, ...]:
    """Return the warnings of the call that this task answers."""
    return _WARNINGS.get()


def kind_of(request: PlanRequest) -> str:
    """Return the kind of a request, as budgets and metrics name it."""
    return request.section.variant or request.kind.name


def list_files(request: PlanRequest) -> tuple[str, ...]:
    """List the clouds, meshes and the scene file of a request, as it names them."""
    scene, meshes = request.scene, (file for _, file in list_mesh_files(request))
    return (*(cloud.file for cloud in scene.cloud_files), *meshes, *(() if scene.file is None else (scene.file,)))


def select_uploads(names: Iterable[str]) -> tuple[str, ...]:
    """Select the names that are ids of uploads."""
    return tuple(name for name in names if name.startswith(UPLOADED))


def _insert_paths(request: PlanRequest, files: Mapping[str, Path]) -> PlanRequest:
    def path_of(name: str) -> str:
        return str(files.get(name, name))

    scene = request.scene
    cloud = scene.cloud
    if isinstance(cloud, str):
        cloud = path_of(cloud)
    elif cloud is not None:
        cloud = tuple(replace(part, file=path_of(part.file)) for part in cloud)
    file = None if scene.file is None else path_of(scene.file)
    return replace_mesh_files(replace(request, scene=replace(scene, cloud=cloud, file=file)), path_of)
