"""Are objects found that a user gives by parameters or as a mesh?  Share, errors, and hits where they are not.

Objects made of parameters hang or lie in rooms with pipes, cartons and shelves, and are searched for in the whole scan
by the code that finds meshes.  Every object is also searched for in scans without it.

With ``--mixed`` the scenes hold four objects each (``benchmarks/clouds/given_mixed.py``), others are searched for as
well, and a table shows how many hits of each confidence are right.

From the checkout's root: ``python -m benchmarks.clouds.given [--seeds 0 1 2] [--variant V] [--only NAME] [--hint]
[--absent] [--mixed] [--record FILE]``.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from benchmarks.clouds.absent import ABSENT
from benchmarks.clouds.given_mixed import compare_surfaces, make_mixed, make_searched
from benchmarks.clouds.others import make_other
from benchmarks.tables import print_table
from perception import CONFIDENT, View, make_view
from perception.simulate.scenes import SimulatedScene
from perception.simulate.scenes.loose import shelf, table
from perception.simulate.scenes.scene import (
    PlacedObjects,
    assemble,
    cartons,
    floor,
    frame,
    generator,
    make_room,
    pose_of,
    things,
    upright_pipe,
)
from perception.simulate.scenes.valves import tilt_axis
from perception.solids.match import find_matches
from perception.solids.mesh import Mesh
from perception.solids.primitives import box, cylinder
from perception.solids.shapes import make_box, make_cylinder, make_lever, make_wheel, unite_meshes

_HINT_SIGMA = 0.05  # [m] how well an operator clicks
_RIGHT_MM, _RIGHT_DEG = 30.0, 8.0
_BORDERS = (0.0, 0.25, 0.5, 0.7, 0.9, 1.01)  # of the confidences
Record = dict[str, Any]


@dataclass(frozen=True)
class Given:
    """Object that a user describes.

    Attributes:
        parts: meshes in its own frame [m].
        axis: column of its rotation that is compared with the truth.
        is_signed: whether a half turn of that axis is an error.
        hangs: whether it is mounted on a post before a wall; else it lies on a table.
    """

    parts: tuple[Mesh, ...]
    axis: int
    is_signed: bool
    hangs: bool


_BRACKET = (
    box((-0.15, -0.1, 0.0), (0.15, 0.1, 0.02)),
    box((-0.15, -0.1, 0.0), (-0.13, 0.1, 0.22)),
    cylinder((0.08, 0.04, 0.0), (0.08, 0.04, 0.12), 0.03),
)
OBJECTS: Mapping[str, Given] = {
    "wheel_15": Given(tuple(make_wheel(0.15, 0.012, 5)), 2, False, True),
    "wheel_32": Given(tuple(make_wheel(0.32, 0.016, 6)), 2, False, True),
    "ring_20": Given(tuple(make_wheel(0.2, 0.02, 0)), 2, False, True),
    "crank_22": Given(tuple(make_lever(0.22, 0.012, 0.1)), 0, True, True),
    "bracket": Given(_BRACKET, 2, True, False),
    "tank": Given(tuple(make_cylinder(0.12, 0.4)), 2, False, False),
    "case": Given(tuple(make_box((0.4, 0.24, 0.14))), 0, False, False),
}


def make_given(name: str, seed: int) -> tuple[SimulatedScene, Float[np.ndarray, "4 4"]]:
    """Return a scene with one of :data:`OBJECTS` and the object's pose."""
    given, rng = OBJECTS[name], generator(name, seed)
    x, y = rng.uniform(0.8, 1.1), rng.uniform(-0.3, 0.3)
    parts: list[PlacedObjects] = [floor(), make_room(1.75, -2.2, 2.2), upright_pipe(1.5, y + 0.8, 0.05)]
    parts += cartons(rng, 2, (1.1, -1.1), 0.25)
    if given.hangs:
        axis = np.array(tilt_axis(rng.uniform(-40.0, 40.0), rng.uniform(-10.0, 60.0)))
        pose = frame((x, y, rng.uniform(0.9, 1.3)), rng.normal(size=3).tolist(), axis.tolist())
        back = pose[:3, 3] - 0.25 * axis
        post = cylinder((pose[:3, 3] - 0.02 * axis).tolist(), back.tolist(), 0.02)
        parts += [things(post, cylinder((back[0], back[1], 0.0), (back[0], back[1], 2.0), 0.035))]
        parts += [shelf((1.4, -1.5, 0.0), 0.9, 0.3, (0.4, 0.9, 1.4), 1.8)]
    else:
        pose = pose_of((x, y, 0.0), yaw=rng.uniform(-np.pi, np.pi))
        if name == "tank" and seed % 2:  # it lies
            pose = frame((x, y, 0.0), (0.0, 0.0, 1.0), (np.cos(rng.uniform(0.0, 3.0)), 1.0, 0.0))
        lowest = min(float((mesh.vertices @ pose[2, :3]).min()) for mesh in given.parts)
        pose[2, 3] = 0.8 - lowest
        can = cylinder((x - 0.05, y + 0.45, 0.8), (x - 0.05, y + 0.45, 1.0), 0.05)
        parts += [table((x - 0.4, y - 0.7, 0.0), 0.9, 1.4, 0.8), things(can)]
    parts.append(things(*(mesh.place(pose) for mesh in given.parts)))
    return assemble(f"given_{name}", seed, parts, pose[:3, 3]), pose


def main(arguments: Sequence[str] | None = None) -> None:
    """Search all scans and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, nargs="+", default=(0, 1, 2))
    parser.add_argument("--variant", action="append", help="sensor; may be repeated")
    parser.add_argument("--only", default="", help="only objects whose name holds one of these, separated by commas")
    parser.add_argument("--hint", action="store_true", help="give a place near each object, as an operator would")
    parser.add_argument("--absent", action="store_true", help="only the scans without the objects")
    parser.add_argument("--mixed", action="store_true", help="scenes with several objects, some of them alike")
    parser.add_argument("--record", type=Path, help="append one JSON line per search")
    chosen = parser.parse_args(arguments)
    names = [name for name in OBJECTS if any(part in name for part in chosen.only.split(","))]
    records = []
    for record in _search_mixed(chosen) if chosen.mixed else _search_all(names, chosen):
        records.append(record)
        print(record["object"], record["scan"], record["confidence"], file=sys.stderr)
        if chosen.record is not None:
            with chosen.record.open("a") as file:
                file.write(json.dumps(record) + "\n")
    if chosen.mixed:
        print_reliability(records)
    else:
        print_records(records)


def _search_mixed(chosen: argparse.Namespace) -> Iterator[Record]:
    for seed in chosen.seeds:
        mixed = make_mixed(seed)
        for variant in chosen.variant or ("dense", "solid", "camera", "sparse"):
            view = make_view(mixed.scene.scan(variant))
            for name in (*mixed.poses, *mixed.absent):
                solid, truth = make_searched(name), mixed.poses.get(name)
                clock = time.process_time()
                matches = find_matches(solid, view)
                record: Record = {"object": name, "scan": f"{seed}:{variant}", "is_there": truth is not None}
                record["cpu"] = round(time.process_time() - clock, 2)
                record["confidence"] = round(matches[0].confidence, 3) if matches else 0.0
                record["n_sure"] = sum(match.confidence >= CONFIDENT for match in matches)
                if truth is not None and matches:
                    record["mm"] = round(1e3 * compare_surfaces(solid, matches[0].pose_world_mesh, truth), 1)
                if matches:
                    record["residuals"] = {key: round(float(x), 4) for key, x in matches[0].residuals.items()}
                yield record


def print_reliability(records: Sequence[Record]) -> None:
    """Print how many hits of each confidence are right, and how many objects are found, by sensor."""
    rows = []
    for low, high in pairwise(_BORDERS):
        mine = [record for record in records if low <= record["confidence"] < high]
        right = [record for record in mine if record.get("mm", np.inf) <= _RIGHT_MM]
        absent = sum(not record["is_there"] for record in mine)
        rows.append((f"{low:.2f} to {min(high, 1.0):.2f}", str(len(mine)), str(len(right)), str(absent)))
    print_table("hits by confidence", ("confidence", "searches", "right", "object absent"), rows)
    rows = []
    for sensor in dict.fromkeys(_label(record)[1] for record in records):
        mine = [record for record in records if _label(record)[1] == sensor]
        there = [record for record in mine if record["is_there"]]
        sure = [record for record in mine if record["confidence"] >= CONFIDENT]
        right = [record for record in sure if record.get("mm", np.inf) <= _RIGHT_MM]
        cpu = f"{np.median([record['cpu'] for record in mine]):.1f}"
        rows.append((sensor, f"{len(right)} / {len(there)}", str(len(sure) - len(right)), cpu))
    print_table("objects found", ("sensor", "found", "wrong", "CPU s"), rows)


def _search_all(names: Sequence[str], chosen: argparse.Namespace) -> Iterator[Record]:
    rng = np.random.default_rng(0)
    for variant in chosen.variant or ("dense", "solid", "camera", "sparse"):
        for seed in chosen.seeds:
            for name in () if chosen.absent else names:
                scene, pose = make_given(name, seed)
                hint = pose[:3, 3] + rng.normal(0.0, _HINT_SIGMA, 3) if chosen.hint else None
                yield _search(name, f"{seed}:{variant}", make_view(scene.scan(variant)), hint, pose)
    for absent in () if chosen.hint else ABSENT:
        view = make_view(make_other(absent, 0).scan("dense"))
        for name in names:
            yield _search(name, absent, view, None, None)


def _search(
    name: str,
    scan: str,
    view: View,
    hint: Float[np.ndarray, "3"] | None,
    pose: Float[np.ndarray, "4 4"] | None,
) -> Record:
    """Return what a search finds; of an object that is there, the errors of the surest hit."""
    given = OBJECTS[name]
    clock = time.process_time()
    matches = find_matches(unite_meshes(given.parts, name), view, hint)
    record: Record = {"object": name, "scan": scan, "cpu": round(time.process_time() - clock, 2)}
    record["confidence"] = round(matches[0].confidence, 3) if matches else 0.0
    record["n_sure"] = sum(match.confidence >= CONFIDENT for match in matches)
    if pose is not None and matches:
        found = matches[0].pose_world_mesh
        cosine = float(found[:3, given.axis] @ pose[:3, given.axis])
        cosine = cosine if given.is_signed else abs(cosine)
        record["mm"] = round(1e3 * float(np.linalg.norm(found[:3, 3] - pose[:3, 3])), 1)
        record["deg"] = round(float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))), 2)
    if matches:
        record["residuals"] = {key: round(float(value), 4) for key, value in matches[0].residuals.items()}
    record["is_there"] = pose is not None
    return record


def print_records(records: Sequence[Record]) -> None:
    """Print, by object and sensor, what was found, the errors, wrong hits, and hits of nothing."""
    rows = []
    there = [record for record in records if record["is_there"]]
    for label, key in (("object", 0), ("sensor", 1)):
        for name in dict.fromkeys(_label(record)[key] for record in there):
            rows.append((label, name, *_count([record for record in there if _label(record)[key] == name])))
    header = ("by", "", "found", "wrong", "mm: median", "worst", "deg: median", "worst", "CPU s")
    if rows:
        print_table("objects that are there, confident hits", header, rows)
    rows = []
    for name in dict.fromkeys(record["object"] for record in records):
        mine = [record for record in records if record["object"] == name and not record["is_there"]]
        if mine:
            sure = [record for record in mine if record["confidence"] >= CONFIDENT]
            where = " ".join(record["scan"] for record in sure)
            cpu = np.median([record["cpu"] for record in mine])
            best = max(record["confidence"] for record in mine)
            rows.append((name, str(len(mine)), str(len(sure)), f"{best:.2f}", f"{cpu:.1f}", where))
    if rows:
        print_table("scans without them", ("object", "scans", "hits", "surest", "CPU s", "where"), rows)


def _label(record: Record) -> tuple[str, str]:
    return record["object"], record["scan"].split(":")[1]


def _count(mine: Sequence[Record]) -> tuple[str, ...]:
    sure = [record for record in mine if record["confidence"] >= CONFIDENT]
    right = [record for record in sure if record["mm"] <= _RIGHT_MM and record["deg"] <= _RIGHT_DEG]
    cpu = f"{np.median([record['cpu'] for record in mine]):.1f}"
    if not right:
        return (f"0 / {len(mine)}", str(len(sure)), "-", "-", "-", "-", cpu)
    mm, deg = ([record[key] for record in right] for key in ("mm", "deg"))
    return (
        f"{len(right)} / {len(mine)}",
        str(len(sure) - len(right)),
        *(f"{np.median(mm):.1f}", f"{max(mm):.1f}", f"{np.median(deg):.2f}", f"{max(deg):.2f}", cpu),
    )


if __name__ == "__main__":
    main()
