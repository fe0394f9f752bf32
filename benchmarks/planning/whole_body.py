"""Atlas among 60 and 120 boxes close to it: how many palm goals that can be reached are certified, and at what cost.

``python -m benchmarks.planning.whole_body [--scenes N] [--boxes 60 120] [--goals position pose] [--seed S] [--each]``

Processor time is of one call of the planner, from the request in memory to the verdict, certificate included.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import islice

import numpy as np

from benchmarks.planning.crowded_scenes import CrowdedScene, crowded_scenes
from benchmarks.tables import print_table
from costs.robot import RobotModel, load_robot
from service.explain.conflict import DemandKind
from service.planner import plan
from service.result.result import PlanResult, Verdict

N_SCENES = 40
LEAST_CERTIFIED = {60: 0.95, 120: 0.85}  # targets by number of boxes
MEDIAN_TARGET_S, P95_TARGET_S = 0.3, 1.5
GOALS = {"position": False, "pose": True}
COLUMNS = (
    "boxes", "goal", "scenes", "straight line", "certified", "CPU median [s]", "CPU p95 [s]", "generation [s]",
)  # fmt: skip


@dataclass(frozen=True)
class Run:
    """One scene planned: processor seconds in all and by step of the planner."""

    scene: CrowdedScene
    result: PlanResult
    cpu_s: float
    cpu_of_step: dict[str, float]

    @property
    def is_certified(self) -> bool:
        return self.result.verdict is Verdict.CERTIFIED

    @property
    def reason(self) -> str:
        """Verdict, and the step or check that caused it."""
        if self.is_certified:
            return self.result.verdict.value
        verdict, conflict = self.result.verdict.value, self.result.conflict
        if conflict is None:  # what a check of the certificate says
            return f"{verdict}, {next(iter(self.result.explanation), '')}"
        kinds = {
            demand.name if demand.kind is DemandKind.CONSTRAINT else demand.kind.value for demand in conflict.demands
        }
        return f"{verdict}, {conflict.step}: {', '.join(sorted(kinds))}"


@dataclass
class Clock:
    """Processor time by step, from the planner's progress reports."""

    step: str = "set-up"
    since: float = field(default_factory=time.process_time)
    cpu: dict[str, float] = field(default_factory=dict)

    def __call__(self, step: str, fraction: float) -> None:
        now = time.process_time()
        self.cpu[self.step] = self.cpu.get(self.step, 0.0) + now - self.since
        self.step, self.since = step, now


def run(scene: CrowdedScene, robot: RobotModel) -> Run:
    """Plan one scene."""
    clock = Clock()
    started = time.process_time()
    result = plan(scene.request, clock, robot=robot)
    cpu_s = time.process_time() - started
    clock("end", 1.0)
    return Run(scene, result, cpu_s, clock.cpu)


def summary(boxes: int, goal: str, runs: Sequence[Run], generation_s: float) -> tuple[str, ...]:
    """Return one row of the table."""
    cpu = [run.cpu_s for run in runs]
    certified = sum(run.is_certified for run in runs)
    return (
        str(boxes),
        goal,
        str(len(runs)),
        str(sum(run.scene.is_straight_enough for run in runs)),
        f"{certified} ({100.0 * certified / len(runs):.0f} %, target {100.0 * LEAST_CERTIFIED.get(boxes, 0.0):.0f})",
        f"{statistics.median(cpu):.2f}",
        f"{np.percentile(cpu, 95):.2f}",
        f"{generation_s:.0f}",
    )


def steps(runs: Sequence[Run]) -> str:
    """Return the mean processor time of each step [ms]."""
    names = dict.fromkeys(step for run in runs for step in run.cpu_of_step)
    mean = {step: 1e3 * sum(run.cpu_of_step.get(step, 0.0) for run in runs) / len(runs) for step in names}
    return ", ".join(f"{step} {milliseconds:.0f}" for step, milliseconds in mean.items() if milliseconds >= 1.0)


def failures(runs: Iterable[Run]) -> str:
    """Return the reasons of runs without a certificate, the most common first."""
    reasons = Counter(run.reason for run in runs if not run.is_certified)
    return "; ".join(f"{count} {reason}" for reason, count in reasons.most_common()) or "none"


def main() -> None:
    """Print a table, and below it steps and failures of every setting."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=N_SCENES)
    parser.add_argument("--boxes", type=int, nargs="+", default=list(LEAST_CERTIFIED))
    parser.add_argument("--goals", nargs="+", default=list(GOALS), choices=list(GOALS))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--each", action="store_true", help="a line for every scene")
    given = parser.parse_args()
    robot = load_robot("atlas")
    rows, below = [], []
    for boxes in given.boxes:
        for goal in given.goals:
            began = time.process_time()
            scenes = list(islice(crowded_scenes(robot, boxes, is_pose=GOALS[goal], seed=given.seed), given.scenes))
            generation_s = time.process_time() - began
            runs = []
            for scene in scenes:
                runs.append(run(scene, robot))
                if given.each:
                    print(f"{scene.name} {goal}: {runs[-1].cpu_s:.2f} s {runs[-1].reason}", flush=True)
            rows.append(summary(boxes, goal, runs, generation_s))
            below.append(f"  {boxes} {goal}: steps [mean ms]: {steps(runs)}\n    failures: {failures(runs)}")
    print_table(
        f"Whole-body reaches among boxes; targets: median {MEDIAN_TARGET_S:g} s, p95 {P95_TARGET_S:g} s", COLUMNS, rows
    )
    print("\n".join(below))


if __name__ == "__main__":
    main()
