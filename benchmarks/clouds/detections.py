"""Detection errors per kind of object, and confident false hits, on recorded and simulated scans.

A row is marked ``MISS`` when a dense scan gives no confident detection, ``OFF`` when a confident detection is beyond a
target (twice the target on sparse scans, where a low confidence is as good), ``FALSE`` for a confident false hit.

From the checkout's root: ``python -m benchmarks.clouds.detections [--kind KIND] [--only NAME] [--variant V] [--seed N]
[--hint]``.  Recorded scans come from the folder ``SCOPT_DATA`` (default: ``../shared/data``).
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.clouds.cases import Case, data_folder, recorded_cases, scene_cases, simulated_cases, variant_turns
from benchmarks.clouds.errors import MEASURES, Found, errors, matched, misses_target
from benchmarks.tables import print_table
from perception import CONFIDENT, KINDS, Cloud, Detection, detect, make_view
from perception.simulate.scenes import Truth

_VARIANTS = ("dense", "sparse", "solid/camera")
_FEWEST = 60  # points on a beam or a seat's cushion below which it cannot be detected
_HINT_SIGMA = 0.05  # [m] how well an operator clicks


@dataclass(frozen=True)
class Row:
    """One object in one scan."""

    case: str
    density: str
    confidence: float | None
    values: tuple[float | None, ...]
    mark: str


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a table per kind, then the summary."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kind", choices=KINDS, action="append", help="only this kind; may be repeated")
    parser.add_argument("--only", default="", help="only scans whose name holds this")
    parser.add_argument(
        "--variant", type=variant_turns, action="append", help="sensor of the simulated scenes; a/b: in turn"
    )
    parser.add_argument("--seed", type=int, default=0, help="of the simulated scenes' details")
    parser.add_argument("--hint", action="store_true", help="give a place near each object, as an operator would")
    chosen = parser.parse_args(arguments)
    kinds = tuple(chosen.kind or KINDS)
    rows: dict[str, list[Row]] = {kind: [] for kind in kinds}
    false: list[tuple[str, str, Detection]] = []
    spent: dict[str, list[float]] = {kind: [] for kind in kinds}
    looked: dict[str, int] = defaultdict(int)
    for case in _cases(chosen.variant or _VARIANTS, chosen.seed, chosen.only):
        cloud = case.load()
        view = make_view(cloud, reach=case.reach)
        for kind in kinds:
            if kind in case.unknown:
                continue
            clock = time.process_time()
            if chosen.hint:
                found = [one for hint in _hints(kind, case) for one in detect(kind, view, hint)]
            else:
                found = detect(kind, view)
            spent[kind].append(time.process_time() - clock)
            looked[kind] += 1
            outcome = matched(kind, found, case.truth, case.lookalikes)
            if not chosen.hint:
                false += [(case.name, kind, one) for one in outcome.false]
            new = [_row(case, cloud, truth, one) for truth, one in outcome.pairs]
            rows[kind] += new
            # The tables come last; misses are printed as they occur.
            told = [row.mark for row in new if row.mark] + ["FALSE"] * len(outcome.false)
            print(f"{case.name}: {kind} {' '.join(told) or 'fine'}", file=sys.stderr)
    for kind in kinds:
        _print_kind(kind, rows[kind])
    _print_false(false)
    _print_summary(kinds, rows, false, spent, looked)


def _cases(variants: Sequence[str], seed: int, only: str) -> Iterator[Case]:
    folder = data_folder()
    for case in (*scene_cases(folder), *recorded_cases(folder), *simulated_cases(variants, seed=seed)):
        if only in case.name:
            yield case


def _hints(kind: str, case: Case) -> list[np.ndarray]:
    rng = np.random.default_rng(len(case.name))
    truth = [one for one in case.truth if one.kind == kind]
    return [one.pose_world_object[:3, 3] + rng.normal(0.0, _HINT_SIGMA, 3) for one in truth]


def _row(case: Case, cloud: Cloud, truth: Truth, found: Found | None) -> Row:
    n_on = {"beam": _n_on_beam, "seat": _n_on_cushion}.get(truth.kind)
    if n_on is not None and n_on(cloud, truth) < _FEWEST:
        return Row(case.name, case.density, None, (), "hidden")
    if found is None:
        return Row(case.name, case.density, None, (), "MISS" if case.density == "dense" else "none")
    values = errors(truth.kind, found, truth)
    mark = "OFF" if misses_target(truth.kind, values, case.density) else ""
    if found.confidence < CONFIDENT:
        mark = "MISS" if case.density == "dense" else "low"
    return Row(case.name, case.density, found.confidence, values, mark)


def _n_on_beam(cloud: Cloud, truth: Truth) -> int:
    local = (cloud.points - truth.pose_world_object[:3, 3]) @ truth.pose_world_object[:3, :3]
    half = 0.5 * np.array([truth.sizes[key] for key in ("length", "width", "thickness")]) + 0.02
    return int((np.abs(local) < half).all(axis=1).sum())


def _n_on_cushion(cloud: Cloud, truth: Truth) -> int:
    local = (cloud.points - truth.pose_world_object[:3, 3]) @ truth.pose_world_object[:3, :3]
    half = 0.5 * np.array([truth.sizes.get(key, 0.5) for key in ("depth", "width")])
    return int((np.abs(local) < [*half, 0.04]).all(axis=1).sum())


def _text(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f}"


def _print_kind(kind: str, rows: list[Row]) -> None:
    header = ("scan", "confidence", *(measure.name for measure in MEASURES[kind]), "")
    lines = []
    for row in rows:
        values = row.values or (None,) * len(MEASURES[kind])
        confidence = "-" if row.confidence is None else f"{row.confidence:.2f}"
        lines.append((row.case, confidence, *(_text(value) for value in values), row.mark))
    for density in ("dense", "sparse"):
        confident = [r for r in rows if r.density == density and r.confidence is not None and r.confidence >= CONFIDENT]
        for name, pick in (("median", statistics.median), ("worst", max)):
            columns = [[r.values[k] for r in confident] for k in range(len(MEASURES[kind]))]
            known = [[value for value in column if value is not None] for column in columns]
            texts = [_text(pick(column)) if column else "-" for column in known]
            lines.append((f"{name}, {density}, confident ({len(confident)})", "", *texts, ""))
    factor = {"dense": 1.0, "sparse": 2.0}
    for density in factor:
        targets = [None if m.target is None else factor[density] * m.target for m in MEASURES[kind]]
        lines.append((f"target, {density}", "", *(_text(target) for target in targets), ""))
    print_table(kind, header, lines)


def _print_false(false: list[tuple[str, str, Detection]]) -> None:
    lines = [
        (name, kind, f"{one.confidence:.2f}", " ".join(f"{x:.2f}" for x in one.pose_world_object[:3, 3]), "FALSE")
        for name, kind, one in false
    ]
    print_table("confident false hits (target: none)", ("scan", "kind", "confidence", "at", ""), lines)


def _print_summary(
    kinds: Sequence[str],
    rows: dict[str, list[Row]],
    false: list[tuple[str, str, Detection]],
    spent: dict[str, list[float]],
    looked: dict[str, int],
) -> None:
    header = ("kind", "dense: found", "off", "missed", "sparse: found", "off", "low or none", "false", "scans", "cpu s")
    lines = []
    for kind in kinds:
        cells = [kind]
        for density in ("dense", "sparse"):
            mine = [row for row in rows[kind] if row.density == density and row.mark != "hidden"]
            n_off = sum(row.mark == "OFF" for row in mine)
            n_not = sum(row.mark in ("MISS", "none", "low") for row in mine)
            cells += [f"{len(mine) - n_not}/{len(mine)}", str(n_off), str(n_not)]
        n_false = sum(one == kind for _, one, _ in false)
        cells += [str(n_false), str(looked[kind]), f"{statistics.median(spent[kind] or [0.0]):.2f}"]
        lines.append(tuple(cells))
    print_table("summary", header, lines)


if __name__ == "__main__":
    main()
