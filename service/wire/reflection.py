"""gRPC reflection, version 1 and its predecessor v1alpha, which older clients ask for."""

from __future__ import annotations

from collections.abc import Iterable

import grpc
from google.protobuf.descriptor_pb2 import FileDescriptorProto
from google.protobuf.descriptor_pool import Default
from grpc_reflection.v1alpha import reflection, reflection_pb2, reflection_pb2_grpc

ALPHA, STABLE = "grpc.reflection.v1alpha", "grpc.reflection.v1"
METHOD = "ServerReflectionInfo"


def enable_reflection(server: grpc.aio.Server, services: Iterable[str]) -> None:
    """Let clients ask a server for the schema of its services.

    grpcio-reflection has v1alpha only. The messages of v1 are the same in another package, so that one servicer answers
    both.
    """
    _describe_stable()
    stable = reflection.SERVICE_NAME.replace(ALPHA, STABLE)
    servicer = reflection.aio.ReflectionServicer((*services, reflection.SERVICE_NAME, stable))  # type: ignore[attr-defined]
    reflection_pb2_grpc.add_ServerReflectionServicer_to_server(servicer, server)
    handler = grpc.stream_stream_rpc_method_handler(
        servicer.ServerReflectionInfo,
        request_deserializer=reflection_pb2.ServerReflectionRequest.FromString,
        response_serializer=reflection_pb2.ServerReflectionResponse.SerializeToString,
    )
    server.add_generic_rpc_handlers((grpc.method_handlers_generic_handler(stable, {METHOD: handler}),))


def _describe_stable() -> None:
    """Add the schema of v1 to the default pool, so that reflection describes itself, too."""
    pool = Default()
    path = reflection_pb2.DESCRIPTOR.name.replace("v1alpha", "v1")
    try:
        pool.FindFileByName(path)
    except KeyError:
        file = FileDescriptorProto()
        reflection_pb2.DESCRIPTOR.CopyToProto(file)
        file.name, file.package = path, STABLE
        for message in file.message_type:
            for field in message.field:
                if field.type_name:  # an empty one, once set, is refused
                    field.type_name = field.type_name.replace(ALPHA, STABLE)
        for service in file.service:
            for method in service.method:
                method.input_type = method.input_type.replace(ALPHA, STABLE)
                method.output_type = method.output_type.replace(ALPHA, STABLE)
        pool.AddSerializedFile(file.SerializeToString())
