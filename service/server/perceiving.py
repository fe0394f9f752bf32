"""BuildScene, GetScene and Detect."""

from __future__ import annotations

import asyncio
import math
import re
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

from service.errors import RequestError
from service.proto.planner.v1.planner_pb2 import (
    BuildSceneRequest,
    BuildSceneResponse,
    CloudsSpec,
    DetectRequest,
    DetectResponse,
    GetSceneRequest,
    GetSceneResponse,
)
from service.request.file import parse_scene, parse_start
from service.request.scene import SceneRequest
from service.request.schema import RobotRequest
from service.scan.cloud import CloudInput
from service.server.asked import uploaded
from service.server.cloud_problems import Kept, as_sent, robot_problems, start_problems
from service.server.disk import Disk
from service.server.known import KnownThings, kept_files, said_settings
from service.server.refusal import invalid
from service.server.robots import RobotFolder
from service.server.settings import SMALL_BYTES, ServerSettings
from service.server.workshop import Workshop, outcome
from service.store import CloudStore, Store
from service.trust import AllowedFolders, current_caller
from service.trust.rpc import Context, deadline_of
from service.wire.perceived import detections_to_messages, scene_to_message
from service.wire.plain import to_plain
from service.wire.violations import violation
from service.work.look import SceneTask, build_scene, detect
from service.work.plan import Refused

T = TypeVar("T")
M = TypeVar("M", BuildSceneRequest, BuildSceneRequest | DetectRequest)
MAX_REACH_M = 50.0
DEFAULT_REACH_M = 4.0
BESIDE_CLOUDS = ("hint", "unknown", "method")  # fields of a message that a request's scene has, too


class Perceiving:
    """Answers the methods about clouds.

    Args:
        settings: of the server.
        folders: that requests may name files in.
        workshop: where clouds are looked at.
        store: where scenes are kept; clouds: where clouds are; disk: both are on.
        robots: that this server knows besides those of the package.
    """

    def __init__(
        self,
        settings: ServerSettings,
        folders: AllowedFolders,
        workshop: Workshop,
        store: Store,
        clouds: CloudStore,
        disk: Disk,
        robots: RobotFolder,
    ) -> None:
        self._settings = settings
        self._folders = folders
        self._workshop = workshop
        self._store = store
        self._clouds = clouds
        self._disk = disk
        self._robots = robots
        self._things = KnownThings(folders, clouds, store.scenes)

    async def build_scene(self, message: BuildSceneRequest, context: Context) -> AsyncIterator[BuildSceneResponse]:
        """Pieces, floor and objects of clouds.

        Raises:
            Refusal: they cannot be had.
        """
        scene = await self._checked(message)
        known = await _aside(message, self._things.asked)
        self._disk.check()
        steps: asyncio.Queue[str | None] = asyncio.Queue()
        with self._placed(message.clouds, scene) as clouds, self._things.found(known) as found:
            task = SceneTask(
                clouds,
                tuple(message.detect),
                scene.hint,
                scene.unknown,
                scene.method,
                tuple((one, found[one.file]) for one in known.meshes),
                None if known.update is None else (found[known.update], known.update),
                said_settings(message),
            )
            piece = self._workshop.start(
                "scene",
                build_scene,
                task,
                deadline=deadline_of(context),
                budget_s=self._settings.budget_s("scene"),
                on_event=steps.put_nowait,
            )
            piece.ended.add_done_callback(lambda _: steps.put_nowait(None))
            try:
                while (step := await steps.get()) is not None:
                    yield BuildSceneResponse(step=step)
                text = self._seen(await outcome(piece), clouds, scene, kept_files(known, found))
            finally:
                piece.cancel()
        scene_id = await asyncio.to_thread(self._store.scenes.put, current_caller().name, text)
        yield BuildSceneResponse(scene=scene_to_message(scene_id, text))

    async def scene(self, message: GetSceneRequest, context: Context) -> GetSceneResponse:
        """A scene that was built before.

        Raises:
            Refusal: no id was given; NotStoredError: it is not there.
        """
        if not message.scene_id:
            raise invalid(["scene_id: is missing"])
        text = await asyncio.to_thread(self._store.scenes.get, message.scene_id)
        return GetSceneResponse(scene=await asyncio.to_thread(scene_to_message, message.scene_id, text))

    async def detect(self, message: DetectRequest, context: Context) -> DetectResponse:
        """Objects of a kind.

        Raises:
            Refusal: they cannot be looked for.
        """
        scene = await self._checked(message)
        with self._placed(message.clouds, scene) as clouds:
            answer = await self._workshop.run(
                "detect",
                detect,
                clouds,
                message.kind,
                scene.hint,
                deadline=deadline_of(context),
                budget_s=self._settings.budget_s("detect"),
            )
            found = self._seen(answer, clouds, scene)
        return DetectResponse(hits=detections_to_messages(found["hits"]), notes=found["notes"])

    async def _checked(self, message: BuildSceneRequest | DetectRequest) -> SceneRequest:
        return await _aside(message, self._scene)

    def _scene(self, message: BuildSceneRequest | DetectRequest) -> SceneRequest:
        """What is asked of clouds, held to the rules of a request's scene.

        Raises:
            Refusal: INVALID_ARGUMENT, naming every field.
        """
        given = message.clouds
        plain = to_plain(message)
        clouds = plain.get("clouds", {})
        data = {key: clouds[key] for key in ("unit", "apply_viewpoint", "sensor", "topic", "message") if key in clouds}
        data |= {key: plain[key] for key in BESIDE_CLOUDS if key in plain}
        problems = [] if clouds.get("clouds") else ["clouds: at least one is needed"]
        reach = given.reach_m if given.HasField("reach_m") else DEFAULT_REACH_M
        if not 0.1 <= reach <= MAX_REACH_M:
            problems.append(f"reach_m: 0.1 to {MAX_REACH_M:g} would do, got {reach:g}")
        bottom, top = _heights(given)
        if not -math.inf < bottom < top < math.inf:
            problems.append(f"top_m: a height above bottom_m, {bottom:g}, would do, got {top:g}")
        problems += robot_problems(clouds.get("robot"))
        problems += start_problems(clouds.get("start", {}))
        try:
            scene = parse_scene({**data, "cloud": clouds.get("clouds") or None})
        except RequestError as error:
            raise invalid(map(_of_message, (*problems, *error.problems))) from None
        problems += [f"{field.removeprefix('scene.')}: {words}" for field, words in self._folders.scene_problems(scene)]
        if problems:
            raise invalid(map(_of_message, problems))
        return scene

    @contextmanager
    def _placed(self, given: CloudsSpec, scene: SceneRequest) -> Iterator[CloudInput]:
        """The clouds where they are kept, which they are while the body runs."""
        named = scene.cloud_files
        with self._clouds.using(uploaded(one.file for one in named)) as files:
            yield CloudInput(
                files=tuple(Path(files.get(one.file, one.file)) for one in named),
                unit=scene.unit,
                transforms=tuple(_numbers(one.position, one.quaternion_wxyz) for one in named),
                apply_viewpoint=scene.apply_viewpoint,
                sensor=scene.sensor,
                topic=scene.topic,
                message=scene.message,
                reach_m=given.reach_m if given.HasField("reach_m") else DEFAULT_REACH_M,
                top_m=_heights(given)[1],
                bottom_m=_heights(given)[0],
                robot=self._robot(given.robot) if given.HasField("robot") else None,
                start=parse_start(to_plain(given.start)) if given.HasField("start") else None,
                seed=given.seed,
            )

    def _seen(self, answer: T | Refused, clouds: CloudInput, scene: SceneRequest, more: Sequence[Kept] = ()) -> T:
        """A worker's answer about clouds.

        Raises:
            Refusal: it cannot be had of them.
        """
        if isinstance(answer, Refused):
            named = zip(scene.cloud_files, clouds.files, strict=True)
            files = [Kept(f"clouds.clouds[{k}].file", one.file, path) for k, (one, path) in enumerate(named)]
            problems = as_sent(answer.problems, [*files, *more])
            raise invalid(self._robots.as_named(problems))
        return answer

    def _robot(self, name: str) -> RobotRequest:
        return self._robots.own(name) or RobotRequest(name=name)


def _of_message(problem: str) -> str:
    """A problem of a scene, beginning with the field of the message that it speaks of."""
    field = violation(problem).field
    if re.split(r"[.\[]", field, maxsplit=1)[0] in BESIDE_CLOUDS:
        return problem
    return f"clouds.{re.sub(r'^cloud(?=[:[])', 'clouds', problem)}" if field else f"clouds: {problem}"


async def _aside(message: M, check: Callable[[M], T]) -> T:
    """What a message says, read off the event loop where it is large."""
    return check(message) if message.ByteSize() <= SMALL_BYTES else await asyncio.to_thread(check, message)


def _heights(given: CloudsSpec) -> tuple[float, float]:
    """Between which points are kept [m]."""
    return (
        given.bottom_m if given.HasField("bottom_m") else CloudInput.bottom_m,
        given.top_m if given.HasField("top_m") else CloudInput.top_m,
    )


def accepted(answer: T | Refused) -> T:
    """A worker's answer.

    Raises:
        Refusal: it cannot be had of what was given.
    """
    if isinstance(answer, Refused):
        raise invalid(answer.problems)
    return answer


def _numbers(*groups: Sequence[float]) -> str:
    return " ".join(repr(number) for group in groups for number in group)
