"""Duration of the time laws relative to the fastest ones.

``python -m benchmarks.planning.timing [--count N] [--seed S]``.

Curves of plans through random waypoints, 1 to 6 joints.  The reference is a linear program on a fine grid
(:mod:`benchmarks.planning.timing_reference`); a ratio of 1.02 means that a law takes 2 % longer.
Processor time is of one law.
"""

from __future__ import annotations

import argparse
import time
from itertools import islice

import numpy as np

from benchmarks.planning.timing_reference import chain, fastest_duration, spline_through, timing_problems
from benchmarks.tables import print_table
from service.motion.timing import time_curve
from service.verify import measure_timed_peaks

N_PROBLEMS = 60
MEAN_TARGET, MOST_TARGET = 1.03, 1.08
COLUMNS = ("curves", "number", "mean", "p95", "most", "speed used", "acceleration used", "CPU [ms]")


def main(count: int, seed: int) -> int:
    """Print the table; return 1 if a target is missed."""
    rows: dict[str, list[tuple[float, ...]]] = {}
    for problem in islice(timing_problems(seed), count):
        robot, curve = problem.robot, problem.curve
        reference = fastest_duration(curve, robot.velocity, robot.acceleration)
        began = time.process_time()
        law = time_curve(robot, curve)
        cpu_s = time.process_time() - began
        peaks = measure_timed_peaks(curve, law)
        used = (float((peaks.speed / robot.velocity).max()), float((peaks.acceleration / robot.acceleration).max()))
        rows.setdefault(problem.kind, []).append((float(law.times[-1]) / reference, *used, 1e3 * cpu_s))
    rows["all"] = [row for kind in rows.values() for row in kind]
    table = []
    for kind, figures in rows.items():
        ratio, speed, acceleration, cpu = np.array(figures).T
        shown = (ratio.mean(), np.percentile(ratio, 95), ratio.max(), speed.mean(), acceleration.mean())
        table.append((kind, str(len(figures)), *(f"{value:.3f}" for value in shown), f"{np.median(cpu):.1f}"))
    table.append(("target", "", f"{MEAN_TARGET}", "", f"{MOST_TARGET}", "", "", ""))
    print_table("Duration of time laws over that of the fastest", COLUMNS, table)
    _print_one_joint()
    ratio = np.array(rows["all"])[:, 0]
    return int(ratio.mean() > MEAN_TARGET or ratio.max() > MOST_TARGET)


def _print_one_joint() -> None:
    """Print the case of one joint over 2 rad at 0.5 rad/s and 3 rad/s^2: 4.17 s from rest to rest."""
    robot = chain(np.array([0.5]), np.array([3.0]))
    rows = []
    for n_waypoints in (2, 3, 5, 8, 12, 20):
        curve = spline_through(robot, np.linspace(0.0, 2.0, n_waypoints)[:, None])
        rows.append((str(n_waypoints), f"{time_curve(robot, curve).times[-1]:.3f}"))
    print_table(f"2 rad at 0.5 rad/s and 3 rad/s^2 ({4.0 + 0.5 / 3.0:.3f} s)", ("waypoints", "duration [s]"), rows)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=N_PROBLEMS)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    raise SystemExit(main(given.count, given.seed))
