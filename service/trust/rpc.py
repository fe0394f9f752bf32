"""Refusals of RPCs with details, and the base class of the server's interceptors."""

from __future__ import annotations

import asyncio
import inspect
import time
from abc import ABC, abstractmethod
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import AbstractAsyncContextManager, aclosing
from functools import cached_property, partial
from typing import Any, NoReturn, TypeAlias

import grpc
from google.protobuf import duration_pb2
from google.protobuf.message import Message
from google.rpc import error_details_pb2, status_pb2

Context: TypeAlias = "grpc.aio.ServicerContext[Any, Any]"
Handler: TypeAlias = "grpc.RpcMethodHandler[Any, Any]"
Enter = Callable[[Context], AbstractAsyncContextManager[None]]

DETAILS_KEY = "grpc-status-details-bin"
MAX_TEXT_BYTES = 1000  # of a status, which travels in a header; the call fails if its headers exceed 8 KiB
REQUEST_WAIT_S = 60.0  # an open call without a message must not occupy its place for ever
SESSION_WAIT_S = 3600.0  # the same of a call in which an operator thinks between two messages
CANCEL_DELAY_S = 0.005


class Refusal(Exception):  # noqa: N818 - a regular answer, not a defect
    """End of an RPC: status code, message, and details for programs.

    Attributes:
        code: gRPC status.
        text: message for people.
        retry_after_s: delay before another try, if one may succeed (``google.rpc.RetryInfo``).
        details: further messages of google.rpc.
    """

    def __init__(
        self,
        code: grpc.StatusCode,
        text: str,
        retry_after_s: float | None = None,
        details: Sequence[Message] = (),
    ) -> None:
        super().__init__(text)
        self.code, self.text, self.retry_after_s = code, shorten(text, MAX_TEXT_BYTES), retry_after_s
        self.details = tuple(details)

    def metadata(self) -> tuple[tuple[str, bytes], ...]:
        """Return the details as trailing metadata; empty without details."""
        details = list(self.details)
        if self.retry_after_s is not None:
            delay = duration_pb2.Duration()
            delay.FromMilliseconds(max(1, round(1000 * self.retry_after_s)))
            details.append(error_details_pb2.RetryInfo(retry_delay=delay))
        if not details:
            return ()
        status = status_pb2.Status(code=self.code.value[0], message=self.text)
        for detail in details:
            status.details.add().Pack(detail)
        return ((DETAILS_KEY, status.SerializeToString()),)


def shorten(text: str, n_bytes: int) -> str:
    """Cut a text to at most ``n_bytes`` of UTF-8."""
    return text.encode(errors="replace")[:n_bytes].decode(errors="ignore")


async def refuse(context: Context, refusal: Refusal) -> NoReturn:
    """End an RPC with a refusal."""
    await context.abort(refusal.code, refusal.text, refusal.metadata())


def deadline_of(context: Context) -> float | None:
    """Return the deadline on the clock of ``time.monotonic`` [s]; None if the client set none."""
    left = context.time_remaining()
    return None if left is None else time.monotonic() + left


class Interceptor(grpc.aio.ServerInterceptor, ABC):  # type: ignore[type-arg]
    """Base of interceptors: ``wrap_call`` surrounds every call of a known method."""

    @cached_property
    def _handlers(self) -> dict[str, Handler]:
        """Wrapped handlers by method: those of the methods of the server, which stay the same."""
        return {}

    async def intercept_service(
        self,
        continuation: Callable[[grpc.HandlerCallDetails], Awaitable[Handler]],
        handler_call_details: grpc.HandlerCallDetails,
    ) -> Handler:
        """Return the method's handler with ``wrap_call`` around each of its calls."""
        method = handler_call_details.method
        if method not in self._handlers:
            handler = await continuation(handler_call_details)
            if not handler:  # None for an unknown method
                return handler
            self._handlers[method] = _wrap_handler(handler, partial(self.wrap_call, method))
        return self._handlers[method]

    @abstractmethod
    def wrap_call(self, method: str, context: Context) -> AbstractAsyncContextManager[None]:
        """Return a context that is entered before the request is read and left at the end of the call."""


def _wrap_handler(handler: Handler, enter: Enter) -> Handler:
    """Make a handler that enters ``enter(context)`` before the request is read and leaves it at the end.

    Raises:
        TypeError: the handler is not asynchronous.
    """
    inner = _behaviour_of(handler)
    takes_stream = handler.request_streaming

    async def read_request(requests: AsyncIterator[Any], context: Context) -> Any:
        if takes_stream:
            return _read_stream(requests, context, SESSION_WAIT_S if handler.response_streaming else REQUEST_WAIT_S)
        try:
            async with asyncio.timeout(REQUEST_WAIT_S):
                request = await context.read()
        except TimeoutError:
            await context.abort(grpc.StatusCode.DEADLINE_EXCEEDED, f"no request arrived within {REQUEST_WAIT_S:g} s")
        if request is grpc.aio.EOF:  # type: ignore[attr-defined]
            await context.abort(grpc.StatusCode.INVALID_ARGUMENT, "no request arrived")
        return request

    async def answer(requests: AsyncIterator[Any], context: Context) -> Any:
        async with enter(context):
            return await inner(await read_request(requests, context), context)

    async def stream(requests: AsyncIterator[Any], context: Context) -> None:
        async with enter(context):
            responses = inner(await read_request(requests, context), context)
            if inspect.isasyncgen(responses):
                async with aclosing(responses):
                    async for response in responses:
                        await context.write(response)
            else:
                await responses

    # Unary requests use a streaming handler too: gRPC would read a unary request before it calls the handler.
    make = grpc.stream_stream_rpc_method_handler if handler.response_streaming else grpc.stream_unary_rpc_method_handler
    return make(
        stream if handler.response_streaming else answer, handler.request_deserializer, handler.response_serializer
    )


async def _read_stream(requests: AsyncIterator[Any], context: Context, wait_s: float) -> AsyncIterator[Any]:
    """Yield the requests of a stream; abort the call if the next one does not arrive within ``wait_s``.

    The stream of a disconnected client ends like a complete one, shortly before gRPC cancels the call. Waiting
    ``CANCEL_DELAY_S`` tells the two apart.
    """
    while True:
        try:
            async with asyncio.timeout(wait_s):
                request = await anext(requests, None)
        except TimeoutError:
            await context.abort(grpc.StatusCode.DEADLINE_EXCEEDED, f"no message arrived within {wait_s:g} s")
        if request is None:
            break
        yield request
    await asyncio.sleep(CANCEL_DELAY_S)


def _behaviour_of(handler: Handler) -> Callable[[Any, Context], Any]:
    kinds = (handler.unary_unary, handler.unary_stream, handler.stream_unary, handler.stream_stream)
    inner = next(kind for kind in kinds if kind is not None)
    if not (inspect.iscoroutinefunction(inner) or inspect.isasyncgenfunction(inner)):
        raise TypeError(f"{inner!r} is neither a coroutine function nor an asynchronous generator function")
    return inner  # type: ignore[return-value]
