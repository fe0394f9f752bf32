"""How many threads long searches may use; one, unless a program says otherwise that has the machine to itself."""

from __future__ import annotations

import os

_n_threads = 1


def use_threads(n_threads: int) -> None:
    """Have searches use so many threads from now on; results are the same for any number.

    Raises:
        ValueError: it is less than one.
    """
    global _n_threads
    if n_threads < 1:
        raise ValueError(f"n_threads: expected at least 1, got {n_threads}")
    _n_threads = n_threads


def use_all_cores() -> None:
    """Have searches use as many threads as this process may run at once."""
    use_threads(len(os.sched_getaffinity(0)))


def thread_count() -> int:
    """Threads that a search may use."""
    return _n_threads
