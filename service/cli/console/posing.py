"""A pose that the operator leads at the page: a pose session of the server, and what becomes of the pose."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from contextlib import aclosing
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from service.cli.console.scans import upload_scan
from service.client import AsyncPlannerClient, PlannerError
from service.errors import RequestError, ServiceError
from service.proto.planner.v1.pose_pb2 import (
    Drag,
    DragTarget,
    PoseEvent,
    PoseSessionOpened,
    PoseStopKind,
    RedoPose,
    RobotDrawing,
    SessionPose,
    SetPose,
    UndoPose,
)
from service.proto.planner.v1.request_pb2 import Pose, Start
from service.request.file import parse_request, parse_section
from service.request.schema import PlanRequest, StartRequest
from service.request.task_files import list_folders
from service.viewer.payload import pack_hull

LED = {"steps": [{"wait": "the operator"}]}  # task of a request that only says where a pose is led
DRAWN_DIGITS = 4  # of a pose that is drawn: 0.1 mm, 1e-4 rad
SHAPE_DIGITS = 7  # of where shapes are in their joints
NO_SESSION = "there is no pose to lead; open the pose tab first"
OTHER_PAGE = (
    "another page of this session has opened a pose, which ended this one; choose robot or scan to begin anew here"
)


class PoseSeat:
    """The pose that the pages of one session lead.

    Args:
        client: of the operator.
        tell: called with the event ``pose`` for every pose, as pages draw it.

    Attributes:
        number: of the session; events and orders name it, so that a page knows when another page has begun one.
        request: robot, scene and first pose of the session, as plain data; empty without a session.
        opened: what the server said of it.
        pose: the newest checked pose, with all bits.
    """

    def __init__(self, client: AsyncPlannerClient, tell: Callable[[Mapping[str, Any]], None]) -> None:
        self._client = client
        self._tell = tell
        self._events: asyncio.Queue[PoseEvent | None] = asyncio.Queue()
        self.number = 0
        self._n_events = 0
        self._task: asyncio.Task[None] | None = None
        self.request: dict[str, Any] = {}
        self.opened = PoseSessionOpened()
        self.pose = SessionPose()

    async def open(self, request: dict[str, Any]) -> dict[str, Any]:
        """Begin a session in place of the one before, and return what a page draws.

        Args:
            request: robot, start and scene, as plain data.

        Raises:
            RequestError: the request cannot be used.
            PlannerError: the server refuses it.
        """
        parsed = parse_request({**request, "task": LED})
        if self.request:
            self._tell({"event": "pose", "session": self.number, "problem": OTHER_PAGE})
        await self.close()
        self.number += 1
        self._events, self._n_events = asyncio.Queue(), 0
        opened: asyncio.Future[PoseSessionOpened] = asyncio.get_running_loop().create_future()
        self._task = asyncio.create_task(self._follow(parsed, self._events, opened))
        try:
            self.opened = await opened
        except BaseException:
            await self.close()
            raise
        self.request, self.pose = request, self.opened.pose
        return {"session": self.number, **describe_opened(self.opened)}

    def send(self, **event: Any) -> int:
        """Send an event, and return its number; the answer is told to the pages.

        Raises:
            RequestError: no session is open.
        """
        self._require_open()
        self._n_events += 1
        self._events.put_nowait(PoseEvent(number=self._n_events, **event))
        return self._n_events

    def require(self, number: int) -> None:
        """Raise RequestError unless this session is open."""
        self._require_open()
        if number != self.number:
            raise RequestError(f"session: {OTHER_PAGE}")

    def write_state(self) -> dict[str, Any]:
        """Return the pose with all bits, as the start of a request or a state file has it.

        Raises:
            RequestError: no session is open.
        """
        self._require_open()
        return write_state(self.opened.joint_names, self.pose)

    def plan_request(self) -> PlanRequest:
        """Return the request of a motion from the first pose of the session to the present one.

        Raises:
            RequestError: no session is open, or the pose is the first one still.
        """
        self._require_open()
        if self.pose.positions == self.opened.pose.positions and self.pose.base == self.opened.pose.base:
            raise RequestError("pose: is the first one still; drag it to where the robot is to go")
        names = self.opened.joint_names
        goal = {"joints": dict(zip(names, self.pose.positions, strict=True))}
        return parse_request({**self.request, "start": write_state(names, self.opened.pose), "goal": goal})

    def keep(self, name: str) -> Path:
        """Write the pose as a task file of this name, which is a tab then, and return its path.

        Raises:
            RequestError: no session is open, the name cannot be one, or such a file exists.
        """
        self._require_open()
        if not name.replace("_", "").replace("-", "").isalnum():
            raise RequestError(f"name: expected letters, digits, _ and -, got {name!r}")
        path = list_folders()[0] / f"{name}.yaml"
        state = self.write_state()
        joints = dict(zip(state["joint_names"], state["positions"], strict=True))
        text = yaml.safe_dump(
            {
                "help": f"Go to the pose {name}, which was led at the console.",
                "task": {"steps": [{"name": name, "move": {"joints": joints}}]},
            },
            sort_keys=False,
        )
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with path.open("x") as file:
                file.write(text)
        except FileExistsError:
            raise RequestError(f"name: there is a task file {name} already; choose another name") from None
        except OSError as error:
            raise RequestError(f"name: {path} cannot be written: {error.strerror}") from None
        return path

    async def close(self) -> None:
        """End the session."""
        task, self._task = self._task, None
        self.request = {}
        if task is not None:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)

    def _require_open(self) -> None:
        if self._task is None or not self.request:
            raise RequestError(NO_SESSION)

    async def _follow(
        self, request: PlanRequest, events: asyncio.Queue[PoseEvent | None], opened: asyncio.Future[PoseSessionOpened]
    ) -> None:
        try:
            async with aclosing(self._client.pose_session(request, _read(events), with_drawing=True)) as answers:
                async for answer in answers:
                    if answer.WhichOneof("part") == "opened":
                        opened.set_result(answer.opened)
                    else:
                        self._take(answer.pose)
            problem = "the server ended the pose session; open it again"
        except ServiceError as error:
            if not opened.done():
                opened.set_exception(error)
                return
            problem = "; ".join(error.problems) if isinstance(error, PlannerError) else str(error)
        if not opened.done():
            opened.set_exception(RequestError(problem))
        self.request = {}
        self._tell({"event": "pose", "session": self.number, "problem": problem})

    def _take(self, pose: SessionPose) -> None:
        if pose.is_checked:
            self.pose = pose
        self._tell({"event": "pose", "session": self.number, **describe_pose(pose)})


async def _read(events: asyncio.Queue[PoseEvent | None]) -> AsyncIterator[PoseEvent]:
    while (event := await events.get()) is not None:
        yield event


async def make_led_request(
    client: AsyncPlannerClient, scans: Sequence[Path], robot: str, posture: str | None, scan: str | None
) -> dict[str, Any]:
    """Return the request of a pose session: the scene of a scan is built once, and named in all that follows.

    Raises:
        RequestError: there is no such scan.
        PlannerError: the server refuses, or does not answer.
    """
    request: dict[str, Any] = {"robot": {"name": robot}}
    if posture is not None:
        request["start"] = {"posture": posture}
    if scan is not None:
        spec = await upload_scan(client, scans, scan, robot, posture)
        request["scene"] = {"file": (await client.build_scene(spec)).scene_id}
    return request


def make_drag(targets: Sequence[Any], joints: Mapping[str, float], is_last: bool) -> Drag:
    """Return the drag that a page asks for; its targets have ``link``, ``position`` and ``quaternion_wxyz``."""
    return Drag(
        targets=[
            DragTarget(link=target.link, position=target.position, quaternion_wxyz=target.quaternion_wxyz or ())
            for target in targets
        ],
        joints=joints,
        is_last=is_last,
    )


STEPS: Mapping[str, dict[str, Any]] = {"undo": {"undo": UndoPose()}, "redo": {"redo": RedoPose()}}
"""Events without content."""


def make_set(start: Mapping[str, Any]) -> dict[str, Any]:
    """Return the event that sets a pose, given as the start of a request.

    Raises:
        RequestError: it is no start.
    """
    parsed = parse_section(StartRequest, start)
    base = parsed.base
    pose = Start(
        posture=parsed.posture,
        joints=parsed.joints,
        joint_names=parsed.joint_names,
        positions=parsed.positions,
        base=None if base is None else Pose(position=base.position, quaternion_wxyz=base.quaternion_wxyz),
    )
    return {"set": SetPose(pose=pose)}


def write_state(joint_names: Sequence[str], pose: SessionPose) -> dict[str, Any]:
    """Return a pose as the start of a request, with all bits."""
    state: dict[str, Any] = {"joint_names": list(joint_names), "positions": list(pose.positions)}
    if pose.base:
        state["base"] = {"position": list(pose.base[:3]), "quaternion_wxyz": list(pose.base[3:])}
    return state


def describe_pose(pose: SessionPose) -> dict[str, Any]:
    """Return a pose as pages draw it, JSON-ready and below 1 kB for a humanoid; positions are rounded."""
    described = {
        "number": pose.number,
        "revision": pose.revision,
        "is_checked": pose.is_checked,
        "base": _round(pose.base),
        "positions": _round(pose.positions),
        "stops": [{"kind": _name_stop(stop.kind), "text": stop.text} for stop in pose.stops],
        "undo": pose.undo_steps,
        "redo": pose.redo_steps,
        "refusal": pose.refusal,
    }
    for name in ("clearance_m", "balance_margin_m", "torque_share"):
        described[name] = round(getattr(pose, name), DRAWN_DIGITS) if pose.HasField(name) else None
    return described


def describe_opened(opened: PoseSessionOpened) -> dict[str, Any]:
    """Return an open session as pages draw it, JSON-ready."""
    return {
        "joint_names": list(opened.joint_names),
        "links": list(opened.links),
        "feet": list(opened.feet),
        "notes": list(opened.notes),
        "pose": describe_pose(opened.pose),
        "drawing": describe_drawing(opened.drawing),
    }


def describe_drawing(drawing: RobotDrawing) -> dict[str, Any]:
    """Return a robot as pages draw it, with the edges and faces of its shapes."""
    return {
        "joints": [
            {
                "parent": joint.parent,
                "rest": _round(joint.rest, SHAPE_DIGITS),
                "motion": _round(joint.motion, SHAPE_DIGITS),
                "at": joint.position,
            }
            for joint in drawing.joints
        ],
        "bodies": [
            {
                "name": body.name,
                "link": body.link,
                "joint": body.joint,
                "hull": pack_hull({"vertices": np.reshape(body.vertices, (-1, 3))}),
            }
            for body in drawing.bodies
        ],
        "frames": [
            {"name": frame.name, "joint": frame.joint, "pose": _round(frame.pose, SHAPE_DIGITS)}
            for frame in drawing.frames
        ],
        "tools": dict(drawing.tools),
    }


def _round(values: Sequence[float], digits: int = DRAWN_DIGITS) -> list[float]:
    return [round(value, digits) for value in values]


def _name_stop(kind: PoseStopKind) -> str:
    return PoseStopKind.Name(kind).removeprefix("POSE_STOP_KIND_").lower()
