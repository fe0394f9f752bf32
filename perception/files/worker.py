"""Files of strangers are parsed in a process of their own, bounded in memory and time, that may crash alone."""

from __future__ import annotations

from pathlib import Path

from perception.errors import CloudError
from perception.files.bag import Message
from perception.files.parse import parse_to_values
from perception.files.scan import Scan
from perception.limits import MAX_PARSER_BYTES, MAX_PARSER_CPU_S, MAX_PARSER_WALL_S
from perception.sandbox import Cause, ProcessLimits, SandboxError, run_in_sandbox

PARSER_LIMITS = ProcessLimits(MAX_PARSER_BYTES, MAX_PARSER_WALL_S, MAX_PARSER_CPU_S)


def parse_in_sandbox(
    path: Path, topic: str | None = None, message: Message = 0, limits: ProcessLimits = PARSER_LIMITS
) -> Scan:
    """As ``parse_file``, in a fresh process: whatever the file does to its reader, this process sees a ``CloudError``.

    Raises:
        CloudError: naming the file, what is wrong and what is expected.
        Stopped: the caller was asked to stop; the process is killed.
    """
    try:
        values = run_in_sandbox(parse_to_values, {"path": str(path), "topic": topic, "message": message}, limits)
    except SandboxError as error:
        raise CloudError(f"{path}: {_reason(error)}") from None
    if "error" in values:
        raise CloudError(values["error"])
    viewpoint = values.pop("viewpoint")
    return Scan(viewpoint=None if viewpoint is None else tuple(viewpoint), notes=tuple(values.pop("notes")), **values)


def _reason(error: SandboxError) -> str:
    needs_memory = f"needs more than {error.limit} to read; is it damaged, or much larger than it looks?"
    if error.cause is Cause.MEMORY:
        return needs_memory
    if error.cause is Cause.CPU_TIME:
        return f"took more than {error.limit} to read; is it damaged, or much larger than it looks?"
    if error.cause is Cause.WALL_TIME:
        return f"took more than {error.limit} to read; is it damaged, or the machine busy?"
    more = f" or it {needs_memory}" if error.ending == "SIGABRT" else ""
    return f"made its reader stop ({error.ending}); is it damaged?{more}"
