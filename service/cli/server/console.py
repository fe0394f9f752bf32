"""``scopt console``: the operator's page for a planning server."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Annotated, Self

import typer

from service.cli.command import command
from service.errors import RequestError

DEFAULT_LISTEN = "127.0.0.1:8080"
CAMERA = "NAME[@WORD+WORD]=URL"


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
    camera: Annotated[
        list[str] | None,
        typer.Option(help="Pictures beside the view, in phases with such words; may be given again.", metavar=CAMERA),
    ] = None,
    tls_ca: Annotated[Path | None, typer.Option(help="Authority of the server's certificate (PEM).")] = None,
    tls_cert: Annotated[Path | None, typer.Option(help="Certificate of this console (PEM), if required.")] = None,
    tls_key: Annotated[Path | None, typer.Option(help="Private key of that certificate (PEM).")] = None,
) -> None:
    """Serve the operator's page for a planning server until a signal to stop.

    Plans are judged and accepted there, and made of task files. Each operator logs in with a token of their own.
    """
    from service.cli.console import ConsoleSettings, parse_camera, run_console

    folders = tuple(scans or (Path(),))
    wrong = [folder for folder in folders if not folder.is_dir()]
    if wrong:
        raise RequestError(f"--scans {wrong[0]}: is no folder")
    settings = ConsoleSettings(target, tls_ca, tls_cert, tls_key, folders, tuple(map(parse_camera, camera or ())))
    run_console(settings, listen, lambda address: typer.echo(f"console at {address}"))


class ConsoleProcess:
    """The page's server in a process of its own, beside a planning server: neither takes the other along if it ends.

    Args:
        listen: where the page is.
        scans: folders with cloud files.
        cameras: as ``--camera`` of ``scopt console``.

    Raises:
        RequestError: the address cannot be used.
    """

    def __init__(self, listen: str, scans: Sequence[Path], cameras: Sequence[str] = ()) -> None:
        from service.cli.console import parse_camera, parse_listen

        try:
            parse_listen(listen)
        except RequestError as error:
            raise RequestError([problem.replace("--listen", "--console") for problem in error.problems]) from None
        for camera in cameras:
            parse_camera(camera)
        self._arguments = ["--listen", listen, *(word for folder in scans for word in ("--scans", str(folder)))]
        self._arguments += [word for camera in cameras for word in ("--camera", camera)]
        self._process: subprocess.Popen[bytes] | None = None

    def start(self, address: str) -> None:
        """Start it for a server that listens at an address; it writes where its page is on this process's stdout."""
        program = [sys.executable, "-c", "from service.cli.app import main; main()", "console"]
        self._process = subprocess.Popen([*program, "--target", find_target(address), *self._arguments])

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._process is not None:
            self._process.terminate()
            self._process.wait()


def find_target(address: str) -> str:
    """Return the address by which this machine reaches a server that listens at one, or at all of its addresses."""
    host, _, port = address.rpartition(":")
    return {"0.0.0.0": f"127.0.0.1:{port}", "[::]": f"[::1]:{port}"}.get(host, address)
