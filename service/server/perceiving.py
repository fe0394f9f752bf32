"""UploadCloud, BuildScene and Detect."""

from __future__ import annotations

import asyncio
import math
import re
from collections.abc import AsyncIterator, Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TypeVar

from service.cloud_asked import CloudAsked
from service.errors import RequestError, shown
from service.proto.planner.v1.planner_pb2 import (
    BuildSceneRequest,
    BuildSceneResponse,
    CloudsSpec,
    DetectRequest,
    DetectResponse,
    GetSceneRequest,
    GetSceneResponse,
    UploadCloudRequest,
    UploadCloudResponse,
)
from service.request import RobotRequest
from service.request_file import parse_known, parse_scene, parse_start
from service.request_known import KnownRequest
from service.request_scene import SceneRequest
from service.rpc import Context, deadline_of
from service.server.asked import uploaded
from service.server.cloud_problems import OF_BEFORE, Kept, as_sent, robot_problems, start_problems
from service.server.disk import Disk
from service.server.refusal import invalid, overloaded
from service.server.robots import RobotFolder
from service.server.settings import SMALL_BYTES, ServerSettings
from service.server.workshop import Workshop, outcome
from service.store import UPLOAD_SUFFIXES, CloudStore, Store, TooLargeError, UploadRefusedError
from service.trust import AllowedFolders, current_caller
from service.trust import Limits as ClientLimiter
from service.trust.folders import BUILT, UPLOADED
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
SHA256 = re.compile(r"[0-9a-f]{64}")


class Perceiving:
    """Answers the methods about clouds.

    Args:
        settings: of the server.
        folders: that requests may name files in.
        workshop: where clouds are looked at.
        store: where scenes are kept; clouds: where clouds are; disk: both are on.
        robots: that this server knows besides those of the package.
        limiter: of how much a client may upload.
        on_upload: told the bytes of every cloud that came.
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
        limiter: ClientLimiter,
        on_upload: Callable[[int], None],
    ) -> None:
        self._settings = settings
        self._folders = folders
        self._workshop = workshop
        self._store = store
        self._clouds = clouds
        self._disk = disk
        self._robots = robots
        self._limiter = limiter
        self._on_upload = on_upload

    async def upload(self, requests: AsyncIterator[UploadCloudRequest], context: Context) -> UploadCloudResponse:
        """Take a cloud in; one that is known need not be sent.

        Raises:
            Refusal: it cannot be taken.
        """
        client = current_caller()
        first = await anext(requests, None)
        if first is None or first.WhichOneof("part") != "header":
            raise invalid(["header: the first message of an upload needs one"])
        suffix = "." + first.header.format.removeprefix(".").lower()
        if suffix not in UPLOAD_SUFFIXES:
            formats = ", ".join(one.removeprefix(".") for one in UPLOAD_SUFFIXES)
            raise invalid([f"header.format: {formats} would do, got {shown(first.header.format)}"])
        claimed = first.header.sha256.lower()
        if claimed and not SHA256.fullmatch(claimed):
            raise invalid([f"header.sha256: 64 hexadecimal digits or nothing would do, got {shown(claimed)}"])
        announced, most = first.header.size_bytes, self._clouds.limits.max_cloud_bytes
        if announced > most:
            raise invalid([f"header.size_bytes: at most {most} would do, got {announced}; downsample the cloud first"])
        known = self._clouds.size(f"{UPLOADED}{claimed}{suffix}") if claimed else None
        if known is not None:
            return UploadCloudResponse(cloud_id=f"{UPLOADED}{claimed}{suffix}", size_bytes=known, was_known=True)
        self._disk.check()
        with self._clouds.upload(client.name, suffix) as upload:
            self._count(client.key, announced)
            async for request in requests:
                if request.WhichOneof("part") != "chunk":
                    raise invalid(["chunk: every message after the first needs one"])
                beyond = upload.n_bytes + len(request.chunk) - max(announced, upload.n_bytes)
                self._count(client.key, beyond, upload.n_bytes)
                try:
                    await asyncio.to_thread(upload.write, request.chunk)
                except TooLargeError as error:
                    raise invalid([f"chunk: {error}"]) from None
            size, sha256 = upload.n_bytes, upload.sha256
            if announced and size != announced:
                raise invalid([f"header.size_bytes: {announced} bytes were announced and {size} came"])
            if claimed and sha256 != claimed:
                raise invalid([f"header.sha256: {claimed} was announced, what came has {sha256}"])
            was_known = self._clouds.has(f"{UPLOADED}{sha256}{suffix}")
            cloud_id = await asyncio.to_thread(_kept, upload.finish)
        self._on_upload(size)
        return UploadCloudResponse(cloud_id=cloud_id, size_bytes=size, was_known=was_known)

    def _count(self, client: str, n_bytes: int, begun: int = 0) -> None:
        """Count bytes of a client's upload, what is announced before any of it is sent.

        Raises:
            Refusal: it brings too many, with the time after which all of it would do.
        """
        refusal = self._limiter.upload(client, n_bytes, begun) if n_bytes > 0 else None
        if refusal is not None:
            raise overloaded(refusal.text, refusal.retry_after_s or 0.0)

    async def build_scene(self, message: BuildSceneRequest, context: Context) -> AsyncIterator[BuildSceneResponse]:
        """Pieces, floor and objects of clouds.

        Raises:
            Refusal: they cannot be had.
        """
        scene = await self._checked(message)
        known = await _aside(message, self._known)
        self._disk.check()
        steps: asyncio.Queue[str | None] = asyncio.Queue()
        with self._placed(message.clouds, scene) as clouds, self._found(known) as found:
            task = SceneTask(
                clouds,
                tuple(message.detect),
                scene.hint,
                scene.unknown,
                scene.method,
                tuple((one, found[one.file]) for one in known.meshes),
                None if known.update is None else (found[known.update], known.update),
                _said(message),
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
                text = self._seen(await outcome(piece), clouds, scene, _kept_files(known, found))
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

    def _known(self, message: BuildSceneRequest) -> KnownRequest:
        """Known meshes and the scene to update.

        Raises:
            Refusal: INVALID_ARGUMENT, naming every field.
        """
        plain = to_plain(message)
        try:
            known = parse_known({key: plain[key] for key in ("meshes", "update") if key in plain})
        except RequestError as error:
            raise invalid(error.problems) from None
        refused = {f"meshes[{k}].file": self._folders.refused(one.file, "mesh") for k, one in enumerate(known.meshes)}
        refused["update"] = "" if known.update is None else self._folders.refused(known.update, "scene")
        problems = [f"{field}: {words}" for field, words in refused.items() if words]
        if problems:
            raise invalid(problems)
        return known

    @contextmanager
    def _found(self, known: KnownRequest) -> Iterator[dict[str, Path]]:
        """Where the files of meshes and of the scene to update are, by their names, while the body runs.

        Raises:
            NotStoredError: one of them has gone meanwhile.
        """
        with ExitStack() as held:
            files = {name: Path(name) for name in known.files}
            files |= held.enter_context(self._clouds.using(uploaded(known.files)))
            if known.update is not None and known.update.startswith(BUILT):
                files[known.update] = held.enter_context(self._store.scenes.as_file(known.update))
            yield files

    @contextmanager
    def _placed(self, given: CloudsSpec, scene: SceneRequest) -> Iterator[CloudAsked]:
        """The clouds where they are kept, which they are while the body runs."""
        named = scene.cloud_files
        with self._clouds.using(uploaded(one.file for one in named)) as files:
            yield CloudAsked(
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

    def _seen(self, answer: T | Refused, clouds: CloudAsked, scene: SceneRequest, more: Sequence[Kept] = ()) -> T:
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


def _said(message: BuildSceneRequest) -> dict[str, str]:
    """Settings that a message says itself, and what they are called in it."""
    given = message.clouds
    is_said = {name: given.HasField(name) for name in ("reach_m", "top_m", "bottom_m")}
    is_said |= {"seed": bool(given.seed), "unknown": bool(message.unknown), "method": bool(message.method)}
    return {name: OF_BEFORE[name] for name, is_there in is_said.items() if is_there}


def _kept_files(known: KnownRequest, found: Mapping[str, Path]) -> list[Kept]:
    kept = [Kept(f"meshes[{k}].file", one.file, found[one.file]) for k, one in enumerate(known.meshes)]
    return kept if known.update is None else [*kept, Kept("update", known.update, found[known.update])]


def _heights(given: CloudsSpec) -> tuple[float, float]:
    """Between which points are kept [m]."""
    return (
        given.bottom_m if given.HasField("bottom_m") else CloudAsked.bottom_m,
        given.top_m if given.HasField("top_m") else CloudAsked.top_m,
    )


def accepted(answer: T | Refused) -> T:
    """A worker's answer.

    Raises:
        Refusal: it cannot be had of what was given.
    """
    if isinstance(answer, Refused):
        raise invalid(answer.problems)
    return answer


def _kept(finish: Callable[[], str]) -> str:
    try:
        return finish()
    except UploadRefusedError as error:
        raise invalid([f"chunk: {error}"]) from None


def _numbers(*groups: Sequence[float]) -> str:
    return " ".join(repr(number) for group in groups for number in group)
