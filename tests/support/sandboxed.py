"""Functions for tests to run in a process sandbox; a process imports this module alone."""

from __future__ import annotations

import ctypes
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

_RESULT = 3  # the first free number, which the process keeps its result under


def print_and_return(text: str) -> dict[str, Any]:
    """The text, which is printed as libraries print."""
    os.write(1, text.encode())
    print(text)
    return {"text": text}


def return_values(**values: Any) -> dict[str, Any]:
    """The arguments, and what this process is."""
    loaded = sorted(name for name in sys.modules if name.partition(".")[0] in ("perception", "costs", "scipy"))
    return {**values, "pid": os.getpid(), "loaded": loaded}


def count_limits() -> dict[str, Any]:
    """The soft limits of this process."""
    kinds = (resource.RLIMIT_AS, resource.RLIMIT_CPU, resource.RLIMIT_CORE)
    return {"limits": [resource.getrlimit(kind)[0] for kind in kinds]}


def fill(n: int) -> dict[str, Any]:
    """An array of that many numbers."""
    return {"numbers": np.arange(n, dtype=np.float64)}


def allocate(n_bytes: int) -> dict[str, Any]:
    """So many bytes, held for a moment."""
    return {"n_bytes": len(bytearray(n_bytes))}


def work_without_end() -> dict[str, Any]:
    """Processor time without end."""
    while True:
        pass


def sleep_beside_a_child(note: str) -> dict[str, Any]:
    """Sleep, deaf to the clock, and have a child that does the same; the note says who they are."""
    signal.setitimer(signal.ITIMER_REAL, 0)
    child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
    Path(note).write_text(f"{os.getpid()} {child.pid}")
    time.sleep(600)
    return {}


def crash(how: str) -> dict[str, Any]:
    """End this process without a result."""
    if how == "segfault":
        ctypes.string_at(0)
    if how == "abort":
        os.abort()
    if how == "exit":
        os._exit(3)
    if how == "error":
        raise RuntimeError("a bug")
    os.write(_RESULT, how.encode())
    os._exit(0)
