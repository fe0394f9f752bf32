"""Verdicts and scenes as a person reads them in a terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

SEEN_TOUCH_M = 1e-4  # feet that rest on a floor are that near to it
HIT_COLUMNS = ("kind", "confidence", "position (m)", "sizes", "fit")
NAMED_LINKS = 3  # links without shape that the verdict's line names
SMALL_LINK_M = 0.05  # a camera or a coupling, which the notes name
MESH_COLUMNS = ("mesh", "place", "confidence", "position (m)", "pieces", "residuals")
_COLOURS = {"CERTIFIED": "green", "FEASIBLE_AT_SAMPLES": "yellow", "TIME_LIMIT": "yellow", "CANCELLED": "yellow"}


def print_findings(out: Console, summary: Mapping[str, Any]) -> None:
    """The checks as a table, what stands in the way, and the notes.

    Args:
        out: where to.
        summary: the keys of ``result.json`` that it shows; the others may be missing.
    """
    checks = summary.get("checks") or []
    if checks:
        out.print(_checks(_tightest(checks)))
    touching = _deepest(summary.get("exempt") or [])
    if touching:
        print_table(out, ("pair that may touch", "deepest", "allowed", "phase"), touching)
    for sentence in summary.get("explanation") or []:
        out.print(Text(f"  {sentence}"), soft_wrap=True)
    for note in summary.get("notes") or []:
        out.print(Text(f"  note: {note}", style="dim"), soft_wrap=True)


def print_verdict(out: Console, summary: Mapping[str, Any]) -> None:
    """The last line of a command, which starts with the verdict; then what stands in the way, or how it went."""
    verdict = str(summary["verdict"])
    sentence = _first_sentence(summary.get("explanation") or [])
    if not sentence:
        planned = f", planned in {summary['planning_time_s']:.2f} s" if "planning_time_s" in summary else ""
        held_to = f", {summary['held_to']}" if summary.get("held_to") else ""
        sentence = f"clearance {_millimetres(summary.get('min_clearance_m'))}{planned}{held_to}"
    sentence += uncovered(summary.get("coverage"))
    line = Text(verdict, style=f"bold {_COLOURS.get(verdict, 'red')}")
    out.print(line.append(f"  {sentence}", style="not bold default"), soft_wrap=True)


def uncovered(coverage: Mapping[str, Any] | None) -> str:
    """What a verdict does not cover, as clauses that begin with a semicolon; empty where there is nothing to say.

    Pairs of joint neighbours and of links that never move against each other are counted, no others expected.
    """
    if coverage is None:
        return ""
    clauses = []
    left_out = coverage["left_out"]
    others = [one for one in left_out if not one["is_neighbour"] and one["reason"] != "same joint"]
    if left_out:
        told = f", {len(others)} of them no neighbours" if others else ""
        clauses.append(f"{_count(len(left_out), 'pair')} of links left out{told}")
    shapeless = [one for one in coverage["shapeless"] if one["reach_m"] != 0.0]
    large = [one["link"] for one in shapeless if one["reach_m"] is None or one["reach_m"] > SMALL_LINK_M]
    if len(shapeless) > len(large):
        clauses.append(f"{_count(len(shapeless) - len(large), 'small link')} without shape")
    if large:
        rest = len(large) - NAMED_LINKS
        more = f" and {rest} more" if rest > 0 else ""
        clauses.append(f"{_count(len(large), 'link')} without shape: {', '.join(large[:NAMED_LINKS])}{more}")
    if coverage["not_checked"]:
        clauses.append(f"not checked: {', '.join(coverage['not_checked'])}")
    return "".join(f"; {clause}" for clause in clauses)


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def _first_sentence(lines: Sequence[str]) -> str:
    """What stands in the way in one line; a line that announces others is followed by them."""
    said: list[str] = []
    for line in lines:
        said += line.split()
        if not line.rstrip().endswith((":", ";")):
            break
    return " ".join(said)


def print_figures(out: Console, summary: Mapping[str, Any]) -> None:
    """Phases, times, smallest clearance and between what, smallest balance margin."""
    names = [phase["name"] for phase in summary.get("phases") or []]
    if names:
        out.print(f"phases           {', '.join(names)}", markup=False)
    if "planning_time_s" in summary:
        seconds = float(summary["planning_time_s"])
        out.print(f"planning time    {seconds:.2f} s{_slowest(summary.get('timings') or {})}", markup=False)
    clearance, pair = summary.get("min_clearance_m"), summary.get("min_clearance_pair")
    between = f" between {pair[0]} and {pair[1]}" if pair else ""
    touching = any(entry["deepest_m"] > SEEN_TOUCH_M for entry in summary.get("exempt") or [])
    aside = ", pairs that may touch aside" if touching else ""
    out.print(f"clearance        {_millimetres(clearance)}{between}{aside}", markup=False)
    out.print(f"balance margin   {_millimetres(summary.get('min_balance_margin_m'))}", markup=False)


def print_table(out: Console, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """A plain table."""
    table = Table(box=None, pad_edge=False)
    for column in columns:
        table.add_column(column, overflow="fold")
    for row in rows:
        table.add_row(*(Text(_printable(cell)) for cell in row))
    out.print(table)


def _printable(text: str) -> str:
    """A text that others wrote, without what would have a terminal do anything but show it."""
    return "".join(one if one.isprintable() or one == "\n" else repr(one)[1:-1] for one in text)


def _deepest(exempt: Sequence[Mapping[str, Any]]) -> list[tuple[str, str, str, str]]:
    """Each pair that touched, in the phase in which it was deepest; the deepest pairs first."""
    rows: dict[str, tuple[str, str, str, str]] = {}
    for entry in sorted(exempt, key=lambda entry: -entry["deepest_m"]):
        pair = " and ".join(entry["pair"])
        if entry["deepest_m"] > 0.0:
            depths = _millimetres(entry["deepest_m"]), _millimetres(entry["allowed_m"])
            rows.setdefault(pair, (pair, *depths, str(entry["phase"])))
    return list(rows.values())


def _tightest(checks: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Every check that fails, and of those that hold the tightest of its kind; the result file has them all."""
    kinds: dict[str, list[Mapping[str, Any]]] = {}
    shown: list[dict[str, Any]] = []
    for check in checks:
        if check["ok"] and check.get("basis") != "unproven":
            kinds.setdefault(_kind(str(check["name"])), []).append(check)
        else:
            shown.append(dict(check))
    for kind, held in kinds.items():
        tightest = min(held, key=_slack)
        count = "" if len(held) == 1 else f"  (tightest of {len(held)})"
        shown.append({**tightest, "name": kind, "text": f"{tightest['text']}{count}"})
    return shown


def _kind(name: str) -> str:
    """``planted.turn.l_foot.waypoints`` is of the kind ``planted.waypoints``; limits are kinds of their own."""
    first, *rest = name.split(".")
    if first == "limits":
        return name
    return f"{first}.waypoints" if rest[-1:] == ["waypoints"] else first


def _slack(check: Mapping[str, Any]) -> float:
    """How far a check that holds is from its limit, as a share of the limit where there is one."""
    value, limit = check["value"], check["limit"]
    if value is None or limit is None:
        return float("inf")
    return float(abs(value - limit) / abs(limit) if limit else abs(value))


def _checks(checks: Sequence[Mapping[str, Any]]) -> Table:
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
            _in_unit(check["value"], unit),
            _in_unit(check["limit"], unit),
            Text(str(check["text"])),
        )
    return table


def _in_unit(value: float | None, unit: str) -> str:
    if value is None:
        return ""
    if unit == "1":
        return f"{100.0 * value:.4g} %"
    return f"{1000.0 * value:.4g} mm" if unit == "m" else f"{value:.4g} {unit}"


def _millimetres(value: float | None) -> str:
    return "none proven" if value is None else f"{1000.0 * value:.1f} mm"


def _slowest(timings: Mapping[str, float]) -> str:
    steps = sorted(timings.items(), key=lambda entry: -entry[1])[:4]
    return f" ({', '.join(f'{name} {seconds:.2f}' for name, seconds in steps)})" if steps else ""


def hit_row(hit: Mapping[str, Any]) -> tuple[str, ...]:
    """A detection in one line of a table; of its residuals, which the files hold, the first: how far points lie off."""
    return (
        str(hit["kind"]),
        f"{hit['confidence']:.2f}",
        _position(hit["pose_world_object"]),
        _listed(hit["sizes"]),
        _listed(dict(list(hit["residuals"].items())[:1])),
    )


def mesh_row(mesh: Mapping[str, Any]) -> tuple[str, ...]:
    """What became of a known mesh in one line of a table."""
    return (
        str(mesh["name"]),
        str(mesh["placing"]),
        f"{mesh['confidence']:.2f}",
        _position(mesh["pose_world_mesh"]),
        str(len(mesh["pieces"])),
        _listed(mesh["residuals"]),
    )


def _position(pose: Sequence[Sequence[float]] | None) -> str:
    return "-" if pose is None else " ".join(f"{row[3]:.3f}" for row in pose[:3])


def _listed(values: Mapping[str, float | None]) -> str:
    return ", ".join(f"{name} {value:.4g}" for name, value in values.items() if value is not None)
