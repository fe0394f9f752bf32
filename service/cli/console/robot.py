"""The server's robot as an operator sees and leads it: its state, the lease, and what changed behind the operator."""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Callable, Mapping, Sequence
from contextlib import aclosing, suppress
from dataclasses import dataclass
from typing import Any

from grpc import StatusCode

from service.cli.console.posing import DRAWN_DIGITS
from service.client import AsyncPlannerClient, PlannerError
from service.errors import ExecutionError
from service.proto.planner.v1.execution_pb2 import ControlHolder, ExecutionMode, WatchResponse

AGAIN_S = 1.0  # before a server that did not answer is watched again
ATTEND_S = 10.0  # until the server has seen that its operator watches
RATE_HZ = 10.0
UNDER_WAY = (
    ExecutionMode.EXECUTION_MODE_LOADING,
    ExecutionMode.EXECUTION_MODE_READY,
    ExecutionMode.EXECUTION_MODE_RUNNING,
    ExecutionMode.EXECUTION_MODE_PAUSED,
    ExecutionMode.EXECUTION_MODE_WAITING,
    ExecutionMode.EXECUTION_MODE_RETURNING,
    ExecutionMode.EXECUTION_MODE_HOLDING,
)
# Modes in which a plan can be gone on with from where the robot is, and those in which it is over for good.
AT_REST = (ExecutionMode.EXECUTION_MODE_PAUSED, ExecutionMode.EXECUTION_MODE_ABORTED)
OVER = (ExecutionMode.EXECUTION_MODE_DONE, ExecutionMode.EXECUTION_MODE_FALLEN, ExecutionMode.EXECUTION_MODE_LOST)
# No robot, none for a caller of this role, or a server from before there were any.
NO_ROBOT = (StatusCode.FAILED_PRECONDITION, StatusCode.PERMISSION_DENIED, StatusCode.UNIMPLEMENTED)


@dataclass(frozen=True)
class Standstill:
    """Where the robot rests in a plan.

    Attributes:
        plan_id, phase: of the plan that it carries out, or was stopped in.
        clock_s: of the plan [s].
        start: measured joints, and base if it floats, as a request's ``start``.
        shifts: displacement of each shifted link in world axes [m].
    """

    plan_id: str
    phase: str
    clock_s: float
    start: dict[str, Any]
    shifts: dict[str, list[float]]


class RobotSeat:
    """Control of the server's robot by the pages of one session.

    While a page is open, it watches; without one the server sees that its operator has gone. What others change while
    the session has control has to be acknowledged before the next order; ``stop`` is always sent.

    Args:
        client: of the operator.
        tell: called with the event ``robot`` after every change, complete each time, and with the event ``measured``
            where nothing but the robot's pose changed.
    """

    def __init__(self, client: AsyncPlannerClient, tell: Callable[[Mapping[str, Any]], None]) -> None:
        self._client = client
        self._tell = tell
        self._station = f"console {secrets.token_hex(2)}"  # nobody else's, so that its own orders are told apart
        self._lease = ""
        self._taken = 0  # revision with which the lease began
        self._state: WatchResponse | None = None
        self._surprises: list[str] = []
        self._problem = ""
        self._has_stopped = False  # whether the latest order was its own stop, which names no station
        self._task: asyncio.Task[None] | None = None

    def attend(self) -> None:
        """Begin to watch, for the first page."""
        if self._task is None:
            self._task = asyncio.create_task(self._watch())

    async def leave(self) -> None:
        """Stop watching, after the last page; the server then does as its policy says."""
        task, self._task = self._task, None
        if task is not None:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)

    async def close(self) -> None:
        """Stop watching, and give control back."""
        await self.leave()
        if self._lease:
            with suppress(PlannerError):
                await self._client.command("release_control", lease=self._lease)

    def describe(self) -> dict[str, Any]:
        """Return the event of the present state; ``is_there`` is false for a server without a robot."""
        told = {"event": "robot", "problem": self._problem, "surprises": list(self._surprises)}
        if self._state is None:
            return {**told, "is_there": False}
        known = {**describe_state(self._state), **describe_measured(self._state)}
        return {**told, "is_there": True, "has_control": bool(self._lease), **known}

    def write_planned(self) -> dict[str, Any]:
        """Return the pose that the robot is to have, as the start of a request.

        Raises:
            ExecutionError: it is not known, or the robot is under way.
        """
        state = self._state
        if state is None or not state.pose.planned:
            raise ExecutionError("the robot's pose is not known until it has carried out a plan; execute one first")
        if state.status.mode in UNDER_WAY:
            mode = describe_state(state)["mode"]
            raise ExecutionError(f"the robot is {mode}; a move begins where it rests: wait, or stop it")
        return _make_start(state, state.pose.planned, state.pose.planned_base)

    def find_standstill(self) -> Standstill:
        """Return where in a plan the robot rests.

        Raises:
            ExecutionError: it carries out no plan, is at the plan's end, or moves.
        """
        state = self._state
        if state is None or not state.plan.plan_id or not state.pose.measured:
            raise ExecutionError("the robot carries out no plan; there is no rest to plan")
        told = describe_state(state)
        if state.status.mode not in AT_REST or state.pose.rate != 0.0:
            hint = (
                "there is no rest to plan" if state.status.mode in OVER else "pause it first, and wait until it rests"
            )
            raise ExecutionError(f"the robot is {told['mode']}; {hint}")
        start = _make_start(state, state.pose.measured, state.pose.measured_base)
        return Standstill(state.plan.plan_id, state.status.phase, state.pose.clock_s, start, told["shifts"])

    async def take(self, takes_over: bool) -> int:
        """Take control, and return the revision once the server sees that its operator watches.

        Raises:
            PlannerError: somebody else has it, or the caller's role does not allow it.
        """
        taken = await self._client.take_control(self._station, takes_over=takes_over)
        self._lease, self._taken, self._surprises = taken.lease, taken.revision, []
        await self.leave()
        self.attend()
        with suppress(TimeoutError):
            async with asyncio.timeout(ATTEND_S):
                while not self._is_attended():
                    await asyncio.sleep(0.01)
        return taken.revision

    async def command(
        self, order: str, revision: int, speed: float = 0.0, link: str = "", offset_m: Sequence[float] = ()
    ) -> int:
        """Give an order about the state of a revision, and return the revision after it.

        Raises:
            ExecutionError: something changed, and was not acknowledged.
            PlannerError: the server refuses the order.
        """
        if order == "stop":
            self._has_stopped = True
            return (await self._client.command("stop")).revision
        self._require_acknowledged()
        self._has_stopped = False
        lease = self._lease
        if order == "release_control":
            self._lease = ""  # before the server tells that nobody has control
        try:
            answer = await self._client.command(
                order, lease=lease, revision=revision, speed=speed, link=link, offset_m=offset_m
            )
        except PlannerError:
            self._lease = lease
            raise
        return answer.revision

    async def execute(
        self,
        plan_id: str,
        trajectory_sha256: str,
        approval: bytes,
        revision: int,
        *,
        is_placed: bool = False,
        scan_age_s: float | None = None,
        lets_go: Sequence[str] = (),
    ) -> tuple[int, str]:
        """Have the robot carry out a trajectory; return the revision, and the hash of what it carries out.

        Raises:
            ExecutionError: something changed, and was not acknowledged.
            PlannerError: the server refuses the plan.
        """
        self._require_acknowledged()
        self._has_stopped = False
        answer = await self._client.execute(
            plan_id,
            trajectory_sha256,
            lease=self._lease,
            revision=revision,
            approval=approval,
            is_placed=is_placed,
            accepted_scan_age_s=scan_age_s,
            lets_go=lets_go,
        )
        return answer.revision, answer.trajectory_sha256

    def acknowledge(self, seen: int) -> None:
        """Note that the operator has seen the first ``seen`` of the changes."""
        del self._surprises[:seen]
        self._tell(self.describe())

    def _is_attended(self) -> bool:
        state = self._state
        return state is not None and state.revision >= self._taken and state.control.is_present

    def _require_acknowledged(self) -> None:
        if self._surprises:
            raise ExecutionError(f"{self._surprises[-1]}; acknowledge it first")

    async def _watch(self) -> None:
        while True:
            try:
                async with aclosing(self._client.watch(lease=self._lease, rate_hz=RATE_HZ)) as states:
                    async for state in states:
                        self._take_state(state)
                self._problem = "the server ended the call that watches the robot"
            except PlannerError as error:
                text = "; ".join(error.problems)
                if self._lease and error.code is StatusCode.FAILED_PRECONDITION:
                    self._lose(text)
                    continue
                if error.code in NO_ROBOT:
                    self._state = None
                    self._tell(self.describe())
                    return
                self._problem = text
            self._tell(self.describe())
            await asyncio.sleep(AGAIN_S)

    def _take_state(self, state: WatchResponse) -> None:
        self._problem = ""
        if self._lease and state.revision >= self._taken:
            if state.control.station != self._station:
                holder = name_holder(state.control)
                self._lose(f"{holder} took control" if holder else "your control of the robot has ended")
            elif self._state is not None:
                surprises = find_surprises(self._state, state)
                self._surprises += [text for text in surprises if not (self._has_stopped and text.startswith("stop "))]
        before, self._state = self._state, state
        if before is not None and not self._surprises and is_moved_only(before, state):
            self._tell({"event": "measured", **describe_measured(state)})
        else:
            self._tell(self.describe())

    def _lose(self, text: str) -> None:
        self._lease = ""
        self._surprises.append(text)


def _make_start(state: WatchResponse, positions: Sequence[float], base: Sequence[float]) -> dict[str, Any]:
    """Return a pose of the robot as a request's ``start``; ``base`` is empty for a fixed one."""
    start: dict[str, Any] = {
        "joint_names": list(state.plan.joint_names),
        "positions": [float(value) for value in positions],
    }
    if base:
        x, y, z, *quaternion = (float(value) for value in base)
        start["base"] = {"position": [x, y, z], "quaternion_wxyz": quaternion}
    return start


def find_surprises(before: WatchResponse, after: WatchResponse) -> list[str]:
    """Return, in sentences, what others than the present holder of control ordered between two states."""
    order = after.status.last_order
    if order in ("", before.status.last_order) or order.endswith(f"by {name_holder(after.control)}"):
        return []
    if before.plan.trajectory_sha256 != after.plan.trajectory_sha256:
        return [f"{order}: plan {after.plan.plan_id} has replaced the one that was loaded"]
    if before.status.speed != after.status.speed:
        return [f"{order}: the speed is now {after.status.speed:.2g}"]
    return [order]


def name_holder(control: ControlHolder) -> str:
    """Return name and station of who has control; empty for nobody."""
    return f"{control.name} ({control.station})" if control.station else control.name


def describe_state(state: WatchResponse) -> dict[str, Any]:
    """Return a state without the robot's pose as pages show it, JSON-ready."""
    status, plan = state.status, state.plan
    return {
        "revision": state.revision,
        "mode": ExecutionMode.Name(status.mode).removeprefix("EXECUTION_MODE_").lower(),
        "phase": status.phase,
        "reason": status.reason,
        "findings": list(status.findings),
        "speed": status.speed,
        "last_order": status.last_order,
        "shifts": {shift.link: list(shift.offset_m) for shift in status.shifts},
        "held": list(status.held),
        "plan_id": plan.plan_id,
        "trajectory_sha256": plan.trajectory_sha256,
        "duration_s": plan.duration_s,
        "joint_names": list(plan.joint_names),
        "phases": list(plan.phases),
        "shiftable": list(plan.shiftable),
        "control": name_holder(state.control),
    }


def describe_measured(state: WatchResponse) -> dict[str, Any]:
    """Return the measured pose as pages draw it, JSON-ready; ``farthest`` is the joint farthest from the plan."""
    plan, pose = state.plan, state.pose
    off = {
        name: abs(measured - planned)
        for name, measured, planned in zip(plan.joint_names, pose.measured, pose.planned, strict=False)
    }
    farthest = max(off, key=lambda name: off[name], default="")
    return {
        "clock_s": round(pose.clock_s, 3),
        "farthest": {"joint": farthest, "off": round(off[farthest], DRAWN_DIGITS)} if farthest else None,
        "base": [round(value, DRAWN_DIGITS) for value in pose.measured_base],
        "positions": [round(value, DRAWN_DIGITS) for value in pose.measured],
    }


def is_moved_only(before: WatchResponse, after: WatchResponse) -> bool:
    """Return whether nothing but the robot's pose changed between two states."""
    return (
        before.revision == after.revision
        and before.status == after.status
        and before.plan == after.plan
        and before.control == after.control
    )
