"""Time and memory of whole plans, each in a fresh process: ``python -m benchmarks.planning.whole_plans [REQUEST ...]``.

Without arguments, the requests under ``examples/requests``.  Processor time is what counts on a shared machine; steps
are told apart by the planner's progress reports.
"""

from __future__ import annotations

import json
import os
import resource
import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from benchmarks.planning.shipped import shipped_requests
from benchmarks.tables import print_table

ROOT = Path(__file__).resolve().parents[2]
HELP_RUNS = 5
TARGETS = {"perception": 2.0, "planning": 2.0, "certificate": 1.0}  # [s]
MEMORY_TARGET_MB, HELP_TARGET_S = 1024.0, 0.35
PERCEPTION, CERTIFICATE = "perceive scene", "certificate"
SET_UP = ("load robot", "check start")


def measure_plan(request: Path) -> dict[str, Any]:
    """Plan in this process: verdict, processor seconds by step, wall seconds, peak memory."""
    started = time.process_time()
    from service.planner import plan
    from service.request.file import load_request

    cpu: dict[str, float] = {"import": time.process_time() - started}
    clock = {"step": "set-up", "since": time.process_time()}

    def on_progress(step: str, fraction: float) -> None:
        now = time.process_time()
        done = str(clock["step"]).split(":")[0]  # of "perceive scene: find planes", the step
        cpu[done] = cpu.get(done, 0.0) + now - clock["since"]
        clock.update(step=step, since=now)

    result = plan(load_request(request), on_progress)
    on_progress("end", 1.0)
    return {
        "verdict": result.verdict.value,
        "cpu": cpu,
        "wall": result.planning_time_s,
        "memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
    }


def in_fresh_process(request: Path) -> dict[str, Any]:
    """Run ``measure_plan`` in a new process."""
    code = (
        "import json, sys; from pathlib import Path; from benchmarks.planning.whole_plans import measure_plan; "
        "print(json.dumps(measure_plan(Path(sys.argv[1]))))"
    )
    done = subprocess.run([sys.executable, "-c", code, str(request)], cwd=ROOT, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"planning {request.name} failed:\n{done.stderr}")
    figures: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return figures


def summed(cpu: dict[str, float]) -> dict[str, float]:
    """Return processor times of perception, planning (all phases, curve, timing), certificate and the whole [s]."""
    perception, certificate = cpu.get(PERCEPTION, 0.0), cpu.get(CERTIFICATE, 0.0)
    aside = cpu["import"] + cpu.get("set-up", 0.0) + sum(cpu.get(step, 0.0) for step in SET_UP)
    total = sum(cpu.values())
    return {
        "import": cpu["import"],
        "perception": perception,
        "planning": total - perception - certificate - aside,
        "certificate": certificate,
        "total": total,
    }


def measure_help() -> tuple[float, float]:
    """Return the median wall and processor time of ``scopt --help`` in a fresh process [s]."""
    command = [sys.executable, "-c", "from service.cli.app import main; main()", "--help"]
    wall, cpu = [], []
    for _ in range(HELP_RUNS):
        before, clock = os.times(), time.perf_counter()
        subprocess.run(command, cwd=ROOT, capture_output=True, check=True)
        after = os.times()
        wall.append(time.perf_counter() - clock)
        cpu.append(after.children_user + after.children_system - before.children_user - before.children_system)
    return statistics.median(wall), statistics.median(cpu)


def main() -> None:
    """Print the table of plans, their steps, and the start-up time of the command line."""
    named = [Path(name).resolve() for name in sys.argv[1:]]
    requests = named or shipped_requests()
    header = ("request", "verdict", "import", "perception", "planning", "certificate", "total", "wall", "memory MB")
    rows, steps = [], []
    for request in requests:
        figures = in_fresh_process(request)
        cpu = summed(figures["cpu"])
        seconds = [f"{value:.2f}" for value in (*cpu.values(), figures["wall"])]
        rows.append((request.stem, figures["verdict"], *seconds, f"{figures['memory_mb']:.0f}"))
        steps.append((request.stem, figures["cpu"]))
    targets = [f"{TARGETS[name]:.2f}" if name in TARGETS else "" for name in header[2:7]]
    rows.append(("target", "", *targets, "", f"{MEMORY_TARGET_MB:.0f}"))
    print_table("Plans, each in a fresh process [processor s; wall s]", header, rows)
    for name, cpu_of_step in steps:
        parts = ", ".join(f"{step} {seconds:.2f}" for step, seconds in cpu_of_step.items() if seconds >= 5e-3)
        print(f"  {name}: {parts}")
    wall, cpu_s = measure_help()
    print_table(
        f"Command line, median of {HELP_RUNS} [s]",
        ("command", "wall", "cpu", "target"),
        [("scopt --help", f"{wall:.2f}", f"{cpu_s:.2f}", f"{HELP_TARGET_S:g}")],
    )


if __name__ == "__main__":
    main()
