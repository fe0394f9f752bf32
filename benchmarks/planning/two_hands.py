"""Atlas with both hands among boxes: goals for both palms, a grip kept, a beam carried; certified or not, at what cost.

``python -m benchmarks.planning.two_hands [--scenes N] [--boxes 30 60] [--tasks places poses grip beam] [--seed S]
[--each]``

Every scene has a solution.  Processor time is of one call of the planner, from the request in memory to the verdict,
certificate included.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Sequence
from itertools import islice

import numpy as np

from benchmarks.planning.two_handed_scenes import TASKS, Task, two_handed_scenes
from benchmarks.planning.whole_body import Run, failures, run, steps
from benchmarks.tables import print_table
from costs.robot import load_robot

N_SCENES = 20
BOXES = (30, 60)
COLUMNS = (
    "task", "boxes", "scenes", "straight line", "certified", "CPU median [s]", "CPU p95 [s]", "generation [s]",
)  # fmt: skip


def summary(task: Task, boxes: int, runs: Sequence[Run], generation_s: float) -> tuple[str, ...]:
    """Return one row of the table."""
    cpu = [run.cpu_s for run in runs]
    certified = sum(run.is_certified for run in runs)
    return (
        task,
        str(boxes),
        str(len(runs)),
        str(sum(run.scene.is_straight_enough for run in runs)),
        f"{certified} ({100.0 * certified / len(runs):.0f} %)",
        f"{statistics.median(cpu):.2f}",
        f"{np.percentile(cpu, 95):.2f}",
        f"{generation_s:.0f}",
    )


def main() -> None:
    """Print a table, and below it steps and failures of every setting."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=N_SCENES)
    parser.add_argument("--boxes", type=int, nargs="+", default=list(BOXES))
    parser.add_argument("--tasks", nargs="+", default=list(TASKS), choices=TASKS)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--each", action="store_true", help="a line for every scene")
    given = parser.parse_args()
    robot = load_robot("atlas")
    rows, below = [], []
    for task in given.tasks:
        for boxes in given.boxes:
            began = time.process_time()
            scenes = list(islice(two_handed_scenes(robot, boxes, task, given.seed), given.scenes))
            generation_s = time.process_time() - began
            runs = []
            for scene in scenes:
                runs.append(run(scene, robot))
                if given.each:
                    print(f"{scene.name}: {runs[-1].cpu_s:.2f} s {runs[-1].reason}", flush=True)
            rows.append(summary(task, boxes, runs, generation_s))
            below.append(f"  {task} {boxes}: steps [mean ms]: {steps(runs)}\n    failures: {failures(runs)}")
    print_table("Atlas with both hands among boxes", COLUMNS, rows)
    print("\n".join(below))


if __name__ == "__main__":
    main()
