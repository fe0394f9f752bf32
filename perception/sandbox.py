"""Process sandbox: run a function in a fresh process with bounded memory and time; its crash does not affect ours.

This file is also the script that the process runs.  Until the limits are set it imports only the standard library.
"""

from __future__ import annotations

import ctypes
import json
import math
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import IO, Any

Values = Mapping[str, Any]

_POLL_S = 0.02
_STDERR_BYTES = 2**16
# Text on standard error of a process that ran out of memory.
_OUT_OF_MEMORY = (
    b"MemoryError", b"bad_alloc", b"failed to map segment", b"Cannot allocate memory", b"emory allocation",
)  # fmt: skip


@dataclass(frozen=True)
class ProcessLimits:
    """Limits of a process.

    Attributes:
        max_bytes: address space, including libraries; also the size of each file it writes.
        max_wall_s: wall time [s].
        max_cpu_s: processor time [s]; None: no limit.
    """

    max_bytes: int
    max_wall_s: float
    max_cpu_s: int | None = None


class Cause(Enum):
    """Reason why a process ended without a result."""

    MEMORY = "memory"
    CPU_TIME = "processor time"
    WALL_TIME = "wall time"
    CRASH = "crash"


class SandboxError(Exception):
    """A process that ended without a result.

    Attributes:
        cause: why it ended.
        limit: the limit it reached, and who set it if not this module; for a crash, the memory limit.
        ending: signal name or exit code.
    """

    def __init__(self, cause: Cause, limit: str, ending: str) -> None:
        super().__init__(f"the process ended with {ending} ({cause.value}, limit {limit})")
        self.cause, self.limit, self.ending = cause, limit, ending


def run_in_sandbox(
    function: Callable[..., Values], values: Values, limits: ProcessLimits, n_threads: int | None = 1
) -> dict[str, Any]:
    """Call ``function(**values)`` in a fresh process and return the mapping it returns.

    Starts a new interpreter instead of a fork, since this process may have threads.  It imports the function's module
    without ``perception/__init__``, whose import takes longer than most calls.  A lower hard limit inherited by this
    process takes precedence over ours.

    Args:
        function: module-level function of this package.
        values: arguments: JSON or arrays of numbers, which arrive as float64 or int64; the same holds for the results.
        n_threads: OpenMP threads; None: all cores.

    Raises:
        SandboxError: the process crashed or reached a limit.
        Stopped: the caller was asked to stop; the process is killed.
    """
    max_bytes, memory = _with_inherited(resource.RLIMIT_AS, limits.max_bytes, lambda n: f"{n // 2**20} MB")
    max_cpu_s, cpu = _with_inherited(resource.RLIMIT_CPU, limits.max_cpu_s, lambda n: f"{n} s")
    head = {
        "path": sys.path,
        "module": function.__module__,
        "function": function.__name__,
        "max_bytes": max_bytes,
        "max_cpu_s": max_cpu_s,
        "max_wall_s": limits.max_wall_s,
    }
    with tempfile.TemporaryFile() as task, tempfile.TemporaryFile() as result, tempfile.TemporaryFile() as complaints:
        _write(task, head, values)
        task.seek(0)
        code = _run(task, result, complaints, limits.max_wall_s, n_threads)
        complaints.seek(max(0, complaints.seek(0, os.SEEK_END) - _STDERR_BYTES))
        last_words = complaints.read()
        result.seek(0)
        if code == 0:
            try:
                return _read(result, json.loads(result.readline()))
            except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
                raise SandboxError(Cause.CRASH, memory, "an unreadable result") from None
    ending = signal.Signals(-code).name if -code in set(signal.Signals) else f"exit {code}"
    if code == -signal.SIGXCPU:
        raise SandboxError(Cause.CPU_TIME, cpu, ending)
    if code == -signal.SIGALRM:
        raise SandboxError(Cause.WALL_TIME, f"{limits.max_wall_s:g} s", ending)
    is_short_of_memory = any(words in last_words for words in _OUT_OF_MEMORY)
    raise SandboxError(Cause.MEMORY if is_short_of_memory else Cause.CRASH, memory, ending)


def _with_inherited(kind: int, ours: int | None, text: Callable[[int], str]) -> tuple[int | None, str]:
    """Return the lower of our limit and the inherited hard limit, and a text that names it."""
    _, hard = resource.getrlimit(kind)
    if hard == resource.RLIM_INFINITY or (ours is not None and ours <= hard):
        return ours, "" if ours is None else text(ours)
    name = "RLIMIT_AS" if kind == resource.RLIMIT_AS else "RLIMIT_CPU"
    own = "" if ours is None else f"; its own is {text(ours)}"
    return hard, f"{text(hard)} (the hard limit {name} that scopt was started with{own})"


def _run(task: IO[bytes], result: IO[bytes], complaints: IO[bytes], max_wall_s: float, n_threads: int | None) -> int:
    """Run the process and return its exit code; minus SIGALRM if the time ran out."""
    from costs.stopping import poll

    # Threads of linear algebra libraries take address space and are not used.
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    if n_threads is not None:
        environment["OMP_NUM_THREADS"] = str(n_threads)
    process = subprocess.Popen(
        [sys.executable, "-I", "-S", __file__],
        stdin=task,
        stdout=result,
        stderr=complaints,
        env=environment,
        start_new_session=True,
    )
    end = time.monotonic() + max_wall_s
    try:
        while process.poll() is None:
            poll()
            if time.monotonic() > end:
                return -signal.SIGALRM
            try:
                process.wait(_POLL_S)
            except subprocess.TimeoutExpired:
                continue
        return process.returncode
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def _write(file: IO[bytes], head: dict[str, Any], values: Values) -> None:
    """Write one line of JSON, then the arrays that it lists."""
    arrays = {key: value for key, value in values.items() if hasattr(value, "dtype")}
    head["values"] = {key: value for key, value in values.items() if key not in arrays}
    kinds = {key: "<i8" if array.dtype.kind in "biu" else "<f8" for key, array in arrays.items()}
    head["arrays"] = {key: (kinds[key], array.shape) for key, array in arrays.items()}
    file.write(json.dumps(head).encode() + b"\n")
    for key, array in arrays.items():
        file.write(array.astype(kinds[key], order="C", copy=False).tobytes())


def _read(file: IO[bytes], head: dict[str, Any]) -> dict[str, Any]:
    """Read the arrays that ``_write`` wrote after its JSON line.

    Raises:
        ValueError, KeyError, TypeError, AttributeError: the file was not written by ``_write``.
    """
    import numpy as np

    values = dict(head["values"])
    left = os.fstat(file.fileno()).st_size - file.tell()
    for key, (kind, shape) in head["arrays"].items():
        count = math.prod(shape)
        left -= 8 * count
        if kind not in ("<i8", "<f8") or min(shape, default=0) < 0 or left < 0:
            raise ValueError(f"array {key}: {kind} {shape}")
        values[key] = np.fromfile(file, dtype=kind, count=count).reshape(shape)
    return values


def _main() -> None:
    """Read the task from standard input, run it, and write the result to standard output."""
    with open(sys.stdin.fileno(), "rb", closefd=False) as task:
        head = json.loads(task.readline())
        _limit(head["max_bytes"], head["max_cpu_s"], head["max_wall_s"])
        sys.path[:] = head["path"]
        package = ModuleType("perception")
        package.__path__ = [str(Path(__file__).parent)]
        sys.modules["perception"] = package
        values = _read(task, head)
    with os.fdopen(os.dup(sys.stdout.fileno()), "wb") as result:
        os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # keeps text printed by libraries out of the result
        _write(result, {}, getattr(import_module(head["module"]), head["function"])(**values))


def _limit(max_bytes: int, max_cpu_s: int | None, max_wall_s: float) -> None:
    """Set the limits of this process, and end it when its parent process ends."""
    for kind in (resource.RLIMIT_AS, resource.RLIMIT_FSIZE, resource.RLIMIT_CORE):
        limit = 0 if kind == resource.RLIMIT_CORE else max_bytes
        _, hard = resource.getrlimit(kind)
        limit = limit if hard == resource.RLIM_INFINITY else min(limit, hard)
        resource.setrlimit(kind, (limit, limit))
    if max_cpu_s is not None:
        _, hard = resource.getrlimit(resource.RLIMIT_CPU)
        # At the hard limit itself the process would be killed without giving a reason.
        soft = max_cpu_s if hard == resource.RLIM_INFINITY else max(1, min(max_cpu_s, hard - 1))
        resource.setrlimit(resource.RLIMIT_CPU, (soft, hard))
    signal.setitimer(signal.ITIMER_REAL, max_wall_s)
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG: killed as soon as the parent is gone


if __name__ == "__main__":
    _main()
