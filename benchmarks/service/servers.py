"""Servers started as by a user, and their processes."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import grpc

from benchmarks.service import asks
from service.executor.linux import rss_bytes
from service.proto.planner.v1.planner_pb2 import GetStatusRequest, GetStatusResponse
from service.proto.planner.v1.planner_pb2_grpc import PlannerServiceStub

READY = "listening on "
MIB = 2.0**20


@dataclass(frozen=True)
class Server:
    """A running server.

    Attributes:
        process: of ``scopt serve``; address: its address.
        log: file with its standard error.
    """

    process: subprocess.Popen[str]
    address: str
    log: Path

    @contextmanager
    def stub(self) -> Iterator[PlannerServiceStub]:
        """Yield a blocking client stub."""
        with grpc.insecure_channel(self.address) as channel:
            yield PlannerServiceStub(channel)  # type: ignore[no-untyped-call]

    def status(self) -> GetStatusResponse:
        """Return its status."""
        with self.stub() as stub:
            status: GetStatusResponse = stub.GetStatus(GetStatusRequest(), timeout=20)
            return status

    def workers(self) -> list[int]:
        """Return the process ids of the running workers."""
        return [worker.pid for worker in self.status().workers if worker.pid]

    def resident_mib(self) -> tuple[float, float]:
        """Return the memory of the server and of its largest worker [MiB]."""
        return rss_bytes(self.process.pid) / MIB, max((rss_bytes(pid) for pid in self.workers()), default=0) / MIB

    def is_alive(self) -> bool:
        """Return whether it still runs."""
        return self.process.poll() is None

    def incident_lines(self) -> list[str]:
        """Return the lines of its log that report an incident."""
        return [line for line in self.log.read_text().splitlines() if "incident" in line or "Traceback" in line]

    def incidents(self) -> int:
        """Return the number of incidents."""
        return len(self.incident_lines())

    def kill(self) -> None:
        """As ``kill -9`` does."""
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()


@contextmanager
def started(folder: Path, *arguments: str, workers: int = 2, queue: int = 4) -> Iterator[Server]:
    """Run ``scopt serve`` in a new process; kill it at the end.

    Args:
        folder: of its data, robots and log; existing files are used again.
    """
    robots = asks.robots(folder / "robots")
    log = folder / "server.log"
    program = (sys.executable, "-c", "from service.cli.app import main; main()", "serve", "--listen", "127.0.0.1:0")
    options = ("--data", str(folder / "data"), "--robots", str(robots), "--workers", str(workers))
    with log.open("a") as errors:
        process = subprocess.Popen(
            [*program, *options, "--queue", str(queue), *arguments],
            stdout=subprocess.PIPE,
            stderr=errors,
            text=True,
            env={**os.environ, "OMP_NUM_THREADS": "1"},
        )
    assert process.stdout is not None
    try:
        line = process.stdout.readline().strip()
        if not line.startswith(READY):
            raise RuntimeError(f"the server said {line!r}; {log.read_text()}")
        yield Server(process, line.removeprefix(READY), log)
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


def kill(pid: int) -> bool:
    """Kill a process (``kill -9``); return whether it existed."""
    with suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)
        return True
    return False


def descendants(pid: int) -> dict[int, str]:
    """Return all descendants of a process with their start times, since process ids are reused."""
    parents: dict[int, list[int]] = {}
    born: dict[int, str] = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            with suppress(OSError):
                fields = (entry / "stat").read_text().rpartition(")")[2].split()
                parents.setdefault(int(fields[1]), []).append(int(entry.name))
                born[int(entry.name)] = fields[19]
    found: dict[int, str] = {}
    left = [pid]
    while left:
        for child in parents.get(left.pop(), ()):
            found[child] = born[child]
            left.append(child)
    return found


def still_there(processes: dict[int, str]) -> list[int]:
    """Return the processes that still run, without zombies."""
    there = []
    for pid, born in processes.items():
        with suppress(OSError):
            fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
            if fields[19] == born and fields[0] != "Z":
                there.append(pid)
    return there
