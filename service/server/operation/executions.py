"""Execute, Command and Watch: the server's robot."""

from __future__ import annotations

import asyncio
import json
import math
import tempfile
import time
from collections.abc import AsyncIterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import structlog

from service.errors import ExecutionError
from service.proto.planner.v1 import execution_pb2 as wire
from service.result.folder import write_files
from service.server.operation.checks import (
    check_approval,
    check_plan,
    check_releases,
    check_scan_age,
    find_scan_age_s,
    read_result_json,
)
from service.server.operation.control import Lease, RobotControl, refuse
from service.server.plan_files import read_files
from service.server.refusals import refuse_invalid
from service.store import DIRECT, PlanRecord, Store
from service.telemetry import bind
from service.trust import current_caller
from service.trust.rpc import Context
from service.wire.times import encode_time
from service.work.robot.handle import RobotProcess
from service.work.robot.process import HOLD

_LOG = structlog.get_logger("scopt.robot")
NO_ROBOT = "the server has no robot; start it with --robot, such as --robot sim"
START_TOLERANCE, MAX_START_TOLERANCE = 0.05, 0.1  # of a joint from the plan's start [rad, m]
PROVEN_S = 60.0  # after which a direct move is verified again before it is carried out
RATE_HZ, MAX_RATE_HZ = 10.0, 50.0  # of poses in Watch
MAX_STATION = 60  # characters
CONTROL_ORDERS = (wire.ORDER_TAKE_CONTROL, wire.ORDER_TAKE_OVER, wire.ORDER_RELEASE_CONTROL)
ORDERS = {
    wire.ORDER_START: "start",
    wire.ORDER_PAUSE: "pause",
    wire.ORDER_RESUME: "resume",
    wire.ORDER_STOP: "stop",
    wire.ORDER_ABORT: "abort",
    wire.ORDER_SPEED: "speed",
    wire.ORDER_SHIFT: "shift",
    wire.ORDER_RETREAT: "retreat",
}
PARTS = ("status", "plan", "control", "pose")


@dataclass(frozen=True)
class RobotSettings:
    """Settings of the server's robot.

    Attributes:
        robot: as ``--robot`` names it; empty for a server without.
        when_alone: ``hold`` or ``finish``: what the robot does when its operator, or the server, has gone.
        requires_approval: whether plans need an acceptance; None: unless the robot is simulated.
        scan_age_s: greatest age of a plan's scan [s].
    """

    robot: str = ""
    when_alone: str = HOLD
    requires_approval: bool | None = None
    scan_age_s: float = 3600.0


class ExecutionHandlers:
    """Handlers of ``Execute``, ``Command`` and ``Watch``.

    Args:
        settings: of the robot.
        store: store of the plans.
    """

    def __init__(self, settings: RobotSettings, store: Store) -> None:
        self._settings = settings
        self._store = store
        self._begun = time.time()
        self._numbers = dict.fromkeys(PARTS, 0)  # of the last change of each part
        self._changed = asyncio.Event()
        self._control = RobotControl(lambda: self._note("control"), self._leave_alone)
        self._robot = RobotProcess(settings.robot, settings.when_alone, self._take) if settings.robot else None
        self._key: tuple[Any, ...] = ()
        self._tasks: set[asyncio.Task[None]] = set()

    async def start(self) -> None:
        """Start the robot's process (ExecutionError: it cannot be used)."""
        if self._robot is not None:
            await self._robot.start()

    async def close(self) -> None:
        """Let go of the robot, which ends as its policy says."""
        if self._robot is not None:
            await self._robot.close()

    async def execute(self, message: wire.ExecuteRequest, context: Context) -> wire.ExecuteResponse:
        """Have the robot carry out a plan; returns when it has begun, or waits for its start.

        Raises:
            Refusal: FAILED_PRECONDITION with a sentence, or INVALID_ARGUMENT.
            NotStoredError: there is no such plan.
        """
        robot = self._require_robot()
        tolerance = _read_tolerance(message)
        lease = self._control.require(message.lease)
        self._control.require_revision(message.expected_revision)
        self._require_presence(lease)
        self._require_idle()
        if message.is_placed and not robot.is_simulated:
            raise refuse("is_placed: only a simulated robot can be put at the plan's start")
        record = self._store.plans.get(message.plan_id)
        bind(plan_id=record.plan_id)
        check_plan(record, message.trajectory_sha256)
        now = time.time()
        is_required = self._needs_approval(robot)
        reviews = self._store.reviews.find(record.plan_id)
        check_approval(record.plan_id, reviews, message.approval, is_required, now, is_direct=record.kind == DIRECT)
        files = await asyncio.to_thread(read_files, self._store, record.plan_id)
        result = read_result_json(files)
        check_releases(result, message.lets_go, () if message.is_placed else robot.state.status.get("held", ()))
        age_s = find_scan_age_s(result, record, self._store, now)
        accepted = message.accepted_scan_age_s if message.HasField("accepted_scan_age_s") else None
        check_scan_age(age_s, self._settings.scan_age_s, accepted)
        if not robot.is_alive:
            await _or_refuse(robot.start())
        with tempfile.TemporaryDirectory(prefix="scopt-") as folder:
            await asyncio.to_thread(write_files, Path(folder), files)
            answer = await _or_refuse(
                robot.order(
                    "execute",
                    folder=folder,
                    plan_id=record.plan_id,
                    trajectory_sha256=message.trajectory_sha256,
                    certificate_sha256=record.certificate_sha256,
                    start_tolerance=tolerance,
                    waits_for_start=message.waits_for_start,
                    is_placed=message.is_placed,
                    is_proven=self._is_just_proven(record, now),
                    by=f"execute by {lease.holder}",
                )
            )
        _LOG.info("executing", plan=record.plan_id, by=lease.holder, scan_age_s=age_s)
        return wire.ExecuteResponse(revision=self._control.revision, trajectory_sha256=answer["trajectory_sha256"])

    async def command(self, message: wire.CommandRequest, context: Context) -> wire.CommandResponse:
        """Obey an order, or give, take or release control.

        Raises:
            Refusal: FAILED_PRECONDITION with a sentence, or INVALID_ARGUMENT.
        """
        robot = self._require_robot()
        order, control = message.order, self._control
        if order not in CONTROL_ORDERS and order not in ORDERS:
            names = [name.removeprefix("ORDER_") for name in wire.Order.keys()[1:]]
            raise refuse_invalid([f"order: expected one of {', '.join(names)}, got {order}"])
        if len(message.station) > MAX_STATION:
            raise refuse_invalid([f"station: expected at most {MAX_STATION} characters, got {len(message.station)}"])
        if order == wire.ORDER_STOP:  # whoever sees a danger stops the robot
            by = f"stop by {_caller_name(message.station)}"
        elif order in (wire.ORDER_TAKE_CONTROL, wire.ORDER_TAKE_OVER):
            taken = control.take(current_caller().name, message.station, order == wire.ORDER_TAKE_OVER)
            _LOG.info("control taken", by=taken.holder, over=order == wire.ORDER_TAKE_OVER)
            return wire.CommandResponse(revision=control.revision, lease=taken.token)
        else:
            lease = control.require(message.lease)
            if order == wire.ORDER_RELEASE_CONTROL:
                control.release(message.lease)
                return wire.CommandResponse(revision=control.revision)
            control.require_revision(message.expected_revision)
            by = f"{ORDERS[order]} by {lease.holder}"
        if order == wire.ORDER_SPEED and not 0.01 <= message.speed <= 1.0:
            raise refuse_invalid([f"speed: expected 0.01 to 1, got {message.speed:g}"])
        values: dict[str, Any] = {"speed": message.speed}
        if order == wire.ORDER_SHIFT:
            self._check_shift(robot, message)
            values = {"link": message.link, "offset_m": list(message.offset_m)}
        await _or_refuse(robot.order(ORDERS[order], by=by, **values))
        _LOG.info("order obeyed", order=by)
        return wire.CommandResponse(revision=control.revision)

    async def watch(self, message: wire.WatchRequest, context: Context) -> AsyncIterator[wire.WatchResponse]:
        """Yield the whole state, then every change of it.

        Raises:
            Refusal: FAILED_PRECONDITION where there is no robot or the lease has ended, or INVALID_ARGUMENT.
        """
        self._require_robot()
        rate = message.rate_hz if message.HasField("rate_hz") else RATE_HZ
        if not 0.0 < rate <= MAX_RATE_HZ:
            raise refuse_invalid([f"rate_hz: expected above 0 and at most {MAX_RATE_HZ:g}, got {rate:g}"])
        with ExitStack() as stack:
            if message.lease:
                stack.enter_context(self._control.attend(message.lease))
            seen, pose_due = dict.fromkeys(PARTS, -1), 0.0
            is_first = True
            while True:
                changed = self._changed
                now = time.monotonic()
                parts = [part for part in PARTS if self._numbers[part] != seen[part]]
                if parts == ["pose"] and now < pose_due:
                    parts = []
                if parts:
                    seen |= {part: self._numbers[part] for part in parts}
                    if "pose" in parts:
                        pose_due = now + 1.0 / rate
                    yield self._describe(parts, is_first)
                    is_first = False
                    continue
                is_pose_late = self._numbers["pose"] != seen["pose"]
                try:
                    async with asyncio.timeout(max(pose_due - now, 0.001) if is_pose_late else None):
                        await changed.wait()
                except TimeoutError:
                    pass

    def _describe(self, parts: list[str], is_snapshot: bool) -> wire.WatchResponse:
        assert self._robot is not None
        state, lease = self._robot.state, self._control.lease
        message = wire.WatchResponse(revision=self._control.revision, is_snapshot=is_snapshot)
        message.time.CopyFrom(encode_time(state.time or time.time()))
        if "status" in parts:
            message.status.CopyFrom(_status_to_message(state.status))
        if "plan" in parts:
            message.plan.CopyFrom(_plan_to_message(state.plan))
        if "pose" in parts:
            message.pose.CopyFrom(_pose_to_message(state.pose))
        if "control" in parts:
            message.control.CopyFrom(
                wire.ControlHolder()
                if lease is None
                else wire.ControlHolder(
                    name=lease.name,
                    station=lease.station,
                    since=encode_time(lease.since),
                    is_present=self._control.is_present,
                )
            )
        return message

    def _take(self, part: str) -> None:
        """Note a change that the robot told; those that orders depend on raise the revision."""
        assert self._robot is not None
        status, plan = self._robot.state.status, self._robot.state.plan
        key = (status["mode"], status["speed"], plan.get("trajectory_sha256"), plan.get("plan_id"))
        if key != self._key:
            self._key = key
            why = status["reason"] or status["last_order"]
            self._control.raise_revision(f"the robot is {status['mode']}" + (f" ({why})" if why else ""))
        self._note(part)

    def _note(self, part: str) -> None:
        self._numbers[part] += 1
        changed, self._changed = self._changed, asyncio.Event()
        changed.set()

    def _leave_alone(self, lease: Lease) -> None:
        """Act by the policy when the last Watch call of the operator has ended."""
        robot = self._robot
        if robot is None or not robot.is_alive or self._settings.when_alone != HOLD:
            return
        if robot.state.status["mode"] not in ("running", "waiting", "returning"):
            return
        _LOG.warning("the operator has gone; the robot holds", operator=lease.holder)
        task = asyncio.get_running_loop().create_task(self._hold(lease))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _hold(self, lease: Lease) -> None:
        assert self._robot is not None
        try:
            await self._robot.order("pause", by=f"pause: {lease.holder} has gone (--when-alone hold)")
        except ExecutionError as error:
            _LOG.warning("the robot was not paused", reason=str(error))

    def _is_just_proven(self, record: PlanRecord, now: float) -> bool:
        """Return whether this server certified a direct move itself, moments ago; its store keeps it as it was."""
        return record.kind == DIRECT and self._begun <= record.created and now - record.created <= PROVEN_S

    def _needs_approval(self, robot: RobotProcess) -> bool:
        required = self._settings.requires_approval
        return not robot.is_simulated if required is None else required

    def _check_shift(self, robot: RobotProcess, message: wire.CommandRequest) -> None:
        """Refuse a displaced target that nobody can have accepted, or that is no displacement."""
        if len(message.offset_m) != 3 or not all(map(math.isfinite, message.offset_m)):
            raise refuse_invalid([f"offset_m: expected three finite numbers [m], got {list(message.offset_m)}"])
        if self._needs_approval(robot):
            raise refuse(
                "shift: this server's robot carries out accepted plans only, and the certificate of none covers a "
                "displaced target; scopt serve --no-require-approval allows it"
            )

    def _require_robot(self) -> RobotProcess:
        if self._robot is None:
            raise refuse(NO_ROBOT)
        return self._robot

    def _require_presence(self, lease: Lease) -> None:
        if self._settings.when_alone == HOLD and not self._control.is_present:
            raise refuse(
                f"lease: {lease.holder} does not watch; open Watch with the lease first, since the robot holds when "
                "its operator has gone (--when-alone hold)"
            )

    def _require_idle(self) -> None:
        assert self._robot is not None
        status, plan = self._robot.state.status, self._robot.state.plan
        if status["mode"] not in ("idle", "aborted", "done", "fallen", "lost"):
            name = plan.get("plan_id", "") or "another plan"
            raise refuse(f"another plan is {status['mode']} ({name}); stop it, or wait until it is done")


async def _or_refuse(call: Any) -> Any:
    try:
        return await call
    except ExecutionError as error:
        raise refuse(str(error)) from None


def _read_tolerance(message: wire.ExecuteRequest) -> float:
    if not message.HasField("start_tolerance"):
        return START_TOLERANCE
    if not 0.0 < message.start_tolerance <= MAX_START_TOLERANCE:
        raise refuse_invalid([
            f"start_tolerance: expected above 0 and at most {MAX_START_TOLERANCE:g}, got {message.start_tolerance:g}"
        ])  # fmt: skip
    return float(message.start_tolerance)


def _caller_name(station: str) -> str:
    name = current_caller().name
    return f"{name} ({station})" if station else name


def _status_to_message(status: Mapping[str, Any]) -> wire.ExecutionStatus:
    shifts = [wire.ShiftedTarget(link=link, offset_m=offset) for link, offset in status.get("shifts", {}).items()]
    return wire.ExecutionStatus(**{**status, "mode": f"EXECUTION_MODE_{status['mode'].upper()}", "shifts": shifts})


def _plan_to_message(plan: Mapping[str, Any]) -> wire.LoadedPlan:
    if not plan:
        return wire.LoadedPlan()
    named = {name: value for name, value in plan.items() if name != "guards"}
    return wire.LoadedPlan(**named, guards_json=json.dumps(plan["guards"]))


def _pose_to_message(pose: Mapping[str, Any]) -> wire.RobotPose:
    if not pose:
        return wire.RobotPose()
    forces = [
        wire.MeasuredForce(link=link, force=force, planned=planned) for link, (force, planned) in pose["forces"].items()
    ]
    return wire.RobotPose(**{**pose, "forces": forces})
