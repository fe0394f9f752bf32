"""Every benchmark, one after the other, each in a process of its own: `make bench`.

One benchmark alone, from the checkout's root: ``python -m benchmarks.planning.cycle``.  Doors and valves take half
an hour and have a target of their own: ``make bench-tasks``.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
NAMES = (
    "planning.cycle",
    "tasks.static_region",
    "planning.scaling",
    "planning.arm",
    "planning.whole_body",
    "planning.two_hands",
    "tasks.equilibrium_poses",
    "planning.ablations",
    "planning.whole_plans",
    "clouds.pieces",
    "clouds.update",
    "clouds.detections",
    "planning.timing",
    "certificate.speed",
    "certificate.random_problems",
    "executor.overhead",
)


def main() -> int:
    """Run all benchmarks; return how many failed."""
    failed = []
    for name in NAMES:
        print(f"\n== {name} ==", flush=True)
        # As a module from the root: the benchmarks import each other as ``benchmarks.<folder>.<name>``.
        if subprocess.run([sys.executable, "-m", f"benchmarks.{name}"], cwd=FOLDER.parent).returncode:
            failed.append(name)
    if failed:
        print(f"\nfailed: {', '.join(failed)}")
    return len(failed)


if __name__ == "__main__":
    sys.exit(main())
