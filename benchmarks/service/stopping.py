"""Time until a stopped worker is free: after a cancelled call, after a deadline, in a call that never returns.

There is one worker, and one plan always waits behind the running one; the worker is free at that plan's first report.
"""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import AsyncIterator
from concurrent.futures import wait
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import Any

import grpc

from benchmarks.service import asks
from benchmarks.service.figures import Figure, Options, ms, percentile, spread
from benchmarks.service.servers import Server, started
from benchmarks.service.stuck import stuck_in_native_code, tell
from service.executor.local_pool import LocalPool
from service.proto.planner.v1.planner_pb2 import GetStatusRequest, PlanResponse
from service.proto.planner.v1.planner_pb2_grpc import PlannerServiceStub

BEYOND_ITERATION_S, STUCK_S = 20e-3, 0.3
LONGEST_S = 2.5  # latest time at which a solve is stopped
SOONEST_DEADLINE_S = 0.8
LONG_S = 60.0  # ENDLESS does not take as long


@dataclass
class _Iterations:
    """Durations of the optimiser's iterations, from the times of their reports [s]."""

    seconds: list[float] = field(default_factory=list)
    _last: tuple[str, int, float] | None = None

    def take(self, response: PlanResponse) -> None:
        """Record a report."""
        if not response.progress.HasField("iteration"):
            return
        step, index, now = response.progress.step, response.progress.iteration.index, time.monotonic()
        if self._last is not None and self._last[0] == step and 0 < index - self._last[1] <= 5:
            self.seconds.append((now - self._last[2]) / (index - self._last[1]))
        self._last = step, index, now


class _Solve:
    """A requested plan without end; its answers are read continuously."""

    def __init__(self, stub: PlannerServiceStub, iterations: _Iterations, timeout_s: float | None = None) -> None:
        self.call = stub.Plan(asks.plan_request(asks.ENDLESS), timeout=timeout_s)
        self.is_queued = asyncio.Event()  # or refused
        self.began: asyncio.Future[float] = asyncio.get_running_loop().create_future()
        self._reading = asyncio.create_task(self._read(iterations))

    async def _read(self, iterations: _Iterations) -> None:
        try:
            async for response in self.call:
                self.is_queued.set()
                if response.WhichOneof("event") == "progress" and not self.began.done():
                    self.began.set_result(time.monotonic())
                iterations.take(response)
        except (grpc.aio.AioRpcError, asyncio.CancelledError):
            pass
        finally:
            self.is_queued.set()
            if not self.began.done():
                self.began.set_result(float("nan"))

    async def end(self) -> None:
        """Stop it."""
        self.call.cancel()
        await self._reading


def measure(options: Options, folder: Path) -> list[Figure]:
    """Measure cancels, deadlines and a stuck call."""
    n = options.count(240, 12)
    iterations = _Iterations()
    random = Random(options.seed)
    with started(folder, workers=1, queue=4) as server:
        after_cancel = asyncio.run(_cancels(server, n, random, iterations))
        killed = server.status().worker_restarts
    with started(folder, workers=1, queue=4) as server:  # a new server, without estimates of these plans' durations
        after_deadline = asyncio.run(_deadlines(server, n // 2, random, iterations))
        killed_late = server.status().worker_restarts
    one = percentile(iterations.seconds, 50)
    limit = percentile(iterations.seconds, 99) + BEYOND_ITERATION_S
    ended, begun = _stuck(options.count(20, 3))
    rule = f"p99 <= iteration's p99 + 20 ms ({ms(limit)})"
    return [
        Figure("one iteration of the solves that are stopped", "", f"{spread(iterations.seconds)}"),
        Figure(
            f"cancel to the start of the next plan ({len(after_cancel)} cancels; {killed} workers had to be killed)",
            rule,
            spread(after_cancel),
            percentile(after_cancel, 99) <= limit and one > 0,
        ),
        Figure(
            f"deadline to the start of the next plan ({len(after_deadline)} deadlines; {killed_late} workers killed; "
            "before it: negative)",
            rule,
            spread(after_deadline),
            percentile(after_deadline, 99) <= limit,
        ),
        Figure(f"cancel of a stuck native call to its end ({len(ended)})", "p99 <= 300 ms", spread(ended),
               percentile(ended, 99) <= STUCK_S),
        Figure("  and to the next job's begin in a new worker", "", spread(begun)),
    ]  # fmt: skip


async def _cancels(server: Server, n: int, random: Random, iterations: _Iterations) -> list[float]:
    """Return the times from a client's cancel to the first report of the waiting plan [s]."""
    found: list[float] = []
    async for stub in _stub(server):
        running = _Solve(stub, iterations)
        await running.began
        while len(found) < n:
            waiting = _Solve(stub, iterations)
            await waiting.is_queued.wait()
            await asyncio.sleep(random.uniform(0.0, LONGEST_S))
            cancelled = time.monotonic()
            await running.end()
            found.append(await waiting.began - cancelled)
            running = waiting
        await running.end()
    return found


async def _deadlines(server: Server, n: int, random: Random, iterations: _Iterations) -> list[float]:
    """Return the times from a deadline to the first report of the waiting plan [s]."""
    found: list[float] = []
    async for stub in _stub(server):
        for _ in range(n):
            left = random.uniform(SOONEST_DEADLINE_S, LONGEST_S)
            deadline = time.monotonic() + left
            bound = _Solve(stub, iterations, left)
            await bound.began
            waiting = _Solve(stub, iterations)
            began = await waiting.began
            if await bound.call.code() is grpc.StatusCode.OK or began > deadline:
                found.append(began - deadline)
            await waiting.end()
            await _until_idle(stub)
    return found


async def _stub(server: Server) -> AsyncIterator[PlannerServiceStub]:
    async with grpc.aio.insecure_channel(server.address) as channel:
        yield PlannerServiceStub(channel)  # type: ignore[no-untyped-call]


async def _until_idle(stub: Any) -> None:
    while any(worker.state != "idle" for worker in (await stub.GetStatus(GetStatusRequest())).workers):
        await asyncio.sleep(0.01)


def _stuck(n: int) -> tuple[list[float], list[float]]:
    """Return the times from cancelling a stuck job to its end and to the start of the next job [s]."""
    ended, begun = [], []
    with LocalPool(1, preload=("benchmarks.service.stuck",)) as pool:
        for _ in range(n):
            pool.wait_ready()
            is_stuck, is_next = threading.Event(), threading.Event()
            stuck = pool.submit(stuck_in_native_code, on_event=lambda _, it=is_stuck: it.set())
            after = pool.submit(tell, on_event=lambda _, it=is_next: it.set())
            is_stuck.wait()
            time.sleep(0.02)
            began = time.monotonic()
            stuck.cancel()
            wait([stuck])
            ended.append(time.monotonic() - began)
            is_next.wait()
            begun.append(time.monotonic() - began)
            after.result()
    return ended, begun
