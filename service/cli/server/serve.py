"""``scopt serve``: the planning service."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from service.cli.command import command
from service.cli.server.config import read_config_option
from service.errors import RequestError

DEFAULT_LISTEN = "127.0.0.1:50051"


@command()
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
    sign_key: Annotated[
        Path | None, typer.Option(help="Ed25519 private key (PEM) that signs what reviewers accept.")
    ] = None,
    metrics: Annotated[str | None, typer.Option(help="Serve Prometheus metrics there.", metavar="HOST:PORT")] = None,
    executor: Annotated[str, typer.Option(help="What plans: local, or ray://HOST:PORT of a Ray cluster.")] = "local",
    drain: Annotated[float, typer.Option(help="Seconds for running plans after a signal to stop.", min=0.0)] = 30.0,
    requests_per_s: Annotated[
        float, typer.Option(help="Calls each client may make in the long run; five times as many at once.", min=0.1)
    ] = 200.0,
    remote_metrics: Annotated[
        bool, typer.Option("--remote-metrics", help="Other machines may read the metrics; they need no token for it.")
    ] = False,
    socket: Annotated[
        Path | None, typer.Option(help="Unix socket for clients of this machine, besides --listen and without TLS.")
    ] = None,
    console: Annotated[
        str | None,
        typer.Option(help="Serve the operator's page there, such as 127.0.0.1:8080 (see scopt console)."),
    ] = None,
    scans: Annotated[
        list[Path] | None, typer.Option(help="Folder with cloud files for the page; may be given again.")
    ] = None,
    camera: Annotated[
        list[str] | None, typer.Option(help="Pictures for the page; as for scopt console.", metavar="NAME[@WORD]=URL")
    ] = None,
    robot: Annotated[
        str,
        typer.Option(
            help="Robot that plans are carried out on: sim, udp, or a driver; NAME,key=value,... with options.",
            show_default=False,
        ),
    ] = "",
    when_alone: Annotated[
        str, typer.Option(help="What the robot does when its operator has gone: hold, or finish its plan.")
    ] = "hold",
    require_approval: Annotated[
        bool | None,
        typer.Option(
            "--require-approval/--no-require-approval",
            help="Whether the robot carries out accepted plans only; by default unless it is simulated.",
            show_default=False,
        ),
    ] = None,
    scan_age: Annotated[
        float, typer.Option(help="Seconds that a plan's scan may be old when it is carried out.", min=0.0)
    ] = 3600.0,
    config: Annotated[
        Path | None,
        typer.Option(
            help="TOML file with options by name (workers = 4); the command line takes precedence.",
            is_eager=True,
            callback=read_config_option,
        ),
    ] = None,
) -> None:
    """Answer requests over gRPC until a signal to stop.

    Without TLS and tokens only this machine is listened to. The first SIGTERM or Ctrl-C lets running plans finish, the
    second one does not.
    """
    # Before anything loads BLAS: its threads cost more than they bring, here and in the workers.
    for library in ("OMP", "OPENBLAS", "MKL"):
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    import asyncio

    from service.server.launch import ServeOptions, launch
    from service.server.operation.executions import RobotSettings

    options = ServeOptions(
        listen=listen,
        settings={
            "data": data,
            "workers": workers or os.cpu_count() or 1,
            "spread": spread,
            "queue": queue,
            "allowed": tuple(allow or ()),
            "robots": robots,
            "drain_s": drain,
        },
        budgets=tuple(budget or ()),
        tls=(tls_cert, tls_key, client_ca),
        tokens=tokens,
        sign_key=sign_key,
        metrics=metrics,
        is_metrics_remote=remote_metrics,
        socket=socket,
        executor=executor,
        requests_per_s=requests_per_s,
        robot=RobotSettings(robot, when_alone, require_approval, scan_age),
    )
    if console is None:
        asyncio.run(launch(options, lambda address: typer.echo(f"listening on {address}")))
        return
    from service.cli.server.console import ConsoleProcess

    with ConsoleProcess(console, scans or (), camera or ()) as page:
        is_secure = tls_cert is not None
        if is_secure and socket is None:
            raise RequestError("--console: with TLS it reaches the server by --socket PATH; give that too")

        def tell(address: str) -> None:
            typer.echo(f"listening on {address}")
            page.start(f"unix:{socket}" if is_secure else address)

        asyncio.run(launch(options, tell))
