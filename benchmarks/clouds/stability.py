"""Do detections depend on the seed and the crop, and does their confidence mean what it says?

Every scan is searched with several seeds and crop radii.  Hits of one object in several of these runs make a group; a
group is stable if every run reports it once, with the same side of the confidence threshold, nearly the same confidence
and nearly the same pose.  Every hit is compared with the truth, which gives the share of right hits by confidence.

From the checkout's root: ``python -m benchmarks.clouds.stability [--kind KIND] [--only NAME] [--seeds 0 1 2]
[--radii 3 4 5] [--sets other simulated recorded] [--variant V] [--record FILE | --from FILE]``.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.clouds.cases import Case, data_folder, recorded_cases, scene_cases, simulated_cases, variant_turns
from benchmarks.clouds.errors import MEASURES, errors, is_lookalike, is_right, matched
from benchmarks.clouds.others import other_cases
from benchmarks.tables import print_table
from perception import CONFIDENT, KINDS, Detection, detect, make_view

_BORDER = 0.7  # [m] objects nearer to the smallest crop's border are cut differently by each crop
_SAME_PLACE, _SAME_ORIGIN, _SAME_CONFIDENCE = 0.25, 0.02, 0.1
_LEVELS = (0.05, 0.2, 0.35, 0.5, 0.65, 0.8, 0.9, 0.97, 1.0001)
Record = dict[str, Any]


def main(arguments: Sequence[str] | None = None) -> None:
    """Search all scans and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kind", choices=KINDS, action="append", help="only this kind; may be repeated")
    parser.add_argument("--only", default="", help="only scans whose name holds one of these, separated by commas")
    parser.add_argument("--seeds", type=int, nargs="+", default=(0, 1, 2))
    parser.add_argument("--radii", type=float, nargs="+", default=(3.0, 4.0, 5.0))
    parser.add_argument("--sets", nargs="+", default=("other", "simulated", "recorded"))
    parser.add_argument("--variant", type=variant_turns, action="append", help="sensor of simulated scenes")
    parser.add_argument("--scene-seed", type=int, default=0, help="of the simulated scenes' details")
    parser.add_argument("--present", action="store_true", help="only kinds that a scan shows, and valves")
    parser.add_argument("--record", type=Path, help="append one JSON line per scan, kind and run")
    parser.add_argument("--from", dest="source", type=Path, help="print the tables of such a file")
    chosen = parser.parse_args(arguments)
    kinds = tuple(chosen.kind or KINDS)
    if chosen.source is not None:
        lines = chosen.source.read_text().splitlines()
        records = [one for one in map(json.loads, lines) if one["kind"] in kinds and _named(one["case"], chosen.only)]
    else:
        records = []
        variants = chosen.variant or ("dense", "sparse", "solid/camera")
        for case in _cases(chosen.sets, variants, chosen.scene_seed):
            if not _named(case.name, chosen.only):
                continue
            shown = {"valve", *(truth.kind for truth in case.truth)}
            searched = [kind for kind in kinds if kind in shown or not chosen.present]
            for record in search(case, searched, chosen.seeds, chosen.radii):
                records.append(record)
                if chosen.record is not None:
                    with chosen.record.open("a") as file:
                        file.write(json.dumps(record) + "\n")
            print(case.name, file=sys.stderr)
    print_found(records)
    print_stability(records)
    print_reliability(records)


def _named(name: str, only: str) -> bool:
    return any(part in name for part in only.split(","))


def _cases(sets: Sequence[str], variants: Sequence[str], seed: int) -> Iterator[Case]:
    if "other" in sets:
        yield from other_cases(variants, seed)
    if "simulated" in sets:
        yield from simulated_cases(variants, seed)
    if "recorded" in sets:
        yield from scene_cases(data_folder())
        yield from recorded_cases(data_folder())


def search(case: Case, kinds: Sequence[str], seeds: Sequence[int], radii: Sequence[float]) -> Iterator[Record]:
    """Yield one record per run and kind: its hits and what became of each true object."""
    cloud = case.load()
    # A whole room is searched at its own radius alone.
    radii = [case.reach.radius] if case.is_room else radii
    for radius in radii:
        reach = replace(case.reach, radius=radius)
        for seed in seeds:
            view = make_view(cloud, reach=reach, seed=seed)
            for kind in kinds:
                if kind in case.unknown:
                    continue
                clock = time.process_time()
                hits = detect(kind, view)
                yield _record(case, kind, seed, radius, hits, time.process_time() - clock)


def _record(case: Case, kind: str, seed: int, radius: float, hits: Sequence[Detection], cpu: float) -> Record:
    outcome = matched(kind, hits, case.truth, case.lookalikes)
    of_hit = {id(hit): (truth, errors(kind, hit, truth)) for truth, hit in outcome.pairs if hit is not None}
    lines = []
    for hit in hits:
        truth, values = of_hit.get(id(hit), (None, ()))
        right = truth is not None and is_right(kind, values)
        how = "right" if right else "alike" if is_lookalike(hit, case.lookalikes) and truth is None else "wrong"
        lines.append(
            {
                "confidence": round(float(hit.confidence), 4),
                "how": how,
                "is_object": truth is not None,
                "pose": np.round(hit.pose_world_object[:3], 4).tolist(),
                "errors": [None if value is None else round(float(value), 2) for value in values],
            }
        )
    truths = [
        {
            "place": np.round(truth.pose_world_object[:3, 3], 3).tolist(),
            "confidence": 0.0 if hit is None else round(float(hit.confidence), 4),
            "right": hit is not None and is_right(kind, errors(kind, hit, truth)),
        }
        for truth, hit in outcome.pairs
    ]
    return {
        "case": case.name,
        "density": case.density,
        "kind": kind,
        "seed": seed,
        "radius": radius,
        "hits": lines,
        "truths": truths,
        "cpu": round(cpu, 3),
    }


def print_found(records: Sequence[Record]) -> None:
    """Print, by kind, objects found, hits that are right or wrong, duplicates and errors."""
    header = ("kind", "scans", "dense: found", "right", "sparse: found", "right", "wrong object", "nothing", "cpu s")
    rows = []
    for kind in dict.fromkeys(record["kind"] for record in records):
        mine = [record for record in records if record["kind"] == kind]
        cells = [kind, str(len(mine))]
        for density in ("dense", "sparse"):
            truths = [one for record in mine if record["density"] == density for one in record["truths"]]
            sure = [one for one in truths if one["confidence"] >= CONFIDENT]
            cells += [f"{len(sure)}/{len(truths)}", str(sum(one["right"] for one in sure))]
        wrong = [
            hit for record in mine for hit in record["hits"] if hit["confidence"] >= CONFIDENT and hit["how"] == "wrong"
        ]
        cells += [str(sum(hit["is_object"] for hit in wrong)), str(sum(not hit["is_object"] for hit in wrong))]
        rows.append((*cells, f"{np.median([record['cpu'] for record in mine]):.2f}"))
    print_table("objects, all runs; confident hits", header, rows)
    rows = []
    for kind, measures in MEASURES.items():
        for density in ("dense", "sparse"):
            sure = [
                hit["errors"]
                for record in records
                if record["kind"] == kind and record["density"] == density
                for hit in record["hits"]
                if hit["is_object"] and hit["confidence"] >= CONFIDENT
            ]
            for k, measure in enumerate(measures):
                values = [line[k] for line in sure if line[k] is not None]
                if values:
                    cuts = [f"{cut:.1f}" for cut in np.percentile(values, (50.0, 90.0))]
                    rows.append((kind, density, measure.name, str(len(values)), *cuts, f"{max(values):.1f}"))
    print_table("errors of confident hits", ("kind", "scan", "error", "hits", "median", "90 %", "worst"), rows)


def print_stability(records: Sequence[Record]) -> None:
    """Print, by kind, how many objects are reported alike by all runs of a scan, and list those that are not."""
    by_scan: Mapping[tuple[str, str], list[Record]] = defaultdict(list)
    for record in records:
        by_scan[record["kind"], record["case"]].append(record)
    rows, odd = [], []
    counts: dict[str, list[int]] = defaultdict(lambda: [0, 0, 0])
    for (kind, case), runs in by_scan.items():
        least = min(run["radius"] for run in runs) - _BORDER
        for group in _groups(runs, least):
            counts[kind][0] += 1
            sides = {any(hit["confidence"] >= CONFIDENT for hit in hits) for hits in group}
            confidences = [max((hit["confidence"] for hit in hits), default=0.0) for hits in group]
            origins = [np.array(max(hits, key=lambda hit: hit["confidence"])["pose"])[:, 3] for hits in group if hits]
            apart = max(float(np.linalg.norm(one - other)) for one in origins for other in origins)
            spread = max(confidences) - min(confidences)
            counts[kind][1] += len(sides) == 1
            if len(sides) == 1 and apart < _SAME_ORIGIN and spread < _SAME_CONFIDENCE:
                counts[kind][2] += 1
            else:
                text = " ".join(f"{value:.2f}" for value in confidences)
                odd.append((case, kind, f"{1e3 * apart:.0f}", text))
    rows = [(kind, *(str(count) for count in three)) for kind, three in counts.items()]
    if odd:
        print_table("objects that not all runs report alike", ("scan", "kind", "apart mm", "confidences"), odd)
    header = ("kind", "objects", "same side of 0.5", "also same place and confidence")
    total = tuple(str(sum(three[k] for three in counts.values())) for k in range(3))
    print_table("stability over seeds and crops", header, [*rows, ("all", *total)])


def _groups(runs: Sequence[Record], least: float) -> Iterator[list[list[dict[str, Any]]]]:
    """Yield, for each place with a confident hit in any run, every run's hits there."""
    loose = [
        (i, hit)
        for i, run in enumerate(runs)
        for hit in run["hits"]
        if np.hypot(hit["pose"][0][3], hit["pose"][1][3]) < least
    ]
    loose.sort(key=lambda pair: -pair[1]["confidence"])
    while loose and loose[0][1]["confidence"] >= CONFIDENT:
        place = np.array(loose[0][1]["pose"])[:, 3]
        near = [np.linalg.norm(np.array(hit["pose"])[:, 3] - place) < _SAME_PLACE for _, hit in loose]
        group: list[list[dict[str, Any]]] = [[] for _ in runs]
        for (i, hit), is_near in zip(loose, near, strict=True):
            if is_near:
                group[i].append(hit)
        yield group
        loose = [pair for pair, is_near in zip(loose, near, strict=True) if not is_near]


def print_reliability(records: Sequence[Record]) -> None:
    """Print the share of right hits by confidence, for all kinds together and by kind above the threshold."""
    hits = [
        (record["kind"], record["density"], hit)
        for record in records
        for hit in record["hits"]
        if hit["how"] != "alike"
    ]
    rows = []
    for low, high in pairwise(_LEVELS):
        cells = [f"{low:.2f} to {min(high, 1.0):.2f}"]
        for density in ("dense", "sparse"):
            mine = [hit for _, one, hit in hits if one == density and low <= hit["confidence"] < high]
            n_right = sum(hit["how"] == "right" for hit in mine)
            mean = np.mean([hit["confidence"] for hit in mine]) if mine else np.nan
            cells += [str(len(mine)), f"{mean:.2f}", f"{n_right / len(mine):.2f}" if mine else "-"]
        rows.append(tuple(cells))
    header = ("confidence", "dense: hits", "mean", "right", "sparse: hits", "mean", "right")
    print_table("reliability", header, rows)
    rows = []
    for kind in dict.fromkeys(kind for kind, _, _ in hits):
        cells = [kind]
        for density in ("dense", "sparse"):
            mine = [h for k, d, h in hits if k == kind and d == density and h["confidence"] >= CONFIDENT]
            n_right = sum(hit["how"] == "right" for hit in mine)
            cells += [str(len(mine)), str(n_right), f"{n_right / len(mine):.3f}" if mine else "-"]
        rows.append(tuple(cells))
    every = [hit for _, _, hit in hits if hit["confidence"] >= CONFIDENT]
    n_right = sum(hit["how"] == "right" for hit in every)
    rows.append(("all", str(len(every)), str(n_right), f"{n_right / max(1, len(every)):.3f}", "", "", ""))
    print_table("confident hits", ("kind", "dense", "right", "share", "sparse", "right", "share"), rows)


if __name__ == "__main__":
    main()
