"""Printed report of a verdict."""

from __future__ import annotations

from io import StringIO
from pathlib import Path
from typing import Any

from rich.console import Console

from service.cli.report import SMALL_LINK_M, list_files, print_figures, print_findings, print_verdict
from service.result.folder import ResultFiles
from service.verify import certificate


def _check(name: str, ok: bool, value: float | None, limit: float, unit: str = "m") -> dict[str, Any]:
    return {"name": name, "ok": ok, "value": value, "limit": limit, "unit": unit, "text": f"text of {name}"}


def _printed(summary: dict[str, Any]) -> list[str]:
    screen = Console(file=StringIO(), width=160)
    print_findings(screen, summary)
    if "planning_time_s" in summary:
        print_figures(screen, summary)
    print_verdict(screen, summary)
    assert isinstance(screen.file, StringIO)
    return [line.rstrip() for line in screen.file.getvalue().splitlines()]


def test_every_failure_is_shown_and_of_the_rest_the_tightest_of_its_kind() -> None:
    checks = [
        _check("balance.reach", True, 0.05, 0.02),
        _check("balance.turn", True, 0.03, 0.02),
        _check("planted.reach.l_foot", False, 0.002, 0.001),
        _check("planted.turn.l_foot", False, 0.003, 0.001),
        _check("planted.turn.r_foot", True, 0.0001, 0.001),
        _check("planted.turn.r_foot.waypoints", True, 0.00001, 0.0001),
        _check("clearance", True, None, 0.0),
    ]
    lines = _printed({"verdict": "NOT_FOUND", "checks": checks, "explanation": ["a foot slips"]})
    rows = [line.split()[0] for line in lines[1:-2]]
    assert rows == [
        "planted.reach.l_foot", "planted.turn.l_foot", "balance", "planted", "planted.waypoints", "clearance",
    ]  # fmt: skip
    assert "FAILS" in lines[1]
    assert "2 mm" in lines[1]
    assert "text of balance.turn  (tightest of 2)" in lines[3]
    assert lines[-2:] == ["  a foot slips", "NOT_FOUND  a foot slips"]


def test_demands_that_are_announced_follow_in_the_verdict_s_line() -> None:
    told = [
        "reach: the one attempt failed; at its end, 2 demands conflict:",
        "a is in b;",
        "c is at d.",
    ]
    lines = _printed(
        {"verdict": "NOT_FOUND", "explanation": [*told, "Without either of them everything else was kept."]}
    )
    assert lines[-1] == f"NOT_FOUND  {' '.join(told)}"


def test_brackets_in_names_are_printed_as_they_are() -> None:
    lines = _printed({"verdict": "INFEASIBLE", "explanation": ["piece [red]x[/red] is in the way"]})
    assert lines == ["  piece [red]x[/red] is in the way", "INFEASIBLE  piece [red]x[/red] is in the way"]


def test_figures_say_when_nothing_is_proven() -> None:
    lines = _printed({"verdict": "NOT_FOUND", "planning_time_s": 1.25, "timings": {"a": 0.2, "b": 1.0}})
    assert lines == [
        "planning time    1.25 s (b 1.00, a 0.20)",
        "clearance        none proven",
        "balance margin   none proven",
        "NOT_FOUND  clearance none proven, planned in 1.25 s",
    ]


def test_the_verdict_counts_those_links_as_small_that_the_certificate_leaves_unchecked() -> None:
    assert certificate.SMALL_LINK_M == SMALL_LINK_M


def test_a_plan_without_a_motion_names_no_trajectory(tmp_path: Path) -> None:
    files = ResultFiles(tmp_path)
    assert list(list_files(files, {"duration_s": 4.5})) == ["viewer", "trajectory"]
    assert list(list_files(files, {"duration_s": None})) == ["viewer"]
    assert list_files(None, {"duration_s": None}) == {}
