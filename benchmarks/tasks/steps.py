"""Steps over stones, up a stair with a handrail, and out of a chair: certified or not, why not, at what cost.

``python -m benchmarks.tasks.steps [--count N] [--seed S] [--kinds stones stair chair] [--out FOLDER]``
"""

from __future__ import annotations

import argparse
import statistics
import time
from pathlib import Path

import yaml

from benchmarks.tables import print_table
from benchmarks.tasks.step_cases import list_cases
from costs.robot import load_robot
from service.planner import plan
from service.request.file import parse_request
from service.result.result import Verdict


def main() -> None:
    """Plan every case and print a row per kind."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kinds", nargs="+")
    parser.add_argument("--out", type=Path, help="folder for the requests that are not certified")
    given = parser.parse_args()
    robot = load_robot("atlas")
    rows = []
    for kind, make in list_cases(robot).items():
        if given.kinds and kind not in given.kinds:
            continue
        times, certified = [], 0
        for seed in range(given.seed, given.seed + given.count):
            try:
                data = make(seed)
            except ValueError as error:
                print(f"{kind} {seed}: no start: {error}", flush=True)
                continue
            started = time.process_time()
            result = plan(parse_request(data))
            times.append(time.process_time() - started)
            certified += result.verdict is Verdict.CERTIFIED
            why = "" if result.verdict is Verdict.CERTIFIED else f": {' '.join(result.explanation)[:200]}"
            print(f"{kind} {seed}: {result.verdict.value} in {times[-1]:.1f} s{why}", flush=True)
            if why and given.out is not None:
                given.out.mkdir(parents=True, exist_ok=True)
                (given.out / f"{kind}_{seed}.yaml").write_text(yaml.safe_dump(data))
        rows.append([kind, f"{certified} of {len(times)}", f"{statistics.median(times):.1f}", f"{max(times):.1f}"])
    print_table("Steps", ["kind", "certified", "median CPU [s]", "longest [s]"], rows)


if __name__ == "__main__":
    main()
