"""docs/service.md tells the limits that the code has, and the client holds back what no server takes."""

from __future__ import annotations

from pathlib import Path

import pytest

from service.client.connection import MAX_SENT_BYTES
from service.server.settings import MESSAGE_BYTES
from service.store import CloudLimits, StoreLimits
from service.trust.limits import ClientLimits
from service.work.plan import REPORT_EVERY_S

TEXT = (Path(__file__).parents[2] / "docs" / "service.md").read_text()
KEPT, CLOUDS, CLIENT = StoreLimits(), CloudLimits(), ClientLimits()


def _mib(n_bytes: float) -> str:
    return f"{n_bytes / 2**20:.0f} MiB"


@pytest.mark.parametrize(
    ("limit", "amount"),
    [
        ("plans with their replies and files", f"{KEPT.max_plans:,}, {_mib(KEPT.max_bytes)} together"),
        ("reviews of one plan", f"{KEPT.max_reviews}"),
        ("scenes", f"{KEPT.max_scenes}, {_mib(KEPT.max_scene_bytes)} together (compressed)"),
        ("one cloud", _mib(CLOUDS.max_cloud_bytes)),
        ("all clouds", f"{_mib(CLOUDS.max_bytes)} together"),
        ("uploads at a time", f"{CLOUDS.max_uploads}, {CLOUDS.max_uploads_per_client} of one client"),
        (
            "bytes uploaded by one client",
            f"{_mib(CLIENT.upload_bytes_per_s)} per second, {_mib(CLIENT.upload_bytes_burst)} at once",
        ),
        (
            "requests of one client",
            f"{CLIENT.requests_per_s:g} per second, {CLIENT.requests_burst:g} at once, "
            f"{CLIENT.max_open_calls} under way",
        ),
        ("one message to the server", _mib(MESSAGE_BYTES)),
    ],
)
def test_a_limit_is_documented_as_it_is(limit: str, amount: str) -> None:
    assert f"| {limit} | {amount} |" in TEXT


def test_a_client_sends_what_a_server_takes() -> None:
    assert MAX_SENT_BYTES == MESSAGE_BYTES


def test_how_often_progress_comes_is_documented_as_it_is() -> None:
    assert f"at most every {1000 * REPORT_EVERY_S:g} ms" in TEXT
