"""Fits the curve from the engine's features to a confidence, and says how well it holds on scenes not used for it.

``gather`` searches scans and appends one line per hit to a table: its scan, source, template, features, and whether it
is right.  ``fit`` fits one logistic curve per template with common weights for what all kinds share, writes
``weights.csv`` and ``usual.csv`` of ``perception/detect/engine``, and prints errors of scenes held out by source.

From the checkout's root: ``python -m benchmarks.clouds.confidence gather TABLE.csv [--seeds 100 101] [--real FOLDER]``
and ``... fit TABLE.csv``.  A real folder has clouds with a JSON file of the truth beside each.
"""

from __future__ import annotations

import argparse
import csv
import json
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from benchmarks.clouds.cases import Case, simulated_cases
from benchmarks.clouds.errors import errors, is_lookalike, is_right, matched
from benchmarks.clouds.others import other_cases
from benchmarks.tables import print_table
from perception import CONFIDENT, KINDS, Cloud, Reach, detect_each, make_view, read_cloud
from perception.detect.engine.hits import PREFIX
from perception.detect.engine.kinds import CLICKED, name_of
from perception.detect.engine.score import FEATURES
from perception.detect.engine.verdict import INPUTS, heed, inputs_of
from perception.simulate.scenes import Truth

_TABLES = Path(__file__).parents[2] / "perception" / "detect" / "engine"
_VARIANTS = ("dense/solid/camera", "sparse/solid_sparse")
# Signs that a weight may have, so that few examples cannot turn evidence for an object into evidence against it.
_SIGNS = dict(zip(INPUTS, (1, -1, -1, 1, -1, -1, 1, 1, -1, 1, -1, -1, 1, 1, 1), strict=True))
# Rows of the engine's own search: these alone are compared with rivals and with the other direction, since their
# templates have all that is about the object.
_SEARCHED = frozenset(chain.from_iterable(CLICKED.values()))
# Templates whose shape says little (a leaf is a flat face) have their detector's rating as an input.
_RATED = frozenset({"door", "panel", "seat", "opening", "hose", "beam", "lever", "lever valve"})
_FLAT = frozenset({"door", "panel", "seat", "opening"})
_OF_SEARCH = frozenset({"flat_share", "flats_share", "margin", "lead"})
_RIDGE, _RIDGE_OWN = 0.1, 0.1
_MOST_WEIGHT = 8.0  # of a recorded hit, relative to a simulated one
_FOLDS = 5
_FEWEST = 4, 2  # right and wrong hits


@dataclass(frozen=True)
class Table:
    """Hits of all scans.

    Attributes:
        inputs: (N, I) inputs of the curve.
        right: (N,) whether a person would call it the object.
        template, source: (N,) names.
    """

    inputs: Float[np.ndarray, "N I"]
    right: Bool[np.ndarray, "N"]
    template: np.ndarray
    source: np.ndarray


def main(arguments: Sequence[str] | None = None) -> None:
    """Gather hits, or fit the curve."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=("gather", "fit"))
    parser.add_argument("table", type=Path)
    parser.add_argument("--seeds", type=int, nargs="*", default=(100, 101))
    parser.add_argument("--real", type=Path, help="folder of recorded clouds with their truth")
    parser.add_argument("--only", default="")
    parser.add_argument("--dry", action="store_true", help="print the tables of a fit and write no weights")
    parser.add_argument("--kinds", nargs="*", choices=KINDS, default=KINDS)
    chosen = parser.parse_args(arguments)
    if chosen.what == "fit":
        _fit_all(_read(chosen.table), is_kept=not chosen.dry)
        return
    for case, source, kinds in chain(list_simulated(chosen.seeds), list_recorded(chosen.real) if chosen.real else ()):
        if chosen.only in case.name:
            _gather(case, source, [kind for kind in kinds if kind in chosen.kinds], chosen.table)


def list_simulated(seeds: Sequence[int]) -> Iterator[tuple[Case, str, Sequence[str]]]:
    """Yield simulated scans, each with its source and the kinds to search."""
    for seed in seeds:
        for case in (*simulated_cases(_VARIANTS, seed), *other_cases(_VARIANTS, seed)):
            shown = sorted({truth.kind for truth in case.truth})
            yield case, f"{case.name.split(':')[0]}/{seed}", shown or KINDS


def list_recorded(folder: Path, moves: Sequence[int] = (0, 1, -1)) -> Iterator[tuple[Case, str, Sequence[str]]]:
    """Yield recorded clouds, each turned by the moves in degrees and lifted by 3 cm per degree."""
    for path in sorted(folder.glob("*.json")):
        document = json.loads(path.read_text())
        truth = tuple(read_truth(document))
        for degrees in moves:
            move = np.eye(4)
            move[:3, :3] = Rotation.from_euler("xy", [degrees, -degrees], degrees=True).as_matrix()
            move[2, 3] = 0.03 * degrees
            load = partial(_read_moved, path.with_suffix(".ply"), move)
            moved = tuple(replace(one, pose_world_object=move @ one.pose_world_object) for one in truth)
            reach = Reach(radius=float(document.get("reach") or 4.0), top=4.0)
            unknown = frozenset({"door lever": ("lever", "door")}.get(document["kind"], ())) | set(
                document.get("excuse", ())
            )
            case = Case(f"{path.stem}:{degrees:+d}", "dense", load, moved, reach=reach)
            yield case, document["source"], [kind for kind in KINDS if kind not in unknown or truth]


def _read_moved(path: Path, move: Float[np.ndarray, "4 4"]) -> Cloud:
    cloud, turn, shift = read_cloud(path), move[:3, :3], move[:3, 3]
    return Cloud(cloud.points @ turn.T + shift, cloud.origin @ turn.T + shift)


def read_truth(document: dict[str, object]) -> Iterator[Truth]:
    """Yield the objects of a recorded cloud's JSON in the detectors' frames."""
    truth = document["truth"]
    if not isinstance(truth, dict):
        return
    pose = np.eye(4)
    if truth["kind"] == "drill":
        x, z = np.array(truth["chuck"]), np.array(truth["grip_up"])
        pose[:3, :3], pose[:3, 3] = np.column_stack([x, np.cross(z, x), z]), truth["grip_middle"]
        yield Truth("drill", pose)
    elif "lever_pivot" in truth:
        pivot = np.array(truth["lever_pivot"])
        x, z = (
            np.array(truth["lever_tip"]) - pivot,
            np.array(truth.get("normal_to_robot") or truth["leaf_normal_to_robot"]),
        )
        length = float(np.linalg.norm(x))
        pose[:3, :3], pose[:3, 3] = np.column_stack([x / length, np.cross(z, x / length), z]), pivot
        yield Truth("lever", pose, {"length": length})
    elif truth["kind"] == "valve":
        x, z = np.array(truth["tip"]) - truth["hub"], np.array(truth["spindle_axis"])
        x -= (x @ z) * z
        length = float(np.linalg.norm(x))
        pose[:3, :3], pose[:3, 3] = np.column_stack([x / length, np.cross(z, x / length), z]), truth["hub"]
        yield Truth("valve", pose, {"lever_length": length})


def _gather(case: Case, source: str, kinds: Sequence[str], table: Path) -> None:
    """Append the hits of a scan to the table."""
    view = make_view(case.load(), reach=case.reach)
    lines = []
    for kind, hits in detect_each(kinds, view, on_failure=lambda kind, error: print(case.name, kind, error)):
        outcome = matched(kind, hits, case.truth, case.lookalikes)
        of_hit = {id(hit): truth for truth, hit in outcome.pairs if hit is not None}
        for hit in hits:
            truth = of_hit.get(id(hit))
            right = truth is not None and is_right(kind, errors(kind, hit, truth))
            if PREFIX + FEATURES[0] not in hit.residuals or (truth is None and is_lookalike(hit, case.lookalikes)):
                continue
            shown = [f"{hit.residuals[PREFIX + name]:.4f}" for name in FEATURES]
            lines.append([case.name, source, name_of(hit), *shown, f"{hit.residuals['rating_score']:.4f}", int(right)])
    is_new = not table.exists()
    with table.open("a", newline="") as file:
        writer = csv.writer(file)
        if is_new:
            writer.writerow(["scan", "source", "template", *FEATURES, "rating", "right"])
        writer.writerows(lines)
    print(case.name, [(line[2], line[-1]) for line in lines], flush=True)


def _read(path: Path) -> Table:
    rows = list(csv.DictReader(path.read_text().splitlines()))
    inputs = [
        list(inputs_of(np.array([float(row[name]) for name in FEATURES]), float(row["rating"])).values())
        for row in rows
    ]
    return Table(
        np.array(inputs),
        np.array([row["right"] == "1" for row in rows]),
        np.array([row["template"] for row in rows]),
        np.array([row["source"] for row in rows]),
    )


def _fit_all(table: Table, *, is_kept: bool) -> None:
    """Fit on all sources and write the weights; print what fits without each fold say about that fold."""
    fold = np.array([zlib.crc32(source.encode()) % _FOLDS for source in table.source])
    held = np.zeros(len(fold))
    for k in range(_FOLDS):
        _, weights = fit(table, fold != k)
        held[fold == k] = predict(table, weights)[fold == k]
    print_calibration(table, held)
    if not is_kept:
        return
    names, weights = fit(table, np.ones(len(fold), dtype=bool))
    _write("weights.csv", ["bias", *INPUTS], weights)
    usual = {name: table.right & (table.template == name) for name in names}
    _write("usual.csv", INPUTS, {name: table.inputs[of].mean(axis=0) for name, of in usual.items() if of.any()})


def _write(file: str, columns: Sequence[str], values: Mapping[str, Float[np.ndarray, "C"]]) -> None:
    """Write a table of the engine, one row per template."""
    with (_TABLES / file).open("w", newline="") as opened:
        writer = csv.writer(opened, lineterminator="\n")
        writer.writerow(["template", *columns])
        for name, row in values.items():
            writer.writerow([name, *(f"{value:.4f}" for value in row)])


def fit(table: Table, used: Bool[np.ndarray, "N"]) -> tuple[list[str], dict[str, Float[np.ndarray, "I1"]]]:
    """Return the templates and their weights, bias first; flat kinds share weights, and all others do."""
    is_flat = np.isin(table.template, list(_FLAT))
    groups = [_fit_group(table, used & these) for these in (is_flat, ~is_flat) if (used & these).any()]
    return [name for names, _ in groups for name in names], {k: v for _, weights in groups for k, v in weights.items()}


def _fit_group(table: Table, used: Bool[np.ndarray, "N"]) -> tuple[list[str], dict[str, Float[np.ndarray, "I1"]]]:
    """Return the templates and their weights, bias first: weights of all, and a bias and rating of each's own."""
    names = [
        str(name)
        for name in np.unique(table.template)
        if _is_enough(name, table.right[used & (table.template == name)])
    ]
    used = used & np.isin(table.template, names)
    if not names:
        return [], {}
    n, k = len(INPUTS), len(names)
    x, y = table.inputs[used], table.right[used].astype(float)
    of = np.array([names.index(name) for name in table.template[used]])
    own = np.eye(k)[of]
    rated = own * np.array([name in _RATED for name in names])
    n_common = n - 1
    applies = np.array([[_applies(key, name) for key in INPUTS[:-1]] for name in names])
    common = applies[of] * x[:, :-1]
    design = np.concatenate([common, rated * x[:, -1:], own, np.ones((len(x), 1))], axis=1)
    size = design.shape[1]
    ridge = np.full(size, _RIDGE)
    ridge[n_common : n_common + k] = _RIDGE_OWN
    ridge[-1] = 1e-3
    bounds = [(0.0, None) if _SIGNS[name] > 0 else (None, 0.0) for name in INPUTS[:-1]]
    bounds += [(0.0, None)] * k + [(None, None)] * (k + 1)

    counts = _weigh(table.source[used], of)

    def loss(w: Float[np.ndarray, "W"]) -> tuple[float, Float[np.ndarray, "W"]]:
        score = design @ w
        value = counts * (np.logaddexp(0.0, score) - y * score)
        slope = design.T @ (counts * (1.0 / (1.0 + np.exp(-score)) - y))
        return float(value.sum() + 0.5 * (ridge * w * w).sum()), slope + ridge * w

    w = minimize(loss, np.zeros(size), jac=True, bounds=bounds, method="L-BFGS-B", options={"maxiter": 2000}).x
    weights = {}
    for i, name in enumerate(names):
        row = np.zeros(n + 1)
        row[0] = w[n_common + k + i] + w[-1]
        row[1:n] = applies[i] * w[:n_common]
        row[n] = w[n_common + i]
        weights[name] = row
    return names, weights


def _weigh(source: np.ndarray, of: np.ndarray) -> Float[np.ndarray, "K"]:
    """Return the weight of each hit: the few of recorded scans count twice as much as all simulated of a template."""
    counts = np.ones(len(source))
    recorded = ~_is_simulated(source)
    for template in np.unique(of):
        mine = of == template
        n_recorded, n_simulated = int((mine & recorded).sum()), int((mine & ~recorded).sum())
        if n_recorded:
            counts[mine & recorded] = np.clip(2.0 * n_simulated / n_recorded, 1.0, _MOST_WEIGHT)
    return counts


def _applies(key: str, name: str) -> bool:
    """Return whether a template's curve has an input."""
    return key not in _OF_SEARCH or name in _SEARCHED


def _is_enough(name: str, right: Bool[np.ndarray, "K"]) -> bool:
    """Return whether hits of a template are enough for a curve; without, its detector's rating stays.

    A fit of the engine's own search has no other rating; what all kinds share then says most.
    """
    few = (0, _FEWEST[1]) if name in _SEARCHED else _FEWEST
    return bool(right.sum() >= few[0] and (~right).sum() >= few[1])


def predict(table: Table, weights: dict[str, Float[np.ndarray, "I1"]]) -> Float[np.ndarray, "N"]:
    """Return the confidence of each hit."""
    # A template without a row keeps its rating, which enters as the logarithm of the odds.
    as_rated = np.append(np.zeros(len(INPUTS)), 1.0)
    rows = np.array([weights.get(name, as_rated) for name in table.template])
    fitted = 1.0 / (1.0 + np.exp(-(rows[:, 0] + (rows[:, 1:] * table.inputs).sum(axis=1))))
    rating = 1.0 / (1.0 + np.exp(-table.inputs[:, -1]))
    own = np.isin(table.template, list(_SEARCHED))
    return np.array(
        [
            value if is_own else heed(float(value), float(rated))
            for value, rated, is_own in zip(fitted, rating, own, strict=True)
        ]
    )


def print_calibration(table: Table, held: Float[np.ndarray, "N"]) -> None:
    """Print, by confidence of scenes held out, how many hits are right, and the expected error in ten bins."""
    rows, error = [], 0.0
    for low in np.arange(0.0, 1.0, 0.1):
        mine = (held >= low) & (held < low + 0.1 + 1e-9 * (low > 0.85))
        if mine.any():
            gap = abs(held[mine].mean() - table.right[mine].mean())
            error += gap * mine.mean()
            rows.append((f"{low:.1f}", str(mine.sum()), f"{held[mine].mean():.2f}", f"{table.right[mine].mean():.2f}"))
    print_table(f"held out; expected error {error:.3f}", ("confidence from", "hits", "mean", "right"), rows)
    is_simulated = _is_simulated(table.source)
    rows = []
    for name in np.unique(table.template):
        row = [str(name)]
        for these in (~is_simulated, is_simulated):
            mine = these & (table.template == name)
            sure = mine & (held >= CONFIDENT)
            row += [str(mine.sum()), str(table.right[mine].sum()), str(sure.sum()), str((sure & table.right).sum())]
        rows.append(row)
    columns = [
        f"{what}, {origin}"
        for origin in ("recorded", "simulated")
        for what in ("hits", "right", "sure", "sure and right")
    ]
    print_table("by template, each held out", ("template", *columns), rows)


def _is_simulated(source: np.ndarray) -> Bool[np.ndarray, "N"]:
    return np.array([name.rsplit("/")[-1].isdigit() or name.startswith("sim") for name in source])


if __name__ == "__main__":
    main()
