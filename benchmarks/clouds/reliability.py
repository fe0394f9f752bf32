"""Is a confident detection right?  Share of right hits by confidence, for all kinds, with a picture of the curve.

Scenes are drawn anew for every seed and searched at one crop radius each, in turn: dense and sparse scans of the
simulator's scenes and of objects that its recipes do not contain, and recorded scans.  A hit is right if a person
would call it the object, by the limits ``right`` of :data:`benchmarks.clouds.errors.MEASURES`.

From the checkout's root: ``python -m benchmarks.clouds.reliability [--seeds 0 1 2] [--radii 3 4 5] [--variant V]
[--sets other simulated recorded] [--only NAME] [--every N] [--present] [--record FILE | --from FILE ...]
[--picture FILE.svg]``.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from benchmarks.clouds.cases import Case, data_folder, recorded_cases, scene_cases, simulated_cases, variant_turns
from benchmarks.clouds.others import other_cases
from benchmarks.clouds.stability import print_found, print_reliability, search
from benchmarks.tables import print_table
from perception import CONFIDENT, KINDS

LEVELS = (0.05, 0.2, 0.35, 0.5, 0.75, 0.9, 1.0001)
_SIZE, _LEFT, _TOP, _EDGE = 320.0, 56.0, 20.0, 44.0
_COLOURS = {"dense": "#1f5fa8", "sparse": "#c25a13"}
Record = dict[str, Any]


def main(arguments: Sequence[str] | None = None) -> None:
    """Search all scans, print the tables and write the picture."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, nargs="+", default=(0, 1, 2), help="of the scenes' details")
    parser.add_argument("--radii", type=float, nargs="+", default=(3.0, 4.0, 5.0), help="crop of each seed, in turn")
    parser.add_argument("--sets", nargs="+", default=("other", "simulated", "recorded"))
    parser.add_argument("--variant", type=variant_turns, action="append", help="sensor of simulated scenes")
    parser.add_argument("--kind", choices=KINDS, action="append", help="only this kind; may be repeated")
    parser.add_argument("--only", default="", help="only scans whose name holds one of these, separated by commas")
    parser.add_argument("--every", type=int, default=1, help="each seed takes one in N scenes; N seeds take all")
    parser.add_argument("--present", action="store_true", help="only kinds that a scan shows, and valves")
    parser.add_argument("--record", type=Path, help="append one JSON line per scan and kind")
    parser.add_argument("--from", dest="sources", type=Path, nargs="+", help="print the tables of such files")
    parser.add_argument("--picture", type=Path, help="file of the curve (SVG)")
    chosen = parser.parse_args(arguments)
    kinds = tuple(chosen.kind or KINDS)
    records: list[Record] = []
    if chosen.sources:
        lines = [line for source in chosen.sources for line in source.read_text().splitlines()]
        records = _latest([record for record in map(json.loads, lines) if record["kind"] in kinds])
    else:
        for scene_seed, radius, case in _cases(chosen):
            shown = {"valve", *(truth.kind for truth in case.truth)}
            searched = [kind for kind in kinds if kind in shown or not chosen.present]
            for found in search(case, searched, (0,), (radius,)):
                records.append({**found, "scene_seed": scene_seed})
                if chosen.record is not None:
                    with chosen.record.open("a") as file:
                        file.write(json.dumps(records[-1]) + "\n")
            print(case.name, file=sys.stderr)
    print_found(records)
    print_reliability(records)
    print_wrong(records)
    if chosen.picture is not None:
        chosen.picture.write_text(draw_curve(records))


def _cases(chosen: argparse.Namespace) -> Iterator[tuple[int, float, Case]]:
    variants = chosen.variant or ("dense/solid/camera", "sparse/solid_sparse")
    for i, seed in enumerate(chosen.seeds):
        radius = chosen.radii[i % len(chosen.radii)]
        sets = {"other": other_cases(variants, seed), "simulated": simulated_cases(variants, seed)}
        for name, cases in sets.items():
            for k, case in enumerate(cases if name in chosen.sets else ()):
                # Three neighbours together, since scenes next to each other are seen by different sensors.
                is_due = (k // len(variants) // 3 + i) % chosen.every == 0
                if is_due and any(part in case.name for part in chosen.only.split(",")):
                    yield seed, radius, case
    for cases in (scene_cases(data_folder()), recorded_cases(data_folder())) if "recorded" in chosen.sets else ():
        for case in cases:
            if any(part in case.name for part in chosen.only.split(",")):
                yield 0, chosen.radii[0], case


def _latest(records: Sequence[Record]) -> list[Record]:
    """Return the last record of every scan and kind: a scan that was searched again counts once."""
    last = {(one["case"], one.get("scene_seed", one["radius"]), one["kind"]): one for one in records}
    return list(last.values())


def print_wrong(records: Sequence[Record]) -> None:
    """Print every confident hit that is wrong."""
    rows = [
        (
            one["case"],
            one["kind"],
            f"{hit['confidence']:.2f}",
            "object" if hit["is_object"] else "nothing",
            " ".join(f"{row[3]:.2f}" for row in hit["pose"]),
        )
        for one in records
        for hit in one["hits"]
        if hit["how"] == "wrong" and hit["confidence"] >= CONFIDENT
    ]
    print_table("wrong confident hits", ("scan", "kind", "confidence", "of", "at"), rows)


def count_right(records: Sequence[Record], density: str) -> list[tuple[float, float, int, int, float]]:
    """Return, per bin of :data:`LEVELS`, its limits, hits, right hits and mean confidence."""
    hits = [
        hit for record in records if record["density"] == density for hit in record["hits"] if hit["how"] != "alike"
    ]
    bins = []
    for low, high in pairwise(LEVELS):
        mine = [hit for hit in hits if low <= hit["confidence"] < high]
        mean = sum(hit["confidence"] for hit in mine) / len(mine) if mine else 0.5 * (low + min(high, 1.0))
        bins.append((low, min(high, 1.0), len(mine), sum(hit["how"] == "right" for hit in mine), mean))
    return bins


def draw_curve(records: Sequence[Record]) -> str:
    """Return the reliability curve as SVG: share of right hits over mean confidence, with their number."""
    width, height = _LEFT + _SIZE + 20.0, _TOP + _SIZE + _EDGE
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {height:.0f}" font-family="sans-serif" '
        'font-size="12">',
        f'<rect width="{width:.0f}" height="{height:.0f}" fill="white"/>',
        _line((0.0, 0.0), (1.0, 1.0), "#999999", "4 4"),
        _line((0.5, 0.95), (1.0, 0.95), "#2f7d32", "2 3"),
        _line((0.5, 0.0), (0.5, 1.0), "#cccccc", "2 3"),
        *(_line(a, b, "#333333", "none") for a, b in (((0.0, 0.0), (1.0, 0.0)), ((0.0, 0.0), (0.0, 1.0)))),
    ]
    for tick in (0.0, 0.2, 0.4, 0.6, 0.8, 1.0):
        x, y = _place((tick, tick))
        parts.append(f'<text x="{x:.0f}" y="{_TOP + _SIZE + 16:.0f}" text-anchor="middle">{tick:.1f}</text>')
        parts.append(f'<text x="{_LEFT - 8:.0f}" y="{y + 4:.0f}" text-anchor="end">{tick:.1f}</text>')
    parts.append(_text(_LEFT + 0.5 * _SIZE, _TOP + _SIZE + 34, "confidence"))
    parts.append(_text(14, _TOP + 0.5 * _SIZE, "share of right hits", turned=True))
    for k, (density, colour) in enumerate(_COLOURS.items()):
        bins = [one for one in count_right(records, density) if one[2]]
        places = [_place((mean, right / n)) for _, _, n, right, mean in bins]
        path = " ".join(f"{x:.1f},{y:.1f}" for x, y in places)
        parts.append(f'<polyline points="{path}" fill="none" stroke="{colour}" stroke-width="2"/>')
        for (x, y), (_, _, n, _, _) in zip(places, bins, strict=True):
            parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4" fill="{colour}"/>')
            parts.append(f'<text x="{x + 6:.1f}" y="{y + 14 + 12 * k:.1f}" fill="{colour}">{n}</text>')
        parts.append(f'<text x="{_LEFT + 12:.0f}" y="{_TOP + 18 + 16 * k:.0f}" fill="{colour}">{density}</text>')
    return "\n".join([*parts, "</svg>", ""])


def _place(share: tuple[float, float]) -> tuple[float, float]:
    return _LEFT + _SIZE * share[0], _TOP + _SIZE * (1.0 - share[1])


def _line(start: tuple[float, float], end: tuple[float, float], colour: str, dashes: str) -> str:
    (a, b), (c, d) = _place(start), _place(end)
    return f'<path d="M{a:.0f} {b:.0f}L{c:.0f} {d:.0f}" stroke="{colour}" stroke-dasharray="{dashes}" fill="none"/>'


def _text(x: float, y: float, text: str, *, turned: bool = False) -> str:
    turn = f' transform="rotate(-90 {x:.0f} {y:.0f})"' if turned else ""
    return f'<text x="{x:.0f}" y="{y:.0f}" text-anchor="middle"{turn}>{text}</text>'


if __name__ == "__main__":
    main()
