"""Commands of a planning server's clients: arguments in, exit codes out."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from service.cli.run import ended_by_sigterm, run

REMOTE_EXIT_CODES = (
    "Exit codes: 0 CERTIFIED, 2 usage, 3 INVALID_REQUEST, 4 no certificate, 5 TIME_LIMIT, 6 OVERLOADED, "
    "69 UNAVAILABLE, 70 internal error, 77 NOT_ALLOWED, 130 CANCELLED."
)

Target = Annotated[str, typer.Option(help="Server: HOST:PORT or unix:PATH.", envvar="SCOPT_TARGET", show_default=False)]
TlsCa = Annotated[Path | None, typer.Option(help="Authority of the server's certificate (PEM); turns TLS on.")]
TlsCert = Annotated[Path | None, typer.Option(help="Certificate of this client (PEM), if the server requires one.")]
TlsKey = Annotated[Path | None, typer.Option(help="Private key of that certificate (PEM).")]
TokenFile = Annotated[Path | None, typer.Option(help="File with the token; by default the variable SCOPT_TOKEN.")]
Attempts = Annotated[int, typer.Option(help="Attempts if the server is unreachable or overloaded.", min=1)]
Json = Annotated[bool, typer.Option("--json", help="Print exactly one JSON object on stdout.")]


@dataclass(frozen=True)
class ServerOptions:
    """Server of a command, and the client's proofs of identity."""

    target: str
    tls_ca: Path | None
    tls_cert: Path | None
    tls_key: Path | None
    token_file: Path | None
    attempts: int = 3


def request_command(
    request: Annotated[Path, typer.Argument(help="Request file (YAML or JSON).", metavar="REQUEST")],
    target: Target,
    out: Annotated[Path | None, typer.Option(help="Result folder; by default out/NAME of the request.")] = None,
    deadline: Annotated[float | None, typer.Option(help="Time limit in seconds, queue included.", min=0.01)] = None,
    request_id: Annotated[
        str | None, typer.Option(help="Id of the request; the same id gives the same plan again.", metavar="ID")
    ] = None,
    attempts: Attempts = 3,
    tls_ca: TlsCa = None,
    tls_cert: TlsCert = None,
    tls_key: TlsKey = None,
    token_file: TokenFile = None,
    as_json: Json = False,
) -> None:
    """Plan a request on a server, write the result.

    The result folder is the one that plan writes. Local cloud, mesh and scene files of the request are uploaded. Ctrl-C
    stops the plan.
    """
    server = ServerOptions(target, tls_ca, tls_cert, tls_key, token_file, attempts)
    folder = out if out is not None else Path("out") / request.stem

    def command() -> str:
        from service.cli.request import request_plan

        with ended_by_sigterm():
            return request_plan(server, request, folder, deadline, request_id, as_json)

    raise typer.Exit(_run(command, as_json, has_verdict=True))


def review_command(
    plan_id: Annotated[str, typer.Argument(help="Id that scopt request printed.", metavar="PLAN_ID")],
    target: Target,
    is_accepted: Annotated[
        bool | None, typer.Option("--accept/--reject", help="Your decision.", show_default=False)
    ] = None,
    comment: Annotated[str, typer.Option(help="Reason of the decision.")] = "",
    out: Annotated[Path | None, typer.Option(help="Folder for the plan's files, viewer.html among them.")] = None,
    tls_ca: TlsCa = None,
    tls_cert: TlsCert = None,
    tls_key: TlsKey = None,
    token_file: TokenFile = None,
    as_json: Json = False,
) -> None:
    """Accept or reject a plan of a server.

    The review is bound to the hashes of the trajectory and the certificate that are shown. Without --accept or
    --reject, the plan and its reviews are shown. With --out, its files are fetched.
    """
    server = ServerOptions(target, tls_ca, tls_cert, tls_key, token_file)

    def command() -> None:
        from service.cli.review import review_plan

        review_plan(server, plan_id, is_accepted, comment, out, as_json)

    raise typer.Exit(_run(command, as_json))


def top_command(
    target: Target,
    every: Annotated[float, typer.Option(help="Seconds between updates.", min=0.1)] = 1.0,
    once: Annotated[bool, typer.Option("--once", help="Print once; always so if stdout is no terminal.")] = False,
    tls_ca: TlsCa = None,
    tls_cert: TlsCert = None,
    tls_key: TlsKey = None,
    token_file: TokenFile = None,
    as_json: Json = False,
) -> None:
    """Show the workers, queue, verdicts and latencies of a server.

    Updated until Ctrl-C.
    """
    server = ServerOptions(target, tls_ca, tls_cert, tls_key, token_file, 1)

    def command() -> None:
        from service.cli.top import watch

        watch(server, every, once, as_json)

    raise typer.Exit(_run(command, as_json))


def _run(command: Callable[[], str | None], as_json: bool, has_verdict: bool = False) -> int:
    """Run a command without gRPC's own log: the commands explain failed connections themselves."""
    os.environ.setdefault("GRPC_VERBOSITY", "NONE")  # read by gRPC when a command imports it
    return run(command, as_json, has_verdict)
