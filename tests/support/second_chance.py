"""A pytest plugin: where few tests failed, these are run once more, one after the other; what they do then decides.

A busy machine may fail a test that states what is true. What only passes the second time is named with its first
failure, at the end and in ``out/second_chance.txt``, so that it gets mended.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Generator

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option that asks for it."""
    parser.addoption(
        "--second-chance", type=int, default=0, metavar="N", help="run failed tests once more if they are at most N"
    )


def pytest_configure(config: pytest.Config) -> None:
    """Watch the process that hands out the tests."""
    if config.option.second_chance and not hasattr(config, "workerinput"):
        config.pluginmanager.register(_SecondChance(config.option.second_chance))


class _SecondChance:
    """Failures of the first run, and the second run."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._failures: dict[str, str] = {}

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Note a failure."""
        if report.failed:
            self._failures.setdefault(report.nodeid, f"{report.when}: {_last_words(report)}")

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_sessionfinish(self, session: pytest.Session) -> Generator[None]:
        """Run what failed once more, after the summary of the first run."""
        names = session.config.rootpath / "out" / "second_chance.txt"
        names.unlink(missing_ok=True)
        yield
        if session.exitstatus != pytest.ExitCode.TESTS_FAILED or not 0 < len(self._failures) <= self._most:
            return
        told = session.config.get_terminal_writer()
        told.sep("=", f"{len(self._failures)} failed, run once more alone")
        command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider"]
        ended = subprocess.run([*command, *self._failures], cwd=session.config.rootpath, check=False)
        session.exitstatus = ended.returncode
        if ended.returncode == pytest.ExitCode.OK:
            told.sep("=", "passed the second time only: to be mended", red=True)
            lines = [f"{name}\n    {words}" for name, words in self._failures.items()]
            told.line("\n".join(lines))
            names.parent.mkdir(exist_ok=True)
            names.write_text("\n".join(lines) + "\n")


def _last_words(report: pytest.TestReport) -> str:
    """Say in a line how a test failed."""
    crash = getattr(report.longrepr, "reprcrash", None)
    return str(report.longreprtext if crash is None else crash.message).strip().splitlines()[-1 if crash is None else 0]
