"""PoseSession: events of an operator in, poses out; the newest drag wins."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import AsyncIterator, Callable
from contextlib import suppress

from service.errors import RequestError
from service.executor import Lane, Place
from service.posing.drag import LedPose
from service.posing.history import PoseHistory
from service.proto.planner.v1 import pose_pb2 as wire
from service.proto.planner.v1.request_pb2 import MotionRequest
from service.request.file import parse_section
from service.request.schema import StartRequest
from service.server.jobs import JobRunner
from service.server.refusals import discard_uploads, refuse_invalid
from service.server.requests import RequestReader, current_warnings, list_files
from service.trust import current_caller
from service.trust.rpc import Context, deadline_of
from service.wire.plain import to_plain
from service.wire.poses import drawing_to_message, pose_to_message, read_drag
from service.work.plan import Refused
from service.work.pose import LeadTask, OpenedPoses, check_pose, lead_pose, open_poses

MOST_REFUSAL = 400  # characters: an answer has at most 1 kB
MOST_WAITING = 100  # events besides drags, which replace each other
NOTHING_TO_DO = "the operator"  # what a request without goal and task waits for
WITHIN = "open.request"


class PoseHandler:
    """Handler of ``PoseSession``.

    A session has no worker of its own: every event is a short job, with the pose before it, on any worker.

    Args:
        reader: reader of requests.
        jobs: runner of the jobs.
    """

    def __init__(self, reader: RequestReader, jobs: JobRunner) -> None:
        self._reader = reader
        self._jobs = jobs

    async def lead(
        self, messages: AsyncIterator[wire.PoseSessionRequest], context: Context
    ) -> AsyncIterator[wire.PoseSessionResponse]:
        """Yield the first pose, then a pose for every event, until the client ends its stream.

        Raises:
            Refusal: the first message opens no session, or the start is no pose in which the robot stands.
        """
        first = await anext(messages, None)
        if first is None or first.WhichOneof("part") != "open":
            raise refuse_invalid(["open: the first message of a pose session needs it"])
        opened = await self._open(first.open, context)
        session = _Session(self._jobs, opened, self._reader.settings.budget_s("default"))
        notes = (*opened.ground.notes, *current_warnings())
        yield wire.PoseSessionResponse(
            opened=wire.PoseSessionOpened(
                joint_names=opened.joint_names,
                links=opened.handles,
                feet=opened.ground.feet,
                pose=session.describe(0),
                notes=notes,
                drawing=drawing_to_message(opened.drawing) if first.open.with_drawing else None,
            )
        )
        waiting = _WaitingEvents()
        reading = asyncio.create_task(waiting.read(messages))
        try:
            while (event := await waiting.take()) is not None:
                async for pose in session.answer(event):
                    yield wire.PoseSessionResponse(pose=pose)
            await reading  # raises what ended it
        finally:
            reading.cancel()
            with suppress(asyncio.CancelledError):
                await asyncio.wait([reading])

    async def _open(self, message: wire.OpenPoseSession, context: Context) -> OpenedPoses:
        request = self._reader.read(_complete(message.request), WITHIN)
        with self._reader.open_files(request) as local:
            answer = await self._jobs.run(
                "pose session",
                open_poses,
                local,
                list_files(local),
                deadline=deadline_of(context),
                budget_s=self._reader.settings.budget_s("default"),
                place=Place(current_caller().owner),
            )
        if isinstance(answer, Refused):
            if answer.damaged:
                raise discard_uploads(self._reader.clouds, answer.damaged)
            raise refuse_invalid(answer.problems, WITHIN)
        return answer


def _complete(message: MotionRequest) -> MotionRequest:
    """Return a request with something to do: a pose session needs neither goal nor task."""
    if message.HasField("goal") or message.HasField("task"):
        return message
    complete = MotionRequest()
    complete.CopyFrom(message)
    complete.task.steps.add().wait = NOTHING_TO_DO
    return complete


class _Session:
    """The poses of one session.

    Args:
        jobs: runner of the jobs.
        opened: its world and first pose.
        budget_s: time that an event may take [s].
    """

    def __init__(self, jobs: JobRunner, opened: OpenedPoses, budget_s: float) -> None:
        self._jobs = jobs
        self._ground = opened.ground
        self._budget_s = budget_s
        self._place = Place(current_caller().owner, Lane.LIGHT)
        self._history = PoseHistory(opened.pose)

    def describe(self, number: int, pose: LedPose | None = None, refusal: str = "") -> wire.SessionPose:
        """Return the answer to an event: the current pose, or another one."""
        history = self._history
        message = pose_to_message(
            pose or history.pose, number, history.revision, history.undo_steps, history.redo_steps
        )
        message.refusal = refusal
        return message

    async def answer(self, event: wire.PoseEvent) -> AsyncIterator[wire.SessionPose]:
        """Yield the answers to an event: a preview if it asks for one, and the checked pose."""
        try:
            order = event.WhichOneof("order")
            if order == "drag":
                drag = read_drag(event.drag)
                move = self._history.measure_move(drag)
                task = LeadTask(self._ground, self._history.pose.numbers, drag, move)
                if event.with_preview:
                    preview = LeadTask(self._ground, self._history.pose.numbers, drag, move, is_preview=True)
                    yield self.describe(event.number, await self._run(lead_pose, preview))
                self._history.take(drag, await self._run(lead_pose, task), is_last=event.drag.is_last)
            elif order == "undo":
                _require(self._history.undo(), "undo: there is no earlier pose")
            elif order == "redo":
                _require(self._history.redo(), "redo: nothing was undone")
            elif order == "set":
                start = parse_section(StartRequest, to_plain(event.set.pose))
                self._history.set(await self._run(check_pose, self._ground, start))
            else:
                raise RequestError("order: expected drag, undo, redo or set")
        except RequestError as error:
            yield self.describe(event.number, refusal="; ".join(error.problems)[:MOST_REFUSAL])
            return
        yield self.describe(event.number)

    async def _run(self, function: Callable[..., LedPose | Refused], *arguments: object) -> LedPose:
        """Return the pose that a worker finds.

        Raises:
            RequestError: it refuses the event.
        """
        answer = await self._jobs.run(
            "pose", function, *arguments, deadline=None, budget_s=self._budget_s, place=self._place
        )
        if isinstance(answer, Refused):
            raise RequestError(answer.problems)
        return answer


def _require(condition: bool, text: str) -> None:
    if not condition:
        raise RequestError(text)


class _WaitingEvents:
    """Events that were not answered yet; a drag replaces the drag that waits before it."""

    def __init__(self) -> None:
        self._events: deque[wire.PoseEvent] = deque()
        self._changed = asyncio.Event()
        self._has_ended = False

    async def read(self, messages: AsyncIterator[wire.PoseSessionRequest]) -> None:
        """Take over all events of a stream.

        Raises:
            Refusal: a message is no event, or too many wait.
        """
        try:
            async for message in messages:
                if message.WhichOneof("part") != "event":
                    raise refuse_invalid(["event: every message after the first needs one"])
                self._add(message.event)
        finally:
            self._has_ended = True
            self._changed.set()

    def _add(self, event: wire.PoseEvent) -> None:
        last = self._events[-1] if self._events else None
        if last is not None and _is_open_drag(last) and event.WhichOneof("order") == "drag":
            self._events.pop()
        if len(self._events) >= MOST_WAITING:
            raise refuse_invalid([f"event: {MOST_WAITING} events wait for their answers; expected fewer"])
        self._events.append(event)
        self._changed.set()

    async def take(self) -> wire.PoseEvent | None:
        """Return the next event; None once the stream has ended and all are taken."""
        while not self._events and not self._has_ended:
            self._changed.clear()
            await self._changed.wait()
        return self._events.popleft() if self._events else None


def _is_open_drag(event: wire.PoseEvent) -> bool:
    return event.WhichOneof("order") == "drag" and not event.drag.is_last
