"""Reaches one after the other, each from the end of the one before: a session against plans that know nothing.

    python -m benchmarks.tasks.chained_reaches [--reaches N] [--seed S] [--places P]

Atlas reaches with its left hand between places among boxes, in an order and with offsets of up to 2 cm that are drawn.
Both plan the same requests.  Times are of the processor, robot and scene included.
"""

from __future__ import annotations

import argparse
import statistics
import time
from dataclasses import replace

import numpy as np

from benchmarks.tables import print_table
from scopt import EffortClock
from service.execution.session import ReachSession
from service.planner import plan
from service.request.file import parse_request
from service.request.schema import PlanRequest
from service.request.tasks.reach import GoalRequest, PoseGoalRequest
from service.result.result import PlanResult, Verdict

BOXES = (
    {"name": "post", "type": "box", "size": [0.06, 0.06, 1.6], "position": [0.55, 0.25, 0.8]},
    {"name": "shelf", "type": "box", "size": [0.3, 0.9, 0.03], "position": [0.72, 0.25, 0.95]},
)
LOW, HIGH = np.array([0.4, 0.05, 1.0]), np.array([0.6, 0.6, 1.45])  # of places of the hand [m]
OFFSET_M = 0.02


def make_request() -> PlanRequest:
    """Return the request that begins the chain."""
    return parse_request({
        "robot": {"name": "atlas"},
        "start": {"posture": "reach_ready"},
        "scene": {"floor": True, "obstacles": list(BOXES)},
        "goal": {"poses": [{"link": "l_tool", "position": [0.45, 0.45, 1.2], "position_tolerance_m": 0.01}]},
    })  # fmt: skip


def main() -> None:
    """Print a line for every reach, and a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--reaches", type=int, default=200)
    parser.add_argument("--places", type=int, default=6)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    rng = np.random.default_rng(given.seed)
    places = rng.uniform(LOW, HIGH, (given.places, 3))
    began = time.process_time()
    request = make_request()
    session = ReachSession(request)
    warm, cold = [time.process_time() - began], [0.0]
    results: list[tuple[PlanResult, PlanResult]] = []
    at = -1
    for k in range(given.reaches):
        at = int((at + rng.integers(1, given.places)) % given.places) if at >= 0 else 0
        position = places[at] + rng.uniform(-OFFSET_M, OFFSET_M, 3)
        x, y, z = position.tolist()
        goal = GoalRequest(poses=(PoseGoalRequest("l_tool", (x, y, z), position_tolerance_m=0.01),))
        began = time.process_time()
        own = session.plan(goal, clock=EffortClock())
        warm.append(time.process_time() - began)
        began = time.process_time()
        alone = plan(replace(own.request, goal=goal), clock=EffortClock())
        cold.append(time.process_time() - began)
        results.append((own, alone))
        print(f"  {k} to {at}: {own.verdict.value} {warm[-1]:.2f} s {own.found_from}; "
              f"cold {alone.verdict.value} {cold[-1]:.2f} s {alone.found_from}", flush=True)  # fmt: skip
    rows = []
    for name, seconds, verdicts in (
        ("session", warm, [own.verdict for own, _ in results]),
        ("cold", cold, [alone.verdict for _, alone in results]),
    ):
        certified = sum(verdict is Verdict.CERTIFIED for verdict in verdicts)
        rows.append((name, str(len(verdicts)), str(certified), f"{sum(seconds):.1f}",
                     f"{statistics.median(seconds[1:]):.2f}", f"{max(seconds):.2f}"))  # fmt: skip
    rows.append(("ratio", "", "", f"{sum(warm) / sum(cold):.2f}", "", ""))
    columns = ("plans", "reaches", "certified", "CPU in all [s]", "CPU median [s]", "CPU max [s]")
    print_table("Chained reaches", columns, rows)


if __name__ == "__main__":
    main()
