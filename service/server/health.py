"""Whether the server serves, for probes and for balancers that watch (grpc.health.v1)."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterable

import grpc
from grpc_health.v1 import health_pb2, health_pb2_grpc

from service.errors import shown
from service.trust.rpc import Context

_Status = health_pb2.HealthCheckResponse


class Health(health_pb2_grpc.HealthServicer):  # type: ignore[misc]
    """Answers for the server as a whole and for its services, which are there from the start and go together.

    A watch is told of the end and then ended: it is no work that a server which stops would have to wait for.

    Args:
        services: by the names that are asked for; the empty name is the server.
    """

    def __init__(self, services: Iterable[str]) -> None:
        self._services = frozenset(("", *services))
        self._is_serving, self._is_ending = True, False
        self._changed = asyncio.Event()

    def tell(self, *, is_serving: bool) -> None:
        """Whether anything new is taken in, until the end."""
        if is_serving != self._is_serving and not self._is_ending:
            self._is_serving = is_serving
            self._wake()

    def end(self) -> None:
        """From now on nothing is served."""
        self._is_serving, self._is_ending = False, True
        self._wake()

    async def Check(self, request: health_pb2.HealthCheckRequest, context: Context) -> health_pb2.HealthCheckResponse:
        if request.service not in self._services:
            await context.abort(grpc.StatusCode.NOT_FOUND, f"no service {shown(request.service)} is here")
        return self._told(request)

    async def Watch(
        self, request: health_pb2.HealthCheckRequest, context: Context
    ) -> AsyncIterator[health_pb2.HealthCheckResponse]:
        told = self._told(request)
        yield told
        while not self._is_ending:
            await self._changed.wait()
            if told != self._told(request):
                told = self._told(request)
                yield told

    def _told(self, request: health_pb2.HealthCheckRequest) -> health_pb2.HealthCheckResponse:
        if request.service not in self._services:
            return _Status(status=_Status.SERVICE_UNKNOWN)
        return _Status(status=_Status.SERVING if self._is_serving else _Status.NOT_SERVING)

    def _wake(self) -> None:
        # Everyone who waits has this very event; whoever comes later waits for the next.
        self._changed.set()
        self._changed = asyncio.Event()
