"""A planner service in a process of its own, as a user starts it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from planner_calls import LONGEST_S

READY = "listening on "
START_S = 300.0


@dataclass
class ServerProcess:
    """A server that answers."""

    process: subprocess.Popen[str]
    address: str
    log: Path

    def stop(self, number: int = signal.SIGTERM, within_s: float = 120.0) -> int:
        """Send a signal and wait; the exit code."""
        self.process.send_signal(number)
        return self.process.wait(within_s)


@contextmanager
def planner_server(
    data: Path, *arguments: str, workers: int = 1, listen: str = "127.0.0.1:0"
) -> Iterator[ServerProcess]:
    """``scopt serve`` in a process of its own; killed at the end if it still runs."""
    process, log = _started(data, "--listen", listen, "--workers", str(workers), *arguments)
    assert process.stdout is not None
    try:
        line = process.stdout.readline().strip()
        if not line.startswith(READY):
            raise AssertionError(f"the server said {line!r}; {log.read_text()}")
        yield ServerProcess(process, line.removeprefix(READY), log)
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


def never_ready(
    data: Path, *arguments: str, at_start: Callable[[int], object] | None = None, within_s: float = START_S
) -> tuple[int, str]:
    """``scopt serve`` that ends before it listens: its exit code, and all it said.

    Args:
        at_start: told the number of the process.
    """
    listen = () if "--listen" in arguments else ("--listen", "127.0.0.1:0")
    process, log = _started(data, *listen, "--workers", "1", *arguments)
    try:
        if at_start is not None:
            at_start(process.pid)
        assert process.stdout is not None
        said = process.stdout.readline()  # nothing, once it has ended
        if said.startswith(READY):
            raise AssertionError(f"the server is {said}")
        rest, _ = process.communicate(timeout=within_s)
    finally:
        process.kill()
        process.wait()
    return process.returncode, said + rest + log.read_text()


def _started(data: Path, *arguments: str) -> tuple[subprocess.Popen[str], Path]:
    log = data.parent / f"{data.name}.log"
    with log.open("a") as errors:
        process = subprocess.Popen(
            [*_program(), "--data", str(data), *_allowance(arguments), *arguments],
            stdout=subprocess.PIPE,
            stderr=errors,
            text=True,
            env={**os.environ, "OMP_NUM_THREADS": "1"},
        )
    return process, log


def _allowance(arguments: Sequence[str]) -> Sequence[str]:
    """What lets ``ENDLESS`` in; a configuration file says for itself what it allows."""
    return () if "--config" in arguments else ("--budget", f"joint_goal={LONGEST_S:g}")


def _program() -> Sequence[str]:
    return (sys.executable, "-c", "from service.cli.app import main; main()", "serve")
