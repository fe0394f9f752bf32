"""SIGSTOP and kill -9 of each process of a server during a plan: time until the answer, beyond the usual one."""

from __future__ import annotations

import os
import signal
import threading
import time
from pathlib import Path
from statistics import median
from typing import Any

import grpc

from benchmarks.service import asks
from benchmarks.service.figures import Figure, Options
from benchmarks.service.servers import Server, descendants, started
from service.proto.planner.v1.planner_pb2_grpc import PlannerServiceStub

MORE_S, SETTLE_S = 2.0, 4.0
AFTER_S = 0.3  # from the begin of the plan to the signal
REQUEST = {**asks.ENDLESS, "options": {"starts": 64, "time_limit_s": 1.5}}


def measure(options: Options, folder: Path) -> list[Figure]:
    """Signal every process once with each signal."""
    figures = []
    with started(folder, workers=2) as server:
        usual = median(_plan(server)[1] for _ in range(options.count(5, 2)))
        for number in (signal.SIGSTOP, signal.SIGKILL):
            for name, commands in _processes(server).items():
                code, took, was_there = _plan_with(server, commands, number)
                if was_there:
                    figures.append(_figure(f"{number.name} of the {name}", code, took, usual))
                time.sleep(SETTLE_S)
    with started(folder / "again", workers=2) as server:
        usual = median(_plan(server)[1] for _ in range(options.count(5, 2)))
        code, took, _ = _plan_with(server, ("scopt-forksrv", "scopt-standby"), signal.SIGKILL)
        name = "SIGKILL of the process that workers are forked from and of a standby at once"
        figures.append(_figure(name, code, took, usual))
    return figures


def _figure(name: str, code: str, took: float, usual: float) -> Figure:
    measured = f"{code} after {took:.1f} s, usually {usual:.1f} s"
    return Figure(name, f"answered within {MORE_S:g} s more", measured, code == "OK" and took - usual <= MORE_S)


def _processes(server: Server) -> dict[str, tuple[str, ...]]:
    """Return name and command of each kind of process."""
    names = {_name(pid) for pid in descendants(server.process.pid)}
    # The standby that takes over is no descendant of the server any more, so that it comes last.
    kinds = {
        "scopt-worker": "busy worker",
        "scopt-standby": "standby",
        "scopt-forksrv": "process that workers are forked from",
    }
    return {kinds[name]: (name,) for name in kinds if name in names}


def _plan_with(server: Server, processes: tuple[str, ...], number: signal.Signals) -> tuple[str, float, bool]:
    """Plan, and signal a process of each name meanwhile; returns code, duration [s], and whether there were any."""
    hit: list[int] = []

    def strike() -> None:
        busy = {worker.pid for worker in server.status().workers if worker.state == "busy"}
        for process in processes:
            pids = [pid for pid in descendants(server.process.pid) if _name(pid) == process]
            hit.extend([pid for pid in pids if process != "scopt-worker" or pid in busy][:1])
        for pid in hit:
            os.kill(pid, number)

    timer = threading.Timer(AFTER_S, strike)
    timer.start()
    code, took = _plan(server)
    timer.join()
    return code, took, bool(hit)


def _plan(server: Server) -> tuple[str, float]:
    began = time.monotonic()
    with grpc.insecure_channel(server.address) as channel:
        stub: Any = PlannerServiceStub(channel)  # type: ignore[no-untyped-call]
        call = stub.Plan(asks.plan_request(REQUEST), timeout=60.0)
        try:
            list(call)
        except grpc.RpcError:
            return call.code().name, time.monotonic() - began
    return "OK", time.monotonic() - began


def _name(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/comm").read_text().strip()
    except OSError:
        return ""
