"""A result shows itself in a notebook: verdict, checks and the page."""

from __future__ import annotations

from pathlib import Path

import pytest

from service.planner import plan
from service.request.file import parse_request
from service.result.result import PlanResult

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def shown() -> tuple[PlanResult, str]:
    result = plan(parse_request({"robot": {"name": "atlas"}, "goal": {"posture": "reach_ready"}}))
    return result, result._repr_html_()


def test_the_verdict_comes_first(shown: tuple[PlanResult, str]) -> None:
    assert shown[1].startswith("<div><b>PlanResult CERTIFIED, ")


def test_failed_checks_and_the_tightest_come_with_value_and_limit(shown: tuple[PlanResult, str]) -> None:
    result, html = shown
    assert result.certificate is not None
    assert 1 < html.count("<tr>") <= 9
    assert any(check.text.replace(">", "&gt;") in html for check in result.certificate.checks)


def test_the_page_is_inside_and_escaped(shown: tuple[PlanResult, str]) -> None:
    page = shown[1].split('srcdoc="')[1].split('" style=')[0]
    assert '"' not in page
    assert "&lt;html" in page or "&lt;!doctype html" in page.lower()
