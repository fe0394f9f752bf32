"""How the service's methods are registered: messages that cannot be read are answered, and refusals become statuses."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Any

import grpc
from google.protobuf.message import DecodeError, Message
from google.protobuf.message_factory import GetMessageClass

from service.proto.planner.v1 import planner_pb2
from service.server.failures import refusal_for
from service.server.refusal import invalid
from service.server.settings import SMALL_BYTES
from service.trust.rpc import Context, refuse
from service.wire.entries import crowding
from service.wire.unknown import unknown_fields

SERVICE = planner_pb2.DESCRIPTOR.services_by_name["PlannerService"]


class UnreadableMessage:
    """Stands for bytes that are no message of the method's type."""

    def __init__(self, name: str) -> None:
        self.name = name


def method_handlers(servicer: object) -> grpc.GenericRpcHandler[Any, Any]:
    """Handlers for all methods of the service; ``servicer`` has a coroutine or asynchronous generator for each.

    A method that answers once is ``async def Name(self, request, context)``, one that streams yields its messages. One
    that takes a stream gets an asynchronous iterator.
    """
    handlers = {}
    for method in SERVICE.methods:
        behaviour = getattr(servicer, method.name)
        kind = GetMessageClass(method.input_type)
        if method.server_streaming:
            handlers[method.name] = grpc.unary_stream_rpc_method_handler(_streaming(behaviour), _reader(kind), _written)
        elif method.client_streaming:
            handlers[method.name] = grpc.stream_unary_rpc_method_handler(_taking(behaviour), _reader(kind), _written)
        else:
            handlers[method.name] = grpc.unary_unary_rpc_method_handler(_answering(behaviour), _reader(kind), _written)
    return grpc.method_handlers_generic_handler(SERVICE.full_name, handlers)


def _reader(kind: type[Message]) -> Callable[[bytes], Message | UnreadableMessage]:
    def read(data: bytes) -> Message | UnreadableMessage:
        try:
            return kind.FromString(data)
        except DecodeError:
            return UnreadableMessage(kind.DESCRIPTOR.full_name)

    return read


def _written(message: Message) -> bytes:
    return message.SerializeToString()


async def _readable(request: Message | UnreadableMessage) -> Message:
    """A message all of which is known, and not too much.

    Raises:
        Refusal: INVALID_ARGUMENT.
    """
    if isinstance(request, UnreadableMessage):
        raise invalid([f"the bytes are no {request.name}"])
    if request.ByteSize() <= SMALL_BYTES:
        return _known(request)
    return await asyncio.to_thread(_known, request)


def _known(request: Message) -> Message:
    crowded = crowding(request)
    if crowded:
        raise invalid([crowded])
    unknown = list(dict.fromkeys(unknown_fields(request)))
    if unknown:
        raise invalid(unknown)
    return request


def _answering(behaviour: Callable[[Any, Context], Awaitable[Message]]) -> Callable[[Any, Context], Any]:
    async def call(request: Any, context: Context) -> Message | None:
        try:
            return await behaviour(await _readable(request), context)
        except grpc.aio.AbortError:
            raise
        except Exception as error:
            await refuse(context, refusal_for(error))

    return call


def _taking(behaviour: Callable[[Any, Context], Awaitable[Message]]) -> Callable[[Any, Context], Any]:
    async def readable(requests: AsyncIterator[Any]) -> AsyncIterator[Any]:
        async for request in requests:
            yield await _readable(request)

    async def call(requests: AsyncIterator[Any], context: Context) -> Message | None:
        try:
            return await behaviour(readable(requests), context)
        except grpc.aio.AbortError:
            raise
        except Exception as error:
            await refuse(context, refusal_for(error))

    return call


def _streaming(behaviour: Callable[[Any, Context], AsyncIterator[Message]]) -> Callable[[Any, Context], Any]:
    async def call(request: Any, context: Context) -> AsyncIterator[Message]:
        try:
            async for message in behaviour(await _readable(request), context):
                yield message
        except grpc.aio.AbortError:
            raise
        except Exception as error:
            await refuse(context, refusal_for(error))

    return call
