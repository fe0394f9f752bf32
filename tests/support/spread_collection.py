"""A pytest plugin: each of several processes begins to collect with other folders than the others.

Every process imports all tests.  In a fresh checkout none of them is compiled yet: where all begin with the same file,
each compiles everything, and where they begin apart, each finds two thirds compiled by the others.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

import pytest


class SpreadCollection:
    """Collects the folder of all tests; sorting the tests afterwards is left to others."""

    def __init__(self, tests: Path) -> None:
        self._tests = tests

    def pytest_collect_directory(self, path: Path, parent: pytest.Collector) -> pytest.Collector | None:
        """Take the folder of all tests, and leave the others to pytest."""
        return _RotatedFolder.from_parent(parent, path=path) if path == self._tests else None


class _RotatedFolder(pytest.Dir):
    """A folder whose entries begin at another one in each process."""

    def collect(self) -> Iterable[pytest.Item | pytest.Collector]:
        """Return all entries."""
        entries = list(super().collect())
        own = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
        first = len(entries) * own // int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
        return entries[first:] + entries[:first]
