"""Processor time of planning a phase again from a changed state: ``python -m benchmarks.tasks.replan [STATES]``.

A door and a valve are planned once. From states in the middle of their phases, with the arms a little off, the rest of
the task is planned again. A phase costs its own steps of the optimiser and an equal share of curve, timing and
certificate of the new motion.
"""

from __future__ import annotations

import json
import statistics
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.tables import print_table
from service.errors import RequestError
from service.planner import plan
from service.replay.rest import make_rest_request
from service.request.file import parse_request
from service.request.schema import PlanRequest
from service.result.folder import read_result
from service.result.output import write_result
from service.result.result import Verdict

STATES = 3  # per phase
NOISE = 4e-3  # standard deviation of the arms' joints [rad]
TARGET_S = 0.5
SHARED = ("curve and timing", "certificate")
ROBOT = {"robot": {"name": "atlas"}, "start": {"posture": "reach_ready"}}
DOOR = {
    "open_deg": 40,
    "opens": "push",
    "leaf": {"hinge": [0.75, -0.45, 0.01], "edge": [0.75, 0.45, 0.01]},
    "handle": {"kind": "lever", "centre": [0.65, 0.38, 1.02]},
}
TASKS: dict[str, dict[str, Any]] = {
    "door": {"door": DOOR},
    "valve": {
        "valve": {
            "centre": [0.68, 0.12, 1.1],
            "axis": [-1, 0, 0],
            "radius": 0.14,
            "spokes_deg": [45, 135, 225, 315],
            "turn_deg": 120,
        }
    },
}


def list_states(data: dict[str, Any], phase: dict[str, Any], count: int) -> Iterator[dict[str, Any]]:
    """Yield states of a recorded phase with the arms off by ``NOISE``."""
    rng = np.random.default_rng(phase["first"])
    names = data["trajectory"]["joint_names"]
    for share in (np.arange(count) + 0.5) / count:
        at = round(phase["first"] + float(share) * (phase["last"] - phase["first"]))
        values = dict(zip(names, data["trajectory"]["positions"][at], strict=True))
        base = [values.pop(name) for name in names[:7]]
        joints = {name: value + NOISE * rng.normal() * ("arm" in name) for name, value in values.items()}
        yield {
            "joints": joints,
            "base": {"position": base[:3], "quaternion_wxyz": base[3:]},
            "mechanism": {movable["joint"]: movable["angles"][at] for movable in data["movables"]},
        }


def measure_rest(request: PlanRequest, phase: str) -> dict[str, Any]:
    """Plan the rest of a task: verdict, number of phases, processor seconds of all of it and of the first phase."""
    cpu: dict[str, float] = {}
    begun = time.process_time()
    clock: dict[str, Any] = {"step": "set-up", "since": begun}

    def on_progress(step: str, fraction: float) -> None:
        now = time.process_time()
        cpu[clock["step"]] = cpu.get(clock["step"], 0.0) + now - clock["since"]
        clock.update(step=step, since=now)

    result = plan(request, on_progress)
    on_progress("end", 1.0)
    count = max(len(result.phases), 1)
    own = sum(cpu.get(step, 0.0) for step in (phase, "take hold", f"pose for '{phase}'"))
    shared = sum(cpu.get(step, 0.0) for step in SHARED)
    return {
        "is_certified": result.verdict is Verdict.CERTIFIED,
        "phases": len(result.phases),
        "rest_s": time.process_time() - begun,
        "phase_s": own + shared / count,
    }


def main(count: int = STATES) -> None:
    """Print a row for each phase, and the median over all of them."""
    rows, all_s = [], []
    with tempfile.TemporaryDirectory() as scratch:
        for task, section in TASKS.items():
            folder = write_result(plan(parse_request({**ROBOT, "task": section})), Path(scratch) / task).folder
            data = read_result(folder)
            for phase in data["phases"]:
                runs, refused = [], 0
                for state in list_states(data, phase, count):
                    file = Path(scratch) / "state.json"
                    file.write_text(json.dumps(state))
                    try:
                        request = make_rest_request(folder, phase["name"], file)
                        runs.append(measure_rest(request, phase["name"]))
                    except RequestError:
                        refused += 1
                if not runs:
                    continue
                all_s += [run["phase_s"] for run in runs]
                rows.append(
                    (
                        task,
                        phase["name"],
                        f"{sum(run['is_certified'] for run in runs)} of {len(runs) + refused}",
                        f"{statistics.median(run['phase_s'] for run in runs):.2f}",
                        str(runs[0]["phases"]),
                        f"{statistics.median(run['rest_s'] for run in runs):.2f}",
                    )
                )
    print_table("phases planned again", ("task", "phase", "certified", "phase CPU [s]", "phases", "all CPU [s]"), rows)
    print(f"median of one phase: {statistics.median(all_s):.2f} s of processor time, at most {TARGET_S:g} wanted")


if __name__ == "__main__":
    main(*(int(argument) for argument in sys.argv[1:]))
