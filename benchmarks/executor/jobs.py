"""Jobs of ``benchmarks.executor.overhead``, in a module of their own since workers do not import the main script."""

from __future__ import annotations

import ctypes
import time
from pathlib import Path

from service.executor import Control


def nothing() -> None:
    """Return at once."""


def echo(data: bytes) -> bytes:
    """Return the argument."""
    return data


def tell_the_time(n_events: int, control: Control) -> None:
    """Report the time repeatedly."""
    for _ in range(n_events):
        control.report(time.monotonic())
        time.sleep(0.002)


def ask_without_rest(control: Control) -> float:
    """Poll for a stop without pause; return the time at which it was seen [s]."""
    control.report(None)
    while not control.should_stop():
        pass
    return time.monotonic()


def stick(control: Control) -> None:
    """Call a function that holds the interpreter's lock and never returns."""
    control.report(None)
    ctypes.PyDLL(None).sleep(600)


def private_bytes() -> int:
    """Return the memory of this process that no other process shares."""
    lines = (line.split() for line in Path("/proc/self/smaps_rollup").read_text().splitlines()[1:])
    return sum(1024 * int(words[1]) for words in lines if words[0].startswith("Private_"))
