"""Logs on stderr: one line of JSON each, or readable lines at a terminal; no secrets in either."""

from __future__ import annotations

import logging
import math
import sys
from collections.abc import Mapping, Sequence
from typing import Any, TextIO

import structlog
from structlog.typing import EventDict, Processor

from service.seen.secrets import without_secrets

MAX_CHARACTERS = 4000  # of one value: what a client sends does not fill the disk
_EXCEPTION_KEYS = {"exception"}


def set_up_logs(stream: TextIO | None = None, *, as_json: bool | None = None, level: str = "info") -> None:
    """Send everything that is logged in this process, by structlog or by ``logging``, to ``stream``.

    Each line has the time (UTC), level, logger and event, what was bound to the request that is being answered
    (``request_id``, ``plan_id``, ``client``), and its own keys.

    Args:
        stream: stderr by default.
        as_json: by default where the stream is no terminal.
        level: the least that is logged: debug, info, warning or error.
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
        render += [structlog.processors.format_exc_info, _short, structlog.processors.JSONRenderer(default=str)]
    else:
        traceback = structlog.dev.plain_traceback
        render += [_short, structlog.dev.ConsoleRenderer(colors=stream.isatty(), exception_formatter=traceback)]
    handler = logging.StreamHandler(stream)
    handler.setFormatter(_Formatter(foreign_pre_chain=shared, processors=render))
    root = logging.getLogger()
    for old in [one for one in root.handlers if isinstance(one.formatter, _Formatter)]:
        root.removeHandler(old)
    root.addHandler(handler)
    root.setLevel(level.upper())


def bind(**ids: str) -> None:
    """Say something about the request that this task answers, on every line of the log from here on."""
    structlog.contextvars.bind_contextvars(**ids)


class _Formatter(structlog.stdlib.ProcessorFormatter):
    """Takes secrets out of the whole line, wherever in it they are."""

    def format(self, record: logging.LogRecord) -> str:
        return without_secrets(super().format(record))


def _short(logger: Any, method: str, event: EventDict) -> Mapping[str, Any]:
    """Values that JSON has, of a bounded length; in texts no control character forges a line or colours a terminal."""
    return {key: value if key in _EXCEPTION_KEYS else _plain(value) for key, value in event.items()}


def _plain(value: Any) -> Any:
    if isinstance(value, str):
        text = value if value.isprintable() else "".join(c if c.isprintable() else repr(c)[1:-1] for c in value)
        return text if len(text) <= MAX_CHARACTERS else f"{text[:MAX_CHARACTERS]}… ({len(value)} characters)"
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    if isinstance(value, Mapping):
        return {_plain(str(key)): _plain(one) for key, one in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, bytes | bytearray | tuple):
        return [_plain(one) for one in value]
    return value
