"""A request as a server takes it: checked by the one validator, within the folders and limits of this server."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from service.errors import RequestError
from service.proto.planner.v1.request_pb2 import MotionRequest
from service.request.scene import MeshRequest, SceneRequest
from service.request.schema import PlanRequest, check_task_has_planner
from service.server.refusal import invalid, refusal_of
from service.server.robots import RobotFolder
from service.server.settings import ServerSettings
from service.store import CloudStore
from service.store.scenes import Scenes
from service.trust import AllowedFolders
from service.trust.folders import BUILT, UPLOADED
from service.wire.requests import request_from_message

WITHIN = "request"  # the field of PlanRequest that holds what the validator speaks of


@dataclass(frozen=True)
class Door:
    """What every request must pass.

    Attributes:
        settings: of the server.
        folders: that requests may name files in.
        clouds: that were uploaded; scenes: that were built.
        robots: that this server knows besides those of the package.
    """

    settings: ServerSettings
    folders: AllowedFolders
    clouds: CloudStore
    scenes: Scenes
    robots: RobotFolder

    def request(self, message: MotionRequest) -> PlanRequest:
        """The request a message says.

        Raises:
            Refusal: INVALID_ARGUMENT naming every field that is wrong, or UNIMPLEMENTED.
        """
        try:
            request = request_from_message(message)
            check_task_has_planner(request)
        except RequestError as error:
            raise refusal_of(error, WITHIN) from None
        problems = [f"{field}: {words}" for field, words in self.folders.problems(request)]
        budget = self.settings.budget_s(kind_of(request))
        if request.options.time_limit_s > budget:
            problems.append(
                f"options.time_limit_s: at most {budget:g} would do on this server, "
                f"got {request.options.time_limit_s:g}"
            )
        if problems:
            raise invalid(problems, WITHIN)
        return request

    @contextmanager
    def placed(self, request: PlanRequest) -> Iterator[PlanRequest]:
        """The request with the files of uploads, built scenes and this server's own robots, which stay for the body.

        Raises:
            NotStoredError: one of them has gone meanwhile.
        """
        named = self.robots.placed(request)
        scene = request.scene
        ids = uploaded(named_files(scene))
        with ExitStack() as held:
            files = dict(held.enter_context(self.clouds.using(ids))) if ids else {}
            if scene.file is not None and scene.file.startswith(BUILT):
                files[scene.file] = held.enter_context(self.scenes.as_file(scene.file))
            yield replace(named, scene=_placed(scene, files)) if files else named


def kind_of(request: PlanRequest) -> str:
    """What is asked for, in one word."""
    if request.goal is not None:
        goal = request.goal
        return "joint_goal" if goal.joints else "pose_goal" if goal.poses else "posture"
    names = ("valve", "door", "egress", "trajopt")
    return next((name for name in names if getattr(request.task, name) is not None), "unknown")


def named_files(scene: SceneRequest) -> tuple[str, ...]:
    """The clouds and meshes of a scene, and the file of one that was made already, as they are named."""
    meshes = (one.file for one in scene.obstacles if isinstance(one, MeshRequest))
    return (*(one.file for one in scene.cloud_files), *meshes, *(() if scene.file is None else (scene.file,)))


def uploaded(names: Iterable[str]) -> tuple[str, ...]:
    """Those names that are ids of what was uploaded."""
    return tuple(name for name in names if name.startswith(UPLOADED))


def _placed(scene: SceneRequest, files: Mapping[str, Path]) -> SceneRequest:
    def place(name: str) -> str:
        return str(files.get(name, name))

    file = None if scene.file is None else place(scene.file)
    obstacles = tuple(
        replace(one, file=place(one.file)) if isinstance(one, MeshRequest) else one for one in scene.obstacles
    )
    scene = replace(scene, obstacles=obstacles)
    if scene.cloud is None or isinstance(scene.cloud, str):
        return replace(scene, cloud=None if scene.cloud is None else place(scene.cloud), file=file)
    return replace(scene, cloud=tuple(replace(one, file=place(one.file)) for one in scene.cloud), file=file)
