"""Transports that carry the client's calls: one waits for each answer, one awaits it."""

from __future__ import annotations

import asyncio
import time
from abc import ABC, abstractmethod
from collections.abc import AsyncGenerator, AsyncIterator, Callable, Iterator
from typing import Any, TypeVar

import grpc
from google.protobuf.message import Message

from service.client.connection import OPTIONS, Connection
from service.proto.planner.v1.planner_pb2_grpc import PlannerServiceStub

R = TypeVar("R")
Messages = Message | Iterator[Message] | AsyncIterator[Message]


class Transport(ABC):
    """Channel to a server and the ways to wait that go with it.

    Args:
        connection: address, TLS files and token.

    Raises:
        RequestError: a TLS file cannot be read.
    """

    def __init__(self, connection: Connection) -> None:
        self._channel = self._open_channel(connection.target, connection.credentials())
        self._stub = PlannerServiceStub(self._channel)  # type: ignore[no-untyped-call]
        self._metadata = connection.metadata

    @abstractmethod
    def _open_channel(self, target: str, credentials: grpc.ChannelCredentials | None) -> Any: ...

    @abstractmethod
    async def call(self, method: str, message: Messages, timeout_s: float | None) -> Any:
        """Return the answer to a message, or to a stream of messages; raises ``grpc.RpcError``."""

    @abstractmethod
    def stream(self, method: str, message: Messages, timeout_s: float | None) -> AsyncGenerator[Any, None]:
        """Yield the events of a call, whose messages are one or a stream; closing it cancels the call.

        Raises ``grpc.RpcError``.
        """

    @abstractmethod
    async def sleep(self, seconds: float) -> None:
        """Wait before the next attempt."""

    @abstractmethod
    async def run(self, function: Callable[..., R], *arguments: Any) -> R:
        """Run a function that reads large files."""

    @abstractmethod
    async def close(self) -> None:
        """Close the channel, which cancels open calls."""

    def _start(self, method: str, message: Messages, timeout_s: float | None) -> Any:
        return getattr(self._stub, method)(message, timeout=timeout_s, metadata=self._metadata)


class BlockingTransport(Transport):
    """Blocks the calling thread in every method, so that no ``await`` on it ever suspends."""

    def _open_channel(self, target: str, credentials: grpc.ChannelCredentials | None) -> grpc.Channel:
        if credentials is None:
            return grpc.insecure_channel(target, OPTIONS)
        return grpc.secure_channel(target, credentials, OPTIONS)

    async def call(self, method: str, message: Messages, timeout_s: float | None) -> Any:
        return self._start(method, message, timeout_s)

    async def stream(self, method: str, message: Messages, timeout_s: float | None) -> AsyncGenerator[Any, None]:
        call = self._start(method, message, timeout_s)
        try:
            for event in call:
                yield event
        finally:
            call.cancel()

    async def sleep(self, seconds: float) -> None:
        time.sleep(seconds)

    async def run(self, function: Callable[..., R], *arguments: Any) -> R:
        return function(*arguments)

    async def close(self) -> None:
        self._channel.close()


class AsyncTransport(Transport):
    """Calls of one asyncio event loop."""

    def _open_channel(self, target: str, credentials: grpc.ChannelCredentials | None) -> grpc.aio.Channel:
        if credentials is None:
            return grpc.aio.insecure_channel(target, OPTIONS)
        return grpc.aio.secure_channel(target, credentials, OPTIONS)

    async def call(self, method: str, message: Messages, timeout_s: float | None) -> Any:
        return await self._start(method, message, timeout_s)

    async def stream(self, method: str, message: Messages, timeout_s: float | None) -> AsyncGenerator[Any, None]:
        call = self._start(method, message, timeout_s)
        try:
            async for event in call:
                yield event
        finally:
            call.cancel()

    async def sleep(self, seconds: float) -> None:
        await asyncio.sleep(seconds)

    async def run(self, function: Callable[..., R], *arguments: Any) -> R:
        return await asyncio.to_thread(function, *arguments)

    async def close(self) -> None:
        await self._channel.close(None)
