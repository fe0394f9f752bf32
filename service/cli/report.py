"""Output of results, verdicts and scenes on a terminal."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

if TYPE_CHECKING:
    from service.result.folder import ResultFiles
    from service.result.result import PlanResult

SEEN_TOUCH_M = 1e-4  # smaller overlaps are those of feet that rest on a floor
HIT_COLUMNS = ("kind", "confidence", "position (m)", "sizes", "fit", "against it")
MARGIN_SLACK = 1e-7  # of the last digit, so that a written decimal stays itself
NAMED_LINKS = 3  # links without shape that are named in the verdict's line
SMALL_LINK_M = 0.05  # that of the verifier, which is slow to import (tests/cli/test_cli_report.py compares them)
MESH_COLUMNS = ("mesh", "place", "confidence", "position (m)", "pieces", "residuals")
TRIED_COLUMNS = ("step", "tried start", "CPU [s]", "steps", "solved")
_COLOURS = {
    "CERTIFIED": "green",
    "DONE": "green",
    "TRACKED": "green",
    "STOOD": "yellow",
    "FEASIBLE_AT_SAMPLES": "yellow",
    "TIME_LIMIT": "yellow",
    "HELD_BEFORE": "yellow",
    "CANCELLED": "yellow",
}


def print_result(
    out: Console, summary: Mapping[str, Any], lines: Mapping[str, object] | None = None, *, is_verbose: bool = False
) -> None:
    """Print findings, figures, ``lines`` with their labels, and the verdict of a summary (``summary_json``)."""
    print_findings(out, summary, is_verbose=is_verbose)
    print_figures(out, summary)
    for label, value in (lines or {}).items():
        print_line(out, label, value)
    print_verdict(out, summary)


def list_tried(result: PlanResult) -> list[tuple[str, ...]]:
    """Return ``TRIED_COLUMNS`` for every start of a search."""
    return [
        (own.step, own.start, f"{own.cpu_s:.2f}", str(own.n_steps), "yes" if own.is_feasible else "no")
        for own in result.tried
    ]


def list_files(files: ResultFiles | None, summary: Mapping[str, Any]) -> dict[str, object]:
    """Return the files of a result folder that a person opens, by label; without a motion the page alone."""
    if files is None:
        return {}
    return {"viewer": files.viewer, **({} if summary["duration_s"] is None else {"trajectory": files.trajectory})}


def print_line(out: Console, label: str, value: object) -> None:
    """Print a value in the column of the figures."""
    out.print(f"{label:<16} {value}", markup=False, soft_wrap=True)


def print_findings(out: Console, summary: Mapping[str, Any], *, is_verbose: bool = False) -> None:
    """Print the table of checks, the pairs that touch, the explanation and the notes; missing keys are skipped."""
    checks = summary.get("checks") or []
    if checks:
        out.print(_make_check_table(checks if is_verbose else _select_tightest(checks)))
    touching = _select_deepest(summary.get("exempt") or [])
    if touching:
        print_table(out, ("pair that may touch", "deepest", "allowed", "phase"), touching)
    for sentence in summary.get("explanation") or []:
        out.print(Text(f"  {sentence}"), soft_wrap=True)
    for note in summary.get("notes") or []:
        out.print(Text(f"  note: {note}", style="dim"), soft_wrap=True)


def print_verdict(out: Console, summary: Mapping[str, Any]) -> None:
    """Print the last line of a command: the verdict, then the explanation or, if there is none, the main figures."""
    verdict = str(summary["verdict"])
    sentence = _join_first_sentence(summary.get("explanation") or [])
    if not sentence:
        planned = f", planned in {summary['planning_time_s']:.2f} s" if "planning_time_s" in summary else ""
        held_to = f", {summary['held_to']}" if summary.get("held_to") else ""
        sentence = f"clearance {_format_margin(summary.get('min_clearance_m'))}{planned}{held_to}"
    sentence += describe_servos(summary.get("notes")) + describe_omissions(summary.get("coverage"))
    line = Text(verdict, style=f"bold {_COLOURS.get(verdict, 'red')}")
    out.print(line.append(f"  {sentence}", style="not bold default"), soft_wrap=True)


def describe_servos(notes: Sequence[str] | None) -> str:
    """Return a clause, after a semicolon, on servos that need torques fed forward; empty where they do not."""
    need = next((note for note in notes or () if note.startswith("needs torque feed-forward")), "")
    return f"; {need}" if need else ""


def describe_omissions(coverage: Mapping[str, Any] | None) -> str:
    """Return clauses, each after a semicolon, on what a verdict does not cover; empty if it covers everything."""
    if coverage is None:
        return ""
    clauses = []
    left_out = coverage["left_out"]
    others = [pair for pair in left_out if not pair["is_neighbour"] and pair["reason"] != "same joint"]
    if left_out:
        unexpected = f", {len(others)} of them no neighbours" if others else ""
        clauses.append(f"{_format_count(len(left_out), 'pair')} of links left out{unexpected}")
    shapeless = [link for link in coverage["shapeless"] if link["reach_m"] != 0.0]
    large = [link["link"] for link in shapeless if link["reach_m"] is None or link["reach_m"] > SMALL_LINK_M]
    if len(shapeless) > len(large):
        clauses.append(f"{_format_count(len(shapeless) - len(large), 'small link')} without shape")
    if large:
        rest = len(large) - NAMED_LINKS
        more = f" and {rest} more" if rest > 0 else ""
        clauses.append(f"{_format_count(len(large), 'link')} without shape: {', '.join(large[:NAMED_LINKS])}{more}")
    if coverage["not_checked"]:
        clauses.append(f"not checked: {', '.join(coverage['not_checked'])}")
    return "".join(f"; {clause}" for clause in clauses)


def _format_count(number: int, noun: str) -> str:
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def _join_first_sentence(lines: Sequence[str]) -> str:
    """Return the first line, joined with the next ones while it ends with a colon or semicolon."""
    words: list[str] = []
    for line in lines:
        words += line.split()
        if not line.rstrip().endswith((":", ";")):
            break
    return " ".join(words)


def print_figures(out: Console, summary: Mapping[str, Any]) -> None:
    """Print phases, planning time, smallest clearance with its pair, and smallest balance margin."""
    names = [_name_phase(phase) for phase in summary.get("phases") or []]
    names += [f"{name} (NOT_PLANNED)" for name in summary.get("not_planned") or []]
    if names:
        out.print(f"phases           {', '.join(names)}", markup=False)
    if "planning_time_s" in summary:
        seconds = float(summary["planning_time_s"])
        out.print(f"planning time    {seconds:.2f} s{_format_slowest(summary.get('timings') or {})}", markup=False)
    clearance, pair = summary.get("min_clearance_m"), summary.get("min_clearance_pair")
    between = f" between {pair[0]} and {pair[1]}" if pair else ""
    touching = any(entry["deepest_m"] > SEEN_TOUCH_M for entry in summary.get("exempt") or [])
    aside = ", pairs that may touch aside" if touching else ""
    out.print(f"clearance        {_format_margin(clearance)}{between}{aside}", markup=False)
    left = (summary.get("servo") or {}).get("margin_after_sag_m")
    sagged = "" if left is None else f", {_format_margin(left)} after the sag of the servos"
    out.print(f"balance margin   {_format_margin(summary.get('min_balance_margin_m'))}{sagged}", markup=False)


def _name_phase(phase: Mapping[str, Any]) -> str:
    """Return a phase's name, with its status unless it is certified."""
    status = phase.get("status", "CERTIFIED")
    return str(phase["name"]) if status == "CERTIFIED" else f"{phase['name']} ({status})"


def print_table(out: Console, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table without lines; cells may hold text of others."""
    table = Table(box=None, pad_edge=False)
    for column in columns:
        table.add_column(column, overflow="fold")
    for row in rows:
        table.add_row(*(Text(_escape_controls(cell)) for cell in row))
    out.print(table)


def _escape_controls(text: str) -> str:
    """Escape characters that would control the terminal."""
    return "".join(c if c.isprintable() or c == "\n" else repr(c)[1:-1] for c in text)


def _select_deepest(exempt: Sequence[Mapping[str, Any]]) -> list[tuple[str, str, str, str]]:
    """Return a row for each pair that touched, of its deepest phase; the deepest pairs first."""
    rows: dict[str, tuple[str, str, str, str]] = {}
    for entry in sorted(exempt, key=lambda entry: -entry["deepest_m"]):
        pair = " and ".join(entry["pair"])
        if entry["deepest_m"] > 0.0:
            depths = _format_mm(entry["deepest_m"]), _format_mm(entry["allowed_m"])
            rows.setdefault(pair, (pair, *depths, str(entry["phase"])))
    return list(rows.values())


def _select_tightest(checks: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Select every failed or unproven check and, of those that hold, the tightest of its kind."""
    kinds: dict[str, list[Mapping[str, Any]]] = {}
    shown: list[dict[str, Any]] = []
    for check in checks:
        if check["ok"] and check.get("basis") != "unproven":
            kinds.setdefault(_get_kind(str(check["name"])), []).append(check)
        else:
            shown.append(dict(check))
    for kind, held in kinds.items():
        tightest = min(held, key=_measure_slack)
        count = "" if len(held) == 1 else f"  (tightest of {len(held)})"
        shown.append({**tightest, "name": kind, "text": f"{tightest['text']}{count}"})
    return shown


def _get_kind(name: str) -> str:
    """Return a check's kind: ``planted.waypoints`` of ``planted.turn.l_foot.waypoints``; a limit is its own kind."""
    first, *rest = name.split(".")
    if first == "limits":
        return name
    return f"{first}.waypoints" if rest[-1:] == ["waypoints"] else first


def _measure_slack(check: Mapping[str, Any]) -> float:
    """Return the distance of a check's value from its limit, relative to the limit unless that is 0."""
    value, limit = check["value"], check["limit"]
    if value is None or limit is None:
        return float("inf")
    return float(abs(value - limit) / abs(limit) if limit else abs(value))


def _make_check_table(checks: Sequence[Mapping[str, Any]]) -> Table:
    table = Table(box=None, pad_edge=False)
    table.add_column("check")
    table.add_column("")
    table.add_column("value", justify="right", no_wrap=True)
    table.add_column("limit", justify="right", no_wrap=True)
    table.add_column("", overflow="fold")
    for check in checks:
        mark = Text("ok", style="green") if check["ok"] else Text("FAILS", style="bold red")
        if check["ok"] and check.get("basis") == "unproven":
            mark = Text("unproven", style="yellow")
        unit = str(check["unit"])
        table.add_row(
            Text(str(check["name"])),
            mark,
            _format_value(check["value"], unit),
            _format_value(check["limit"], unit),
            Text(str(check["text"])),
        )
    return table


def _format_value(value: float | None, unit: str) -> str:
    if value is None:
        return ""
    if unit == "1":
        return f"{100.0 * value:.4g} %"
    return f"{1000.0 * value:.4g} mm" if unit == "m" else f"{value:.4g} {unit}"


def _format_margin(value: float | None) -> str:
    """Return a proven margin in millimetres, rounded down."""
    return "none proven" if value is None else f"{math.floor(1e4 * value + MARGIN_SLACK) / 10.0:.1f} mm"


def _format_mm(value: float) -> str:
    return f"{1000.0 * value:.1f} mm"


def _format_slowest(timings: Mapping[str, float]) -> str:
    steps = sorted(timings.items(), key=lambda entry: -entry[1])[:4]
    return f" ({', '.join(f'{name} {seconds:.2f}' for name, seconds in steps)})" if steps else ""


def make_hit_row(hit: Mapping[str, Any]) -> tuple[str, ...]:
    """Return a detection as a row of ``HIT_COLUMNS``; its fit is the first residual."""
    return (
        str(hit["kind"]),
        f"{hit['confidence']:.2f}",
        _format_position(hit["pose_world_object"]),
        _format_values(hit["sizes"]),
        _format_values(dict(list(hit["residuals"].items())[:1])),
        "; ".join(hit.get("doubts", ())),
    )


def make_mesh_row(mesh: Mapping[str, Any]) -> tuple[str, ...]:
    """Return a known mesh as a row of ``MESH_COLUMNS``."""
    return (
        str(mesh["name"]),
        str(mesh["placing"]),
        f"{mesh['confidence']:.2f}",
        _format_position(mesh["pose_world_mesh"]),
        str(len(mesh["pieces"])),
        _format_values(mesh["residuals"]),
    )


def _format_position(pose: Sequence[Sequence[float]] | None) -> str:
    return "-" if pose is None else " ".join(f"{row[3]:.3f}" for row in pose[:3])


def _format_values(values: Mapping[str, float | None]) -> str:
    return ", ".join(f"{name} {value:.4g}" for name, value in values.items() if value is not None)
