"""A client for the length of a command, whose errors become exit codes."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from grpc import StatusCode
from rich.console import Console

from service.cli.run import EXIT_CODES, EXIT_INTERNAL, INTERNAL_ERROR, EndedError
from service.client import PlannerClient, PlannerError, Retry
from service.errors import RequestError

TOKEN_VARIABLE = "SCOPT_TOKEN"
MAX_TOKEN_BYTES = 10_000
_INVALID = ("INVALID_REQUEST", EXIT_CODES["INVALID_REQUEST"])
_INTERNAL = (INTERNAL_ERROR, EXIT_INTERNAL)
_NOT_ALLOWED = ("NOT_ALLOWED", 77)
# What a command says, and its exit code, by how the call ended; those of sysexits.h where there are some.
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
    StatusCode.DATA_LOSS: _INTERNAL,
    StatusCode.UNAUTHENTICATED: _NOT_ALLOWED,
}


@contextmanager
def connected(where: Mapping[str, Any], err: Console) -> Iterator[PlannerClient]:
    """
    Args:
        where: target, TLS files, token file, attempts.
        err: where to say that it is tried again.

    Raises:
        EndedError: a call came to nothing.
    """
    settings = {name: where[name] for name in ("target", "tls_ca", "tls_cert", "tls_key")}
    token, source = _token(where["token_file"])

    def again(error: PlannerError, delay_s: float) -> None:
        line = f"{ENDINGS[error.code][0]}: {error.problems[0]}; trying again in {delay_s:.1f} s"
        err.print(line, style="yellow", markup=False, soft_wrap=True)

    retry = Retry(attempts=where["attempts"])
    try:
        with _client(settings, token, source, retry=retry, on_retry=again) as client:
            yield client
    except PlannerError as error:
        verdict, code = ENDINGS[error.code]
        lines = error.problems
        if error.code is StatusCode.UNAUTHENTICATED:
            lines = (f"{lines[0]}; {_would_do(token, source)}", *lines[1:])
        raise EndedError(verdict, lines, code) from None


def _client(settings: Mapping[str, Any], token: str | None, source: str, **more: Any) -> PlannerClient:
    """
    Raises:
        RequestError: what was given cannot be used; of a token, it says where that came from.
    """
    try:
        return PlannerClient(**settings, token=token, **more)
    except RequestError as error:
        of_token = ("token: ", f"{source}: ")
        raise RequestError(
            [line.replace(*of_token) if line.startswith("token: ") else line for line in error.problems]
        ) from None


def _would_do(token: str | None, source: str) -> str:
    if token is None:
        return f"--token-file FILE or the variable {TOKEN_VARIABLE} would do"
    return f"the token is that of {source}"


def _token(path: Path | None) -> tuple[str | None, str]:
    """The token, if there is one, and what it comes from."""
    if path is None:
        return os.environ.get(TOKEN_VARIABLE) or None, f"the variable {TOKEN_VARIABLE}"
    source = f"--token-file {path}"
    try:
        with path.open("rb") as file:
            token = file.read(MAX_TOKEN_BYTES).decode().strip()
    except UnicodeDecodeError:
        raise RequestError(f"{source} is no text") from None
    except OSError as error:
        raise RequestError(f"{source} cannot be read: {error.strerror}") from None
    if not token:
        raise RequestError(f"{source} is empty; the line that `scopt token` prints on stdout would do")
    return token, source
