"""Every benchmark, one after the other, each in a process of its own: `make bench`.

One benchmark alone, from the checkout's root: ``python -m benchmarks.cycle``.  Doors and valves take half an hour and
have a target of their own: ``make bench-tasks``.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
NAMES = (
    "cycle",
    "static_region",
    "scaling",
    "arm",
    "whole_body",
    "two_hands",
    "equilibrium_poses",
    "ablations",
    "planning",
    "cloud_pieces",
    "cloud_update",
    "cloud_detections",
    "timing",
    "certificate",
    "attack_certificate",
    "executor",
)


def main() -> int:
    """Run all benchmarks; return how many failed."""
    failed = []
    for name in NAMES:
        print(f"\n== {name} ==", flush=True)
        # As a module from the root: the benchmarks import each other as ``benchmarks.<name>``.
        if subprocess.run([sys.executable, "-m", f"benchmarks.{name}"], cwd=FOLDER.parent).returncode:
            failed.append(name)
    if failed:
        print(f"\nfailed: {', '.join(failed)}")
    return len(failed)


if __name__ == "__main__":
    sys.exit(main())
