"""The commands that speak to a planning service: arguments in, exit codes out."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Any

import typer

from service.cli.run import ended_by_sigterm, run

REMOTE_EXIT_CODES = (
    "Exit codes: 0 CERTIFIED, 2 usage, 3 INVALID_REQUEST, 4 no certificate, 5 TIME_LIMIT, 6 OVERLOADED, "
    "69 UNAVAILABLE, 70 internal error, 77 NOT_ALLOWED, 130 CANCELLED."
)

Target = Annotated[
    str, typer.Option(help="The server: HOST:PORT or unix:PATH.", envvar="SCOPT_TARGET", show_default=False)
]
TlsCa = Annotated[Path | None, typer.Option(help="Authority that the server's certificate comes from (PEM): use TLS.")]
TlsCert = Annotated[Path | None, typer.Option(help="Certificate of this client (PEM), where the server asks for one.")]
TlsKey = Annotated[Path | None, typer.Option(help="Its private key (PEM).")]
TokenFile = Annotated[Path | None, typer.Option(help="File with the token; by default the variable SCOPT_TOKEN.")]
Attempts = Annotated[int, typer.Option(help="How often to ask a server that is away or overloaded.", min=1)]
Json = Annotated[bool, typer.Option("--json", help="Print exactly one JSON object on stdout.")]


def request_command(
    request: Annotated[Path, typer.Argument(help="Request file (YAML or JSON).", metavar="REQUEST")],
    target: Target,
    out: Annotated[Path | None, typer.Option(help="Result folder; by default out/NAME of the request.")] = None,
    deadline: Annotated[float | None, typer.Option(help="Seconds it may take, queue included.", min=0.01)] = None,
    request_id: Annotated[
        str | None, typer.Option(help="Name for it: asked again by this name, it is the same plan.", metavar="ID")
    ] = None,
    attempts: Attempts = 3,
    tls_ca: TlsCa = None,
    tls_cert: TlsCert = None,
    tls_key: TlsKey = None,
    token_file: TokenFile = None,
    as_json: Json = False,
) -> None:
    """Have a server plan a request, write the result.

    The result folder is the one that plan writes. Clouds of the request that are files here are uploaded. Ctrl-C stops
    the plan.
    """
    where = _where(target, tls_ca, tls_cert, tls_key, token_file, attempts)
    folder = out if out is not None else Path("out") / request.stem

    def command() -> str:
        from service.cli.request import request_plan

        with ended_by_sigterm():
            return request_plan(where, request, folder, deadline, request_id, as_json)

    raise typer.Exit(run(command, as_json, has_verdict=True))


def review_command(
    plan_id: Annotated[str, typer.Argument(help="As scopt request told it.", metavar="PLAN_ID")],
    target: Target,
    is_accepted: Annotated[
        bool | None, typer.Option("--accept/--reject", help="What you say of it.", show_default=False)
    ] = None,
    comment: Annotated[str, typer.Option(help="Why.")] = "",
    out: Annotated[
        Path | None, typer.Option(help="Folder to fetch the plan's files to, with the viewer to look at.")
    ] = None,
    tls_ca: TlsCa = None,
    tls_cert: TlsCert = None,
    tls_key: TlsKey = None,
    token_file: TokenFile = None,
    as_json: Json = False,
) -> None:
    """Accept or reject a plan of a server.

    The review is bound to the hashes of the trajectory and the certificate that are shown. Without --accept or
    --reject, the plan and its reviews are shown. With --out, its files come too, viewer.html among them.
    """
    where = _where(target, tls_ca, tls_cert, tls_key, token_file)

    def command() -> None:
        from service.cli.review import review_plan

        review_plan(where, plan_id, is_accepted, comment, out, as_json)

    raise typer.Exit(run(command, as_json))


def top_command(
    target: Target,
    every: Annotated[float, typer.Option(help="Seconds between looks.", min=0.1)] = 1.0,
    once: Annotated[bool, typer.Option("--once", help="Look once; always so where stdout is no terminal.")] = False,
    tls_ca: TlsCa = None,
    tls_cert: TlsCert = None,
    tls_key: TlsKey = None,
    token_file: TokenFile = None,
    as_json: Json = False,
) -> None:
    """Watch what a server is doing.

    Workers, queue, verdicts and latencies, until Ctrl-C.
    """
    where = _where(target, tls_ca, tls_cert, tls_key, token_file, 1)

    def command() -> None:
        from service.cli.top import watch

        watch(where, every, once, as_json)

    raise typer.Exit(run(command, as_json))


def _where(
    target: str,
    tls_ca: Path | None,
    tls_cert: Path | None,
    tls_key: Path | None,
    token_file: Path | None,
    attempts: int = 3,
) -> dict[str, Any]:
    os.environ.setdefault("GRPC_VERBOSITY", "NONE")  # what it tells of sockets, the commands say in words of their own
    return {
        "target": target,
        "tls_ca": tls_ca,
        "tls_cert": tls_cert,
        "tls_key": tls_key,
        "token_file": token_file,
        "attempts": attempts,
    }
