"""Number of threads for long searches: one, unless a program that runs alone on its machine sets more."""

from __future__ import annotations

import os

_n_threads = 1


def use_threads(n_threads: int) -> None:
    """Set the number of threads of all later searches; results are the same for any number.

    Raises:
        ValueError: it is less than one.
    """
    global _n_threads
    if n_threads < 1:
        raise ValueError(f"n_threads: expected at least 1, got {n_threads}")
    _n_threads = n_threads


def use_all_cores() -> None:
    """Let searches use as many threads as this process may run at once."""
    use_threads(len(os.sched_getaffinity(0)))


def thread_count() -> int:
    """Return the number of threads of a search."""
    return _n_threads
