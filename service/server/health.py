"""Whether the server serves, for probes and for balancers that watch (grpc.health.v1)."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterable

import grpc
from grpc_health.v1 import health_pb2, health_pb2_grpc

from service.errors import shown
from service.rpc import Context

_Status = health_pb2.HealthCheckResponse


class Health(health_pb2_grpc.HealthServicer):  # type: ignore[misc]
    """Answers for the server as a whole and for its services, which are there from the start and go together.

    A watch is told of the end and then ended: it is no work that a server which stops would have to wait for.

    Args:
        services: by the names that are asked for; the empty name is the server.
    """

    def __init__(self, services: Iterable[str]) -> None:
        self._services = frozenset(("", *services))
        self._ending = asyncio.Event()

    def end(self) -> None:
        """From now on nothing is served."""
        self._ending.set()

    async def Check(self, request: health_pb2.HealthCheckRequest, context: Context) -> health_pb2.HealthCheckResponse:
        if request.service not in self._services:
            await context.abort(grpc.StatusCode.NOT_FOUND, f"no service {shown(request.service)} is here")
        return self._told(request)

    async def Watch(
        self, request: health_pb2.HealthCheckRequest, context: Context
    ) -> AsyncIterator[health_pb2.HealthCheckResponse]:
        yield self._told(request)
        if not self._ending.is_set():
            await self._ending.wait()
            yield self._told(request)

    def _told(self, request: health_pb2.HealthCheckRequest) -> health_pb2.HealthCheckResponse:
        if request.service not in self._services:
            return _Status(status=_Status.SERVICE_UNKNOWN)
        return _Status(status=_Status.NOT_SERVING if self._ending.is_set() else _Status.SERVING)
