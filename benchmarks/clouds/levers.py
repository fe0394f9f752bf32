"""Ball valves with flat levers on pipes: found, sure and right, by state, pipe, body and sensor.

Every draw takes new sizes: pipes of 2 to 6 cm radius, levers of 10 to 25 cm, at 0.6 to 1.3 m; open (the lever along its
pipe), shut (across) and half open, on level and upright pipes, with flanges and with screwed ends.  A hit is right if
its pivot is within 3 cm, its axis within 8 degrees, its direction within 15 degrees and its length within 2 cm.

From the checkout's root: ``python -m benchmarks.clouds.levers [--seeds 0 1] [--variant V] [--only NAME]``.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence

import numpy as np

from benchmarks.clouds.cases import variant_turns
from benchmarks.clouds.errors import axis, distance, matched, size
from benchmarks.tables import print_table
from perception import CONFIDENT, detect, make_view
from perception.simulate.scenes.scene import (
    PlacedObjects,
    SimulatedScene,
    Truth,
    assemble,
    cartons,
    floor,
    frame,
    generator,
    upright_pipe,
    wall,
)
from perception.simulate.scenes.valves import tilt_axis, valve_body
from perception.solids.primitives import Mesh, box, cylinder, lathe

STATES = {"open": (0.0, 12.0), "half": (30.0, 60.0), "shut": (78.0, 90.0)}  # angles between lever and pipe [deg]
PIPES = {"level": (0.0, 1.0, 0.0), "upright": (0.0, 0.0, 1.0)}
BODIES = ("flanged", "screwed")
NAMES = tuple("_".join(parts) for parts in itertools.product(STATES, PIPES, BODIES))
_RIGHT = (30.0, 8.0, 15.0, 20.0)  # pivot [mm], axis [deg], direction [deg], length [mm]


def make_lever_scene(name: str, seed: int) -> SimulatedScene:
    """Return a ball valve of a kind in :data:`NAMES` before a wall, with a second pipe and cartons."""
    state, pipe, body = name.split("_")
    rng = generator(name, seed)
    pivot = np.array([rng.uniform(0.6, 1.3), rng.uniform(-0.3, 0.3), rng.uniform(0.8, 1.4)])
    radius = rng.uniform(0.02, 0.06)
    reach = 1.7 if body == "flanged" else 1.4
    above = reach * radius + rng.uniform(0.015, 0.035)
    upward = rng.uniform(-5.0, 35.0) if pipe == "level" else rng.uniform(-4.0, 4.0)
    normal = np.array(tilt_axis(rng.uniform(-20.0, 20.0), upward))
    along = np.array(PIPES[pipe]) - (np.array(PIPES[pipe]) @ normal) * normal
    along /= np.linalg.norm(along)
    turn = np.radians(rng.uniform(*STATES[state])) * rng.choice([-1.0, 1.0])
    way = rng.choice([-1.0, 1.0]) * (np.cos(turn) * along + np.sin(turn) * np.cross(normal, along))
    pose = frame((float(pivot[0]), float(pivot[1]), float(pivot[2])), way.tolist(), normal.tolist())
    length, half, thick = rng.uniform(0.1, 0.25), rng.uniform(0.009, 0.016), rng.uniform(0.0015, 0.004)
    plate = box((-1.5 * half, -half, -thick), (length, half, thick)).place(pose)
    foot = pivot - above * normal
    stem = cylinder(foot.tolist(), (pivot + (thick + 0.006) * normal).tolist(), 0.3 * radius + 0.004, 24)
    fitting = valve_body(foot, normal, PIPES[pipe], radius, 0.9) if body == "flanged" else _screwed(foot, along, radius)
    truth = Truth("valve", pose, {"lever_length": length, "lever_radius": half})
    alike = (("lever", pose[:3, 3]), ("lever", (pose @ [0.5 * length, 0.0, 0.0, 1.0])[:3]))
    face = float(pivot[0]) + above + radius + rng.uniform(0.12, 0.6)
    parts = [
        PlacedObjects((plate, stem, *fitting), (truth,), alike),
        wall(face),
        upright_pipe(face - 0.1, float(pivot[1]) + rng.choice([-1.0, 1.0]) * rng.uniform(0.4, 0.8), 0.05),
        *cartons(rng, 1, (0.9, -1.1), 0.2),
    ]
    return assemble(name, seed, [floor(), *parts], tuple(pivot.tolist()))


def _screwed(place: np.ndarray, along: np.ndarray, radius: float) -> tuple[Mesh, ...]:
    """Return a six-sided body on a pipe with screwed ends."""
    half = 1.8 * radius
    outline = [(radius, -half), (1.4 * radius, -0.8 * half), (1.4 * radius, 0.8 * half), (radius, half)]
    end = 0.9 * along
    return (
        lathe(outline, place.tolist(), along.tolist(), 6),
        cylinder((place - end).tolist(), (place + end).tolist(), radius),
    )


def lever_scans(seeds: Sequence[int], variants: Sequence[str]) -> Iterator[tuple[str, str, SimulatedScene]]:
    """Yield name, sensor and scene; sensors joined by a slash take turns."""
    for seed in seeds:
        for i, name in enumerate(NAMES):
            for turns in variants:
                sensors = turns.split("/")
                yield name, sensors[(i + seed) % len(sensors)], make_lever_scene(name, seed)


def main(arguments: Sequence[str] | None = None) -> None:
    """Search all scans and print a line for each and the counts."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, nargs="+", default=(0, 1))
    parser.add_argument("--variant", type=variant_turns, action="append", help="sensors; a/b: in turn")
    parser.add_argument("--only", default="", help="only scenes whose name holds this")
    chosen = parser.parse_args(arguments)
    variants = chosen.variant or ("dense/solid/camera", "sparse/solid_sparse")
    counts: dict[str, list[int]] = defaultdict(lambda: [0, 0, 0, 0])
    lines, spent = [], []
    for name, sensor, scene in lever_scans(chosen.seeds, variants):
        if chosen.only not in name:
            continue
        view = make_view(scene.scan(sensor))
        clock = time.process_time()
        hits = detect("valve", view)
        spent.append(time.process_time() - clock)
        outcome = matched("valve", hits, scene.truth, ())
        truth, hit = outcome.pairs[0]
        of = (distance, axis(2, signed=True), axis(0, signed=True), size("lever_length"))
        errors = [] if hit is None else [measure(hit, truth) for measure in of]
        is_sure = hit is not None and hit.confidence >= CONFIDENT
        is_right = is_sure and all(
            value is not None and value <= most for value, most in zip(errors, _RIGHT, strict=True)
        )
        row = [1, int(is_sure), int(is_right), len(outcome.false)]
        density = "sparse" if "sparse" in sensor else "dense"
        for group in ("all", density, *name.split("_")):
            counts[group] = [a + b for a, b in zip(counts[group], row, strict=True)]
        texts = ["-" if value is None else f"{value:.1f}" for value in errors] or ["-"] * len(of)
        lines.append((name, str(scene.seed), sensor, "-" if hit is None else f"{hit.confidence:.2f}", *texts))
        print(*lines[-1], "right" if is_right else "", "FALSE" * len(outcome.false), file=sys.stderr, flush=True)
    header = ("scan", "seed", "sensor", "confidence", "pivot mm", "axis deg", "along deg", "length mm")
    print_table("ball valves with flat levers", header, lines)
    rows = [(group, *map(str, row)) for group, row in counts.items()]
    print_table("confident hits", ("scans of", "valves", "found", "right", "of nothing"), rows)
    print(f"CPU per scan: {np.mean(spent):.2f} s")


if __name__ == "__main__":
    main()
