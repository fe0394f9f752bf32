"""The robot ``trajectory``: a controller with ros2_control's action ``FollowJointTrajectory``, behind a transport.

Every command is a short goal that replaces the one before: a point one period ahead, and the rest that follows from it
within ``STOP_S``. A controller that hears nothing more comes to rest by itself. Nothing of ROS is imported here: a
``TrajectoryTransport`` carries plain data, by rclpy on a robot and by a played controller in tests.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from jaxtyping import Float

from service.errors import ExecutionError, RequestError, shown
from service.execution.driver import JointCommand, RobotDriver, RobotReading
from service.execution.reference import PlannedReference
from service.work.robot.robot import read_options

STOP_S = 0.2  # in which a robot that hears nothing more comes to rest
FIRST_S = 5.0  # in which the first state has to come
SILENT_S = 0.25  # without a new state, after which the driver says so
DEFAULTS = {"period_ms": 20.0}
GRAVITY = (0.0, 0.0, 9.81)


class TrajectoryTransport(Protocol):
    """What carries goals and states between this process and a controller."""

    def read_state(self) -> Mapping[str, Any] | None:
        """Return the newest ``sensor_msgs/JointState`` as data; None before the first.

        Keys are ``stamp`` [s], ``name``, ``position``, ``velocity`` and ``effort``, which may be empty.
        """

    def send_goal(self, goal: Mapping[str, Any]) -> None:
        """Hand over a goal of ``FollowJointTrajectory``, which replaces the present one.

        Keys are ``joint_names`` and ``points`` with ``positions``, ``velocities`` and ``time_from_start`` [s].
        """

    def read_error(self) -> str:
        """Return why the controller has refused or ended a goal, which it did not replace; empty: it has not."""

    def close(self) -> None:
        """Let go of the controller."""


OpenTrajectoryTransport = Callable[[], TrajectoryTransport]


class TrajectoryDriver:
    """A controller of joint trajectories; implements ``RobotDriver``.

    It knows neither base nor feet: an execution has position guards only, and its report says what is not watched.
    """

    def __init__(self, transport: TrajectoryTransport, period_s: float) -> None:
        """Wait for the first state.

        Raises:
            ExecutionError: one sentence: none comes, or it cannot be read.
        """
        self._transport, self.period_s = transport, period_s
        end = time.monotonic() + FIRST_S
        state = transport.read_state()
        while state is None and time.monotonic() < end:
            time.sleep(0.01)
            state = transport.read_state()
        if state is None:
            raise ExecutionError(f"the controller says nothing of its joints within {FIRST_S:g} s")
        try:
            self.joint_names = tuple(str(name) for name in state["name"])
            if not self.joint_names or len(set(self.joint_names)) < len(self.joint_names):
                raise ValueError("joint names are missing or repeated")
            self._begin_s = float(state["stamp"])
            self._reading = self._read(state)
        except (KeyError, TypeError, ValueError) as error:
            raise ExecutionError(f"the controller's state cannot be read: {error}") from None
        self._heard = self._due = time.monotonic()

    def read(self) -> RobotReading:
        """Return the newest state as a reading; one that cannot be read is left out.

        Raises:
            ConnectionError: the controller has refused a goal, or says nothing new for too long.
        """
        error = self._transport.read_error()
        if error:
            raise ConnectionError(f"the controller refuses the trajectory: {error}")
        state, now = self._transport.read_state(), time.monotonic()
        try:
            reading = self._reading if state is None else self._read(state)
            if reading.time_s != self._reading.time_s:
                self._reading, self._heard = reading, now
        except (KeyError, TypeError, ValueError):
            pass
        if now - self._heard > SILENT_S:
            raise ConnectionError(f"no new state of the joints for {now - self._heard:.2f} s")
        return self._reading

    def command(self, command: JointCommand) -> None:
        """Send a goal, and wait until the next one is due."""
        self._transport.send_goal(make_goal(self.joint_names, command, self.period_s))
        now = time.monotonic()
        self._due = max(self._due + self.period_s, now - self.period_s)
        if self._due > now:
            time.sleep(self._due - now)

    def _read(self, state: Mapping[str, Any]) -> RobotReading:
        """Return a state as a reading in the order of the first one (KeyError, TypeError, ValueError: it is none)."""
        names = [str(name) for name in state["name"]]
        order = [names.index(name) for name in self.joint_names]
        q, qd, torque = (_read_numbers(state[key], len(names)) for key in ("position", "velocity", "effort"))
        if not len(q):
            raise ValueError("position is empty")
        return RobotReading(
            time_s=float(state["stamp"]) - self._begin_s,
            q=q[order],
            qd=qd[order] if len(qd) else np.zeros(len(order)),
            imu_rotation=np.eye(3),
            imu_angular_velocity=np.zeros(3),
            imu_acceleration=np.array(GRAVITY),
            foot_wrenches={},
            torque=torque[order] if len(torque) else torque,
        )


def make_goal(names: Sequence[str], command: JointCommand, period_s: float) -> dict[str, Any]:
    """Return a goal that follows a command for a period and comes to rest after it, with constant deceleration."""
    rest = command.q + 0.5 * STOP_S * command.qd
    return {
        "joint_names": list(names),
        "points": [
            {"positions": command.q.tolist(), "velocities": command.qd.tolist(), "time_from_start": period_s},
            {
                "positions": rest.tolist(),
                "velocities": [0.0] * len(names),
                "time_from_start": period_s + STOP_S,
            },
        ],
    }


class TrajectoryRobot:
    """The robot ``trajectory`` for one plan after the other."""

    is_simulated = False

    def __init__(self, driver: TrajectoryDriver, transport: TrajectoryTransport) -> None:
        self._driver, self._transport = driver, transport

    def drive(self, reference: PlannedReference, folder: Path, is_placed: bool, tolerance: float) -> RobotDriver:
        """Return the one driver of the robot."""
        return self._driver

    def follow(self, phase: int) -> None:
        """Nothing: grippers have controllers of their own."""

    def pose_world_base(self) -> Float[np.ndarray, "4 4"] | None:
        """Nothing measures the base."""
        return None

    def close(self) -> None:
        """Let go of the controller."""
        self._transport.close()


def open_trajectory(options: Mapping[str, str]) -> TrajectoryRobot:
    """Open the robot ``trajectory``, whose options are ``transport`` (``module:function``) and ``period_ms``.

    Raises:
        RequestError: an option is wrong.
        ExecutionError: the controller does not answer.
    """
    others = {key: value for key, value in options.items() if key != "transport"}
    period_ms = read_options("trajectory", others, DEFAULTS)["period_ms"]
    if not 1.0 <= period_ms <= 100.0:
        raise RequestError(f"--robot trajectory: period_ms {period_ms:g}; expected 1 to 100")
    name = options.get("transport", "")
    module, colon, attribute = name.partition(":")
    if not (module and colon and attribute):
        raise RequestError(f"--robot trajectory: transport: expected MODULE:FUNCTION, got {shown(name)}")
    try:
        open_transport: OpenTrajectoryTransport = getattr(import_module(module), attribute)
        transport = open_transport()
    except Exception as error:  # foreign code
        raise RequestError(f"--robot trajectory: transport {shown(name)} cannot be opened: {error}") from None
    try:
        return TrajectoryRobot(TrajectoryDriver(transport, 1e-3 * period_ms), transport)
    except ExecutionError:
        transport.close()
        raise


def _read_numbers(values: Any, n: int) -> np.ndarray:
    """Return n numbers, or none of them, as an array (ValueError where their number is another)."""
    array = np.asarray(values, dtype=float)
    if array.shape not in ((n,), (0,)):
        raise ValueError(f"expected {n} numbers, got {array.size}")
    return array
