"""The process of a robot: ``python -m service.work.robot.process FD ROBOT hold|finish``.

It talks with the service over a socket, a line of JSON per message. When the service has gone, the robot ends as its
policy says, and the process with it.
"""

from __future__ import annotations

import json
import os
import socket
import sys
from collections.abc import Mapping
from contextlib import suppress
from threading import Lock, Thread
from typing import Any, BinaryIO

from service.errors import ServiceError
from service.work.robot.robot import open_robot
from service.work.robot.runner import Runner

HOLD, FINISH = "hold", "finish"
POLICIES = (HOLD, FINISH)  # of ``--when-alone``


def run(channel: socket.socket, robot_text: str, policy: str) -> int:
    """Open a robot and run it; return the exit code."""
    writer, lock = channel.makefile("wb"), Lock()

    def tell(message: Mapping[str, Any]) -> None:
        with lock, suppress(OSError, ValueError):  # the service has gone: nobody hears it
            writer.write(json.dumps(message).encode() + b"\n")
            writer.flush()

    try:
        robot = open_robot(robot_text)
    except ServiceError as error:
        tell({"ready": False, "error": " ".join(str(error).split())})
        return 1
    runner = Runner(robot, tell, holds_alone=policy == HOLD)
    tell({"ready": True, "is_simulated": robot.is_simulated})
    Thread(target=_listen, args=(channel.makefile("rb"), runner), name="orders", daemon=True).start()
    runner.run()
    return 0


def _listen(reader: BinaryIO, runner: Runner) -> None:
    with suppress(OSError):
        for line in reader:
            runner.give(json.loads(line))
    runner.leave_alone()


def main() -> None:
    """Run the robot that the arguments name."""
    descriptor, robot, policy = sys.argv[1:4]
    code = run(socket.socket(fileno=int(descriptor)), robot, policy)
    sys.stderr.flush()
    os._exit(code)  # threads of drivers must not keep a robot's process alive


if __name__ == "__main__":
    main()
