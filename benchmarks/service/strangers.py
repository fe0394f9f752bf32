"""Hostile files, half-open connections and garbage on the port, while another client checks the health."""

from __future__ import annotations

import asyncio
import socket
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from random import Random
from typing import Any

import grpc

from benchmarks.service import asks, hostile_files
from benchmarks.service.figures import Figure, Options, percentile, spread
from benchmarks.service.messages import violations
from benchmarks.service.pings import PING_S, pinging
from benchmarks.service.servers import Server, started
from service.proto.planner.v1 import planner_pb2 as wire

CONNECTIONS = 500
GARBAGE_BYTES = 4096
CHUNK_BYTES = 2**19
TIMEOUT_S = 60.0
PREFACE = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"
SETTINGS = b"\0\0\0\4\0\0\0\0\0"
ANSWERS = ("INVALID_ARGUMENT", "RESOURCE_EXHAUSTED", "OK")  # OK: it could be read after all; CANCELLED and worse: not


def measure(options: Options, folder: Path) -> list[Figure]:
    """Measure one after the other, each with its own ping."""
    allowed = folder / "allowed"
    robots = hostile_files.robots(allowed)
    clouds = hostile_files.clouds(options.seed)
    rounds, seconds = options.count(5, 1), options.count(20, 3)
    answers: Counter[str] = Counter()
    odd: list[str] = []
    pings: dict[str, list[float]] = {}
    with started(folder, "--allow", str(allowed)) as server:
        attacks: dict[str, Callable[[], None]] = {
            "nothing else going on": lambda: time.sleep(seconds),
            "hostile files": lambda: _hostile_files(server, clouds, robots, rounds, answers, odd),
            f"{CONNECTIONS} half-open connections": lambda: _half_open(server, seconds),
            "garbage on the port": lambda: _garbage(server, seconds, options.seed),
        }
        for name, attack in attacks.items():
            with pinging(server.address) as taken:
                attack()
            pings[name] = taken()
        good = asyncio.run(_good(server))
        is_alive, restarts = server.is_alive(), server.status().worker_restarts
        incidents = server.incidents()
    for line in odd[:10]:
        print(f"  {line}")
    n = sum(answers.values())
    answered = ", ".join(f"{code} {number}" for code, number in answers.most_common())
    return [
        Figure(
            f"{n} hostile files: server ended, workers replaced, incidents, answers that name no field",
            "0",
            f"{int(not is_alive)}, {restarts}, {incidents}, {len(odd)}",
            is_alive and not restarts and not incidents and not odd,
        ),
        Figure("  answers", "", answered),
        Figure("  a good cloud and a good robot, sent in the same way", "OK", good, good == "OK, OK"),
        *(
            Figure(
                f"  ping of another client: {name} ({len(took)} pings)",
                "p99 < 10 ms" if name in list(pings)[1:] else "",
                spread(took),
                percentile(took, 99) < PING_S if name in list(pings)[1:] else None,
            )
            for name, took in pings.items()
        ),
    ]


def _hostile_files(
    server: Server,
    clouds: Mapping[str, tuple[str, bytes]],
    robots: Mapping[str, Path],
    rounds: int,
    answers: Counter[str],
    odd: list[str],
) -> None:
    """Upload and perceive every cloud, and plan with every robot, two at a time."""

    async def send() -> None:
        async with grpc.aio.insecure_channel(server.address) as channel:
            for _ in range(rounds):
                work = [(name, _cloud(channel, *cloud)) for name, cloud in clouds.items()]
                work += [(f"valve in {name}", _valve(channel, *cloud)) for name, cloud in clouds.items()]
                work += [(name, _robot(channel, path)) for name, path in robots.items()]
                left = iter(work)

                async def client(left: Iterator[Any] = left) -> None:
                    for name, asked in left:
                        code, text, is_named = await asked
                        answers[code] += 1
                        if code not in ANSWERS or (code == "INVALID_ARGUMENT" and not is_named):
                            odd.append(f"{name}: {code} {text[:200]}")

                await asyncio.gather(client(), client())

    asyncio.run(send())


async def _good(server: Server) -> str:
    """Check that correct files are accepted; otherwise refusing the others would prove nothing."""
    points = b"".join(b"%.2f %.2f 0.0\n" % (0.05 * x, 0.05 * y) for x in range(20, 40) for y in range(20))
    async with grpc.aio.insecure_channel(server.address) as channel:
        cloud, *_ = await _cloud(channel, "xyz", points)
        robot, *_ = await _ended(channel, "Plan", asks.plan_request(asks.ARM_TURNS).SerializeToString())
    return f"{cloud}, {robot}"


async def _cloud(channel: grpc.aio.Channel, suffix: str, data: bytes) -> tuple[str, str, bool]:
    """Build a scene of a cloud."""
    try:
        cloud = await _uploaded(channel, suffix, data)
    except grpc.aio.AioRpcError as error:
        return _refused(error)
    message = wire.BuildSceneRequest(clouds={"clouds": [{"file": cloud}], "sensor": [0, 0, 1]})  # type: ignore[arg-type]
    return await _ended(channel, "BuildScene", message.SerializeToString())


async def _valve(channel: grpc.aio.Channel, suffix: str, data: bytes) -> tuple[str, str, bool]:
    """Plan to turn the valve in a cloud."""
    try:
        cloud = await _uploaded(channel, suffix, data)
    except grpc.aio.AioRpcError as error:
        return _refused(error)
    message = asks.plan_request({"robot": {"name": "atlas"}, "scene": {"cloud": cloud}, "task": {"valve": {}}})
    return await _ended(channel, "Plan", message.SerializeToString())


async def _uploaded(channel: grpc.aio.Channel, suffix: str, data: bytes) -> str:
    parts = [wire.UploadCloudRequest(header={"format": suffix})]  # type: ignore[arg-type]
    parts += [wire.UploadCloudRequest(chunk=data[at : at + CHUNK_BYTES]) for at in range(0, len(data), CHUNK_BYTES)]
    upload = channel.stream_unary("/planner.v1.PlannerService/UploadCloud")
    answer = await upload((part.SerializeToString() for part in parts), timeout=TIMEOUT_S)
    return wire.UploadCloudResponse.FromString(answer).cloud_id


async def _robot(channel: grpc.aio.Channel, path: Path) -> tuple[str, str, bool]:
    message = asks.plan_request({"robot": {"urdf": str(path)}, "goal": {"joints": {"j": 0.5}}})
    return await _ended(channel, "Plan", message.SerializeToString())


async def _ended(channel: grpc.aio.Channel, method: str, message: bytes) -> tuple[str, str, bool]:
    """Return the status of a call with a streamed answer."""
    try:
        async for _ in channel.unary_stream(f"/planner.v1.PlannerService/{method}")(message, timeout=TIMEOUT_S):
            pass
    except grpc.aio.AioRpcError as error:
        return _refused(error)
    return "OK", "", True


def _refused(error: grpc.aio.AioRpcError) -> tuple[str, str, bool]:
    """Return status, text, and whether the text names the wrong field."""
    told = violations(tuple(error.trailing_metadata()))
    return error.code().name, error.details() or "", bool(told) and all(field for field, _ in told)


def _half_open(server: Server, seconds: float) -> None:
    """Open connections that send all or half of the preface and nothing else."""
    opened = []
    for k in range(CONNECTIONS):
        opened.append(_connected(server))
        opened[-1].sendall((b"", PREFACE[:10], PREFACE, PREFACE + SETTINGS)[k % 4])
    time.sleep(seconds)
    for connection in opened:
        connection.close()


def _garbage(server: Server, seconds: float, seed: int) -> None:
    """Send random bytes, some after a correct preface, until stopped."""
    random, until = Random(seed), time.monotonic() + seconds
    while time.monotonic() < until:
        with _connected(server) as connection, suppress(OSError):
            connection.sendall(random.choice((b"", PREFACE, PREFACE + SETTINGS)) + random.randbytes(GARBAGE_BYTES))
            connection.settimeout(0.02)
            connection.recv(GARBAGE_BYTES)
        time.sleep(0.005)


def _connected(server: Server) -> socket.socket:
    host, _, port = server.address.rpartition(":")
    return socket.create_connection((host, int(port)))
