"""Task files on drawn scenes: certified or not, why not, done in physics or not, at what cost.

``python -m benchmarks.tasks.objects [--count N] [--seed S] [--robots gantry atlas] [--files plug ...] [--perturb P]``

The gantry takes objects alone; parts that are pushed and faces that are followed are for Atlas.
"""

from __future__ import annotations

import argparse
import tempfile
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.attack.gantry_files import write_gantry
from benchmarks.tables import print_table
from benchmarks.tasks.drawn import COLUMNS, carry_out_draws
from benchmarks.tasks.object_cases import ATLAS, CASES, make_gantry_place
from benchmarks.tasks.part_cases import PART_CASES
from service.request.file import parse_request


def main() -> None:
    """Plan every draw, carry out what is certified, and print a row per robot and task file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--robots", nargs="+", choices=("gantry", "atlas"), default=("gantry", "atlas"))
    parser.add_argument("--files", nargs="+", choices=(*CASES, *PART_CASES), default=(*CASES, *PART_CASES))
    parser.add_argument("--perturb", type=float, default=0.0)
    given = parser.parse_args()
    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        urdf = str(write_gantry(Path(scratch)))
        for robot in given.robots:
            place = make_gantry_place(urdf) if robot == "gantry" else ATLAS
            makers = {name: partial(make, place) for name, make in CASES.items()}
            makers |= PART_CASES if robot == "atlas" else {}
            for index, (name, make) in enumerate(makers.items()):
                if name not in given.files:
                    continue
                seeds = range(given.seed, given.seed + given.count)
                draws = ((n, parse_request(make(np.random.default_rng([n, index])))) for n in seeds)
                rows.append([robot, name, *carry_out_draws(name, draws, given.perturb)])
    print_table("Task files", ["robot", "file", *COLUMNS], rows)


if __name__ == "__main__":
    main()
