"""The control loop of a robot: it carries out plans, obeys orders between two cycles, and reports."""

from __future__ import annotations

import queue
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np
import pinocchio as pin

from service.errors import ExecutionError, ServiceError
from service.execution.execution import Cycle, Execution
from service.execution.guards import Severity
from service.execution.machine import Mode, Order
from service.execution.reference import place_base
from service.work.robot.load import LoadedPlan, load_plan
from service.work.robot.robot import Robot

POSE_PERIOD_S = 0.02  # between two reports of a pose
IDLE_WAIT_S = 0.05  # for orders while nothing is carried out
ORDERS = {order.value: order for order in Order}
IDLE: Mapping[str, Any] = {
    "mode": "idle", "phase": "", "reason": "", "findings": [], "speed": 1.0, "last_order": "", "shifts": {}, "held": [],
}  # fmt: skip
Message = Mapping[str, Any]


class Runner:
    """A robot and what it carries out.

    Args:
        robot: the robot.
        tell: called with every message for the service: answers to orders by their ``id``, and parts of the state
            (``status``, ``plan``, ``pose``).
        holds_alone: whether the robot pauses when the service has gone; else it finishes its plan.
    """

    def __init__(self, robot: Robot, tell: Callable[[Message], None], *, holds_alone: bool) -> None:
        self._robot = robot
        self._tell = tell
        self._holds_alone = holds_alone
        self._orders: queue.Queue[Message] = queue.Queue()
        self._execution: Execution | None = None
        self._plan: LoadedPlan | None = None
        self._is_loading = self._waits_for_start = self._is_alone = False
        self._last_order = ""
        self._told: Message = {}
        self._pose_due = 0.0

    def give(self, message: Message) -> None:
        """Take a message of the service, from any thread: ``{"id", "order", ...}``."""
        self._orders.put(message)

    def leave_alone(self) -> None:
        """Note that the service has gone: the robot ends as its policy says, and then ``run`` returns."""
        self._orders.put({"id": 0, "order": "alone"})

    def run(self) -> None:
        """Carry out cycles and orders until the service has gone and the robot is at rest."""
        self._tell_status()
        while not self._is_finished():
            answers = self._obey_orders()
            execution = self._execution
            if execution is not None and not (execution.is_lost and execution.state.is_over):
                cycle = execution.step()
                self._robot.follow(execution.state.phase)
                self._report(execution, cycle)
            else:
                self._tell_status()
            for answer in answers:  # after the cycle that obeyed them, so that the state which follows is theirs
                self._tell(answer)
        self._robot.close()

    def _is_finished(self) -> bool:
        execution = self._execution
        if not self._is_alone or execution is None:
            return self._is_alone
        return execution.state.is_over or (execution.state.mode is Mode.PAUSED and execution.is_at_rest)

    def _obey_orders(self) -> list[Message]:
        """Obey all orders that wait; return their answers."""
        answers = []
        is_idle = self._execution is None or (self._execution.is_lost and self._execution.state.is_over)
        try:
            message = self._orders.get(timeout=IDLE_WAIT_S) if is_idle else self._orders.get_nowait()
            while True:
                answer = self._obey(message)
                if answer is not None:
                    answers.append(answer)
                message = self._orders.get_nowait()
        except queue.Empty:
            return answers

    def _obey(self, message: Message) -> Message | None:
        """Obey one order; return its answer, or None if that follows later or nobody waits for one."""
        order = message["order"]
        try:
            if order == "alone":
                self._is_alone = True
                if self._holds_alone and self._moves():
                    self._give(Order.PAUSE, "pause: the service has gone (--when-alone hold)")
                return None
            if order == "execute":
                self._begin_loading(message)
                return None
            if order == "loaded":
                self._begin(message)
            elif order == "shift":
                self._shift(message)
            elif order == "speed":
                self._require_execution("speed").set_speed(float(message["speed"]))
                self._last_order = message["by"]
            else:
                self._order(order, message["by"])
        except ServiceError as error:
            return {"id": message["id"], "error": " ".join(str(error).split())}
        return {
            "id": message["id"],
            "error": "",
            "trajectory_sha256": self._plan.trajectory_sha256 if self._plan else "",
        }

    def _shift(self, message: Message) -> None:
        execution = self._require_execution("shift")
        if execution.state.is_over or self._waits_for_start:
            mode = "ready" if self._waits_for_start else execution.state.mode.value
            raise ExecutionError(f"shift: the execution is {mode}; expected one that runs or is paused")
        execution.shift(message["link"], np.array(message["offset_m"], dtype=float))
        self._last_order = message["by"]

    def _order(self, order: str, by: str) -> None:
        execution = self._require_execution(order)
        if order == "start":
            if not self._waits_for_start:
                raise ExecutionError(f"start: the plan is {execution.state.mode.value}; it waits for no start")
            self._give(Order.RESUME, by)
            return
        if order == "resume" and self._waits_for_start:
            raise ExecutionError("resume: the plan has not started; give the order start")
        if order == "resume" and execution.state.mode is not Mode.PAUSED:
            raise ExecutionError(f"resume: the execution is {execution.state.mode.value}, not paused")
        self._give(ORDERS[order], by)

    def _give(self, order: Order, by: str) -> None:
        assert self._execution is not None
        self._execution.give(order)
        if order is not Order.PAUSE:
            self._waits_for_start = False
        self._last_order = by

    def _require_execution(self, order: str) -> Execution:
        if self._execution is None:
            raise ExecutionError(f"{order}: the robot carries out no plan")
        return self._execution

    def _moves(self) -> bool:
        execution = self._execution
        return execution is not None and not execution.state.is_over and execution.state.mode is not Mode.PAUSED

    def _begin_loading(self, message: Message) -> None:
        """Read a plan in a thread, verify it unless the service just did, and hold the pose; ``loaded`` follows."""
        if self._is_loading:
            raise ExecutionError("another plan is being loaded")
        if self._execution is not None and not self._execution.state.is_over:
            raise ExecutionError(
                f"another plan is {self._execution.state.mode.value}; stop it, or wait until it is done"
            )
        self._is_loading = True

        def load() -> None:
            loaded: dict[str, Any] = {**message, "order": "loaded", "error": "", "plan": None}
            try:
                loaded["plan"] = load_plan(
                    Path(message["folder"]), message["trajectory_sha256"], is_proven=message.get("is_proven", False)
                )
            except ServiceError as error:
                loaded["error"] = str(error)
            except Exception as error:  # the loop must go on whatever a plan's files do to its reader
                loaded["error"] = f"the plan cannot be read: {type(error).__name__}"
            self._orders.put(loaded)

        Thread(target=load, name="load", daemon=True).start()

    def _begin(self, message: Message) -> None:
        """Begin the execution of a loaded plan.

        Raises:
            ExecutionError, ResultError: one sentence: it could not be loaded, or the robot is not at its start.
        """
        self._is_loading = False
        if message["error"]:
            raise ExecutionError(message["error"])
        plan: LoadedPlan = message["plan"]
        tolerance = float(message["start_tolerance"])
        driver = self._robot.drive(plan.reference, plan.folder, bool(message["is_placed"]), tolerance)
        execution = Execution(plan.reference, driver, plan.settings, start_tolerance=tolerance)
        self._waits_for_start = bool(message["waits_for_start"])
        if self._waits_for_start:
            execution.give(Order.PAUSE)
        self._execution, self._plan, self._last_order = execution, plan, message["by"]
        reference = plan.reference
        self._tell({
            "plan": {
                "plan_id": message["plan_id"],
                "trajectory_sha256": plan.trajectory_sha256,
                "certificate_sha256": message["certificate_sha256"],
                "scene_sha256": plan.scene_sha256,
                "phases": [phase.name for phase in reference.phases],
                "duration_s": reference.duration_s,
                "joint_names": list(driver.joint_names),
                "unwatched": list(execution.watch.list_unwatched()),
                "guards": execution.watch.describe(),
                "shiftable": list(execution.controller.links),
            }
        })  # fmt: skip

    def _report(self, execution: Execution, cycle: Cycle) -> None:
        """Tell the state if it has changed, and the pose with it or when it is due."""
        sentences = tuple(finding.sentence for finding in cycle.findings if finding.severity is not Severity.NOTE)
        status, now = self._describe_status(sentences), time.monotonic()
        message: dict[str, Any] = {}
        if status != self._told:
            self._told = message["status"] = status
        if message or now >= self._pose_due:
            self._pose_due = now + POSE_PERIOD_S
            message["pose"] = self._describe_pose(execution, cycle)
        if message:
            self._tell(message)

    def _tell_status(self) -> None:
        """Tell the service the state without a cycle, if it has changed."""
        status = self._describe_status(())
        if status != self._told:
            self._told = status
            self._tell({"status": status})

    def _describe_status(self, findings: tuple[str, ...]) -> dict[str, Any]:
        execution = self._execution
        status: dict[str, Any] = {**IDLE, "last_order": self._last_order, "findings": list(findings)}
        if execution is not None:
            state = execution.state
            is_ready = self._waits_for_start and state.mode is Mode.PAUSED
            status |= {
                "mode": "ready" if is_ready else state.mode.value,
                "phase": execution.reference.phases[state.phase].name,
                "reason": "" if is_ready else state.reason,
                "speed": execution.machine.settings.speed,
                "shifts": {link: shift.goal.tolist() for link, shift in execution.shifts.items() if shift.goal.any()},
                "held": [part.item for part in execution.reference.motion.phases[state.phase].carriers if part.link],
            }
            if execution.is_lost:
                status["mode"] = "lost"
        if self._is_loading:
            status["mode"] = "loading"
        return status

    def _describe_pose(self, execution: Execution, cycle: Cycle) -> dict[str, Any]:
        """Return where the robot is and what it feels, in the order of the driver's joints."""
        reference, names = execution.reference, execution.driver.joint_names
        planned = dict(zip(reference.joint_names, cycle.wanted.q.tolist(), strict=True))
        base = self._measure_base(cycle)
        measured = {**cycle.forces.contacts, **cycle.forces.hands}
        expected = cycle.wanted.contact_wrenches
        return {
            "clock_s": cycle.state.time_s,
            "rate": cycle.state.rate,
            "measured": _round(cycle.reading.q),
            "planned": [round(planned[name], 5) for name in names],
            "measured_base": [] if base is None or not cycle.wanted.is_floating else _flatten(base),
            "planned_base": _flatten(place_base(cycle.wanted.configuration)) if cycle.wanted.is_floating else [],
            "forces": {
                link: [_round(force, 1), _round(expected[link][:3], 1) if link in expected else []]
                for link, force in measured.items()
            },
        }

    def _measure_base(self, cycle: Cycle) -> np.ndarray | None:
        if cycle.estimate is None:
            return self._robot.pose_world_base()
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = cycle.estimate.rotation, cycle.estimate.position
        return pose


def _flatten(pose: np.ndarray) -> list[float]:
    """Return position and quaternion w x y z of a pose (4, 4)."""
    x, y, z, w = pin.Quaternion(pose[:3, :3]).coeffs()
    return _round([*pose[:3, 3], w, x, y, z])


def _round(values: Any, digits: int = 5) -> list[float]:
    return [round(float(value), digits) for value in values]
