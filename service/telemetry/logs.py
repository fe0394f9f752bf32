"""Logs on stderr, as JSON lines or readable lines at a terminal, without secrets; incidents by number."""

from __future__ import annotations

import logging
import math
import re
import secrets
import sys
from collections.abc import Mapping, Sequence
from typing import Any, TextIO

import grpc
import structlog
from structlog.typing import EventDict, Processor

from service.trust.rpc import Refusal

MAX_CHARACTERS = 4000  # of one value, so that a client cannot fill the disk
_LOG = structlog.get_logger("scopt.server")
_EXCEPTION_KEYS = {"exception"}
_REPLACEMENT = "[secret]"
_SECRETS = (
    re.compile(r"scopt_[A-Za-z0-9_-]{20,}"),
    re.compile(r"(?i)(?<=\bbearer )[^\s\"'\\,)\]}]+"),
    re.compile(r"(?i)(?<=\bbasic )[A-Za-z0-9+/=]{6,}"),
    re.compile(r"-----BEGIN [A-Z ]*PRIVATE KEY-----.*?(-----END [A-Z ]*PRIVATE KEY-----|\Z)", re.DOTALL),
)


def set_up_logs(stream: TextIO | None = None, *, as_json: bool | None = None, level: str = "info") -> None:
    """Send all logs of this process, by structlog or by ``logging``, to ``stream``.

    Each line has the time (UTC), level, logger, event, the keys bound to the request (``request_id``, ``plan_id``,
    ``client``) and its own keys.

    Args:
        stream: stderr by default.
        as_json: by default True unless the stream is a terminal.
        level: lowest level that is logged: debug, info, warning or error.
    """
    stream = sys.stderr if stream is None else stream
    as_json = not stream.isatty() if as_json is None else as_json
    shared: list[Processor] = [
        structlog.contextvars.merge_contextvars,
        structlog.stdlib.add_log_level,
        structlog.stdlib.add_logger_name,
        structlog.stdlib.ExtraAdder(),
        structlog.processors.TimeStamper(fmt="iso", utc=True),
    ]
    structlog.configure(
        processors=[
            structlog.stdlib.filter_by_level,
            *shared,
            structlog.stdlib.PositionalArgumentsFormatter(),
            structlog.stdlib.ProcessorFormatter.wrap_for_formatter,
        ],
        logger_factory=structlog.stdlib.LoggerFactory(),
        wrapper_class=structlog.stdlib.BoundLogger,
        cache_logger_on_first_use=False,
    )
    render: list[Processor] = [structlog.stdlib.ProcessorFormatter.remove_processors_meta]
    if as_json:
        render += [structlog.processors.format_exc_info, _sanitize, structlog.processors.JSONRenderer(default=str)]
    else:
        traceback = structlog.dev.plain_traceback
        render += [_sanitize, structlog.dev.ConsoleRenderer(colors=stream.isatty(), exception_formatter=traceback)]
    new = logging.StreamHandler(stream)
    new.setFormatter(_Formatter(foreign_pre_chain=shared, processors=render))
    root = logging.getLogger()
    for old in [handler for handler in root.handlers if isinstance(handler.formatter, _Formatter)]:
        root.removeHandler(old)
    root.addHandler(new)
    root.setLevel(level.upper())


def bind(**ids: str) -> None:
    """Add keys to every further log line of the request that this task answers."""
    structlog.contextvars.bind_contextvars(**ids)


def log_incident(error: BaseException, **where: Any) -> Refusal:
    """Log an unexpected error with its traceback; the returned refusal tells the client only the incident's number.

    Args:
        error: with its traceback.
        where: further keys of the log line.
    """
    number = secrets.token_hex(4)
    _LOG.error("incident", incident=number, exc_info=error, **where)
    return Refusal(grpc.StatusCode.INTERNAL, f"internal error {number}, please report it; the server's log tells more")


def remove_secrets(text: str) -> str:
    """Replace every token and private key in a text, also in the middle of JSON or of a traceback."""
    for secret in _SECRETS:
        text = secret.sub(_REPLACEMENT, text)
    return text


class _Formatter(structlog.stdlib.ProcessorFormatter):
    """Formatter that removes secrets anywhere in the line."""

    def format(self, record: logging.LogRecord) -> str:
        return remove_secrets(super().format(record))


def _sanitize(logger: Any, method: str, event: EventDict) -> Mapping[str, Any]:
    """Convert values to JSON's types and bound their length; control characters are escaped against forged lines."""
    return {key: value if key in _EXCEPTION_KEYS else _to_json(value) for key, value in event.items()}


def _to_json(value: Any) -> Any:
    if isinstance(value, str):
        text = value if value.isprintable() else "".join(c if c.isprintable() else repr(c)[1:-1] for c in value)
        return text if len(text) <= MAX_CHARACTERS else f"{text[:MAX_CHARACTERS]}… ({len(value)} characters)"
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    if isinstance(value, Mapping):
        return {_to_json(str(key)): _to_json(entry) for key, entry in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, bytes | bytearray | tuple):
        return [_to_json(entry) for entry in value]
    return value
