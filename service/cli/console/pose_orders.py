"""Orders about the pose that the operator leads, and direct moves of ghost or robot."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping
from typing import Annotated, Any, Literal, TypeVar

from pydantic import Field
from pydantic.dataclasses import dataclass as checked

from service.cli.console.jobs import start_plan
from service.cli.console.moves import Recipient, carry_out_step, make_nudge_step
from service.cli.console.order import Console, PageOrder
from service.cli.console.posing import STEPS, make_drag, make_led_request, make_set
from service.cli.console.sessions import OperatorSession
from service.request.fields import SECTION, Name, Number, PlainData, Point, Section, at_most
from service.request.tasks.hand_steps import Force, FreeAxis, HandChoice, OtherHand

POSE = "pose"  # the task of a plan to a pose that was led
Quaternion = tuple[Number, Number, Number, Number]
T = TypeVar("T", bound="PoseOrder")


@checked(config=SECTION)
class OpenPoseOrder(Section):
    """Which robot is led, how it stands at first, and the scan about it."""

    robot: Name
    posture: Name | None = None
    scan: Name | None = None


@checked(config=SECTION)
class PoseOrder(Section):
    """An order about the pose of a session, by the number that opening it gave."""

    session: int


@checked(config=SECTION)
class LedTarget(Section):
    """Where a link is led to; without a quaternion it may turn freely."""

    link: Name
    position: Point
    quaternion_wxyz: Quaternion | None = None


@checked(config=SECTION)
class DragOrder(PoseOrder):
    """All that is held now; ``is_last`` ends the drag, which is one step of undo."""

    targets: Annotated[tuple[LedTarget, ...], at_most(8)] = ()
    joints: Annotated[dict[Name, Number], at_most(100)] = Field(default_factory=dict)
    is_last: bool = False


@checked(config=SECTION)
class HistoryOrder(PoseOrder):
    """A step back or forward."""

    way: Literal["undo", "redo"]


@checked(config=SECTION)
class SetPoseOrder(PoseOrder):
    """A pose by its numbers, or a posture, as the start of a request has it."""

    start: PlainData


@checked(config=SECTION)
class KeepOrder(PoseOrder):
    """Under which name the pose is kept as a task file."""

    name: Annotated[str, Field(min_length=1, max_length=60)]


@checked(config=SECTION)
class NudgeOrder(PoseOrder):
    """A key, what it moves, and who gets the motion.

    Attributes:
        middle: point between both hands, about which both turn [m].
        touch_pieces, touch_force_n: what the hand may touch, and the force at which it stops [N]; None: nothing.
        revision: of the robot's state that the page showed.
    """

    key: Annotated[str, Field(max_length=10)]
    hand: HandChoice = "right"
    other_hand: OtherHand = "keep"
    free_axis: FreeAxis = "none"
    middle: Point | None = None
    touch_pieces: Annotated[tuple[Name, ...], at_most(64)] = ()
    touch_force_n: Force | None = None
    to: Recipient = "ghost"
    revision: int = 0


@checked(config=SECTION)
class MoveOrder(PoseOrder):
    """One step of ``task.steps``, and who gets its motion."""

    step: PlainData
    to: Recipient = "ghost"
    revision: int = 0


async def _open(console: Console, session: OperatorSession, order: OpenPoseOrder) -> Any:
    scans = console.settings.scans
    request = await make_led_request(session.client, scans, order.robot, order.posture, order.scan)
    return await session.pose.open(request)


async def _drag(console: Console, session: OperatorSession, order: DragOrder) -> Any:
    return {"number": session.pose.send(drag=make_drag(order.targets, order.joints, order.is_last))}


async def _go(console: Console, session: OperatorSession, order: HistoryOrder) -> Any:
    return {"number": session.pose.send(**STEPS[order.way])}


async def _set(console: Console, session: OperatorSession, order: SetPoseOrder) -> Any:
    return {"number": session.pose.send(**make_set(order.start))}


async def _read(console: Console, session: OperatorSession, order: PoseOrder) -> Any:
    return session.pose.write_state()


async def _plan(console: Console, session: OperatorSession, order: PoseOrder) -> Any:
    return start_plan(session, POSE, session.pose.plan_request())


async def _keep(console: Console, session: OperatorSession, order: KeepOrder) -> Any:
    return {"path": str(session.pose.keep(order.name))}


async def _nudge(console: Console, session: OperatorSession, order: NudgeOrder) -> Any:
    step = make_nudge_step(session, order, order.to)
    return await carry_out_step(session, step, order.to, order.revision)


async def _move(console: Console, session: OperatorSession, order: MoveOrder) -> Any:
    return await carry_out_step(session, order.step, order.to, order.revision)


def _about_pose(arguments: type[T], act: Callable[[Console, OperatorSession, T], Awaitable[Any]]) -> PageOrder[T]:
    """Return an order that is carried out only while the session that it names is open."""

    async def act_in_session(console: Console, session: OperatorSession, order: T) -> Any:
        session.pose.require(order.session)
        return await act(console, session, order)

    return PageOrder(arguments, act_in_session)


POSE_ORDERS: Mapping[str, PageOrder[Any]] = {
    "pose_open": PageOrder(OpenPoseOrder, _open),
    "pose_drag": _about_pose(DragOrder, _drag),
    "pose_go": _about_pose(HistoryOrder, _go),
    "pose_set": _about_pose(SetPoseOrder, _set),
    "pose_read": _about_pose(PoseOrder, _read),
    "pose_plan": _about_pose(PoseOrder, _plan),
    "pose_keep": _about_pose(KeepOrder, _keep),
    "nudge": _about_pose(NudgeOrder, _nudge),
    "move": _about_pose(MoveOrder, _move),
}
