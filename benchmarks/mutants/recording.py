"""Which lines each fast test runs, recorded once for a state of the project."""

from __future__ import annotations

import ast
import hashlib
import json
import os
import subprocess
import sys
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import pytest
from coverage import Coverage, CoverageData

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("scopt", "costs", "perception", "service")
MOST_TESTS, MOST_SECONDS = 150, 20.0  # per mutant, the quickest first


@dataclass(frozen=True)
class Recording:
    """Lines that tests have run.

    Attributes:
        folder: with the files of a recording.
        project: folder in which they were recorded.
    """

    folder: Path
    project: Path

    @property
    def modules(self) -> list[str]:
        """Modules that were imported, in their order."""
        return list(self._session["modules"])

    def find_tests(self, path: str, line: int) -> list[tuple[str, float]]:
        """Return the tests that run the statement at a line of a file, with their seconds, the quickest first.

        A statement that runs at import is tested by all tests that run something of its file.
        """
        first, last = _find_statement((self.project / path).read_bytes(), line)
        contexts = self._data.contexts_by_lineno(path)
        names = {name for number in range(first, last + 1) for name in contexts.get(number, ())}
        if "" in names:
            names |= {name for tests in contexts.values() for name in tests}
        seconds = self._session["seconds"]
        tests = sorted((seconds[name], name) for name in names if name in seconds)[:MOST_TESTS]
        chosen: list[tuple[str, float]] = []
        total = 0.0
        for taken, name in tests:
            total += taken
            if chosen and total > MOST_SECONDS:
                break
            chosen.append((name, taken))
        return chosen

    @cached_property
    def _session(self) -> dict[str, Any]:
        return dict(json.loads((self.folder / "session.json").read_text()))

    @cached_property
    def _data(self) -> CoverageData:
        data = CoverageData(str(self.folder / "coverage"))
        data.read()
        return data


def record(project: Path, folder: Path, tests: tuple[str, ...] = ("tests",)) -> Recording:
    """Return the recording of a project's fast tests; one of the same state is used again."""
    digest = hashlib.sha256(repr(tests).encode())
    for file in sorted(file for name in (*PACKAGES, "tests", "benchmarks") for file in (project / name).rglob("*.py")):
        digest.update(str(file.relative_to(project)).encode() + file.read_bytes())
    recording = Recording(folder / digest.hexdigest()[:16], project)
    if not (recording.folder / "session.json").is_file():
        recording.folder.mkdir(parents=True, exist_ok=True)
        environment = {**os.environ, "PYTHONPATH": f"{project}{os.pathsep}{ROOT}", "OMP_NUM_THREADS": "1"}
        command = [sys.executable, "-m", "benchmarks.mutants.recording", str(recording.folder), *tests]
        subprocess.run(command, cwd=project, env=environment, check=True, stdout=subprocess.DEVNULL)
    return recording


class _Recorder:
    """Plugin of pytest: one context per test, and the seconds of each test that passes."""

    def __init__(self, coverage: Coverage) -> None:
        self._coverage = coverage
        self._failed: set[str] = set()
        self.seconds: dict[str, float] = {}

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Any:
        self._coverage.switch_context(item.nodeid)
        try:
            return (yield)
        finally:
            self._coverage.switch_context("")

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self.seconds[report.nodeid] = self.seconds.get(report.nodeid, 0.0) + report.duration
        if report.failed or report.skipped:
            self._failed.add(report.nodeid)

    def pytest_sessionfinish(self) -> None:
        for name in self._failed:
            self.seconds.pop(name, None)


def _find_statement(source: bytes, line: int) -> tuple[int, int]:
    """Return first and last line of the innermost simple statement at a line, or of a compound one's head."""
    spans = [(line, line)]
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.stmt):
            body = getattr(node, "body", None)
            last = body[0].lineno - 1 if body else node.end_lineno or node.lineno
            spans.append((node.lineno, max(last, node.lineno)))
    return max((span for span in spans[1:] if span[0] <= line <= span[1]), default=spans[0])


def _run(folder: Path, tests: list[str]) -> None:
    coverage = Coverage(data_file=str(folder / "coverage"), source=list(PACKAGES), config_file=False)
    coverage.set_option("run:relative_files", True)
    recorder = _Recorder(coverage)
    coverage.start()
    options = ["-q", "-p", "no:cacheprovider", "-p", "no:xdist", "-m", "not slow", "--continue-on-collection-errors"]
    pytest.main([*options, *tests], plugins=[recorder])
    coverage.stop()
    coverage.save()
    if not recorder.seconds:
        sys.exit("no test passed")
    session = {"modules": list(sys.modules), "seconds": recorder.seconds}
    (folder / "session.json").write_text(json.dumps(session))


if __name__ == "__main__":
    _run(Path(sys.argv[1]), sys.argv[2:])
