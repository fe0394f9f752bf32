"""The end of calls that are still open when a server can wait no longer, in words of its own instead of gRPC's."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import grpc

from service.trust.rpc import Context, Interceptor, Refusal, refuse

STOPPING = Refusal(grpc.StatusCode.UNAVAILABLE, "the server is stopping; try another one, or later")
GOING_DOWN = Refusal(grpc.StatusCode.UNAVAILABLE, "the server is going down now; try another one, or later")


class Farewell(Interceptor):
    """Knows the calls that are open, and ends all of them when it is told to, also those that come after."""

    def __init__(self) -> None:
        self._open: set[asyncio.Task[Any]] = set()
        self._over = asyncio.Event()

    def end_all(self) -> None:
        """From now on no call is answered."""
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
