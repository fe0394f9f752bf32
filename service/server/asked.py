"""A request as a server takes it: checked by the one validator, within the folders and limits of this server."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from service.errors import RequestError
from service.planned import check_planned
from service.proto.planner.v1.request_pb2 import MotionRequest
from service.request import PlanRequest
from service.request_scene import CloudFileRequest, SceneRequest
from service.server.refusal import invalid, refusal_of
from service.server.robots import RobotFolder
from service.server.settings import ServerSettings
from service.store import CloudStore
from service.trust import AllowedFolders
from service.trust.folders import UPLOADED
from service.wire.requests import request_from_message

WITHIN = "request"  # the field of PlanRequest that holds what the validator speaks of


@dataclass(frozen=True)
class Door:
    """What every request must pass.

    Attributes:
        settings: of the server.
        folders: that requests may name files in.
        clouds: that were uploaded.
        robots: that this server knows besides those of the package.
    """

    settings: ServerSettings
    folders: AllowedFolders
    clouds: CloudStore
    robots: RobotFolder

    def request(self, message: MotionRequest) -> PlanRequest:
        """The request a message says.

        Raises:
            Refusal: INVALID_ARGUMENT naming every field that is wrong, or UNIMPLEMENTED.
        """
        try:
            request = request_from_message(message)
            check_planned(request)
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
        """The request with the files of uploaded clouds and of this server's own robots, which stay for the body.

        Raises:
            NotStoredError: a cloud has gone meanwhile.
        """
        named = self.robots.placed(request)
        ids = uploaded(request.scene.cloud_files)
        if not ids:
            yield named
            return
        with self.clouds.using(ids) as files:
            yield replace(named, scene=_placed(request.scene, files))


def kind_of(request: PlanRequest) -> str:
    """What is asked for, in one word."""
    if request.goal is not None:
        goal = request.goal
        return "joint_goal" if goal.joints else "pose_goal" if goal.poses else "posture"
    names = ("valve", "door", "egress", "trajopt")
    return next((name for name in names if getattr(request.task, name) is not None), "unknown")


def uploaded(clouds: Iterable[CloudFileRequest]) -> tuple[str, ...]:
    """The ids of those clouds that were uploaded."""
    return tuple(one.file for one in clouds if one.file.startswith(UPLOADED))


def _placed(scene: SceneRequest, files: Mapping[str, Path]) -> SceneRequest:
    if isinstance(scene.cloud, str):
        return replace(scene, cloud=str(files.get(scene.cloud, scene.cloud)))
    clouds = tuple(replace(one, file=str(files.get(one.file, one.file))) for one in scene.cloud_files)
    return replace(scene, cloud=clouds)
