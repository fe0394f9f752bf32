"""The robot ``udp``: one that follows joint commands in datagrams, such as ``examples/08_a_robot_over_udp.py``.

Every datagram is a JSON object. The driver first sends ``{"hello": 1}`` until the robot answers with ``joint_names``,
``period_s`` and its reading. Then it sends a command per cycle, ``{"n", "q", "qd", "tau"}``, and the robot answers each
with a reading, ``{"n", "time_s", "q", "qd", "torque"}``, which may have ``imu_rotation`` (9 numbers, row by row),
``imu_angular_velocity``, ``imu_acceleration``, ``foot_wrenches`` (six numbers by link) and ``base_offset`` (16 numbers,
row by row). Units are those of ``RobotReading``. Before the first command the driver says hello again for every
reading. What is late or unreadable is left out; the guards of the execution see how old the last reading is.
"""

from __future__ import annotations

import json
import socket
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from service.errors import ExecutionError, RequestError, shown
from service.execution.driver import JointCommand, RobotDriver, RobotReading
from service.execution.reference import PlannedReference

HELLO = b'{"hello": 1}'
HELLO_S = 5.0  # in which the robot has to answer
AGAIN_S = 0.2  # between two hellos
SILENT_S = 0.1  # without a reading, after which the driver says so
MAX_BYTES = 65507
GRAVITY = (0.0, 0.0, 9.81)


class UdpDriver:
    """A robot at the other end of a socket; implements ``RobotDriver``."""

    def __init__(self, host: str, port: int) -> None:
        """Greet the robot.

        Raises:
            ExecutionError: one sentence: it does not answer, or not as it should.
        """
        self._name = f"{host}:{port}"
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.connect((host, port))
            hello = self._greet()
            self.joint_names = tuple(str(name) for name in hello["joint_names"])
            self.period_s = float(hello["period_s"])
            if not 5e-4 <= self.period_s <= 0.1:
                raise ValueError(f"period_s {self.period_s:g}; expected 0.0005 to 0.1")
            self._reading = self._read_message(hello)
        except (OSError, KeyError, TypeError, ValueError) as error:
            self._socket.close()
            raise ExecutionError(f"the robot at {self._name} does not answer as it should: {error}") from None
        self._socket.setblocking(False)
        self._heard = self._due = time.monotonic()
        self._n = 0

    def read(self) -> RobotReading:
        """Return the newest reading.

        Raises:
            ConnectionError: none has come for so long that the robot cannot be said to answer.
        """
        if self._n == 0:  # nothing is commanded yet, so that only a greeting is answered
            with suppress(OSError):
                self._socket.send(HELLO)
        while True:
            try:
                data = self._socket.recv(MAX_BYTES)
            except BlockingIOError:
                break
            except OSError:  # such as a port that nobody listens on
                break
            try:
                self._reading = self._read_message(json.loads(data))
                self._heard = time.monotonic()
            except (KeyError, TypeError, ValueError):
                continue
        silent_s = time.monotonic() - self._heard
        if silent_s > SILENT_S:
            raise ConnectionError(f"no reading from {self._name} for {silent_s:.2f} s")
        return self._reading

    def command(self, command: JointCommand) -> None:
        """Send a command, and wait until the next one is due."""
        self._n += 1
        values = {"q": command.q.tolist(), "qd": command.qd.tolist(), "tau": command.tau.tolist()}
        self._socket.send(json.dumps({"n": self._n, **values}).encode())
        now = time.monotonic()
        self._due = max(self._due + self.period_s, now - self.period_s)
        if self._due > now:
            time.sleep(self._due - now)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def _greet(self) -> Mapping[str, Any]:
        self._socket.settimeout(AGAIN_S)
        end = time.monotonic() + HELLO_S
        while time.monotonic() < end:
            try:
                self._socket.send(HELLO)
                answer = json.loads(self._socket.recv(MAX_BYTES))
            except (TimeoutError, ConnectionRefusedError):
                time.sleep(0.01)
                continue
            if isinstance(answer, dict) and "joint_names" in answer:
                return answer
        raise ValueError(f"no answer within {HELLO_S:g} s")

    def _read_message(self, message: Mapping[str, Any]) -> RobotReading:
        n, base = len(self.joint_names), message.get("base_offset")
        return RobotReading(
            time_s=float(message["time_s"]),
            q=_read_numbers(message["q"], n),
            qd=_read_numbers(message["qd"], n),
            imu_rotation=_read_numbers(message.get("imu_rotation", np.eye(3).ravel()), 9).reshape(3, 3),
            imu_angular_velocity=_read_numbers(message.get("imu_angular_velocity", np.zeros(3)), 3),
            imu_acceleration=_read_numbers(message.get("imu_acceleration", GRAVITY), 3),
            foot_wrenches={str(k): _read_numbers(v, 6) for k, v in message.get("foot_wrenches", {}).items()},
            torque=_read_numbers(message.get("torque", ()), None if message.get("torque") is None else n),
            base_offset=None if base is None else _read_numbers(base, 16).reshape(4, 4),
        )


class UdpRobot:
    """The robot ``udp`` for one plan after the other."""

    is_simulated = False

    def __init__(self, driver: UdpDriver) -> None:
        self._driver = driver

    def drive(self, reference: PlannedReference, folder: Path, is_placed: bool, tolerance: float) -> RobotDriver:
        """Return the one driver of the robot."""
        return self._driver

    def follow(self, phase: int) -> None:
        """Nothing: grippers are the robot's own."""

    def pose_world_base(self) -> Float[np.ndarray, "4 4"] | None:
        """Nothing measures the base."""
        return None

    def close(self) -> None:
        """Close the socket."""
        self._driver.close()


def open_udp(options: Mapping[str, str]) -> UdpRobot:
    """Open the robot ``udp``, whose options are ``host`` and ``port``.

    Raises:
        RequestError: an option is wrong.
        ExecutionError: the robot does not answer.
    """
    for key in options:
        if key not in ("host", "port"):
            raise RequestError(f"--robot udp: unknown option {shown(key)}; expected host, port")
    port = options.get("port", "")
    if not port.isdigit() or not 0 < int(port) < 2**16:
        raise RequestError(f"--robot udp: port: expected 1 to 65535, got {shown(port)}; such as udp,port=7007")
    return UdpRobot(UdpDriver(options.get("host", "127.0.0.1"), int(port)))


def _read_numbers(values: Any, n: int | None) -> np.ndarray:
    """Return numbers as an array (ValueError where their number is another)."""
    array = np.asarray(values, dtype=float)
    if n is not None and array.shape != (n,):
        raise ValueError(f"expected {n} numbers, got {array.size}")
    return array
