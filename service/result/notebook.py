"""A result as notebooks show it: verdict, the checks with the least room, and the viewer page in a frame."""

from __future__ import annotations

import tempfile
from html import escape
from pathlib import Path

from service.result.output import write_result
from service.result.result import PlanResult
from service.verify import Check

HEIGHT_PX = 560
MOST_CHECKS = 8
COLUMNS = ("check", "holds", "value", "limit", "basis")


def make_html(result: PlanResult) -> str:
    """Return a result as one piece of HTML without outside references."""
    with tempfile.TemporaryDirectory() as folder:
        page = write_result(result, Path(folder) / "result").viewer.read_text(encoding="utf-8")
    lines = "".join(f"<li>{escape(line)}</li>" for line in (*result.explanation, *result.notes))
    frame = f'<iframe srcdoc="{escape(page)}" style="width: 100%; height: {HEIGHT_PX}px; border: 0"></iframe>'
    return f"<div><b>{escape(repr(result)[1:-1])}</b>{_make_table(result)}<ul>{lines}</ul>{frame}</div>"


def _make_table(result: PlanResult) -> str:
    """Return the failed checks, then those that use most of their limit, as a table."""
    if result.certificate is None:
        return ""
    checks = sorted(result.certificate.checks, key=lambda check: (check.ok, -_measure_use(check)))[:MOST_CHECKS]
    head = "".join(f"<th>{column}</th>" for column in COLUMNS)
    rows = "".join(
        f"<tr><td>{escape(check.text)}</td><td>{'yes' if check.ok else 'no'}</td><td>{check.value:.4g} "
        f"{escape(check.unit)}</td><td>{check.limit:.4g}</td><td>{escape(check.basis.value)}</td></tr>"
        for check in checks
    )
    return f"<table><tr>{head}</tr>{rows}</table>"


def _measure_use(check: Check) -> float:
    """Return the share of its limit that a check uses; 0 where the limit is 0."""
    return abs(check.value / check.limit) if check.limit else 0.0
