"""The orders that a page may give, their arguments, and what carries them out."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass as checked

from service.cli.console.cameras import take_picture
from service.cli.console.inbox import execute_plan, list_inbox, open_plan, review_plan
from service.cli.console.jobs import cancel_plan, plan_rest, start_plan
from service.cli.console.order import Console, Nothing, PageOrder
from service.cli.console.pose_orders import POSE_ORDERS
from service.cli.console.scans import (
    MOST_POINTS,
    compare_scans,
    detect_at,
    list_scans,
    move_hit,
    show_scan,
    show_unseen,
    upload_scan,
)
from service.cli.console.sessions import OperatorSession
from service.cli.console.tabs import list_tabs, make_request
from service.proto.planner.v1.planner_pb2 import SimulationVerdict
from service.request.fields import SECTION, Name, PlainData, Point, Section

Comment = Annotated[str, Field(max_length=10_000)]
Hash = Annotated[str, Field(max_length=100)]


@checked(config=SECTION)
class OpenOrder(Section):
    """Which plan is to be shown."""

    plan_id: Name


@checked(config=SECTION)
class SimulateOrder(Section):
    """Which plan is to be carried out in physics."""

    plan_id: Name


@checked(config=SECTION)
class ReviewOrder(Section):
    """A decision, and what the page showed when it was made.

    Attributes:
        despite: the plan's verdict, to accept one that is not ``CERTIFIED``.
    """

    plan_id: Name
    accept: bool
    trajectory_sha256: Hash
    certificate_sha256: Hash
    page_sha256: Hash
    comment: Comment = ""
    despite: Annotated[str, Field(max_length=100)] = ""


@checked(config=SECTION)
class ScanOrder(Section):
    """Which scan is to be shown, by its name in the list, which robot stood in it, and with how many points."""

    scan: Name
    robot: Name
    posture: Name | None = None
    most_points: Annotated[int, Field(ge=100, le=MOST_POINTS)] = MOST_POINTS


@checked(config=SECTION)
class PictureOrder(Section):
    """Of which camera a picture is wanted."""

    camera: Name


@checked(config=SECTION)
class UnseenOrder(Section):
    """What of which scan was not seen, by the robot that stood in it."""

    scan: Name
    robot: Name
    posture: Name | None = None


@checked(config=SECTION)
class ChangesOrder(Section):
    """Which scan is to be compared with which earlier one, and the robot that stood in both."""

    scan: Name
    before: Name
    robot: Name
    posture: Name | None = None


@checked(config=SECTION)
class DetectOrder(Section):
    """Where the operator clicked in the scan in which a robot stood, and kinds of objects that may be there."""

    scan: Name
    robot: Name
    at: Point
    kinds: Annotated[tuple[Name, ...], Field(min_length=1, max_length=8)]
    posture: Name | None = None


@checked(config=SECTION)
class MoveHitOrder(Section):
    """By how far the operator moved a fit from where the scan shows it, in world axes [m]."""

    hit: int
    moved_m: Point


@checked(config=SECTION)
class PlanOrder(Section):
    """What is to be planned.

    Attributes:
        task: name of a task file.
        values: its parameters.
        robot, posture: the robot, and how it stands at the start.
        scan: its surroundings; None for none.
        hit: number of the object that the operator has accepted.
    """

    task: Name
    values: PlainData
    robot: Name
    posture: Name | None = None
    scan: Name | None = None
    hit: int | None = None


@checked(config=SECTION)
class CancelOrder(Section):
    """Which plan is to be stopped."""

    job: int


@checked(config=SECTION)
class TakeOrder(Section):
    """Control of the robot is to be taken, also from somebody who has it."""

    takes_over: bool = False


@checked(config=SECTION)
class ExecuteOrder(Section):
    """Which plan the robot is to carry out, and what the page showed when the operator said so.

    Attributes:
        revision: of the robot's state.
        is_placed: whether a simulated robot is put at the plan's start first.
        scan_age_s: age up to which the operator has found the plan's scan to be right still [s].
        lets_go: objects that hands may let go.
    """

    plan_id: Name
    trajectory_sha256: Hash
    revision: int
    is_placed: bool = False
    scan_age_s: Annotated[float, Field(ge=0.0)] | None = None
    lets_go: Annotated[tuple[Name, ...], Field(max_length=100)] = ()


@checked(config=SECTION)
class RobotOrder(Section):
    """What the robot is to do about the state that the page showed.

    Attributes:
        revision: of the robot's state; ``stop`` is obeyed with any.
        speed: with ``speed``, share of real time.
        link, offset_m: with ``shift``, a foot or hand, and the displacement of its target [m].
    """

    command: Literal["pause", "resume", "stop", "abort", "retreat", "speed", "shift", "release_control"]
    revision: int
    speed: float = 0.0
    link: Annotated[str, Field(max_length=200)] = ""
    offset_m: Annotated[tuple[float, ...], Field(max_length=3)] = ()


@checked(config=SECTION)
class AcknowledgeOrder(Section):
    """How many of the changes behind the page its operator has seen."""

    seen: Annotated[int, Field(ge=1)]


async def _inbox(console: Console, session: OperatorSession, order: Nothing) -> Any:
    return await list_inbox(session.client)


async def _open(console: Console, session: OperatorSession, order: OpenOrder) -> Any:
    return await open_plan(session, order.plan_id)


async def _simulate(console: Console, session: OperatorSession, order: SimulateOrder) -> Any:
    answer = await session.client.simulate(order.plan_id)
    verdict = SimulationVerdict.Name(answer.verdict).removeprefix("SIMULATION_VERDICT_")
    return {"verdict": verdict, "explanation": list(answer.explanation)}


async def _review(console: Console, session: OperatorSession, order: ReviewOrder) -> Any:
    hashes = order.trajectory_sha256, order.certificate_sha256, order.page_sha256
    return await review_plan(session, order.plan_id, order.accept, hashes, order.comment, order.despite)


async def _tabs(console: Console, session: OperatorSession, order: Nothing) -> Any:
    robots = await session.client.robots()
    return {
        "tabs": list_tabs(),
        "robots": [{"name": robot.name, "postures": list(robot.postures)} for robot in robots],
        "scans": list_scans(console.settings.scans),
        "cameras": [{"name": camera.name, "phases": camera.phases} for camera in console.settings.cameras],
    }


async def _picture(console: Console, session: OperatorSession, order: PictureOrder) -> Any:
    return await take_picture(console.settings.cameras, order.camera)


async def _scan(console: Console, session: OperatorSession, order: ScanOrder) -> Any:
    return await show_scan(console.settings.scans, order.scan, order.robot, order.posture, order.most_points)


async def _changes(console: Console, session: OperatorSession, order: ChangesOrder) -> Any:
    return await compare_scans(console.settings.scans, order.scan, order.before, order.robot, order.posture)


async def _unseen(console: Console, session: OperatorSession, order: UnseenOrder) -> Any:
    return await show_unseen(console.settings.scans, order.scan, order.robot, order.posture)


async def _detect(console: Console, session: OperatorSession, order: DetectOrder) -> Any:
    clouds = await upload_scan(session.client, console.settings.scans, order.scan, order.robot, order.posture)
    return await detect_at(session.client, session.hits, clouds, order.at, order.kinds)


async def _move_hit(console: Console, session: OperatorSession, order: MoveHitOrder) -> Any:
    return move_hit(session.hits, order.hit, order.moved_m)


async def _plan(console: Console, session: OperatorSession, order: PlanOrder) -> Any:
    request = make_request(session, console.settings.scans, order)
    return start_plan(session, order.task, request)


async def _plan_rest(console: Console, session: OperatorSession, order: Nothing) -> Any:
    return await plan_rest(session)


async def _cancel(console: Console, session: OperatorSession, order: CancelOrder) -> Any:
    cancel_plan(session, order.job)
    return {}


async def _take(console: Console, session: OperatorSession, order: TakeOrder) -> Any:
    return {"revision": await session.robot.take(order.takes_over)}


async def _execute(console: Console, session: OperatorSession, order: ExecuteOrder) -> Any:
    return await execute_plan(
        session,
        order.plan_id,
        order.trajectory_sha256,
        order.revision,
        order.is_placed,
        order.scan_age_s,
        order.lets_go,
    )


async def _command(console: Console, session: OperatorSession, order: RobotOrder) -> Any:
    shift = order.link, order.offset_m
    return {"revision": await session.robot.command(order.command, order.revision, order.speed, *shift)}


async def _acknowledge(console: Console, session: OperatorSession, order: AcknowledgeOrder) -> Any:
    session.robot.acknowledge(order.seen)
    return {}


ORDERS: Mapping[str, PageOrder[Any]] = {
    "inbox": PageOrder(Nothing, _inbox),
    "open": PageOrder(OpenOrder, _open),
    "review": PageOrder(ReviewOrder, _review),
    "simulate": PageOrder(SimulateOrder, _simulate),
    "tabs": PageOrder(Nothing, _tabs),
    "scan": PageOrder(ScanOrder, _scan),
    "changes": PageOrder(ChangesOrder, _changes),
    "picture": PageOrder(PictureOrder, _picture),
    "unseen": PageOrder(UnseenOrder, _unseen),
    "detect": PageOrder(DetectOrder, _detect),
    "move_hit": PageOrder(MoveHitOrder, _move_hit),
    "plan": PageOrder(PlanOrder, _plan),
    "plan_rest": PageOrder(Nothing, _plan_rest),
    "cancel": PageOrder(CancelOrder, _cancel),
    "take": PageOrder(TakeOrder, _take),
    "execute": PageOrder(ExecuteOrder, _execute),
    "command": PageOrder(RobotOrder, _command),
    "acknowledge": PageOrder(AcknowledgeOrder, _acknowledge),
    **POSE_ORDERS,
}
