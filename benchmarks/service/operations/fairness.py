"""A polite client beside a greedy one: twenty calls at once without a pause against two that come back as told.

Once more with batch requests of the greedy client.
"""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import grpc

from benchmarks.service import asks
from benchmarks.service.figures import Figure, Options, spread
from benchmarks.service.servers import started
from service.client.errors import read_error
from service.proto.planner.v1.planner_pb2 import (
    PRIORITY_BATCH,
    PRIORITY_INTERACTIVE,
    ListRobotsRequest,
    PlanRequest,
    PlanResponse,
    Priority,
)
from service.proto.planner.v1.planner_pb2_grpc import PlannerServiceStub
from service.trust import Role, make_token

WORKERS, QUEUE, GREEDY, POLITE = 2, 4, 20, 2
FAIR_SHARE, LIGHT_S = 0.45, 0.5


@dataclass
class _Counts:
    """Outcomes by client, and durations [s]."""

    codes: dict[str, Counter[str]] = field(default_factory=lambda: {"greedy": Counter(), "polite": Counter()})
    took: dict[str, list[float]] = field(default_factory=lambda: {"greedy": [], "polite": [], "light": []})


def measure(options: Options, folder: Path) -> list[Figure]:
    """Measure shares for a minute, and for another one with a greedy batch."""
    tokens = {name: make_token(name, list(Role)) for name in ("greedy", "polite")}
    file = folder / "tokens.yaml"
    file.write_text("\n".join(line for _, line in tokens.values()))
    file.chmod(0o600)
    arguments = ("--tokens", str(file), "--requests-per-s", "100000")
    with started(folder, *arguments, workers=WORKERS, queue=QUEUE) as server:
        seconds = options.time_s(60.0, 10.0)
        secrets = {name: token for name, (token, _) in tokens.items()}
        return [
            figure
            for priority in (PRIORITY_INTERACTIVE, PRIORITY_BATCH)
            for figure in _figures(asyncio.run(_load(server.address, secrets, seconds, priority)), priority)
        ]


def _figures(counts: _Counts, priority: Priority) -> list[Figure]:
    done = {name: codes["OK"] for name, codes in counts.codes.items()}
    share = done["polite"] / max(sum(done.values()), 1)
    refused = counts.codes["polite"]["RESOURCE_EXHAUSTED"]
    what = "greedy batch ones" if priority == PRIORITY_BATCH else "greedy ones"
    return [
        Figure(
            f"{POLITE} polite calls beside {GREEDY} {what}: share of {sum(done.values())} plans",
            f">= {FAIR_SHARE:.0%}",
            f"{share:.0%}, refused {refused} times",
            share >= FAIR_SHARE,
        ),
        Figure("  duration of a polite plan", "", spread(counts.took["polite"])),
        Figure("  duration of a greedy plan", "", spread(counts.took["greedy"])),
        Figure(
            "  ListRobots of the polite client meanwhile",
            f"longest <= {LIGHT_S:g} s",
            spread(counts.took["light"]),
            max(counts.took["light"], default=9.0) <= LIGHT_S,
        ),
    ]


async def _load(address: str, tokens: dict[str, str], seconds: float, greedy: Priority) -> _Counts:
    """Send calls of both clients; ``greedy`` is the priority of one of them."""
    counts, until = _Counts(), time.monotonic() + seconds
    metadata = {name: (("authorization", f"Bearer {token}"),) for name, token in tokens.items()}
    requests = {"polite": asks.plan_request(asks.OVER_A_TABLE), "greedy": asks.plan_request(asks.OVER_A_TABLE)}
    requests["greedy"].priority = greedy
    async with grpc.aio.insecure_channel(address) as channel:
        stub = PlannerServiceStub(channel)  # type: ignore[no-untyped-call]

        async def plan(name: str) -> None:
            while time.monotonic() < until:
                began, delay = time.monotonic(), 0.0
                try:
                    await _finish(stub, requests[name], metadata[name])
                    counts.codes[name]["OK"] += 1
                    counts.took[name].append(time.monotonic() - began)
                except grpc.aio.AioRpcError as error:
                    refusal = read_error(error)
                    counts.codes[name][refusal.code.name] += 1
                    delay = 0.005 if name == "greedy" else refusal.retry_delay_s or 1.0
                await asyncio.sleep(delay)

        async def list_robots() -> None:
            await stub.ListRobots(ListRobotsRequest(), metadata=metadata["polite"])
            while time.monotonic() < until:
                began = time.monotonic()
                await stub.ListRobots(ListRobotsRequest(), metadata=metadata["polite"])
                counts.took["light"].append(time.monotonic() - began)
                await asyncio.sleep(0.2)

        clients = [plan("greedy") for _ in range(GREEDY)] + [plan("polite") for _ in range(POLITE)]
        await asyncio.gather(*clients, list_robots())
    return counts


async def _finish(stub: PlannerServiceStub, request: PlanRequest, metadata: tuple[tuple[str, str], ...]) -> None:
    call = stub.Plan(request, metadata=metadata, timeout=120.0)
    response: PlanResponse
    async for response in call:
        del response
