"""Measure the service: ``python -m benchmarks.service [--part NAME ...] [--seconds S] [--short]``."""

from __future__ import annotations

import argparse
import os
import platform
import sys
import tempfile
import time
import traceback
from importlib import import_module
from pathlib import Path

from benchmarks.service.figures import Figure, Options, print_figures

PARTS = (
    "overhead",
    "stopping",
    "overload",
    "worker_kills",
    "server_kills",
    "messages",
    "strangers",
    "endurance",
    "operations.acknowledged",
    "operations.fairness",
    "operations.loads",
    "operations.stops",
    "operations.damage",
    "operations.mutator",
)


def main() -> int:
    """Run the parts, each with a new server; return 1 if a target is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--part", action="append", choices=PARTS, help="only this one; may be given again")
    parser.add_argument("--seconds", type=float, help="of overload and of killing workers, instead of 600 and 300")
    parser.add_argument("--solves", type=int, help="in a row, instead of 10,000")
    parser.add_argument("--messages", type=int, help="malformed or hostile ones, instead of 10,000")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--short", action="store_true", help="only see whether all parts work")
    told = parser.parse_args()
    options = Options(told.short, told.seconds, told.solves, told.messages, told.seed)
    print(_machine(), flush=True)
    figures: list[Figure] = []
    for name in told.part or PARTS:
        began = time.monotonic()
        with tempfile.TemporaryDirectory(prefix="bench-service-") as folder:
            found = _measured(name, options, Path(folder))
        print_figures(f"{name} ({time.monotonic() - began:.0f} s)", found)
        sys.stdout.flush()
        figures += found
    print_figures("The service's figures", figures)
    return int(any(figure.is_met is False for figure in figures))


def _measured(name: str, options: Options, folder: Path) -> list[Figure]:
    """Return the figures of a part; a part that cannot be measured does not affect the others."""
    try:
        found: list[Figure] = import_module(f"benchmarks.service.{name}").measure(options, folder)
    except Exception as error:
        traceback.print_exc()
        return [Figure(f"{name}: could not be measured", "", f"{type(error).__name__}: {error}"[:100], False)]
    return found


def _machine() -> str:
    """Return processor, number of cores and present load."""
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    said = {key.strip(): value.strip() for key, _, value in (line.partition(":") for line in lines)}
    speed = f"{float(said.get('cpu MHz', 'nan')):.0f} MHz"
    name = said.get("model name", platform.machine())
    return f"{os.cpu_count()} cores, {name}, {speed}; load average at the start {os.getloadavg()[0]:.1f}"


if __name__ == "__main__":
    sys.exit(main())
