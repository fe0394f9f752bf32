"""Methods of the service: their registration, the check of each message, and refusals as statuses."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import dataclass
from itertools import islice
from typing import Any

import grpc
from google.protobuf.message import DecodeError, Message
from google.protobuf.message_factory import GetMessageClass

from service.proto.planner.v1 import execution_pb2 as execution
from service.proto.planner.v1 import planner_pb2 as wire
from service.proto.planner.v1 import pose_pb2
from service.server.cloud_handlers import CloudHandlers
from service.server.operation.executions import ExecutionHandlers
from service.server.operation.lists import ListHandlers
from service.server.operation.pose_handler import PoseHandler
from service.server.plan_handler import PlanHandler
from service.server.query_handlers import QueryHandlers
from service.server.refusals import refuse_error, refuse_invalid
from service.server.requests import set_warnings
from service.server.settings import SMALL_BYTES
from service.server.uploads import UploadHandler
from service.trust.rpc import Context, refuse, shorten
from service.wire.message_checks import MAX_MESSAGES, find_excess, find_unknown_fields, has_unknown_fields

WARNING_KEY = "scopt-warning"  # of the trailing metadata
MAX_WARNINGS, MAX_WARNING_BYTES = 10, 200  # they travel in a header
SERVICE = wire.DESCRIPTOR.services_by_name["PlannerService"]


@dataclass(frozen=True)
class Servicer:
    """The methods of the service under their names on the wire; each calls its handler."""

    plan: PlanHandler
    upload: UploadHandler
    clouds: CloudHandlers
    queries: QueryHandlers
    poses: PoseHandler
    lists: ListHandlers
    executions: ExecutionHandlers

    def Plan(self, message: wire.PlanRequest, context: Context) -> AsyncIterator[wire.PlanResponse | bytes]:
        return self.plan.plan(message, context)

    async def UploadCloud(
        self, messages: AsyncIterator[wire.UploadCloudRequest], context: Context
    ) -> wire.UploadCloudResponse:
        return await self.upload.upload(messages, context)

    def BuildScene(self, message: wire.BuildSceneRequest, context: Context) -> AsyncIterator[wire.BuildSceneResponse]:
        return self.clouds.build_scene(message, context)

    async def GetScene(self, message: wire.GetSceneRequest, context: Context) -> wire.GetSceneResponse:
        return await self.clouds.get_scene(message, context)

    async def Detect(self, message: wire.DetectRequest, context: Context) -> wire.DetectResponse:
        return await self.clouds.detect(message, context)

    async def Verify(self, message: wire.VerifyRequest, context: Context) -> wire.VerifyResponse:
        return await self.queries.verify(message, context)

    async def SimulatePlan(self, message: wire.SimulatePlanRequest, context: Context) -> wire.SimulatePlanResponse:
        return await self.queries.simulate(message, context)

    async def ListRobots(self, message: wire.ListRobotsRequest, context: Context) -> wire.ListRobotsResponse:
        return await self.queries.list_robots(message, context)

    def GetPlan(self, message: wire.GetPlanRequest, context: Context) -> AsyncIterator[wire.GetPlanResponse]:
        return self.queries.get_plan(message, context)

    async def ListPlans(self, message: wire.ListPlansRequest, context: Context) -> wire.ListPlansResponse:
        return await self.lists.list_plans(message, context)

    async def ListScenes(self, message: wire.ListScenesRequest, context: Context) -> wire.ListScenesResponse:
        return await self.lists.list_scenes(message, context)

    async def ReviewPlan(self, message: wire.ReviewPlanRequest, context: Context) -> wire.ReviewPlanResponse:
        return await self.queries.review_plan(message, context)

    def PoseSession(
        self, messages: AsyncIterator[pose_pb2.PoseSessionRequest], context: Context
    ) -> AsyncIterator[pose_pb2.PoseSessionResponse]:
        return self.poses.lead(messages, context)

    async def Execute(self, message: execution.ExecuteRequest, context: Context) -> execution.ExecuteResponse:
        return await self.executions.execute(message, context)

    async def Command(self, message: execution.CommandRequest, context: Context) -> execution.CommandResponse:
        return await self.executions.command(message, context)

    def Watch(self, message: execution.WatchRequest, context: Context) -> AsyncIterator[execution.WatchResponse]:
        return self.executions.watch(message, context)

    async def GetStatus(self, message: wire.GetStatusRequest, context: Context) -> wire.GetStatusResponse:
        return await self.queries.get_status(message, context)


class UnreadableMessage:
    """Bytes that are no message of the method's type."""

    def __init__(self, name: str) -> None:
        self.name = name


def make_handlers(servicer: object) -> grpc.GenericRpcHandler[Any, Any]:
    """Make gRPC handlers for all methods of the service.

    Args:
        servicer: has ``async def Name(self, request, context)`` for each method. A method that streams responses yields
            them; a method that takes a stream gets an asynchronous iterator.
    """
    handlers = {}
    for method in SERVICE.methods:
        behaviour = getattr(servicer, method.name)
        read = _make_reader(GetMessageClass(method.input_type))
        if method.server_streaming and method.client_streaming:
            handlers[method.name] = grpc.stream_stream_rpc_method_handler(
                _exchange_streams(behaviour), read, _serialize
            )
        elif method.server_streaming:
            handlers[method.name] = grpc.unary_stream_rpc_method_handler(_stream_responses(behaviour), read, _serialize)
        elif method.client_streaming:
            handlers[method.name] = grpc.stream_unary_rpc_method_handler(_take_stream(behaviour), read, _serialize)
        else:
            handlers[method.name] = grpc.unary_unary_rpc_method_handler(_answer_once(behaviour), read, _serialize)
    return grpc.method_handlers_generic_handler(SERVICE.full_name, handlers)


def _make_reader(kind: type[Message]) -> Callable[[bytes], Message | UnreadableMessage]:
    def read(data: bytes) -> Message | UnreadableMessage:
        try:
            return kind.FromString(data)
        except DecodeError:
            return UnreadableMessage(kind.DESCRIPTOR.full_name)

    return read


def _serialize(message: Message | bytes) -> bytes:
    return message if isinstance(message, bytes) else message.SerializeToString()


async def _check(request: Message | UnreadableMessage, context: Context) -> Message:
    """Return a message of bounded size; the client is warned of its unknown fields.

    Raises:
        Refusal: INVALID_ARGUMENT.
    """
    if isinstance(request, UnreadableMessage):
        raise refuse_invalid([f"the bytes are no {request.name}"])
    is_small = request.ByteSize() <= SMALL_BYTES
    warnings = _find_warnings(request) if is_small else await asyncio.to_thread(_find_warnings, request)
    set_warnings(warnings)
    if warnings:
        context.set_trailing_metadata([(WARNING_KEY, shorten(warning, MAX_WARNING_BYTES)) for warning in warnings])
    return request


def _find_warnings(request: Message) -> tuple[str, ...]:
    """Return a sentence per unknown field, which is ignored.

    Raises:
        Refusal: there are too many entries.
    """
    if request.ByteSize() > MAX_MESSAGES:  # an entry takes at least one byte
        excess = find_excess(request)
        if excess:
            raise refuse_invalid([excess])
    if not has_unknown_fields(request):
        return ()
    return tuple(islice(dict.fromkeys(find_unknown_fields(request)), MAX_WARNINGS))


def _answer_once(behaviour: Callable[[Any, Context], Awaitable[Message]]) -> Callable[[Any, Context], Any]:
    async def call(request: Any, context: Context) -> Message | None:
        try:
            return await behaviour(await _check(request, context), context)
        except grpc.aio.AbortError:
            raise
        except Exception as error:
            await refuse(context, refuse_error(error))

    return call


async def _check_all(requests: AsyncIterator[Any], context: Context) -> AsyncIterator[Any]:
    async for request in requests:
        yield await _check(request, context)


def _take_stream(behaviour: Callable[[Any, Context], Awaitable[Message]]) -> Callable[[Any, Context], Any]:
    async def call(requests: AsyncIterator[Any], context: Context) -> Message | None:
        try:
            return await behaviour(_check_all(requests, context), context)
        except grpc.aio.AbortError:
            raise
        except Exception as error:
            await refuse(context, refuse_error(error))

    return call


def _exchange_streams(behaviour: Callable[[Any, Context], AsyncIterator[Any]]) -> Callable[[Any, Context], Any]:
    async def call(requests: AsyncIterator[Any], context: Context) -> AsyncIterator[Message]:
        try:
            async for message in behaviour(_check_all(requests, context), context):
                yield message
        except grpc.aio.AbortError:
            raise
        except Exception as error:
            await refuse(context, refuse_error(error))

    return call


def _stream_responses(behaviour: Callable[[Any, Context], AsyncIterator[Any]]) -> Callable[[Any, Context], Any]:
    async def call(request: Any, context: Context) -> AsyncIterator[Message | bytes]:
        try:
            async for message in behaviour(await _check(request, context), context):
                yield message
        except grpc.aio.AbortError:
            raise
        except Exception as error:
            await refuse(context, refuse_error(error))

    return call
