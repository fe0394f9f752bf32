"""A client for the length of a command, whose errors become exit codes."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from grpc import StatusCode
from rich.console import Console

from service.cli_run import EXIT_CODES, EXIT_INTERNAL, INTERNAL_ERROR, EndedError
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

    def again(error: PlannerError, delay_s: float) -> None:
        line = f"{ENDINGS[error.code][0]}: {error.problems[0]}; trying again in {delay_s:.1f} s"
        err.print(line, style="yellow", markup=False, soft_wrap=True)

    retry = Retry(attempts=where["attempts"])
    try:
        with PlannerClient(**settings, token=_token(where["token_file"]), retry=retry, on_retry=again) as client:
            yield client
    except PlannerError as error:
        verdict, code = ENDINGS[error.code]
        raise EndedError(verdict, error.problems, code) from None


def _token(path: Path | None) -> str | None:
    if path is None:
        return os.environ.get(TOKEN_VARIABLE) or None
    try:
        with path.open("rb") as file:
            return file.read(MAX_TOKEN_BYTES).decode().strip()
    except UnicodeDecodeError:
        raise RequestError(f"--token-file: {path} is no text") from None
    except OSError as error:
        raise RequestError(f"--token-file: {path} cannot be read: {error.strerror}") from None
