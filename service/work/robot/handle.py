"""A robot's process as the service sees it: it takes orders, and its state is always at hand."""

from __future__ import annotations

import asyncio
import itertools
import json
import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import structlog

from service.errors import ExecutionError

_LOG = structlog.get_logger("scopt.robot")
START_S = 120.0
ANSWER_S = 120.0  # a plan that is loaded is verified before
END_S = 2.0  # for a process whose socket was closed
LINE_BYTES = 2**22
LOST = {
    "mode": "lost", "phase": "", "reason": "", "findings": [], "speed": 1.0, "last_order": "",
}  # fmt: skip


@dataclass
class RobotState:
    """The last that a robot has told, by part.

    Attributes:
        status, plan, pose: as ``Runner`` tells them; empty until then.
        time: when the last of them came [s since 1970].
    """

    status: Mapping[str, Any] = field(default_factory=lambda: dict(LOST))
    plan: Mapping[str, Any] = field(default_factory=dict)
    pose: Mapping[str, Any] = field(default_factory=dict)
    time: float = 0.0


class RobotProcess:
    """A robot in a process of its own, for one event loop.

    Args:
        robot: as ``--robot`` names it.
        policy: what it does when the service has gone: ``hold`` or ``finish``.
        on_change: called after every message with the part of the state that changed.

    Attributes:
        state: the last that it told.
        is_simulated: whether it can be put anywhere.
    """

    def __init__(self, robot: str, policy: str, on_change: Callable[[str], None]) -> None:
        self.robot = robot
        self.state = RobotState()
        self.is_simulated = False
        self._policy = policy
        self._on_change = on_change
        self._process: subprocess.Popen[bytes] | None = None
        self._writer: asyncio.StreamWriter | None = None
        self._reading: asyncio.Task[None] | None = None
        self._numbers = itertools.count(1)
        self._answers: dict[int, asyncio.Future[Mapping[str, Any]]] = {}

    @property
    def is_alive(self) -> bool:
        """Whether the process answers."""
        return self._writer is not None

    async def start(self) -> None:
        """Start the process and wait until it has its robot.

        Raises:
            ExecutionError: one sentence: the robot cannot be used, or did not answer in time.
        """
        ours, theirs = socket.socketpair()
        command = [sys.executable, "-m", "service.work.robot.process", str(theirs.fileno()), self.robot, self._policy]
        with theirs:
            self._process = subprocess.Popen(
                command,
                pass_fds=(theirs.fileno(),),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                start_new_session=True,  # a Ctrl-C in the service's terminal is not for it
                env={**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
            )
        reader, self._writer = await asyncio.open_connection(sock=ours, limit=LINE_BYTES)
        try:
            async with asyncio.timeout(START_S):
                line = await reader.readline()
        except TimeoutError:
            line = b""
        first = json.loads(line) if line else {"ready": False, "error": "its process ended, or did not answer in time"}
        if not first["ready"]:
            await self.close()
            raise ExecutionError(f"the robot {self.robot!r} cannot be used: {first['error']}")
        self.is_simulated = bool(first["is_simulated"])
        self._reading = asyncio.create_task(self._read(reader))

    async def order(self, name: str, **values: Any) -> Mapping[str, Any]:
        """Give an order and wait for its answer, which comes after the control cycle that obeyed it.

        Raises:
            ExecutionError: one sentence: it is refused, or the robot does not answer.
        """
        if self._writer is None:
            raise ExecutionError(f"{name}: the robot's process has ended; load a plan to start it again")
        number = next(self._numbers)
        answer = self._answers[number] = asyncio.get_running_loop().create_future()
        try:
            self._writer.write(json.dumps({"id": number, "order": name, **values}).encode() + b"\n")
            async with asyncio.timeout(ANSWER_S):
                made: Mapping[str, Any] = await answer
        except (TimeoutError, ConnectionError):
            raise ExecutionError(f"{name}: the robot does not answer") from None
        finally:
            self._answers.pop(number, None)
        if made["error"]:
            raise ExecutionError(str(made["error"]))
        return made

    async def close(self) -> None:
        """Close the connection: the process ends after its policy, a simulated robot's at once."""
        writer, self._writer = self._writer, None
        if self._reading is not None:
            self._reading.cancel()
        if writer is not None:
            writer.close()
        process = self._process
        if process is None:
            return
        if self.is_simulated:
            process.kill()
        await asyncio.to_thread(_wait, process)

    async def _read(self, reader: asyncio.StreamReader) -> None:
        with suppress(ConnectionError, ValueError):
            while line := await reader.readline():
                self._take(json.loads(line))
        self._end()

    def _take(self, message: Mapping[str, Any]) -> None:
        if "id" in message:
            answer = self._answers.get(message["id"])
            if answer is not None and not answer.done():
                answer.set_result(message)
            return
        self.state.time = time.time()
        for part, value in message.items():
            setattr(self.state, part, value)
        for part in message:
            self._on_change(part)

    def _end(self) -> None:
        """Note that the process has ended by itself."""
        self._writer = None
        code = None if self._process is None else self._process.poll()
        _LOG.error("the robot's process has ended", robot=self.robot, exit_code=code)
        reason = "the robot's process has ended; whether the robot holds its pose is for its servos to say"
        self.state.status = {**LOST, "reason": reason, "last_order": self.state.status["last_order"]}
        self.state.time = time.time()
        for answer in self._answers.values():
            if not answer.done():
                answer.set_result({"error": reason})
        self._on_change("status")


def _wait(process: subprocess.Popen[bytes]) -> None:
    with suppress(subprocess.TimeoutExpired):
        process.wait(END_S)
