"""Health of the server for probes (grpc.health.v1), and its open calls, which a shutdown ends."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterable
from contextlib import asynccontextmanager
from typing import Any

import grpc
from grpc_health.v1 import health_pb2, health_pb2_grpc

from service.errors import shown
from service.server.refusals import GOING_DOWN
from service.trust.rpc import Context, Interceptor, refuse

_Status = health_pb2.HealthCheckResponse


class Health(health_pb2_grpc.HealthServicer):  # type: ignore[misc]
    """Health of the server as a whole and of its services, which share one state: that of all parts together.

    A watch ends with the server's health, so that a drain need not wait for it.

    Args:
        services: names of the services; the empty name stands for the server.
    """

    def __init__(self, services: Iterable[str]) -> None:
        self._services = frozenset(("", *services))
        self._problems: set[str] = set()
        self._is_ending = False
        self._changed = asyncio.Event()

    def set_ready(self, part: str, is_ready: bool) -> bool:
        """Set whether a part of the server is ready; work is accepted while all are. Returns whether that is new."""
        if is_ready is (part not in self._problems):
            return False
        (self._problems.discard if is_ready else self._problems.add)(part)
        self._wake()
        return True

    def end(self) -> None:
        """Report NOT_SERVING from now on, and end all watches."""
        self._is_ending = True
        self._wake()

    async def Check(self, request: health_pb2.HealthCheckRequest, context: Context) -> health_pb2.HealthCheckResponse:
        if request.service not in self._services:
            await context.abort(grpc.StatusCode.NOT_FOUND, f"service: unknown service {shown(request.service)}")
        return self._status(request)

    async def Watch(
        self, request: health_pb2.HealthCheckRequest, context: Context
    ) -> AsyncIterator[health_pb2.HealthCheckResponse]:
        latest = self._status(request)
        yield latest
        while not self._is_ending:
            await self._changed.wait()
            if latest != self._status(request):
                latest = self._status(request)
                yield latest

    def _status(self, request: health_pb2.HealthCheckRequest) -> health_pb2.HealthCheckResponse:
        if request.service not in self._services:
            return _Status(status=_Status.SERVICE_UNKNOWN)
        is_serving = not self._problems and not self._is_ending
        return _Status(status=_Status.SERVING if is_serving else _Status.NOT_SERVING)

    def _wake(self) -> None:
        # All current waiters hold this event; later waiters get the new one.
        self._changed.set()
        self._changed = asyncio.Event()


class OpenCalls(Interceptor):
    """The open calls of a server, which end with a message of its own instead of gRPC's."""

    def __init__(self) -> None:
        self._open: set[asyncio.Task[Any]] = set()
        self._over = asyncio.Event()

    def end_all(self) -> None:
        """End all open calls, and refuse every later one."""
        self._over.set()
        for task in self._open:
            task.cancel()

    @asynccontextmanager
    async def wrap_call(self, method: str, context: Context) -> AsyncIterator[None]:
        task = asyncio.current_task()
        if self._over.is_set() or task is None:
            await refuse(context, GOING_DOWN)
        self._open.add(task)
        try:
            yield
        except asyncio.CancelledError:
            if not self._over.is_set():
                raise  # the client has gone
            task.uncancel()
            await refuse(context, GOING_DOWN)
        finally:
            self._open.discard(task)
