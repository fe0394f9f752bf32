"""Task files that take objects, on drawn scenes: certified or not, why not, done in physics or not, at what cost.

``python -m benchmarks.tasks.objects [--count N] [--seed S] [--robots gantry atlas] [--files plug ...] [--perturb P]``
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.attack.gantry_files import write_gantry
from benchmarks.tables import print_table
from benchmarks.tasks.object_cases import ATLAS, CASES, Place, make_gantry_place
from service.errors import RequestError
from service.planner import plan
from service.request.file import parse_request
from service.result.result import Verdict
from service.simulation.options import SimulationOptions
from service.simulation.run import execute_motion
from service.simulation.verdict import judge


def main() -> None:
    """Plan every draw, carry out what is certified, and print a row per robot and task file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--robots", nargs="+", choices=("gantry", "atlas"), default=("gantry", "atlas"))
    parser.add_argument("--files", nargs="+", choices=tuple(CASES), default=tuple(CASES))
    parser.add_argument("--perturb", type=float, default=0.0)
    given = parser.parse_args()
    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        urdf = str(write_gantry(Path(scratch)))
        for robot in given.robots:
            place = make_gantry_place(urdf) if robot == "gantry" else ATLAS
            for name in given.files:
                rows.append([robot, name, *_run(place, name, given.seed, given.count, given.perturb)])
    print_table("Task files", ["robot", "file", "certified", "done", "median CPU [s]", "longest [s]"], rows)


def _run(place: Place, name: str, seed: int, count: int, perturb: float) -> list[str]:
    """Return the cells of a row."""
    times, certified, done = [], 0, 0
    for number in range(seed, seed + count):
        request = parse_request(CASES[name](place, np.random.default_rng([number, list(CASES).index(name)])))
        started = time.process_time()
        try:
            result = plan(request)
        except RequestError as error:  # the draw has the robot inside its furniture
            print(f"{name} {number}: no start: {error}", flush=True)
            continue
        times.append(time.process_time() - started)
        text = f"{name} {number}: {result.verdict.value} in {times[-1]:.1f} s"
        if result.verdict is Verdict.CERTIFIED and result.motion is not None:
            certified += 1
            options = SimulationOptions(perturb=perturb, seed=number)
            runs = execute_motion(result.motion, request, result.verdict.value, "", options)
            verdicts = [judge(run.reference, run.record, run.model.physics) for run in runs]
            done += all(verdict.verdict == "DONE" for verdict in verdicts)
            text += "".join(f", {verdict.verdict} {'; '.join(verdict.reasons)[:160]}" for verdict in verdicts)
        else:
            text += f": {' '.join(result.explanation)[:300]}"
        print(text, flush=True)
    cost = [f"{statistics.median(times):.1f}", f"{max(times):.1f}"] if times else ["-", "-"]
    return [f"{certified} of {len(times)}", f"{done} of {len(times)}", *cost]


if __name__ == "__main__":
    main()
