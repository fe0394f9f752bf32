"""Getting out of a vehicle that is known only from a scan."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from service.planner import plan
from service.request.file import parse_request
from service.result.result import Verdict

REQUEST = Path(__file__).resolve().parents[2] / "benchmarks" / "tasks" / "requests" / "egress_scanned.yaml"
SCAN = Path("scenes") / "car_ev"


@pytest.fixture
def folder(shared_data):
    """The folder of the scan."""
    if not (shared_data / SCAN).is_dir():
        pytest.skip(f"no scan at {shared_data / SCAN} (set SCOPT_DATA)")
    return shared_data / SCAN


def load(folder, **changes):
    """The request with other fields of its task."""
    data = yaml.safe_load(REQUEST.read_text())
    data["task"]["egress"] |= changes
    return parse_request(data, folder)


def test_the_right_foot_leaves_a_scanned_car_with_a_certificate(folder):
    result = plan(load(folder, samples=2))
    assert result.verdict is Verdict.CERTIFIED, result.explanation


def test_a_later_phase_in_a_scanned_car_fails_with_its_reason_and_what_can_be_planned(folder):
    result = plan(load(folder, samples=1, until="stand up inside"))
    assert result.verdict is Verdict.NOT_FOUND
    assert any("no pose of 'stand up inside' holds" in line for line in result.explanation)
    assert any("task.egress.until: 'right foot out' plans the phases before" in note for note in result.notes)
