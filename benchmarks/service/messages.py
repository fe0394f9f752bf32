"""Malformed and hostile messages to every method: no crash, and every invalid field is named."""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import grpc
from google.protobuf.message import DecodeError
from google.protobuf.message_factory import GetMessageClass
from google.rpc.error_details_pb2 import BadRequest
from google.rpc.status_pb2 import Status

from benchmarks.service.figures import Figure, Options, percentile, spread
from benchmarks.service.large import large
from benchmarks.service.mutations import hostile, wire_type
from benchmarks.service.pings import PING_S, pinging
from benchmarks.service.servers import Server, started
from service.client.errors import ANSWER_LOST
from service.errors import RequestError
from service.proto.planner.v1 import planner_pb2 as wire
from service.wire.requests import request_from_message

AT_A_TIME = 4
TIMEOUT_S = 20.0
NO_MESSAGE = "the bytes are no "  # beginning of a violation that cannot name a field
# Beginnings of violations in which a message as a whole is wrong, not one of its fields.
HOLDERS: Mapping[str, tuple[str, ...]] = {
    "request": ("exactly one of goal, task is needed", "request: is missing"),
    "clouds": (),
}
CRASHES = ("UNKNOWN", "INTERNAL", "UNAVAILABLE", "DATA_LOSS")
LARGE_CODES = ("INVALID_ARGUMENT", "NOT_FOUND", "OK")  # a cloud with a false point count is read only when it is used
DETAILS_KEY = "grpc-status-details-bin"


@dataclass(frozen=True)
class Answer:
    """How a call ended.

    Attributes:
        sent: method and messages.
        is_invalid: whether it must be refused; None if only the server knows.
        code: the status; text: its message.
        violations: field and description.
        took: wall time [s].
    """

    method: str
    sent: list[bytes]
    is_invalid: bool | None
    code: str
    text: str
    violations: tuple[tuple[str, str], ...]
    took: float

    @property
    def is_named(self) -> bool:
        """Whether it names the wrong field, if there are fields."""
        return bool(self.violations) and all(
            words.startswith(HOLDERS.get(field, "") if field else NO_MESSAGE) for field, words in self.violations
        )


def measure(options: Options, folder: Path) -> list[Figure]:
    """Send 10,000 random messages, and some of the largest size."""
    n = options.messages or options.count(10_000, 300)
    with started(folder, "--requests-per-s", "100000") as server:
        answers = asyncio.run(_ask(server, n, options.seed))
        with pinging(server.address) as taken:
            large_answers = asyncio.run(_ask_large(server, options.count(10, 1)))
        is_alive, incidents = server.is_alive(), server.incidents()
        for line in server.incident_lines()[:5]:
            print(f"  {line[-1500:]}")
        restarts = server.status().worker_restarts if is_alive else 0
    return [*_figures(answers, is_alive, restarts, incidents), *_figures_of_large(large_answers, taken())]


async def _ask(server: Server, n: int, seed: int) -> list[Answer]:
    async with grpc.aio.insecure_channel(server.address) as channel:
        cloud = await _uploaded(channel)
        calls = iter(list(hostile(n, seed, cloud)))
        answers: list[Answer] = []

        async def client() -> None:
            for method, messages in calls:
                answers.append(await _call(channel, method, messages))

        await asyncio.gather(*(client() for _ in range(AT_A_TIME)))
        return answers


async def _ask_large(server: Server, rounds: int) -> dict[str, list[Answer]]:
    """Return the answers to messages of the largest size by name, sent two at a time."""
    async with grpc.aio.insecure_channel(server.address) as channel:
        calls = large(await _uploaded(channel))
        answers: dict[str, list[Answer]] = {name: [] for name in calls}
        left = iter([(name, *call) for _ in range(rounds) for name, call in calls.items()])

        async def client() -> None:
            for name, method, messages in left:
                answers[name].append(await _call(channel, method, messages))

        await asyncio.gather(client(), client())
        return answers


async def _uploaded(channel: grpc.aio.Channel) -> str:
    """Upload a cloud of a few points; return its id."""
    points = b"".join(b"%d %d 0.5\n" % (x, y) for x in range(10) for y in range(10))
    parts = [wire.UploadCloudRequest(header={"format": "xyz"}), wire.UploadCloudRequest(chunk=points)]  # type: ignore[arg-type]
    data = await channel.stream_unary("/planner.v1.PlannerService/UploadCloud")(it.SerializeToString() for it in parts)
    return wire.UploadCloudResponse.FromString(data).cloud_id


async def _call(channel: grpc.aio.Channel, name: str, messages: list[bytes]) -> Answer:
    """Call, and repeat once if this side lost the answer."""
    answer = await _asked(channel, name, messages)
    if (answer.code, answer.text) == (ANSWER_LOST[0].name, ANSWER_LOST[1]):
        answer = await _asked(channel, name, messages)
    return answer


async def _asked(channel: grpc.aio.Channel, name: str, messages: list[bytes]) -> Answer:
    method = wire.DESCRIPTOR.services_by_name["PlannerService"].methods_by_name[name]
    path, began = f"/planner.v1.PlannerService/{name}", time.monotonic()
    call: Any
    if method.client_streaming:
        call = channel.stream_unary(path)(iter(messages), timeout=TIMEOUT_S)
    elif method.server_streaming:
        call = channel.unary_stream(path)(messages[0], timeout=TIMEOUT_S)
    else:
        call = channel.unary_unary(path)(messages[0], timeout=TIMEOUT_S)
    try:
        if method.server_streaming:
            async for _ in call:
                pass
        else:
            await call
    except grpc.aio.AioRpcError:
        pass
    code, text = await call.code(), await call.details()
    told = violations(await call.trailing_metadata())
    took = time.monotonic() - began
    return Answer(name, messages, is_invalid(name, messages), code.name, text, told, took)


def violations(metadata: Sequence[tuple[str, bytes]] | None) -> tuple[tuple[str, str], ...]:
    """Return field and description of each violation of a refused call."""
    for key, value in metadata or ():
        if key == DETAILS_KEY:
            detail = BadRequest()
            status = Status.FromString(value)
            if status.details and status.details[0].Unpack(detail):
                return tuple((one.field, one.description) for one in detail.field_violations)
    return ()


def is_invalid(method: str, sent: list[bytes]) -> bool | None:
    """Return whether a call must be refused as INVALID_ARGUMENT; None if that depends on the server's data."""
    kind = GetMessageClass(wire_type(method))
    messages = []
    for data in sent:
        try:
            messages.append(kind.FromString(data))
        except DecodeError:
            return True if len(sent) == 1 else None  # of a stream, something before may be what is told
    message = messages[0]
    if isinstance(message, wire.PlanRequest):
        return _is_plan_invalid(message)
    if isinstance(message, wire.UploadCloudRequest):
        return True if message.WhichOneof("part") != "header" else None
    if isinstance(message, wire.VerifyRequest | wire.SimulatePlanRequest):
        return True if bool(message.plan_id) == bool(message.files) else None
    if isinstance(message, wire.GetPlanRequest):
        return True if not message.plan_id else None
    if isinstance(message, wire.ReviewPlanRequest):
        return True if message.decision not in (wire.DECISION_ACCEPTED, wire.DECISION_REJECTED) else None
    if isinstance(message, wire.BuildSceneRequest | wire.DetectRequest):
        return True if not message.clouds.clouds else None
    return None


def _is_plan_invalid(message: wire.PlanRequest) -> bool | None:
    if not message.HasField("request"):
        return True
    try:
        request_from_message(message.request)
    except RequestError:
        return True
    return None


def _figures(answers: list[Answer], is_alive: bool, restarts: int, incidents: int) -> list[Figure]:
    crashed = [it for it in answers if it.code in CRASHES]
    invalid = [it for it in answers if it.is_invalid]
    told = [it for it in answers if it.is_invalid or it.code == "INVALID_ARGUMENT"]
    wrong = [it for it in told if it.code != "INVALID_ARGUMENT"]
    unnamed = [it for it in told if it.code == "INVALID_ARGUMENT" and not it.is_named]
    _show("ended as a crash does", crashed)
    _show("not refused as invalid", wrong)
    _show("no field named", unnamed)
    share = 1.0 - (len(wrong) + len(unnamed)) / max(len(told), 1)
    codes = ", ".join(f"{code} {n}" for code, n in Counter(it.code for it in answers).most_common())
    n_crashes = len(crashed) + restarts + (not is_alive) + incidents
    return [
        Figure(
            f"{len(answers)} malformed or hostile messages: crashes of server or workers, internal errors",
            "0",
            str(n_crashes),
            n_crashes == 0,
        ),
        Figure(
            f"  INVALID_ARGUMENT with the field named, of {len(told)} that are invalid ({len(invalid)} known before)",
            "100 %",
            f"{share:.2%}",
            share == 1.0,
        ),
        Figure("  answers", "", codes),
        Figure("  time of an answer", "", spread([it.took for it in answers])),
    ]


def _figures_of_large(answers: dict[str, list[Answer]], pings: list[float]) -> list[Figure]:
    every = [it for of_one in answers.values() for it in of_one]
    wrong = [it for it in every if it.code not in LARGE_CODES or (it.code == LARGE_CODES[0] and not it.is_named)]
    _show("of the large", wrong)
    slowest = max(answers, key=lambda name: max(it.took for it in answers[name]))
    codes = ", ".join(f"{code} {n}" for code, n in Counter(it.code for it in every).most_common())
    return [
        Figure(
            f"{len(every)} messages of the largest size, in {len(answers)} ways: answers other than "
            "OK, NOT_FOUND and INVALID_ARGUMENT with the field named",
            "0",
            str(len(wrong)),
            not wrong,
        ),
        Figure("  answers", "", codes),
        Figure(f"  time of an answer (slowest: {slowest})", "", spread([it.took for it in every])),
        Figure(
            f"  ping of another client meanwhile ({len(pings)} pings)",
            "p99 < 10 ms",
            spread(pings),
            percentile(pings, 99) < PING_S,
        ),
    ]


def _show(what: str, answers: list[Answer], most: int = 5) -> None:
    """Print a few of the failures for inspection."""
    for it in answers[:most]:
        print(f"  {what}: {it.method} {it.code} {it.text[:200]!r} {it.violations[:2]} {[d[:200] for d in it.sent]}")
