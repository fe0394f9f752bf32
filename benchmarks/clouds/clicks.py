"""Is what a person clicks found?  Clicks within 10 cm of objects and at random points, recorded and simulated scans.

A click is at the middle of a lever, else at an object's origin, moved by up to 10 cm.  *Found*: one of the few fits
that are shown lies within 15 mm and 5 deg, the error of the truth added; *first*: the surest one does.

From the checkout's root: ``python -m benchmarks.clouds.clicks [--real FOLDER] [--seeds 0 1] [--clicks 4] [--only NAME]
[--rows TABLE.csv]``; ``--rows`` appends the evidence of every fit for ``benchmarks.clouds.confidence fit``.
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path

import numpy as np
from jaxtyping import Float

from benchmarks.clouds.cases import Case, data_folder
from benchmarks.clouds.confidence import list_recorded, list_simulated
from benchmarks.clouds.errors import axis, distance, errors, is_lookalike, is_right
from benchmarks.tables import print_table
from perception import CONFIDENT, Detection, detect_at, make_view
from perception.detect.engine.hits import PREFIX
from perception.detect.engine.kinds import CLICKED
from perception.detect.engine.score import FEATURES
from perception.simulate.scenes import Truth
from perception.view import View

_OFF, _RANGE = 0.1, 3.0  # of a click from its object; of random clicks from the sensor [m]
_PLACE_MM, _TURN_DEG = 15.0, 5.0


def main(arguments: Sequence[str] | None = None) -> None:
    """Click at objects and elsewhere; print one row per kind and origin of the scans."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--real", type=Path, default=data_folder() / "real", help="folder of recorded clouds")
    parser.add_argument("--seeds", type=int, nargs="*", default=(600,), help="of simulated scenes")
    parser.add_argument("--clicks", type=int, default=4, help="at each object, and at random points of each scan")
    parser.add_argument("--only", default="", help="only scans whose name holds one of these, separated by commas")
    parser.add_argument("--every", type=int, default=4, help="one in N simulated scans with objects")
    parser.add_argument("--rows", type=Path, help="append the evidence of each fit to this table")
    chosen = parser.parse_args(arguments)
    simulated = [one for one in list_simulated(chosen.seeds) if any(t.kind in CLICKED for t in one[0].truth)]
    counts: dict[tuple[str, str], list[float]] = defaultdict(lambda: [0.0] * 5)
    for origin, case, source in chain(
        (("recorded", case, source) for case, source, _ in list_recorded(chosen.real, moves=(0,))),
        (("simulated", case, source) for case, source, _ in simulated[:: chosen.every]),
    ):
        if any(part in case.name for part in chosen.only.split(",")):
            error_mm = _truth_error(chosen.real, case) if origin == "recorded" else 0.0
            _click(origin, case, source, chosen, counts, error_mm)
            print(case.name, file=sys.stderr)
    rows = [
        (kind, origin, f"{n:.0f}", f"{found:.0f}", f"{first:.0f}", f"{wrong:.0f}", f"{cpu / max(n, 1):.2f}")
        for (kind, origin), (n, found, first, wrong, cpu) in sorted(counts.items())
    ]
    print_table("clicks", ("kind", "scans", "clicks", "found", "first", "confident and wrong", "CPU s"), rows)


def _click(
    origin: str,
    case: Case,
    source: str,
    chosen: argparse.Namespace,
    counts: dict[tuple[str, str], list[float]],
    error_mm: float,
) -> None:
    """Click at a scan's objects and at random points; add to the counts and append the rows."""
    view = make_view(case.load(), reach=case.reach)
    rng = np.random.default_rng(sum(map(ord, case.name)))
    for click, truth in list_clicks(view, case.truth, chosen.clicks, rng):
        kinds = tuple(CLICKED) if truth is None else (truth.kind,)
        begun = time.process_time()
        for kind, hits in detect_at(kinds, view, click):
            own = [hit for hit in hits if PREFIX + FEATURES[0] in hit.residuals]
            right = [any(_is_close(hit, one, error_mm) for one in case.truth if one.kind == kind) for hit in own]
            count = counts[kind if truth is not None else "elsewhere", origin]
            count[0] += 1
            count[1] += any(right)
            count[2] += bool(right) and right[0]
            count[3] += sum(hit.confidence >= CONFIDENT and not _is_object(hit, case, error_mm) for hit in hits)
            count[4] += time.process_time() - begun
            begun = time.process_time()
            if chosen.rows is not None:
                _append(chosen.rows, case, source, own, error_mm)


def list_clicks(
    view: View, truths: Sequence[Truth], n: int, rng: np.random.Generator
) -> Iterator[tuple[Float[np.ndarray, "3"], Truth | None]]:
    """Yield clicks about each object that the engine has a template of, then clicks at random points."""
    for truth in truths:
        if truth.kind not in CLICKED:
            continue
        pose = truth.pose_world_object
        length = truth.sizes.get("lever_length") or (truth.sizes.get("length", 0.0) if truth.kind == "lever" else 0.0)
        for _ in range(n):
            off = rng.normal(size=3)
            off *= rng.uniform(0.0, _OFF) / np.linalg.norm(off)
            yield pose[:3, 3] + 0.5 * length * pose[:3, 0] + off, truth
    near = view.obstacles[np.linalg.norm(view.obstacles - np.median(view.starts, axis=0), axis=1) < _RANGE]
    for _ in range(n if len(near) else 0):
        yield near[rng.integers(len(near))], None


def _truth_error(folder: Path, case: Case) -> float:
    """Return the error of a recorded cloud's truth [mm]."""
    truth = json.loads((folder / f"{case.name.split(':')[0]}.json").read_text())["truth"]
    return float(truth.get("error_mm", 0.0)) if isinstance(truth, dict) else 0.0


def _is_close(hit: Detection, truth: Truth, error_mm: float) -> bool:
    """Return whether a fit lies within the targets of place and main axis."""
    column = 2 if truth.kind in ("hose", "valve") and "lever_length" not in truth.sizes else 0
    turn = axis(column, signed=column == 0)(hit, truth)
    return distance(hit, truth) <= _PLACE_MM + error_mm and turn is not None and turn <= _TURN_DEG


def _is_object(hit: Detection, case: Case, error_mm: float) -> bool:
    """Return whether a hit is an object of its kind, or one that counts neither way."""
    of_kind = [one for one in case.truth if one.kind == hit.kind]
    true = any(is_right(hit.kind, errors(hit.kind, hit, one), error_mm) for one in of_kind)
    return true or hit.kind in case.unknown or is_lookalike(hit, case.lookalikes)


def _append(table: Path, case: Case, source: str, hits: Sequence[Detection], error_mm: float) -> None:
    """Append the evidence of fits in the columns of ``benchmarks.clouds.confidence``."""
    is_new = not table.exists()
    with table.open("a", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        if is_new:
            writer.writerow(["scan", "source", "template", *FEATURES, "rating", "right"])
        for hit in hits:
            right = any(
                is_right(hit.kind, errors(hit.kind, hit, one), error_mm) for one in case.truth if one.kind == hit.kind
            )
            if right or not is_lookalike(hit, case.lookalikes):
                shown = [f"{hit.residuals[PREFIX + name]:.4f}" for name in FEATURES]
                writer.writerow([case.name, source, _row_of(hit), *shown, "0.5000", int(right)])


def _row_of(hit: Detection) -> str:
    """Return the row of weights of a fit about a click."""
    names = list(CLICKED[hit.kind])
    return names[-1] if "lever_length" in hit.sizes else names[0]


if __name__ == "__main__":
    main()
