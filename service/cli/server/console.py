"""``scopt console``: the operator's page for a planning server."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from service.cli.command import command
from service.errors import RequestError

DEFAULT_LISTEN = "127.0.0.1:8080"


@command()
def console_command(
    target: Annotated[
        str, typer.Option(help="Server: HOST:PORT or unix:PATH.", envvar="SCOPT_TARGET", show_default=False)
    ],
    listen: Annotated[str, typer.Option(help="Where the page is: HOST:PORT of this machine.")] = DEFAULT_LISTEN,
    scans: Annotated[
        list[Path] | None,
        typer.Option(help="Folder with cloud files; may be given again. By default the working directory."),
    ] = None,
    tls_ca: Annotated[Path | None, typer.Option(help="Authority of the server's certificate (PEM).")] = None,
    tls_cert: Annotated[Path | None, typer.Option(help="Certificate of this console (PEM), if required.")] = None,
    tls_key: Annotated[Path | None, typer.Option(help="Private key of that certificate (PEM).")] = None,
) -> None:
    """Serve the operator's page for a planning server until a signal to stop.

    Plans are judged and accepted there, and made of task files. Each operator logs in with a token of their own.
    """
    from service.console import ConsoleSettings, run_console

    folders = tuple(scans or (Path(),))
    wrong = [folder for folder in folders if not folder.is_dir()]
    if wrong:
        raise RequestError(f"--scans {wrong[0]}: is no folder")
    settings = ConsoleSettings(target, tls_ca, tls_cert, tls_key, folders)
    run_console(settings, listen, lambda address: typer.echo(f"console at {address}"))
