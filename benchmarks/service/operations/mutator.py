"""Messages by a second mutator, which knows only the wire format: no answer is INTERNAL or UNKNOWN.

It splits messages into tags and values, and repeats, drops, swaps, crosses, retypes and nests those, with lengths that
are right or wrong.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from random import Random
from typing import Any

import grpc

from benchmarks.service import asks
from benchmarks.service.figures import Figure, Options
from benchmarks.service.servers import started
from service.proto.planner.v1 import execution_pb2 as execution
from service.proto.planner.v1 import planner_pb2 as wire

METHODS = {
    "Plan": 6,
    "BuildScene": 2,
    "Detect": 2,
    "Verify": 1,
    "SimulatePlan": 1,
    "GetPlan": 1,
    "GetScene": 1,
    "ListPlans": 1,
    "ListScenes": 1,
    "Execute": 1,
    "Command": 1,
    "ReviewPlan": 1,
    "ListRobots": 1,
    "GetStatus": 1,
}
DEFECTS = ("INTERNAL", "UNKNOWN", "UNIMPLEMENTED", "ABORTED")
AT_A_TIME, TIMEOUT_S = 6, 30.0
VARINT, FIXED64, LENGTH, FIXED32 = 0, 1, 2, 5
Field = tuple[int, int, bytes]  # number, wire type, value without its length


def measure(options: Options, folder: Path) -> list[Figure]:
    """Send 10,000 messages."""
    n = options.messages or options.count(10_000, 300)
    with started(folder, "--requests-per-s", "100000", workers=2, queue=50) as server:
        codes = asyncio.run(_send(server.address, n, Random(options.seed)))
        incidents, is_alive = server.incidents(), server.is_alive()
        for line in server.incident_lines()[:5]:
            print(f"  {line[-1500:]}")
    defects = sum(codes[code] for code in DEFECTS)
    counted = ", ".join(f"{code} {count}" for code, count in codes.most_common())
    return [
        Figure(f"{n} messages of the second mutator: {counted}; INTERNAL, UNKNOWN", "0", str(defects), defects == 0),
        Figure("  incidents in the log, server ended", "0, no", f"{incidents}, {'no' if is_alive else 'yes'}",
               incidents == 0 and is_alive),
    ]  # fmt: skip


async def _send(address: str, n: int, random: Random) -> Counter[str]:
    seeds = {name: [_split(data) for data in messages] for name, messages in _seeds().items()}
    codes: Counter[str] = Counter()
    todo = iter(range(n))
    async with grpc.aio.insecure_channel(address) as channel:

        async def client() -> None:
            for _ in todo:
                (method,) = random.choices(list(METHODS), list(METHODS.values()))
                pool = seeds[method] if random.random() < 0.8 else random.choice(list(seeds.values()))
                data = _mutate(random.choice(pool), seeds, random)
                call = channel.unary_stream(f"/planner.v1.PlannerService/{method}", None, None)(data, timeout=TIMEOUT_S)
                try:
                    async for _ in call:
                        pass
                except grpc.aio.AioRpcError:
                    pass
                codes[(await call.code()).name] += 1

        await asyncio.gather(*(client() for _ in range(AT_A_TIME)))
    return codes


def _seeds() -> dict[str, list[bytes]]:
    cloud = {"file": "sha256:" + "0" * 64 + ".xyz"}
    limited = {"time_limit_s": 0.1, "starts": 1}
    plans = [
        asks.plan_request({**request, "options": limited})
        for request in (asks.ELBOW, asks.ARM_TURNS, asks.OVER_A_TABLE)
    ]
    clouds = wire.CloudsSpec(clouds=[cloud], robot="atlas", reach_m=2.0)
    messages: dict[str, list[Any]] = {
        "Plan": plans,
        "BuildScene": [wire.BuildSceneRequest(clouds=clouds, detect=["valve"], hint=[1.0, 0.0, 1.0])],
        "Detect": [wire.DetectRequest(clouds=clouds, kind="door")],
        "Verify": [
            wire.VerifyRequest(plan_id="a" * 32),
            wire.VerifyRequest(files=[{"path": "result.json", "data": b"{}"}]),
        ],
        "SimulatePlan": [wire.SimulatePlanRequest(plan_id="a" * 32, friction=0.5)],
        "GetPlan": [wire.GetPlanRequest(plan_id="a" * 32, with_files=True)],
        "GetScene": [wire.GetSceneRequest(scene_id="scene:" + "0" * 64)],
        "ListPlans": [wire.ListPlansRequest(state=wire.PLAN_STATE_FINISHED, since={"seconds": 1}, task="valve")],  # type: ignore[arg-type]
        "ListScenes": [wire.ListScenesRequest(page_size=3, page_token="7")],
        "Execute": [execution.ExecuteRequest(plan_id="a" * 32, trajectory_sha256="b" * 64, start_tolerance=0.05)],
        "Command": [execution.CommandRequest(order=execution.ORDER_TAKE_CONTROL, station="console")],
        "ReviewPlan": [wire.ReviewPlanRequest(plan_id="a" * 32, decision=wire.DECISION_ACCEPTED, comment="fine")],
        "ListRobots": [wire.ListRobotsRequest()],
        "GetStatus": [wire.GetStatusRequest()],
    }
    return {name: [message.SerializeToString() for message in group] for name, group in messages.items()}


def _mutate(fields: list[Field], seeds: dict[str, list[list[Field]]], random: Random) -> bytes:
    for _ in range(random.choice((1, 1, 2, 3, 6))):
        fields = _change(list(fields), seeds, random)
    data = _join(fields)
    if random.random() < 0.1 and data:
        data = data[: random.randrange(len(data))]
    return data


def _change(fields: list[Field], seeds: dict[str, list[list[Field]]], random: Random) -> list[Field]:
    if not fields:
        return [(random.randrange(1, 20), LENGTH, random.randbytes(random.randrange(8)))]
    at = random.randrange(len(fields))
    number, kind, value = fields[at]
    match random.randrange(9):
        case 0:  # repeat, also very often
            fields[at:at] = [fields[at]] * random.choice((1, 2, 300))
        case 1:
            del fields[at]
        case 2:
            fields[at] = (random.choice((number + 1, number - 1 or 1, 1, 15, 16, 2047, 2**29 - 1)), kind, value)
        case 3:  # a value of another wire type
            retyped = {VARINT: _varint(random.getrandbits(64)), FIXED64: random.randbytes(8), LENGTH: value}
            fields[at] = (number, *random.choice(list(retyped.items())))
        case 4:  # part of another message
            other = random.choice(random.choice(list(seeds.values())))
            fields[at] = (number, LENGTH, _join(other))
        case 5 if kind == LENGTH:  # text that is no UTF-8, numbers that are odd
            odd = (b"\xff\xfe\x80", b"\0" * 9, value[::-1], value * 50, b"\x00\x00\x00\x00\x00\x00\xf8\x7f", b"")
            fields[at] = (number, LENGTH, random.choice(odd))
        case 6:
            random.shuffle(fields)
        case 7:  # nested in itself
            for _ in range(random.choice((2, 30, 120))):
                value = _join([(number, LENGTH, value)])
            fields[at] = (number, LENGTH, value)
        case _ if kind == LENGTH and (inner := _split(value)):
            fields[at] = (number, LENGTH, _join(_change(inner, seeds, random)))
        case _:
            changed = bytearray(value or b"\0")
            changed[random.randrange(len(changed))] ^= 1 << random.randrange(8)
            fields[at] = (number, kind, bytes(changed))
    return fields


def _split(data: bytes) -> list[Field]:
    """Split a message into its fields; what cannot be read is dropped."""
    return list(_read_fields(data))


def _read_fields(data: bytes) -> Iterator[Field]:
    at = 0
    while at < len(data):
        tag, at = _read_varint(data, at)
        number, kind = tag >> 3, tag & 7
        if not number or kind not in (VARINT, FIXED64, LENGTH, FIXED32):
            return
        if kind == VARINT:
            _, end = _read_varint(data, at)
        elif kind == LENGTH:
            length, at = _read_varint(data, at)
            end = at + length
        else:
            end = at + (8 if kind == FIXED64 else 4)
        if end > len(data):
            return
        yield number, kind, data[at:end]
        at = end


def _read_varint(data: bytes, at: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 70, 7):
        if at >= len(data):
            break
        value |= (data[at] & 127) << shift
        at += 1
        if data[at - 1] < 128:
            break
    return value, at


def _join(fields: list[Field]) -> bytes:
    parts = []
    for number, kind, value in fields:
        length = _varint(len(value)) if kind == LENGTH else b""
        parts.append(_varint(number << 3 | kind) + length + value)
    return b"".join(parts)[:1_000_000]


def _varint(value: int) -> bytes:
    data = bytearray()
    while value > 127:
        data.append(value & 127 | 128)
        value >>= 7
    data.append(value)
    return bytes(data)
