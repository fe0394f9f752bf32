"""``scopt health``: whether a server accepts work, for probes of containers and service managers."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from service.cli.command import command
from service.cli.run import EndedError

UNAVAILABLE = 69


@command()
def health_command(
    target: Annotated[
        str, typer.Option(help="Server: HOST:PORT or unix:PATH.", envvar="SCOPT_TARGET")
    ] = "127.0.0.1:50051",
    tls_ca: Annotated[Path | None, typer.Option(help="Authority of the server's certificate (PEM).")] = None,
    timeout: Annotated[float, typer.Option(help="Seconds to wait for the answer.", min=0.1)] = 3.0,
) -> None:
    """Print SERVING and end with 0 if a server accepts work, else with 69; no token is needed."""
    import grpc
    from grpc_health.v1 import health_pb2, health_pb2_grpc

    from service.client.connection import OPTIONS, Connection

    credentials = Connection(target, tls_ca=tls_ca).credentials()
    with (
        grpc.insecure_channel(target, OPTIONS)
        if credentials is None
        else grpc.secure_channel(target, credentials, OPTIONS)
    ) as channel:
        try:
            answer = health_pb2_grpc.HealthStub(channel).Check(health_pb2.HealthCheckRequest(), timeout=timeout)
        except grpc.RpcError as error:
            reason = f"UNAVAILABLE: {target} does not answer within {timeout:g} s ({error.code().name})"
            raise EndedError("UNAVAILABLE", (reason,), UNAVAILABLE) from None
    status = health_pb2.HealthCheckResponse.ServingStatus.Name(answer.status)
    if answer.status != health_pb2.HealthCheckResponse.SERVING:
        raise EndedError("UNAVAILABLE", (status,), UNAVAILABLE)
    typer.echo(status)
