"""Response times of health checks by another client."""

from __future__ import annotations

import asyncio
import multiprocessing
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection

import grpc
from grpc_health.v1 import health_pb2, health_pb2_grpc

PING_S = 10e-3  # target for the 99th percentile
PING_EVERY_S = 10e-3


@contextmanager
def pinging(address: str) -> Iterator[Callable[[], list[float]]]:
    """Check the server's health from another process while the body runs; yield a function for the times [s]."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_ping, args=(address, theirs))
    process.start()
    found: list[float] = []
    try:
        ours.recv()  # it has begun
        yield lambda: found
        ours.send("enough")
        found.extend(ours.recv())
    finally:
        process.kill()
        process.join()


def _ping(address: str, pipe: Connection) -> None:
    async def ask() -> None:
        took = []
        async with grpc.aio.insecure_channel(address) as channel:
            stub = health_pb2_grpc.HealthStub(channel)  # type: ignore[no-untyped-call]
            await stub.Check(health_pb2.HealthCheckRequest())
            pipe.send("begun")
            while not pipe.poll():
                began = time.perf_counter()
                await stub.Check(health_pb2.HealthCheckRequest())
                took.append(time.perf_counter() - began)
                await asyncio.sleep(PING_EVERY_S)
        pipe.send(took)

    asyncio.run(ask())
