"""Fixtures and settings all tests share."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import HealthCheck, settings

if TYPE_CHECKING:
    from planner_stand_in import PlannerStandIn

settings.register_profile("house", derandomize=True, deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("house")
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as in the background of a shell, and in all that starts there
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session", autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Nothing that an earlier run kept answers for this one."""
    os.environ["XDG_CACHE_HOME"] = str(tmp_path_factory.mktemp("cache"))


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of the data that tests use when it is there: ``SCOPT_DATA`` or ``../shared/data`` beside the checkout."""
    folder = Path(os.environ.get("SCOPT_DATA", Path(__file__).parents[2] / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"no test data at {folder} (set SCOPT_DATA)")
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
