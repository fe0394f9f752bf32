"""Fixtures and settings all tests share."""

from __future__ import annotations

import gc
import os
import signal
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import second_chance
from hypothesis import HealthCheck, settings
from second_chance import pytest_addoption
from spread_collection import SpreadCollection

__all__ = ["pytest_addoption"]  # of ``second_chance``

if TYPE_CHECKING:
    from planner_stand_in import PlannerStandIn

settings.register_profile(
    "house", max_examples=50, derandomize=True, deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("house")
# Collecting garbage took a third of the time in which 8,000 tests are found, and a fifteenth of that of a plan.
ALLOCATIONS = 20_000  # between two collections
gc.disable()  # until all tests are found
# As in the Makefile: without bytecode files each process that a test starts compiles the project, which takes 5 s.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as in the background of a shell, and in all that starts there
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Test modules (`costs/test_x.py`) and test functions (`costs/test_x.py::test_y`) that `make test-fast` leaves out.
TESTS = Path(__file__).parent
SLOW = frozenset((TESTS / "slow.txt").read_text().split())
SLOW_OVER_S = 2.0


def pytest_configure(config: pytest.Config) -> None:
    """Run what failed once more, if asked to, and spread the collection of tests."""
    second_chance.pytest_configure(config)
    config.pluginmanager.register(SpreadCollection(TESTS))


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Do not even import a module of slow tests when these are not wanted."""
    return True if config.option.markexpr == "not slow" and name_module(collection_path) in SLOW else None


def name_module(path: Path) -> str:
    """Return the path of a test module as ``slow.txt`` has it."""
    return path.relative_to(TESTS).as_posix() if path.is_relative_to(TESTS) else path.name


@pytest.hookimpl(tryfirst=True)  # before pytest selects by marker
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests that ``slow.txt`` lists; their files come first, so that no process waits long for another."""
    names = {path: name_module(path) for path in {item.path for item in items}}
    for item in items:
        function = getattr(item, "originalname", item.name)
        module = names[item.path]
        if module in SLOW or f"{module}::{function}" in SLOW:
            item.add_marker("slow")
    files = {name.partition("::")[0] for name in SLOW}
    items.sort(key=lambda item: (names[item.path] not in files, names[item.path]))


def pytest_collection_finish() -> None:
    """Leave modules and tests to no collection of garbage from now on, and what tests make to fewer."""
    gc.freeze()
    gc.set_threshold(ALLOCATIONS, *gc.get_threshold()[1:])
    gc.enable()


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Name the slowest tests that ``slow.txt`` lacks."""
    seconds: Counter[str] = Counter()
    for reports in terminalreporter.stats.values():
        for report in reports:
            if isinstance(report, pytest.TestReport) and "slow" not in report.keywords:
                seconds[report.nodeid] += report.duration
    hints = [f"{taken:6.1f} s  {name}" for name, taken in seconds.most_common(10) if taken > SLOW_OVER_S]
    if hints:
        terminalreporter.section(
            f"over {SLOW_OVER_S:g} s here: if they are on an idle machine too, add to tests/slow.txt"
        )
        terminalreporter.write_line("\n".join(hints))


@pytest.fixture(scope="session", autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Nothing that an earlier run kept answers for this one, whose processes share a folder (``shared_plans``)."""
    os.environ["XDG_CACHE_HOME"] = str(tmp_path_factory.mktemp("cache"))
    base = tmp_path_factory.getbasetemp()
    os.environ["SCOPT_TEST_RUN"] = str(base.parent if "PYTEST_XDIST_WORKER" in os.environ else base)


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of the data that tests use when it is there: ``SCOPT_DATA`` or ``../shared/data`` beside the checkout."""
    folder = Path(os.environ.get("SCOPT_DATA", Path(__file__).parents[2] / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"no test data at {folder} (set SCOPT_DATA)")
    return folder


@pytest.fixture(scope="session")
def shared_cases(shared_data: Path) -> Path:
    """Folder of inputs that once failed, beside the data."""
    folder = shared_data.parent / "cases"
    if not folder.is_dir():
        pytest.skip(f"no recorded inputs at {folder}")
    return folder


@pytest.fixture
def stand_in() -> PlannerStandIn:
    """What a test tells to answer in a server's place."""
    from planner_stand_in import PlannerStandIn  # gRPC takes a while to import, and most tests need none

    return PlannerStandIn()


@pytest.fixture
def target(stand_in: PlannerStandIn) -> Iterator[str]:
    """Where the stand-in is served."""
    from planner_stand_in import serving

    with serving(stand_in) as address:
        yield address


@pytest.fixture(params=["blocking", "asyncio"])
def connect(request: pytest.FixtureRequest, target: str) -> Callable[..., Any]:
    """Makes a client of the stand-in, of either kind."""
    from planner_clients import CLIENTS

    return lambda **settings: CLIENTS[request.param](target, **settings)
