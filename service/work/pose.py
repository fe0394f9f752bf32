"""Poses that are led, in a worker: a session's world is made once and kept; every event is a call of its own."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from typing import TYPE_CHECKING

from service.errors import RequestError
from service.executor import Control
from service.executor.job import JobCancelled
from service.posing.drag import Drag, LedPose, Move
from service.posing.numbers import PoseNumbers
from service.request.schema import PlanRequest, StartRequest
from service.store import find_damaged_uploads
from service.work.plan import ROBOTS, Refused, perceive_cached, stops_with

if TYPE_CHECKING:
    from service.posing.drawing import RobotDrawing
    from service.posing.ground import PoseGround
    from service.posing.world import PoseWorld

MOST_WORLDS = 4  # that a worker keeps


@dataclass(frozen=True)
class OpenedPoses:
    """A session's world and its first pose.

    Attributes:
        ground: of all later calls.
        joint_names: of the positions of a pose.
        handles: links that are usually led.
        pose: the first one.
        drawing: of the robot.
    """

    ground: PoseGround
    joint_names: tuple[str, ...]
    handles: tuple[str, ...]
    pose: LedPose
    drawing: RobotDrawing


@dataclass(frozen=True)
class LeadTask:
    """Task of ``lead_pose``: an event of a drag.

    Attributes:
        ground: of the session.
        numbers: the pose before.
        drag: where it is led to.
        move: of the drag's targets since the event before.
        is_preview: whether a pose that is not checked is enough.
    """

    ground: PoseGround
    numbers: PoseNumbers
    drag: Drag
    move: Move
    is_preview: bool = False


class _Worlds:
    """Worlds of the sessions that this process has worked for most recently."""

    def __init__(self) -> None:
        self._known: OrderedDict[str, PoseWorld] = OrderedDict()

    def get(self, ground: PoseGround) -> PoseWorld:
        """Return the world of a session, made from its ground if it is not known.

        Raises:
            RequestError: its robot cannot be loaded.
        """
        if ground.key not in self._known:
            self._known[ground.key] = ground.make_world(ROBOTS.get(ground.request))
        self._known.move_to_end(ground.key)
        while len(self._known) > MOST_WORLDS:
            self._known.popitem(last=False)
        return self._known[ground.key]


_WORLDS = _Worlds()


def open_poses(request: PlanRequest, files: tuple[str, ...], control: Control) -> OpenedPoses | Refused:
    """Prepare the world of a session; ``files`` are those of its scene."""
    from service.posing.drawing import draw_robot
    from service.posing.ground import PoseGround
    from service.posing.reading import list_joint_names

    damaged = find_damaged_uploads(files)
    if damaged:
        return Refused((), damaged)
    try:
        with stops_with(control):
            robot = ROBOTS.get(request)
        ground = PoseGround.of(request, robot, control.should_stop, perceive_cached)
        if ground is None:
            raise JobCancelled("stopped on request")
        world = _WORLDS.get(ground)
        pose = world.check(ground.start)
    except RequestError as error:
        return Refused(error.problems)
    drawing = draw_robot(world.robot, world.handles)
    return OpenedPoses(ground, list_joint_names(world.robot), world.handles, pose, drawing)


def lead_pose(task: LeadTask) -> LedPose | Refused:
    """Lead a pose by an event of a drag."""
    try:
        world = _WORLDS.get(task.ground)
        if task.is_preview:
            return world.preview(task.numbers, task.drag)
        return world.lead(task.numbers, task.drag, task.move)
    except RequestError as error:
        return Refused(error.problems)


def check_pose(ground: PoseGround, start: StartRequest) -> LedPose | Refused:
    """Check a pose that is given as the start of a request."""
    from service.posing.ground import read_start

    try:
        world = _WORLDS.get(ground)
        return world.check(read_start(world.robot, start))
    except RequestError as error:
        return Refused(error.problems)
