"""Processor time before a plan and of a whole one: ``python -m benchmarks.planning.start_up [OTHER]``.

New processes import the planner, and plan a joint goal by the command line, ``--rounds`` times each; a figure is the
least of these. With another checkout both take turns, and what counts is the ratio. Bytecode is written before.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.tables import print_table

ROOT = Path(__file__).resolve().parents[2]
PLAN = (
    "import sys; from service.cli.app import main;"
    "sys.argv = ['scopt', 'plan', 'examples/requests/joint_goal.yaml', '-o', sys.argv[1]]; main()"
)
PROGRAMS = {
    "import of numpy and pinocchio": "import numpy, pinocchio",
    "import of the planner": "import service.planner",
    "plan of a joint goal, whole process": PLAN,
}
COUNT = "import sys; import service.planner; print(len(sys.modules))"


def main() -> int:
    """Print the figures of this checkout, and of another one beside them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "other", type=Path, nargs="?", help="another checkout, such as a worktree of an earlier release"
    )
    parser.add_argument("--rounds", type=int, default=5)
    given = parser.parse_args()
    checkouts = [ROOT] if given.other is None else [given.other.resolve(), ROOT]
    with tempfile.TemporaryDirectory() as folder:
        least = {
            (name, checkout): min(times)
            for name, program in PROGRAMS.items()
            for checkout, times in _take_turns(program, checkouts, given.rounds, folder).items()
        }
        counts = {checkout: _run(COUNT, checkout, folder)[1] for checkout in checkouts}
    rows = [
        (name, *(f"{least[name, checkout]:.2f}" for checkout in checkouts), _ratio([least[name, c] for c in checkouts]))
        for name in PROGRAMS
    ]
    rows.append(("modules of the planner", *(counts[checkout].strip() for checkout in checkouts), ""))
    header = ("", "here", "") if given.other is None else ("", "other", "here", "ratio")
    print_table(f"Processor time, Python {sys.version.split()[0]} [s]", header, rows)
    return 0


def _ratio(figures: list[float]) -> str:
    return f"{figures[-1] / figures[0]:.2f}" if len(figures) > 1 else ""


def _take_turns(program: str, checkouts: list[Path], rounds: int, folder: str) -> dict[Path, list[float]]:
    """Return the processor times of a program in each checkout; the first run of each only writes bytecode."""
    times: dict[Path, list[float]] = {checkout: [] for checkout in checkouts}
    for turn in range(rounds + 1):
        for checkout in checkouts:
            spent, _ = _run(program, checkout, folder)
            if turn:
                times[checkout].append(spent)
    return times


def _run(program: str, checkout: Path, folder: str) -> tuple[float, str]:
    """Return processor time [s] and output of a new process."""
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"}
    environment |= {"PYTHONPATH": str(checkout), "PYTHONPYCACHEPREFIX": f"{folder}/bytecode", "OMP_NUM_THREADS": "1"}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    # A release may refuse to replace the result of another one.
    result = Path(folder) / f"result{checkout.as_posix().replace('/', '_')}"
    done = subprocess.run(
        [sys.executable, "-c", program, str(result)],
        cwd=checkout,
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, done.stdout


if __name__ == "__main__":
    sys.exit(main())
