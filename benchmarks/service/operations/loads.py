"""Mixed requests at 0.5 to 4 times the capacity, with random intervals, by a generator of its own.

Of a hundred calls sixty plan an arm, fifteen plan a reach with files, ten list robots, five ask for the status, five
fetch a stored plan, and five name an unknown robot.
"""

from __future__ import annotations

import asyncio
import multiprocessing
import time
from collections import Counter
from collections.abc import Awaitable, Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Any

import grpc
import numpy as np

from benchmarks.service import asks
from benchmarks.service.figures import Figure, Options, ms, percentile, spread
from benchmarks.service.servers import started
from service.client.errors import read_error
from service.proto.planner.v1 import planner_pb2 as wire
from service.proto.planner.v1.planner_pb2_grpc import PlannerServiceStub

FACTORS = (0.5, 1.0, 1.5, 2.0, 4.0)
SHARES = {"plan": 60, "files": 15, "robots": 10, "status": 5, "stored": 5, "wrong": 5}
HEAVY = ("plan", "files")
WORKERS, QUEUE, LIGHT_S, REFUSED_S = 2, 4, 0.1, 10e-3
EXPECTED = {"wrong": "INVALID_ARGUMENT"}
CHANNELS = 8
GROWTH, LONG_S = 0.05, 600.0  # a line fitted to a shorter run shows nothing


@dataclass(frozen=True)
class Sample:
    """One call: its kind, how it ended, and its duration [s]."""

    kind: str
    code: str
    took: float


def measure(options: Options, folder: Path) -> list[Figure]:
    """Measure each load for two minutes, 1.5 times the capacity for twenty."""
    figures = []
    with started(folder, "--requests-per-s", "100000", workers=WORKERS, queue=QUEUE) as server:
        with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as process:
            warm = process.submit(_run, server.address, 0.0, options.time_s(20.0, 5.0), 0).result()
            capacity = sum(sample.code == "OK" and sample.kind in HEAVY for sample in warm) / options.time_s(20.0, 5.0)
            rate = capacity * 100.0 / sum(SHARES[kind] for kind in HEAVY)
            for factor in FACTORS:
                seconds = options.time_s(1200.0 if factor == 1.5 else 120.0, 5.0)
                running = process.submit(_run, server.address, factor * rate, seconds, options.seed + 1)
                memory = []
                while not running.done():
                    memory.append((time.monotonic(), sum(server.resident_mib())))
                    time.sleep(1.0)
                figures += _figures(factor, running.result(), memory, seconds)
        incidents = server.incidents()
    return [
        Figure(f"capacity: {capacity:.1f} plans/s on {WORKERS} workers", "", ""),
        *figures,
        Figure("incidents in the log", "0", str(incidents), incidents == 0),
    ]


def _figures(factor: float, samples: list[Sample], memory: list[tuple[float, float]], seconds: float) -> list[Figure]:
    heavy = [sample for sample in samples if sample.kind in HEAVY]
    done = [sample.took for sample in heavy if sample.code == "OK"]
    refused = [sample.took for sample in heavy if sample.code == "RESOURCE_EXHAUSTED"]
    light = [sample.took for sample in samples if sample.kind not in HEAVY]
    odd = Counter(
        (sample.kind, sample.code)
        for sample in samples
        if sample.code not in (EXPECTED.get(sample.kind, "OK"), "RESOURCE_EXHAUSTED")
    )
    times, sizes = np.array(memory[len(memory) // 5 :] or memory).T
    slope = float(np.polyfit(times, sizes, 1)[0]) * 60.0 if len(times) > 2 else 0.0
    growth = slope * seconds / 60.0 / float(np.mean(sizes))
    is_long = seconds >= LONG_S
    return [
        Figure(f"{factor:g}x: {len(samples)} calls; {len(done) / seconds:.1f} plans/s, duration", "", spread(done)),
        Figure(f"  refused ({len(refused)})", f"p50 <= {ms(REFUSED_S)}", spread(refused),
               not refused or percentile(refused, 50) <= REFUSED_S),
        Figure(f"  light calls and wrong requests ({len(light)})", f"p99 <= {ms(LIGHT_S)}", spread(light),
               percentile(light, 99) <= LIGHT_S),
        Figure("  other codes", "0", ", ".join(f"{n} {' '.join(key)}" for key, n in odd.items()) or "0", not odd),
        Figure("  slope of the memory of server and largest worker", f"< {100 * GROWTH:g} % in all" if is_long else "",
               f"{slope:+.2f} MiB/min, {100 * growth:+.1f} %", growth < GROWTH if is_long else None),
    ]  # fmt: skip


def _run(address: str, rate: float, seconds: float, seed: int) -> list[Sample]:
    """Send calls at a rate [1/s]; with rate 0, as many as ``WORKERS`` clients can."""
    return asyncio.run(_send(address, rate, seconds, Random(seed)))


async def _send(address: str, rate: float, seconds: float, random: Random) -> list[Sample]:
    samples: list[Sample] = []
    channels = [grpc.aio.insecure_channel(address, [("grpc.use_local_subchannel_pool", 1)]) for _ in range(CHANNELS)]
    stubs: list[Any] = [PlannerServiceStub(channel) for channel in channels]  # type: ignore[no-untyped-call]
    latest = [await _plan(stubs[0], asks.ELBOW)]  # an old plan is removed when the store is full

    async def call(kind: str, stub: Any) -> None:
        began = time.monotonic()
        try:
            answer = await _calls(stub, latest[0])[kind]()
            code = "OK"
            if kind == "files" and answer:
                latest[0] = answer
        except grpc.aio.AioRpcError as error:
            code = read_error(error).code.name
        samples.append(Sample(kind, code, time.monotonic() - began))

    def draw() -> str:
        return random.choices(list(SHARES), list(SHARES.values()))[0]

    async def client(stub: Any) -> None:
        while time.monotonic() < until:
            await call(draw(), stub)

    at = time.monotonic()
    until = at + seconds
    if rate:
        open_calls = []
        while at < until:
            await asyncio.sleep(at - time.monotonic())
            open_calls.append(asyncio.create_task(call(draw(), random.choice(stubs))))
            at += random.expovariate(rate)
        await asyncio.gather(*open_calls)
    else:
        await asyncio.gather(*(client(stub) for stub in stubs[: WORKERS + 1]))
    for channel in channels:
        await channel.close(None)
    return samples


def _calls(stub: Any, stored: str) -> dict[str, Callable[[], Awaitable[object]]]:
    wrong = {**asks.ARM_TURNS, "robot": {"name": "arm8"}}
    return {
        "plan": lambda: _plan(stub, asks.ARM_TURNS),
        "files": lambda: _plan(stub, asks.OVER_A_TABLE, with_files=True),
        "robots": lambda: stub.ListRobots(wire.ListRobotsRequest()),
        "status": lambda: stub.GetStatus(wire.GetStatusRequest()),
        "stored": lambda: _read(stub.GetPlan(wire.GetPlanRequest(plan_id=stored))),
        "wrong": lambda: _plan(stub, wrong),
    }


async def _plan(stub: Any, request: Any, with_files: bool = False) -> str:
    responses = await _read(stub.Plan(asks.plan_request(request, with_files=with_files), timeout=120.0))
    return next((response.accepted.plan_id for response in responses if response.HasField("accepted")), "")


async def _read(call: Any) -> list[Any]:
    return [response async for response in call]
