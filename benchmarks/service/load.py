"""Load generator: asynchronous clients in a separate process, which report the outcome of every request."""

from __future__ import annotations

import asyncio
import multiprocessing
import time
from collections.abc import Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import count
from random import Random

import grpc

from service.proto.planner.v1.planner_pb2 import PlanRequest, PlanResponse
from service.proto.planner.v1.result_pb2 import Verdict

PLAN = "/planner.v1.PlannerService/Plan"
TIMEOUT_S = 120.0


@dataclass(frozen=True)
class Load:
    """Requests to send.

    Attributes:
        address: of the server.
        request: a serialized ``PlanRequest`` without an id.
        prefix: of the request ids.
        clients: number of clients that send a request as soon as the last is answered; 0 if ``rate`` is given.
        rate: of requests with random intervals, independent of earlier answers [1/s].
        seconds: duration of sending; open requests are then awaited.
        requests: largest number of requests.
        seed: of the times between requests.
    """

    address: str
    request: bytes
    prefix: str
    clients: int = 0
    rate: float = 0.0
    seconds: float = float("inf")
    requests: int = 10**9
    seed: int = 0


@dataclass(frozen=True)
class Call:
    """Outcome of one request.

    Attributes:
        request_id: its own.
        began: on the clock of ``time.monotonic`` [s]; took: until the call's end [s].
        code: how the call ended.
        plans: number of results received.
        verdict: of the last result; empty without one.
        planned_s: the planner's own time [s].
    """

    request_id: str
    began: float
    took: float
    code: str
    plans: int
    verdict: str
    planned_s: float


@contextmanager
def generating(load: Load) -> Iterator[Future[list[Call]]]:
    """Send a load from another process while the body runs."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as process:
        yield process.submit(send, load)


def send(load: Load) -> list[Call]:
    """Send a load."""
    return asyncio.run(_send(load))


async def _send(load: Load) -> list[Call]:
    async with grpc.aio.insecure_channel(load.address) as channel:
        plan = channel.unary_stream(
            PLAN,
            request_serializer=PlanRequest.SerializeToString,
            response_deserializer=PlanResponse.FromString,
        )
        return await (_as_they_like(load, plan) if load.rate else _one_by_one(load, plan))


async def _one_by_one(load: Load, plan: grpc.aio.UnaryStreamMultiCallable) -> list[Call]:
    calls: list[Call] = []
    numbers, until = count(), time.monotonic() + load.seconds

    async def client() -> None:
        while time.monotonic() < until and (number := next(numbers)) < load.requests:
            calls.append(await _call(load, plan, number))

    await asyncio.gather(*(client() for _ in range(load.clients)))
    return calls


async def _as_they_like(load: Load, plan: grpc.aio.UnaryStreamMultiCallable) -> list[Call]:
    random, begun = Random(load.seed), []
    at = time.monotonic()
    until = at + load.seconds
    while at < until and len(begun) < load.requests:
        await asyncio.sleep(at - time.monotonic())
        begun.append(asyncio.create_task(_call(load, plan, len(begun))))
        at += random.expovariate(load.rate)
    return list(await asyncio.gather(*begun))


async def _call(load: Load, plan: grpc.aio.UnaryStreamMultiCallable, number: int) -> Call:
    message = PlanRequest.FromString(load.request)
    message.request_id = f"{load.prefix}-{number}"
    plans, verdict, planned_s = 0, "", 0.0
    began = time.monotonic()
    call = plan(message, timeout=TIMEOUT_S)
    try:
        async for response in call:
            if response.WhichOneof("event") == "finished":
                plans += 1
                verdict = Verdict.Name(response.finished.result.verdict).removeprefix("VERDICT_")
                planned_s = response.finished.result.planning_time_s
    except grpc.aio.AioRpcError:
        pass
    code = await call.code()
    return Call(message.request_id, began, time.monotonic() - began, code.name, plans, verdict, planned_s)
