"""BuildScene, GetScene and Detect."""

from __future__ import annotations

import asyncio
import math
import re
from collections.abc import AsyncIterator, Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

from service.errors import RequestError
from service.executor import Place
from service.proto.planner.v1.planner_pb2 import (
    BuildSceneRequest,
    BuildSceneResponse,
    CloudsSpec,
    DetectRequest,
    DetectResponse,
    GetSceneRequest,
    GetSceneResponse,
)
from service.request.file import parse_section
from service.request.scene import KnownMeshRequest, SceneRequest
from service.request.schema import RobotRequest, StartRequest
from service.scan.cloud import DEFAULT_REACH_M, CloudInput
from service.server.cloud_requests import (
    KnownReader,
    NamedFile,
    check_robot,
    check_start,
    list_known_files,
    list_settings,
    rename_fields,
)
from service.server.disk import DiskWatch
from service.server.jobs import JobRunner, await_result
from service.server.refusals import discard_uploads, refuse_invalid
from service.server.requests import RequestReader, select_uploads
from service.server.settings import SMALL_BYTES
from service.store import Store
from service.trust import current_caller
from service.trust.rpc import Context, deadline_of
from service.wire.plain import to_plain
from service.wire.scenes import detections_to_messages, scene_to_message
from service.wire.violations import make_violation
from service.work.look import DetectTask, KnownFiles, SceneTask, build_scene, detect
from service.work.plan import Refused

T = TypeVar("T")
M = TypeVar("M", BuildSceneRequest, BuildSceneRequest | DetectRequest)
MIN_REACH_M, MAX_REACH_M = 0.1, 50.0
SCENE_FIELDS = ("hint", "unknown", "method")  # fields of a message that the scene of a request has, too
CLOUD_FIELDS = (
    "unit",
    "apply_viewpoint",
    "sensor",
    "level",
    "sensor_model",
    "sensor_sigma",
    "topic",
    "message",
)  # of ``clouds`` that it has, too


class CloudHandlers:
    """Handlers of ``BuildScene``, ``GetScene`` and ``Detect``.

    Args:
        reader: reader of requests, with the server's settings, folders, uploads and robots.
        jobs: runner of perception.
        store: store of the scenes.
        disk: watch on the store's disk.
    """

    def __init__(self, reader: RequestReader, jobs: JobRunner, store: Store, disk: DiskWatch) -> None:
        self._settings = reader.settings
        self._folders = reader.folders
        self._clouds = reader.clouds
        self._robots = reader.robots
        self._jobs = jobs
        self._store = store
        self._disk = disk
        self._known = KnownReader(reader.folders, reader.clouds, store.scenes)

    async def build_scene(self, message: BuildSceneRequest, context: Context) -> AsyncIterator[BuildSceneResponse]:
        """Yield the steps of perception, then the stored scene.

        Raises:
            Refusal: the clouds make no scene.
        """
        scene = await _read_aside(message, self._read_scene)
        known = await _read_aside(message, self._known.read)
        self._disk.require_space()
        steps: asyncio.Queue[str | None] = asyncio.Queue()
        with self._open_clouds(message.clouds, scene) as clouds, self._known.open_files(known) as paths:
            task = SceneTask(
                clouds,
                tuple(message.detect),
                scene.hint,
                scene.unknown,
                scene.method,
                _with_paths(known.meshes, paths),
                None if known.update is None else (paths[known.update], known.update),
                list_settings(message),
            )
            handle = self._jobs.start(
                "scene",
                build_scene,
                task,
                deadline=deadline_of(context),
                budget_s=self._settings.budget_s("scene"),
                on_event=steps.put_nowait,
                place=Place(current_caller().owner),
            )
            handle.ended.add_done_callback(lambda _: steps.put_nowait(None))
            try:
                while (step := await steps.get()) is not None:
                    yield BuildSceneResponse(step=step)
                text = self._accept(await await_result(handle), clouds, scene, list_known_files(known, paths))
            finally:
                handle.cancel()
        scene_id = await asyncio.to_thread(self._store.scenes.put, current_caller().name, text)
        yield BuildSceneResponse(scene=scene_to_message(scene_id, text))

    async def get_scene(self, message: GetSceneRequest, context: Context) -> GetSceneResponse:
        """Return a scene that was built before.

        Raises:
            Refusal: no id was given.
            NotStoredError: there is no such scene.
        """
        if not message.scene_id:
            raise refuse_invalid(["scene_id: is missing"])
        text = await asyncio.to_thread(self._store.scenes.get, message.scene_id)
        return GetSceneResponse(scene=await asyncio.to_thread(scene_to_message, message.scene_id, text))

    async def detect(self, message: DetectRequest, context: Context) -> DetectResponse:
        """Detect objects of one kind, or given objects.

        Raises:
            Refusal: the clouds cannot be searched.
        """
        scene = await _read_aside(message, self._read_scene)
        known = await _read_aside(message, self._known.read)
        with self._open_clouds(message.clouds, scene) as clouds, self._known.open_files(known) as paths:
            answer = await self._jobs.run(
                "detect",
                detect,
                DetectTask(clouds, message.kind, scene.hint, _with_paths(known.objects, paths)),
                deadline=deadline_of(context),
                budget_s=self._settings.budget_s("detect"),
                place=Place(current_caller().owner),
            )
            result = self._accept(answer, clouds, scene, list_known_files(known, paths))
        return DetectResponse(hits=detections_to_messages(result["hits"]), notes=result["notes"])

    def _read_scene(self, message: BuildSceneRequest | DetectRequest) -> SceneRequest:
        """Read and check the clouds of a message by the rules of a request's scene.

        Raises:
            Refusal: INVALID_ARGUMENT naming every wrong field.
        """
        plain = to_plain(message)
        clouds = plain.get("clouds", {})
        data = {key: clouds[key] for key in CLOUD_FIELDS if key in clouds}
        data |= {key: plain[key] for key in SCENE_FIELDS if key in plain}
        problems = [] if clouds.get("clouds") else ["clouds: expected at least one"]
        reach = _reach_m(message.clouds)
        if not MIN_REACH_M <= reach <= MAX_REACH_M:
            problems.append(f"reach_m: expected {MIN_REACH_M:g} to {MAX_REACH_M:g}, got {reach:g}")
        bottom, top = _heights_m(message.clouds)
        if not -math.inf < bottom < top < math.inf:
            problems.append(f"top_m: expected a height above bottom_m, which is {bottom:g}, got {top:g}")
        problems += check_robot(clouds.get("robot"))
        problems += check_start(clouds.get("start", {}))
        try:
            scene = parse_section(SceneRequest, {**data, "cloud": clouds.get("clouds") or None})
        except RequestError as error:
            raise refuse_invalid(map(_to_message_field, (*problems, *error.problems))) from None
        for field, problem in self._folders.find_scene_problems(scene):
            problems.append(f"{field.removeprefix('scene.')}: {problem}")
        if problems:
            raise refuse_invalid(map(_to_message_field, problems))
        return scene

    @contextmanager
    def _open_clouds(self, given: CloudsSpec, scene: SceneRequest) -> Iterator[CloudInput]:
        """Yield the clouds with paths on the server, which stay readable for the body."""
        files = scene.cloud_files
        bottom, top = _heights_m(given)
        with self._clouds.open_files(select_uploads(file.file for file in files)) as paths:
            yield CloudInput(
                files=tuple(Path(paths.get(file.file, file.file)) for file in files),
                unit=scene.unit,
                transforms=tuple(_join_numbers(file.position, file.quaternion_wxyz) for file in files),
                apply_viewpoint=scene.apply_viewpoint,
                sensor=scene.sensor,
                level=scene.level,
                sensor_model=scene.sensor_model,
                sensor_sigma=scene.sensor_sigma,
                topic=scene.topic,
                message=scene.message,
                reach_m=_reach_m(given),
                top_m=top,
                bottom_m=bottom,
                robot=self._robot(given.robot) if given.HasField("robot") else None,
                start=parse_section(StartRequest, to_plain(given.start)) if given.HasField("start") else None,
                seed=given.seed,
            )

    def _accept(
        self, answer: T | Refused, clouds: CloudInput, scene: SceneRequest, more: Sequence[NamedFile] = ()
    ) -> T:
        """Return a worker's answer.

        Raises:
            Refusal: the worker refused the clouds.
        """
        if isinstance(answer, Refused):
            if answer.damaged:
                raise discard_uploads(self._clouds, answer.damaged)
            pairs = zip(scene.cloud_files, clouds.files, strict=True)
            files = [NamedFile(f"clouds.clouds[{k}].file", cloud.file, path) for k, (cloud, path) in enumerate(pairs)]
            problems = rename_fields(answer.problems, [*files, *more])
            raise refuse_invalid(self._robots.hide_paths(problems))
        return answer

    def _robot(self, name: str) -> RobotRequest:
        return self._robots.get(name) or RobotRequest(name=name)


async def _read_aside(message: M, read: Callable[[M], T]) -> T:
    """Read a message, a large one in a thread beside the event loop."""
    return read(message) if message.ByteSize() <= SMALL_BYTES else await asyncio.to_thread(read, message)


def _with_paths(known: Sequence[KnownMeshRequest], paths: Mapping[str, Path]) -> KnownFiles:
    """Return known objects with the paths of their files on the server."""
    return tuple((mesh, None if mesh.file is None else paths[mesh.file]) for mesh in known)


def _to_message_field(problem: str) -> str:
    """Begin a problem of a scene with the field of the message."""
    field = make_violation(problem).field
    if re.split(r"[.\[]", field, maxsplit=1)[0] in SCENE_FIELDS:
        return problem
    return f"clouds.{re.sub(r'^cloud(?=[:[])', 'clouds', problem)}" if field else f"clouds: {problem}"


def _reach_m(given: CloudsSpec) -> float:
    return given.reach_m if given.HasField("reach_m") else DEFAULT_REACH_M


def _heights_m(given: CloudsSpec) -> tuple[float, float]:
    """Return the lowest and the highest point that is used."""
    return (
        given.bottom_m if given.HasField("bottom_m") else CloudInput.bottom_m,
        given.top_m if given.HasField("top_m") else CloudInput.top_m,
    )


def _join_numbers(*groups: Sequence[float]) -> str:
    return " ".join(repr(number) for group in groups for number in group)
