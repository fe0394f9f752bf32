"""Largest step of a joint's acceleration between two set points, without and with a jerk limit.

``python -m benchmarks.planning.acceleration_steps [NAME ...]``.  Names are files of ``examples/requests``.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.tables import print_table
from costs.curve import Curve, TimeLaw
from service.planner import plan
from service.request.file import load_request

REQUESTS = Path(__file__).parents[2] / "examples" / "requests"
NAMES = ("joint_goal", "pose_goal", "drawer", "door", "valve")
PERIOD_S = 0.01  # of the set points
HEADER = ("plan", "jerk_scale", "verdict", "takes [s]", "largest step [rad/s2]", "allowed [rad/s2]")


def measure_steps(curve: Curve, law: TimeLaw) -> np.ndarray:
    """Return each joint's largest step of acceleration between set points, from positions alone (n,) [rad/s2]."""
    times = np.arange(-3, int(law.times[-1] / PERIOD_S) + 4) * PERIOD_S
    q = curve(law.at(np.clip(times, 0.0, law.times[-1]))[0])
    return np.asarray(np.abs(np.diff(q, 3, axis=0)).max(axis=0) / PERIOD_S**2)


def main() -> None:
    """Plan, measure and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.planning.acceleration_steps")
    parser.add_argument("names", nargs="*", default=list(NAMES))
    rows = []
    for name in parser.parse_args().names:
        request = load_request(REQUESTS / f"{name}.yaml")
        for scale in (None, 1.0, 0.5):
            made = plan(replace(request, options=replace(request.options, jerk_scale=scale)))
            motion = made.motion
            if motion is None or motion.law is None:
                rows.append((name, str(scale), made.verdict.value, "", "", ""))
                continue
            steps, bound = measure_steps(motion.curve, motion.law), motion.robot.acceleration
            worst = int(np.where(np.isfinite(bound), steps, 0.0).argmax())
            allowed = "" if scale is None else f"{scale * bound[worst] / 0.1 * PERIOD_S:.2f}"
            row = name, str(scale), made.verdict.value, f"{motion.law.times[-1]:.1f}", f"{steps[worst]:.2f}", allowed
            rows.append(row)
            print(*row, flush=True)
    print_table("Steps of acceleration between set points 10 ms apart", HEADER, rows)


if __name__ == "__main__":
    main()
