"""Circles that a drill cuts into a wall: radius, distance of the wall, height, and how the bit is in the hand.

``python -m benchmarks.tasks.circles [--radii 0.2 0.3] [--turns -30 -20 -10 0 15]``
"""

from __future__ import annotations

import argparse
import copy
import statistics
import time
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.tables import print_table
from benchmarks.tasks.part_cases import make_wall, request_of
from service.planner import plan
from service.request.file import parse_request
from service.request.task_files import use_task
from service.result.result import Verdict

WALLS, HEIGHTS, Y = (0.7, 0.8), (1.0, 1.15, 1.3), -0.15
TURNS = (-30.0, -20.0, -10.0, 0.0, 15.0)  # beyond 20 deg the drill meets the forearm [deg]


def make_circle(radius: float, x: float, height: float, turn_deg: float) -> dict[str, Any]:
    """Return the request of one circle; the drill is turned in the hand, about the hand's axis of grip."""
    values = {"centre": [x, Y, height], "radius": radius, "wall": ["wall"]}
    data = use_task(request_of("drill", values, [make_wall(x)]))
    turn, pivot = Rotation.from_euler("z", turn_deg, degrees=True), np.array(data["attached"][0]["position"])
    data["attached"] = copy.deepcopy(data["attached"])
    for body in data["attached"]:
        at = pivot + turn.apply(np.array(body["position"]) - pivot)
        turned = turn * Rotation.from_quat(body["quaternion_wxyz"], scalar_first=True)
        body |= {"position": at.tolist(), "quaternion_wxyz": turned.as_quat(scalar_first=True).tolist()}
    return data


def main() -> None:
    """Plan every circle, print a line for each, and a row per radius and wall."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--radii", nargs="+", type=float, default=(0.2, 0.3))
    parser.add_argument("--turns", nargs="+", type=float, default=TURNS)
    given = parser.parse_args()
    rows = []
    for radius in given.radii:
        for x in WALLS:
            times, certified = list[float](), 0
            for turn in given.turns:
                for height in HEIGHTS:
                    started = time.process_time()
                    result = plan(parse_request(make_circle(radius, x, height, turn)))
                    times.append(time.process_time() - started)
                    certified += result.verdict is Verdict.CERTIFIED
                    why = "" if result.verdict is Verdict.CERTIFIED else f": {' '.join(result.explanation)[:200]}"
                    where = f"radius {radius:g}, wall {x:g}, centre {height:g}, turned {turn:g}"
                    print(f"{where}: {result.verdict.value} in {times[-1]:.1f} s{why}", flush=True)
            cost = [f"{statistics.median(times):.1f}", f"{max(times):.1f}"]
            rows.append([f"{radius:g}", f"{x:g}", f"{certified} of {len(times)}", *cost])
    print_table("Circles", ["radius [m]", "wall [m]", "certified", "median CPU [s]", "longest [s]"], rows)


if __name__ == "__main__":
    main()
