"""Tests that a busy machine failed are run once more: only few of them, and only once."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

SUPPORT = Path(__file__).parents[1] / "support"
FAILS_AT_FIRST = """
import pathlib, pytest
@pytest.mark.parametrize("number", range({count}))
def test_it(number):
    note = pathlib.Path(__file__).with_name(f"runs {{number}}")
    note.write_text(note.read_text() + "." if note.exists() else ".")
    assert len(note.read_text()) > {n_failures}, "too early"
"""


def _run(folder: Path, count: int, n_failures: int, *arguments: str) -> tuple[int, str, list[int]]:
    """Exit code and output of a suite of tests that fail so often, and how often each was run."""
    (folder / "test_it.py").write_text(FAILS_AT_FIRST.format(count=count, n_failures=n_failures))
    command = [sys.executable, "-m", "pytest", "-p", "second_chance", "--second-chance", "3", *arguments]
    variables = {**os.environ, "PYTHONPATH": str(SUPPORT), "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    done = subprocess.run(command, cwd=folder, env=variables, capture_output=True, text=True, check=False)
    return done.returncode, done.stdout, [len(note.read_text()) for note in folder.glob("runs *")]


def test_few_failures_are_run_once_more_and_named(tmp_path: Path) -> None:
    code, told, runs = _run(tmp_path, 3, 1, "-p", "xdist", "-n", "2")
    assert (code, runs) == (0, [2, 2, 2])
    told = told.partition("passed the second time only")[2]
    names = (tmp_path / "out" / "second_chance.txt").read_text()
    for number in range(3):
        assert f"test_it.py::test_it[{number}]\n    call: AssertionError: too early\n" in told
        assert f"test_it.py::test_it[{number}]\n    call: AssertionError: too early\n" in names
    assert _run(tmp_path, 3, 0, "-p", "xdist", "-n", "2")[0] == 0
    assert not (tmp_path / "out" / "second_chance.txt").exists()


@pytest.mark.parametrize(("count", "n_failures", "n_runs"), [(1, 2, 2), (4, 1, 1)])
def test_what_fails_twice_or_is_more_than_few_fails(tmp_path: Path, count: int, n_failures: int, n_runs: int) -> None:
    assert _run(tmp_path, count, n_failures)[::2] == (1, [n_runs] * count)
