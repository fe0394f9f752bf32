"""A request as a server takes it: checked by the one validator, within the folders and limits of this server."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from service.planned import check_planned
from service.proto.planner.v1.request_pb2 import MotionRequest
from service.request import PlanRequest
from service.request_scene import SceneRequest
from service.server.refusal import invalid
from service.server.settings import ServerSettings
from service.store import CloudStore
from service.trust import AllowedFolders
from service.trust.folders import UPLOADED
from service.wire.requests import request_from_message
from service.wire.unknown import unknown_fields

WITHIN = "request"  # the field of PlanRequest that holds what the validator speaks of


@dataclass(frozen=True)
class Door:
    """What every request must pass.

    Attributes:
        settings: of the server.
        folders: that requests may name files in.
    """

    settings: ServerSettings
    folders: AllowedFolders

    def request(self, message: MotionRequest) -> PlanRequest:
        """The request a message says.

        Raises:
            Refusal: INVALID_ARGUMENT naming every field that is wrong, or UNIMPLEMENTED.
        """
        unknown = list(unknown_fields(message))
        if unknown:
            raise invalid(unknown, WITHIN)
        request = request_from_message(message)
        check_planned(request)
        problems = [f"{field}: {words}" for field, words in self.folders.problems(request)]
        budget = self.settings.budget_s(kind_of(request))
        if request.options.time_limit_s > budget:
            problems.append(
                f"options.time_limit_s: at most {budget:g} would do on this server, "
                f"got {request.options.time_limit_s:g}"
            )
        if problems:
            raise invalid(problems, WITHIN)
        return self._named(request)

    def _named(self, request: PlanRequest) -> PlanRequest:
        """The request with the files of a robot that this server knows by name."""
        return request


def kind_of(request: PlanRequest) -> str:
    """What is asked for, in one word."""
    if request.goal is not None:
        goal = request.goal
        return "joint_goal" if goal.joints else "pose_goal" if goal.poses else "posture"
    names = ("valve", "door", "egress", "trajopt")
    return next((name for name in names if getattr(request.task, name) is not None), "unknown")


def cloud_ids(request: PlanRequest) -> tuple[str, ...]:
    """Uploaded clouds that a request names."""
    return tuple(one.file for one in request.scene.cloud_files if one.file.startswith(UPLOADED))


@contextmanager
def with_clouds(request: PlanRequest, store: CloudStore) -> Iterator[PlanRequest]:
    """The request with the files of uploaded clouds, which stay while the body runs."""
    ids = cloud_ids(request)
    if not ids:
        yield request
        return
    with store.using(ids) as files:
        yield replace(request, scene=_placed(request.scene, files))


def _placed(scene: SceneRequest, files: Mapping[str, Path]) -> SceneRequest:
    if isinstance(scene.cloud, str):
        return replace(scene, cloud=str(files.get(scene.cloud, scene.cloud)))
    clouds = tuple(replace(one, file=str(files.get(one.file, one.file))) for one in scene.cloud_files)
    return replace(scene, cloud=clouds)
