"""A planner service that plans nothing, behind whatever interceptors a test puts before it."""

from __future__ import annotations

from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from typing import Any

import grpc
from grpc_health.v1 import health, health_pb2_grpc

from service.proto.planner.v1 import planner_pb2, planner_pb2_grpc, result_pb2
from service.trust import current_caller


class SmallService(planner_pb2_grpc.PlannerServiceServicer):
    """Answers at once, and remembers who called what."""

    def __init__(self) -> None:
        self.callers: list[tuple[str, str]] = []
        self.complete_uploads = 0

    def _called(self, method: str) -> None:
        try:
            self.callers.append((method, current_caller().name))
        except LookupError:
            self.callers.append((method, ""))

    async def Plan(self, request: Any, context: Any) -> AsyncIterator[Any]:
        self._called("Plan")
        if request.request_id == "abort":
            await context.abort(grpc.StatusCode.INVALID_ARGUMENT, "no goal")
        if request.request_id == "raise":
            raise RuntimeError("a bug")
        yield planner_pb2.PlanResponse(accepted=planner_pb2.PlanAccepted(request_id=request.request_id))
        for number in range(3):
            yield planner_pb2.PlanResponse(file=result_pb2.FileChunk(path=str(number)))

    async def UploadCloud(self, requests: Any, context: Any) -> Any:
        self._called("UploadCloud")
        n_bytes = 0
        async for request in requests:
            n_bytes += len(request.chunk)
        self.complete_uploads += 1
        return planner_pb2.UploadCloudResponse(size_bytes=n_bytes)

    async def ListRobots(self, request: Any, context: Any) -> Any:
        self._called("ListRobots")
        return planner_pb2.ListRobotsResponse()

    async def ReviewPlan(self, request: Any, context: Any) -> Any:
        self._called("ReviewPlan")
        return planner_pb2.ReviewPlanResponse()

    async def GetStatus(self, request: Any, context: Any) -> Any:
        self._called("GetStatus")
        return planner_pb2.GetStatusResponse()


async def end_of(call: Any) -> tuple[grpc.StatusCode, str]:
    """How a call ends, whatever it answers before."""
    try:
        if hasattr(call, "__aiter__"):
            async for _ in call:
                pass
        else:
            await call
    except grpc.aio.AioRpcError:
        pass
    return await call.code(), await call.details()


@asynccontextmanager
async def serving(
    interceptors: Sequence[Any], credentials: grpc.ServerCredentials | None = None
) -> AsyncIterator[tuple[str, SmallService]]:
    """A running server: where it listens, and what it answers with."""
    server = grpc.aio.server(interceptors=list(interceptors))
    service = SmallService()
    planner_pb2_grpc.add_PlannerServiceServicer_to_server(service, server)
    health_pb2_grpc.add_HealthServicer_to_server(health.aio.HealthServicer(), server)  # type: ignore[attr-defined]
    address = "127.0.0.1:0"
    port = server.add_insecure_port(address) if credentials is None else server.add_secure_port(address, credentials)
    await server.start()
    try:
        yield f"127.0.0.1:{port}", service
    finally:
        await server.stop(None)
