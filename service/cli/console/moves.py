"""Direct moves: a nudge or another single step is planned with a certificate, and its motion goes to ghost or robot."""

from __future__ import annotations

import asyncio
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, Protocol

from service.cli.console.posing import make_set
from service.cli.console.sessions import OperatorSession
from service.client.answers import FinishedPlan
from service.errors import ExecutionError
from service.proto.planner.v1.result_pb2 import Trajectory
from service.request.fields import Point
from service.request.file import parse_request
from service.request.tasks.hand_steps import FreeAxis, HandChoice, OtherHand
from service.request.tasks.nudges import NudgeSettings, Touch, make_nudge

PERIOD_S = 0.1  # between two moves: a held key repeats at most ten times a second
CERTIFIED = "CERTIFIED"
BASE_COLUMNS = 7  # of a trajectory: x y z, then w x y z
NECKS = ("neck", "head")
NODS = ("ry", "pitch", "tilt", "nod", "y")  # how the joint of a neck that nods is called
Recipient = Literal["ghost", "robot"]


class NudgeFields(Protocol):
    """What a page sends with a key."""

    key: str
    hand: HandChoice
    other_hand: OtherHand
    free_axis: FreeAxis
    middle: Point | None
    touch_pieces: tuple[str, ...]
    touch_force_n: float | None


def make_nudge_step(session: OperatorSession, order: NudgeFields, to: Recipient) -> dict[str, Any]:
    """Return the step of a key that the operator pressed.

    Raises:
        RequestError: there is no such key, or a setting that it needs is missing.
    """
    touch = None if order.touch_force_n is None else Touch(order.touch_pieces, order.touch_force_n)
    start = find_start(session, to)
    neck = find_neck(start["joint_names"], start["positions"])
    settings = NudgeSettings(order.hand, order.other_hand, order.free_axis, order.middle, neck, touch=touch)
    return make_nudge(order.key, settings)


async def carry_out_step(
    session: OperatorSession, step: Mapping[str, Any], to: Recipient, revision: int
) -> dict[str, Any]:
    """Plan one step from where ghost or robot is, and give exactly its certified motion to the one or the other.

    Args:
        session: of the operator, with a pose session, whose scene counts.
        step: of ``task.steps``.
        to: who gets the motion; the ghost shows it in either case.
        revision: of the robot's state that the page showed.

    Raises:
        RequestError: no pose session is open, or the step cannot be used.
        ExecutionError: no certified motion was found, or another step is under way.
        PlannerError: the server refuses.
    """
    if session.is_moving:
        raise ExecutionError("another move is under way; wait for it")
    begun = time.monotonic()
    session.is_moving = True
    try:
        start = find_start(session, to)
        request = parse_request({**session.pose.request, "start": start, "task": {"steps": [dict(step)]}})
        with tempfile.TemporaryDirectory(prefix="scopt-console-") as scratch:
            folder = Path(scratch) / "plan" if to == "robot" else None  # only plans with files are carried out
            finished = await session.client.plan(request, out=folder, is_direct=True)
        if finished.verdict != CERTIFIED:
            raise ExecutionError("; ".join([finished.verdict, *finished.result.explanation]))
        after = 0
        if to == "robot":
            sha256 = finished.result.trajectory.sha256
            after, _ = await session.robot.execute(finished.plan_id, sha256, b"", revision)
        session.pose.send(**make_set(read_last_pose(finished.result.trajectory)))
        await asyncio.sleep(max(0.0, begun + PERIOD_S - time.monotonic()))
        return describe_move(finished, after)
    finally:
        session.is_moving = False


def find_start(session: OperatorSession, to: Recipient) -> dict[str, Any]:
    """Return where a move begins, as the start of a request: the ghost's pose, or that which the robot is to have.

    Raises:
        RequestError: no pose session is open, or the robot's pose is not known.
    """
    if to == "ghost":
        return session.pose.write_state()
    session.pose.write_state()  # its scene counts, also for the robot
    return session.robot.write_planned()


def find_neck(joint_names: list[str], positions: list[float]) -> tuple[str, float] | None:
    """Return the joint of a neck that nods, with its position; None where no name says so."""
    necks = [k for k, name in enumerate(joint_names) if any(word in name.lower() for word in NECKS)]
    necks.sort(key=lambda k: next((i for i, end in enumerate(NODS) if joint_names[k].lower().endswith(end)), len(NODS)))
    return (joint_names[necks[0]], positions[necks[0]]) if necks else None


def read_last_pose(trajectory: Trajectory) -> dict[str, Any]:
    """Return the last pose of a trajectory as the start of a request."""
    names = list(trajectory.joint_names)
    row = list(trajectory.positions[-len(names) :])
    first = BASE_COLUMNS if names[0] == "base_x" and names[BASE_COLUMNS - 1] == "base_qz" else 0
    start: dict[str, Any] = {"joint_names": names[first:], "positions": row[first:]}
    if first:
        start["base"] = {"position": row[:3], "quaternion_wxyz": row[3:first]}
    return start


def describe_move(finished: FinishedPlan, revision: int) -> dict[str, Any]:
    """Return what a page is told of a move: the hash of the motion that ghost and robot got, and how long it lasts."""
    trajectory = finished.result.trajectory
    return {
        "plan_id": finished.plan_id,
        "trajectory_sha256": trajectory.sha256,
        "duration_s": trajectory.times[-1],
        "planning_time_s": finished.result.planning_time_s,
        "revision": revision,
    }
