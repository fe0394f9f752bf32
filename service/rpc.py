"""What interceptors put around an RPC of any kind, and how it ends with more than a code."""

from __future__ import annotations

import asyncio
import inspect
import time
from abc import ABC, abstractmethod
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import AbstractAsyncContextManager, aclosing
from typing import Any, NoReturn, TypeAlias

import grpc
from google.protobuf import duration_pb2
from google.protobuf.message import Message
from google.rpc import error_details_pb2, status_pb2

Context: TypeAlias = "grpc.aio.ServicerContext[Any, Any]"
Handler: TypeAlias = "grpc.RpcMethodHandler[Any, Any]"
Enter = Callable[[Context], AbstractAsyncContextManager[None]]

DETAILS_KEY = "grpc-status-details-bin"
MAX_TEXT_BYTES = 1000  # of a status: it travels in a header, and headers of more than 8 KiB end the call otherwise
# A client that opens a call and says nothing does not hold its place for ever.
REQUEST_WAIT_S = 60.0
GONE_AFTER_S = 0.005


class Refusal(Exception):  # noqa: N818 - an answer, not an accident
    """Ends an RPC with a status, a sentence for people, and details for programs.

    Attributes:
        code: the status.
        text: the sentence.
        retry_after_s: when to try again, where that may do (``google.rpc.RetryInfo``).
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
        self.code, self.text, self.retry_after_s = code, shortened(text, MAX_TEXT_BYTES), retry_after_s
        self.details = tuple(details)

    def metadata(self) -> tuple[tuple[str, bytes], ...]:
        """The details as trailing metadata; none where there are none."""
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


def shortened(text: str, n_bytes: int) -> str:
    """The beginning of a text, as UTF-8 of at most ``n_bytes``."""
    return text.encode(errors="replace")[:n_bytes].decode(errors="ignore")


async def refuse(context: Context, refusal: Refusal) -> NoReturn:
    """End an RPC."""
    await context.abort(refusal.code, refusal.text, refusal.metadata())


def deadline_of(context: Context) -> float | None:
    """On the clock of ``time.monotonic`` [s]; None where the client set none."""
    left = context.time_remaining()
    return None if left is None else time.monotonic() + left


class Interceptor(grpc.aio.ServerInterceptor, ABC):  # type: ignore[type-arg]
    """Stands before every call of a method that is there; others have no handler to stand before."""

    async def intercept_service(
        self,
        continuation: Callable[[grpc.HandlerCallDetails], Awaitable[Handler]],
        handler_call_details: grpc.HandlerCallDetails,
    ) -> Handler:
        """The method's handler, with ``through`` around each of its calls."""
        handler = await continuation(handler_call_details)
        method = handler_call_details.method
        return around(handler, lambda context: self.through(method, context)) if handler else handler

    @abstractmethod
    def through(self, method: str, context: Context) -> AbstractAsyncContextManager[None]:
        """Entered before anything of a call's request is read, left at its end."""


def around(handler: Handler, enter: Enter) -> Handler:
    """A handler that enters ``enter(context)`` before anything of the request is read, and leaves it at the end.

    Raises:
        TypeError: the handler is not asynchronous.
    """
    inner = _inner(handler)
    takes_stream = handler.request_streaming

    async def request_of(requests: AsyncIterator[Any], context: Context) -> Any:
        if takes_stream:
            return _to_their_end(requests, context)
        try:
            async with asyncio.timeout(REQUEST_WAIT_S):
                request = await context.read()
        except TimeoutError:
            await context.abort(grpc.StatusCode.DEADLINE_EXCEEDED, f"no request came in {REQUEST_WAIT_S:g} s")
        if request is grpc.aio.EOF:  # type: ignore[attr-defined]
            await context.abort(grpc.StatusCode.INVALID_ARGUMENT, "no request came")
        return request

    async def answer(requests: AsyncIterator[Any], context: Context) -> Any:
        async with enter(context):
            return await inner(await request_of(requests, context), context)

    async def stream(requests: AsyncIterator[Any], context: Context) -> None:
        async with enter(context):
            responses = inner(await request_of(requests, context), context)
            if inspect.isasyncgen(responses):
                async with aclosing(responses):
                    async for response in responses:
                        await context.write(response)
            else:
                await responses

    # Unary requests come through a streaming handler too: gRPC reads a unary one before it calls anybody.
    make = grpc.stream_stream_rpc_method_handler if handler.response_streaming else grpc.stream_unary_rpc_method_handler
    return make(
        stream if handler.response_streaming else answer, handler.request_deserializer, handler.response_serializer
    )


async def _to_their_end(requests: AsyncIterator[Any], context: Context) -> AsyncIterator[Any]:
    """The requests of a stream, which ends where none comes for too long.

    That of a client who has gone ends as that of a client who has said everything does, a moment before the call is
    cancelled; nobody takes the one for the other who waits that moment.
    """
    while True:
        try:
            async with asyncio.timeout(REQUEST_WAIT_S):
                request = await anext(requests, None)
        except TimeoutError:
            await context.abort(grpc.StatusCode.DEADLINE_EXCEEDED, f"nothing more came in {REQUEST_WAIT_S:g} s")
        if request is None:
            break
        yield request
    await asyncio.sleep(GONE_AFTER_S)


def _inner(handler: Handler) -> Callable[[Any, Context], Any]:
    kinds = (handler.unary_unary, handler.unary_stream, handler.stream_unary, handler.stream_stream)
    inner = next(kind for kind in kinds if kind is not None)
    if not (inspect.iscoroutinefunction(inner) or inspect.isasyncgenfunction(inner)):
        raise TypeError(f"{inner!r} is no coroutine function and no asynchronous generator function")
    return inner  # type: ignore[return-value]
