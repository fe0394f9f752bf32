"""A planner service in a process of its own, as a user starts it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

READY = "listening on "
START_S = 120.0


@dataclass
class ServerProcess:
    """A server that answers."""

    process: subprocess.Popen[str]
    address: str
    log: Path

    def stop(self, number: int = signal.SIGTERM, within_s: float = 60.0) -> int:
        """Send a signal and wait; the exit code."""
        self.process.send_signal(number)
        return self.process.wait(within_s)


@contextmanager
def planner_server(
    data: Path, *arguments: str, workers: int = 1, listen: str = "127.0.0.1:0"
) -> Iterator[ServerProcess]:
    """``scopt serve`` in a process of its own; killed at the end if it still runs."""
    log = data.parent / f"{data.name}.log"
    with log.open("a") as errors:
        process = subprocess.Popen(
            [*_program(), "--listen", listen, "--data", str(data), "--workers", str(workers), *arguments],
            stdout=subprocess.PIPE,
            stderr=errors,
            text=True,
            env={**os.environ, "OMP_NUM_THREADS": "1"},
        )
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


def _program() -> Sequence[str]:
    return (sys.executable, "-c", "from service.cli import main; main()", "serve")
