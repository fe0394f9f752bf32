"""Every call comes through the gate: over the wire, in each of the ways a call can be refused or let in."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Coroutine
from pathlib import Path
from typing import Any

import grpc
import pytest
from google.rpc import error_details_pb2
from grpc_health.v1 import health_pb2, health_pb2_grpc
from grpc_status import rpc_status
from small_service import end_of, serving

import service.trust.rpc
from service.proto.planner.v1 import planner_pb2, planner_pb2_grpc
from service.trust import AccessInterceptor, ClientLimiter, ClientLimits, Role, Tokens, make_token
from service.trust.rpc import Refusal


@pytest.fixture
def known(tmp_path: Path) -> tuple[dict[Role, str], Tokens]:
    made = {role: make_token(f"has-{role}", [role]) for role in Role}
    path = tmp_path / "tokens.yaml"
    path.write_text("\n".join(line for _, line in made.values()))
    path.chmod(0o600)
    return {role: token for role, (token, _) in made.items()}, Tokens(path)


def _with(token: str) -> tuple[tuple[str, str], ...]:
    return (("authorization", f"Bearer {token}"),)


def _run(coroutine: Coroutine[Any, Any, None]) -> None:
    asyncio.run(asyncio.wait_for(coroutine, 120))


def test_calls_of_every_kind_come_through_and_know_their_caller(known: tuple[dict[Role, str], Tokens]) -> None:
    tokens, file = known

    async def calls() -> None:
        async with (
            serving([AccessInterceptor(file, ClientLimiter())]) as (address, answering),
            grpc.aio.insecure_channel(address) as channel,
        ):
            stub, plan = planner_pb2_grpc.PlannerServiceStub(channel), _with(tokens[Role.PLAN])
            await stub.ListRobots(planner_pb2.ListRobotsRequest(), metadata=plan)
            answers = [a async for a in stub.Plan(planner_pb2.PlanRequest(request_id="r7"), metadata=plan)]
            assert answers[0].accepted.request_id == "r7"
            assert [answer.file.path for answer in answers[1:]] == ["0", "1", "2"]
            chunks = (planner_pb2.UploadCloudRequest(chunk=b"x" * 1000) for _ in range(50))
            assert (await stub.UploadCloud(chunks, metadata=plan)).size_bytes == 50_000
            await stub.ReviewPlan(planner_pb2.ReviewPlanRequest(), metadata=_with(tokens[Role.REVIEW]))
            await stub.GetStatus(planner_pb2.GetStatusRequest(), metadata=_with(tokens[Role.ADMIN]))
        assert answering.callers == [
            ("ListRobots", "has-plan"),
            ("Plan", "has-plan"),
            ("UploadCloud", "has-plan"),
            ("ReviewPlan", "has-review"),
            ("GetStatus", "has-admin"),
        ]

    _run(calls())


def test_without_a_known_token_or_the_right_role_nothing_is_called(known: tuple[dict[Role, str], Tokens]) -> None:
    tokens, file = known

    async def calls() -> None:
        async with (
            serving([AccessInterceptor(file, ClientLimiter())]) as (address, answering),
            grpc.aio.insecure_channel(address) as channel,
        ):
            stub = planner_pb2_grpc.PlannerServiceStub(channel)
            code, words = await end_of(stub.ListRobots(planner_pb2.ListRobotsRequest()))
            assert code is grpc.StatusCode.UNAUTHENTICATED
            assert "authorization: Bearer TOKEN" in words
            code, words = await end_of(stub.Plan(planner_pb2.PlanRequest(), metadata=_with("scopt_wrong")))
            assert code is grpc.StatusCode.UNAUTHENTICATED
            assert "scopt_wrong" not in words
            review = stub.ReviewPlan(planner_pb2.ReviewPlanRequest(), metadata=_with(tokens[Role.PLAN]))
            assert await end_of(review) == (
                grpc.StatusCode.PERMISSION_DENIED,
                "ReviewPlan needs the role review; has-plan has plan",
            )
            assert (await end_of(stub.UploadCloud(iter(()))))[0] is grpc.StatusCode.UNAUTHENTICATED
            other = channel.unary_unary("/planner.v1.PlannerService/Nothing")
            assert (await end_of(other(b"")))[0] is grpc.StatusCode.UNIMPLEMENTED
        assert answering.callers == []

    _run(calls())


def test_health_is_told_to_all_and_watched_by_the_known_only(known: tuple[dict[Role, str], Tokens]) -> None:
    tokens, file = known

    async def calls() -> None:
        async with (
            serving([AccessInterceptor(file, ClientLimiter())]) as (address, _),
            grpc.aio.insecure_channel(address) as channel,
        ):
            stub = health_pb2_grpc.HealthStub(channel)
            answer = await stub.Check(health_pb2.HealthCheckRequest())
            assert answer.status == health_pb2.HealthCheckResponse.SERVING
            assert (await end_of(stub.Watch(health_pb2.HealthCheckRequest())))[0] is grpc.StatusCode.UNAUTHENTICATED
            watch = stub.Watch(health_pb2.HealthCheckRequest(), metadata=_with(tokens[Role.PLAN]))
            assert (await watch.read()).status == health_pb2.HealthCheckResponse.SERVING

    _run(calls())


def test_without_a_tokens_file_everybody_on_this_machine_is_local() -> None:
    async def calls() -> None:
        async with (
            serving([AccessInterceptor(None, ClientLimiter())]) as (address, answering),
            grpc.aio.insecure_channel(address) as channel,
        ):
            stub = planner_pb2_grpc.PlannerServiceStub(channel)
            await stub.GetStatus(planner_pb2.GetStatusRequest(), metadata=_with("whatever"))
        assert answering.callers == [("GetStatus", "local")]

    _run(calls())


def test_the_request_of_a_refused_call_is_not_read(known: tuple[dict[Role, str], Tokens]) -> None:
    """The largest message is refused for who sent it, not for its size: nobody looked at it."""

    async def calls() -> None:
        large = planner_pb2.PlanRequest(request_id="x" * 20 * 2**20)
        async with (
            serving([AccessInterceptor(known[1], ClientLimiter())]) as (address, _),
            grpc.aio.insecure_channel(address) as channel,
        ):
            stub = planner_pb2_grpc.PlannerServiceStub(channel)
            assert (await end_of(stub.Plan(large)))[0] is grpc.StatusCode.UNAUTHENTICATED
            allowed = stub.Plan(large, metadata=_with(known[0][Role.PLAN]))
            assert (await end_of(allowed))[0] is grpc.StatusCode.RESOURCE_EXHAUSTED

    _run(calls())


def test_too_many_requests_of_one_client_are_refused_with_a_time_and_leave_others_alone(
    known: tuple[dict[Role, str], Tokens],
) -> None:
    tokens, file = known

    async def calls() -> None:
        gate = AccessInterceptor(file, ClientLimiter(ClientLimits(requests_per_s=0.01, requests_burst=3)))
        async with serving([gate]) as (address, _), grpc.aio.insecure_channel(address) as channel:
            stub, plan = planner_pb2_grpc.PlannerServiceStub(channel), _with(tokens[Role.PLAN])
            for _ in range(3):
                await stub.ListRobots(planner_pb2.ListRobotsRequest(), metadata=plan)
            with pytest.raises(grpc.aio.AioRpcError) as caught:
                await stub.ListRobots(planner_pb2.ListRobotsRequest(), metadata=plan)
            assert caught.value.code() is grpc.StatusCode.RESOURCE_EXHAUSTED
            assert 10.0 < _retry_after(caught.value) <= 100.0
            await stub.GetStatus(planner_pb2.GetStatusRequest(), metadata=_with(tokens[Role.ADMIN]))

    _run(calls())


def test_tokens_cannot_be_tried_at_leisure(known: tuple[dict[Role, str], Tokens]) -> None:
    async def calls() -> None:
        gate = AccessInterceptor(known[1], ClientLimiter(ClientLimits(requests_per_s=0.01, requests_burst=5)))
        async with serving([gate]) as (address, _), grpc.aio.insecure_channel(address) as channel:
            stub = planner_pb2_grpc.PlannerServiceStub(channel)
            codes = [
                (await end_of(stub.ListRobots(planner_pb2.ListRobotsRequest(), metadata=_with(str(n)))))[0]
                for n in range(8)
            ]
            assert codes == [grpc.StatusCode.UNAUTHENTICATED] * 5 + [grpc.StatusCode.RESOURCE_EXHAUSTED] * 3
            plan = _with(known[0][Role.PLAN])
            await stub.ListRobots(planner_pb2.ListRobotsRequest(), metadata=plan)

    _run(calls())


class _TwoOpenCalls(ClientLimiter):
    """Lets two calls be open, and says when both are."""

    def __init__(self) -> None:
        super().__init__(ClientLimits(max_open_calls=2))
        self.both_open, self.n_entered = asyncio.Event(), 0

    def enter(self, key: str) -> Refusal | None:
        refusal = super().enter(key)
        self.n_entered += refusal is None
        if self.n_entered == 2:
            self.both_open.set()
        return refusal


def test_open_calls_are_limited_and_their_places_are_given_back(known: tuple[dict[Role, str], Tokens]) -> None:
    async def calls() -> None:
        limiter = _TwoOpenCalls()
        gate = AccessInterceptor(known[1], limiter)
        async with serving([gate]) as (address, _), grpc.aio.insecure_channel(address) as channel:
            stub, plan = planner_pb2_grpc.PlannerServiceStub(channel), _with(known[0][Role.PLAN])
            open_calls = [stub.UploadCloud(metadata=plan) for _ in range(2)]
            for call in open_calls:
                await call.write(planner_pb2.UploadCloudRequest(chunk=b"x"))
            await limiter.both_open.wait()
            third = stub.ListRobots(planner_pb2.ListRobotsRequest(), metadata=plan)
            words = "2 calls of this client are open; try again when one has ended"
            assert await end_of(third) == (grpc.StatusCode.RESOURCE_EXHAUSTED, words)
            open_calls[0].cancel()
            await open_calls[1].done_writing()
            assert (await open_calls[1]).size_bytes == 1
            for _ in range(3):
                code, _ = await until_other_than(grpc.StatusCode.RESOURCE_EXHAUSTED, stub, plan)
                assert code is grpc.StatusCode.OK

    _run(calls())


def test_a_call_that_says_nothing_or_too_little_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    async def calls() -> None:
        async with (
            serving([AccessInterceptor(None, ClientLimiter())]) as (address, answering),
            grpc.aio.insecure_channel(address) as channel,
        ):
            method = channel.stream_unary("/planner.v1.PlannerService/ListRobots")
            empty = method()
            await empty.done_writing()
            assert await end_of(empty) == (grpc.StatusCode.INVALID_ARGUMENT, "no request arrived")
            monkeypatch.setattr(service.trust.rpc, "REQUEST_WAIT_S", 2.0)
            silent, stalled = method(), planner_pb2_grpc.PlannerServiceStub(channel).UploadCloud()
            await stalled.write(planner_pb2.UploadCloudRequest())
            assert await asyncio.gather(end_of(silent), end_of(stalled)) == [
                (grpc.StatusCode.DEADLINE_EXCEEDED, "no request arrived within 2 s"),
                (grpc.StatusCode.DEADLINE_EXCEEDED, "no message arrived within 2 s"),
            ]
        assert answering.callers == [("UploadCloud", "local")]

    _run(calls())


def test_an_upload_that_the_client_breaks_off_never_looks_complete() -> None:
    async def calls() -> None:
        async with (
            serving([AccessInterceptor(None, ClientLimiter())]) as (address, answering),
            grpc.aio.insecure_channel(address) as channel,
        ):
            stub = planner_pb2_grpc.PlannerServiceStub(channel)
            for _ in range(10):
                call = stub.UploadCloud()
                await call.write(planner_pb2.UploadCloudRequest(chunk=b"x"))
                call.cancel()
            await end_of(stub.UploadCloud(timeout=0.05))
            await asyncio.sleep(0.1)
            assert answering.complete_uploads == 0
            await end_of(stub.UploadCloud(iter([planner_pb2.UploadCloudRequest(chunk=b"x")])))
            assert answering.complete_uploads == 1

    _run(calls())


def test_what_a_handler_says_at_its_end_reaches_the_client_unchanged() -> None:
    async def calls() -> None:
        async with (
            serving([AccessInterceptor(None, ClientLimiter())]) as (address, _),
            grpc.aio.insecure_channel(address) as channel,
        ):
            stub = planner_pb2_grpc.PlannerServiceStub(channel)
            aborted = stub.Plan(planner_pb2.PlanRequest(request_id="abort"))
            assert await end_of(aborted) == (grpc.StatusCode.INVALID_ARGUMENT, "no goal")

    _run(calls())


def test_garbage_on_the_wire_gets_an_error_and_the_server_goes_on() -> None:
    async def calls() -> None:
        async with (
            serving([AccessInterceptor(None, ClientLimiter())]) as (address, _),
            grpc.aio.insecure_channel(address) as channel,
        ):
            host, port = address.split(":")
            reader, writer = await asyncio.open_connection(host, int(port))
            writer.write(os.urandom(4096))
            await asyncio.wait_for(reader.read(), 60)
            writer.close()
            await planner_pb2_grpc.PlannerServiceStub(channel).ListRobots(planner_pb2.ListRobotsRequest())

    _run(calls())


async def until_other_than(
    code: grpc.StatusCode, stub: planner_pb2_grpc.PlannerServiceStub, metadata: tuple[tuple[str, str], ...]
) -> tuple[grpc.StatusCode, str]:
    """Ask until a call ends otherwise, at most a minute; how it ended."""
    for _ in range(1200):
        end = await end_of(stub.ListRobots(planner_pb2.ListRobotsRequest(), metadata=metadata))
        if end[0] is not code:
            break
        await asyncio.sleep(0.05)
    return end


def _retry_after(error: grpc.aio.AioRpcError) -> float:
    """What ``google.rpc.RetryInfo`` in an error says [s]."""
    metadata = dict(error.trailing_metadata() or ())
    status = rpc_status.status_pb2.Status.FromString(metadata["grpc-status-details-bin"])  # type: ignore[attr-defined]
    assert status.message == error.details()
    info = error_details_pb2.RetryInfo()
    assert status.details[0].Unpack(info)
    return info.retry_delay.ToTimedelta().total_seconds()
