"""Files of strangers are parsed in a process of their own, bounded in memory and time, that may crash alone."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np

from costs.stopping import poll
from perception.errors import CloudError
from perception.files import child
from perception.files.bag import Message
from perception.files.scan import Scan
from perception.limits import MAX_PARSER_BYTES, MAX_PARSER_CPU_S, MAX_PARSER_WALL_S

_LOOK_S = 0.05  # how often a running process is looked after


@dataclass(frozen=True)
class Limits:
    """What the process may use.

    Attributes:
        max_bytes: of address space, libraries included.
        max_cpu_s: of processor time [s].
        max_wall_s: from start to end [s].
    """

    max_bytes: int = MAX_PARSER_BYTES
    max_cpu_s: int = MAX_PARSER_CPU_S
    max_wall_s: float = MAX_PARSER_WALL_S


_DEFAULT_LIMITS = Limits()


def parse_in_worker(
    path: Path, topic: str | None = None, message: Message = 0, limits: Limits = _DEFAULT_LIMITS
) -> Scan:
    """As ``parse_file``, in a fresh process: whatever the file does to its reader, this process sees a ``CloudError``.

    A new interpreter that imports no more than the readers, instead of a fork, since this process may have threads.

    Raises:
        CloudError: naming the file, what is wrong and what would do.
        Stopped: it was asked to stop; the process is killed.
    """
    task = {
        "file": str(path),
        "topic": topic,
        "message": message,
        "path": sys.path,
        "max_bytes": limits.max_bytes,
        "max_cpu_s": limits.max_cpu_s,
        "max_wall_s": limits.max_wall_s,
    }
    with tempfile.TemporaryFile() as answer:
        code = _run(json.dumps(task).encode(), answer, limits.max_wall_s)
        answer.seek(0)
        head = answer.readline()
        if code == 0 and head:
            return _scan(json.loads(head), answer, path, limits)
    raise CloudError(f"{path}: {_how_it_ended(code, limits)}")


def _run(task: bytes | None, answer: IO[bytes], max_wall_s: float) -> int:
    # Threads of numerical libraries cost address space and have nothing to do.
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    process = subprocess.Popen(
        [sys.executable, "-I", "-S", child.__file__],
        stdin=subprocess.PIPE,
        stdout=answer,
        stderr=subprocess.DEVNULL,
        env=environment,
        start_new_session=True,
    )
    end = time.monotonic() + max_wall_s
    try:
        while not _has_ended(process, task):
            task = None  # it has it by now
            poll()
            if time.monotonic() > end:
                return -signal.SIGALRM
    finally:
        process.kill()
        process.wait()
    return process.returncode


def _has_ended(process: subprocess.Popen[bytes], task: bytes | None) -> bool:
    """Wait for it a while, handing it its task the first time."""
    try:
        process.communicate(task, timeout=_LOOK_S)
    except subprocess.TimeoutExpired:
        return False
    return True


def _scan(head: dict[str, object], body: IO[bytes], path: Path, limits: Limits) -> Scan:
    if "error" in head:
        raise CloudError(str(head["error"]))
    if "failed" in head:
        raise CloudError(f"{path}: {_needs_memory(limits)}")
    shapes: dict[str, list[int]] = head["arrays"]  # type: ignore[assignment]
    arrays = {
        key: np.fromfile(body, dtype="<f8", count=math.prod(shape)).reshape(shape) for key, shape in shapes.items()
    }
    viewpoint: list[float] | None = head["viewpoint"]  # type: ignore[assignment]
    notes: list[str] = head["notes"]  # type: ignore[assignment]
    return Scan(
        arrays["points"],
        None if viewpoint is None else tuple(viewpoint),
        arrays["misses"],
        arrays.get("starts"),
        arrays.get("miss_starts"),
        tuple(notes),
        str(head["unit"]),
    )


def _how_it_ended(code: int, limits: Limits) -> str:
    if code == -signal.SIGXCPU:
        return f"took more than {limits.max_cpu_s} s to read; is it damaged, or much larger than it looks?"
    if code == -signal.SIGALRM:
        return f"took more than {limits.max_wall_s:g} s to read; is it damaged, or the machine busy?"
    if code == -signal.SIGABRT:
        return f"made its reader stop (SIGABRT); is it damaged? or it {_needs_memory(limits)}"
    name = signal.Signals(-code).name if -code in set(signal.Signals) else f"exit {code}"
    return f"made its reader stop ({name}); is it damaged?"


def _needs_memory(limits: Limits) -> str:
    return f"needs more than {limits.max_bytes // 2**20} MB to read; is it damaged, or much larger than it looks?"
