"""Client of one command, whose errors become exit codes."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from grpc import StatusCode
from rich.console import Console

from service.cli.options import ServerOptions
from service.cli.run import EXIT_CODES, EXIT_INTERNAL, INTERNAL_ERROR, EndedError
from service.client import PlannerClient, PlannerError, Retry
from service.errors import RequestError

TOKEN_VARIABLE = "SCOPT_TOKEN"
MAX_TOKEN_BYTES = 10_000
_INVALID = ("INVALID_REQUEST", EXIT_CODES["INVALID_REQUEST"])
_INTERNAL = (INTERNAL_ERROR, EXIT_INTERNAL)
_NOT_ALLOWED = ("NOT_ALLOWED", 77)
# Verdict and exit code of a command by the status of its call; exit codes from 64 on are those of sysexits.h.
ENDINGS: Mapping[StatusCode, tuple[str, int]] = {
    StatusCode.OK: _INTERNAL,
    StatusCode.CANCELLED: ("CANCELLED", EXIT_CODES["CANCELLED"]),
    StatusCode.UNKNOWN: _INTERNAL,
    StatusCode.INVALID_ARGUMENT: _INVALID,
    StatusCode.DEADLINE_EXCEEDED: ("TIME_LIMIT", EXIT_CODES["TIME_LIMIT"]),
    StatusCode.NOT_FOUND: _INVALID,
    StatusCode.ALREADY_EXISTS: _INVALID,
    StatusCode.PERMISSION_DENIED: _NOT_ALLOWED,
    StatusCode.RESOURCE_EXHAUSTED: ("OVERLOADED", 6),
    StatusCode.FAILED_PRECONDITION: _INVALID,
    StatusCode.ABORTED: _INTERNAL,
    StatusCode.OUT_OF_RANGE: _INVALID,
    StatusCode.UNIMPLEMENTED: _INVALID,
    StatusCode.INTERNAL: _INTERNAL,
    StatusCode.UNAVAILABLE: ("UNAVAILABLE", 69),
    StatusCode.DATA_LOSS: ("DAMAGED", EXIT_CODES["DAMAGED"]),
    StatusCode.UNAUTHENTICATED: _NOT_ALLOWED,
}


@contextmanager
def connect(server: ServerOptions, stderr: Console, attempts: int = 3) -> Iterator[PlannerClient]:
    """Yield a client of a server; further attempts are reported on ``stderr``.

    Raises:
        EndedError: a call failed.
        RequestError: an option cannot be used.
    """
    token, source = _read_token(server.token_file)

    def report_retry(error: PlannerError, delay_s: float) -> None:
        line = f"{ENDINGS[error.code][0]}: {error.problems[0]}; trying again in {delay_s:.1f} s"
        stderr.print(line, style="yellow", markup=False, soft_wrap=True)

    try:
        client = PlannerClient(
            server.target,
            tls_ca=server.tls_ca,
            tls_cert=server.tls_cert,
            tls_key=server.tls_key,
            token=token,
            retry=Retry(attempts=attempts),
            on_retry=report_retry,
        )
    except RequestError as error:
        raise RequestError([re.sub(r"^token(?=: )", lambda _: source, line) for line in error.problems]) from None
    try:
        with client:
            yield client
    except PlannerError as error:
        verdict, code = ENDINGS[error.code]
        lines = error.problems
        if error.code is StatusCode.UNAUTHENTICATED:
            hint = f"the token is from {source}" if token else f"give --token-file FILE or set {TOKEN_VARIABLE}"
            lines = (f"{lines[0]}; {hint}", *lines[1:])
        raise EndedError(verdict, lines, code) from None


def _read_token(path: Path | None) -> tuple[str | None, str]:
    """Return the token, or None without one, and the name of its source."""
    if path is None:
        return os.environ.get(TOKEN_VARIABLE) or None, f"the variable {TOKEN_VARIABLE}"
    source = f"--token-file {path}"
    try:
        with path.open("rb") as file:
            token = file.read(MAX_TOKEN_BYTES).decode().strip()
    except UnicodeDecodeError:
        raise RequestError(f"{source} is no text file; expected the line that `scopt token` prints on stdout") from None
    except OSError as error:
        raise RequestError(f"{source} cannot be read: {error.strerror}") from None
    if not token:
        raise RequestError(f"{source} is empty; expected the line that `scopt token` prints on stdout")
    return token, source
