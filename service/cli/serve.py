"""``scopt serve`` and ``scopt token``: the planning service, and who may come in."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Any

import typer

from service.cli.run import run

DEFAULT_LISTEN = "127.0.0.1:50051"


def serve_command(
    listen: Annotated[
        str, typer.Option(help="Where: HOST:PORT (port 0: any), [IPV6]:PORT or unix:PATH.")
    ] = DEFAULT_LISTEN,
    data: Annotated[
        Path | None,
        typer.Option(help="Folder for plans, reviews and clouds; by default the user's own."),
    ] = None,
    workers: Annotated[int | None, typer.Option(help="Processes that plan; by default one per core.", min=1)] = None,
    spread: Annotated[
        int, typer.Option(help="Workers that may try starts of one plan, while nobody else needs them.", min=1)
    ] = 1,
    queue: Annotated[int, typer.Option(help="Requests that may wait for each of them.", min=0)] = 4,
    budget: Annotated[
        list[str] | None,
        typer.Option(help="Longest time limit of a kind of request; may be given again.", metavar="KIND=SECONDS"),
    ] = None,
    allow: Annotated[
        list[Path] | None, typer.Option(help="Folder from which requests may name files; may be given again.")
    ] = None,
    robots: Annotated[Path | None, typer.Option(help="Folder with a subfolder (robot.urdf, ...) per robot.")] = None,
    tls_cert: Annotated[Path | None, typer.Option(help="Certificate chain (PEM).")] = None,
    tls_key: Annotated[Path | None, typer.Option(help="Its private key (PEM).")] = None,
    client_ca: Annotated[Path | None, typer.Option(help="Authority that client certificates must come from.")] = None,
    tokens: Annotated[Path | None, typer.Option(help="File that says who may do what (see scopt token).")] = None,
    metrics: Annotated[str | None, typer.Option(help="Serve Prometheus metrics there.", metavar="HOST:PORT")] = None,
    executor: Annotated[str, typer.Option(help="What plans: local, or ray://HOST:PORT of a Ray cluster.")] = "local",
    drain: Annotated[float, typer.Option(help="Seconds for running plans after a signal to stop.", min=0.0)] = 30.0,
    requests_per_s: Annotated[
        float, typer.Option(help="Calls each client may make in the long run; five times as many at once.", min=0.1)
    ] = 200.0,
) -> None:
    """Answer requests over gRPC until a signal to stop.

    Without TLS and tokens only this machine is listened to. The first SIGTERM or Ctrl-C lets running plans finish, the
    second one does not.
    """
    settings: dict[str, Any] = {
        "data": data,
        "workers": workers or os.cpu_count() or 1,
        "spread": spread,
        "queue": queue,
        "allowed": tuple(allow or ()),
        "robots": robots,
        "drain_s": drain,
    }
    tls = (tls_cert, tls_key, client_ca)
    told = listen, settings, tuple(budget or ()), tls, tokens, metrics, executor, requests_per_s
    raise typer.Exit(run(lambda: _serve(*told)))


def token_command(
    name: Annotated[str, typer.Argument(help="Of the client.", metavar="NAME")],
    role: Annotated[list[str], typer.Option(help="plan, review or admin; may be given again.", metavar="ROLE")],
) -> None:
    """Make a token: it is printed once, with the lines that the server's --tokens file needs."""
    raise typer.Exit(run(lambda: _token(name, role)))


def _serve(
    listen: str,
    given: dict[str, Any],
    budgets: tuple[str, ...],
    tls: tuple[Path | None, Path | None, Path | None],
    tokens: Path | None,
    metrics: str | None,
    executor: str,
    requests_per_s: float,
) -> None:
    # Before anything loads BLAS: its threads cost more than they bring, here and in the workers.
    for library in ("OMP", "OPENBLAS", "MKL"):
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    os.environ.setdefault("GRPC_VERBOSITY", "NONE")  # its C core writes lines of its own; what matters is logged here
    import asyncio

    from service.server.launch import Launch, launch

    asyncio.run(
        launch(
            Launch(
                listen=listen,
                settings=given,
                budgets=budgets,
                tls=tls,
                tokens=tokens,
                metrics=metrics,
                executor=executor,
                requests_per_s=requests_per_s,
            ),
            lambda address: typer.echo(f"listening on {address}"),
        )
    )


def _token(name: str, roles: list[str]) -> None:
    from service.errors import RequestError, would_do
    from service.trust import Role, make_token

    known = [role.value for role in Role]
    for role in roles:
        if role not in known:
            raise RequestError(f"--role: unknown role {role!r}; {would_do(role, known)} would do")
    token, lines = make_token(name, [Role(role) for role in roles])
    typer.echo(token)
    typer.echo(lines, err=True)
