"""Two checkouts on the same problems in turn: ``python -m benchmarks.planning.against OTHER [REQUEST ...]``.

Each checkout plans in a process of its own that stays; the problems go to one, then to the other, ``--rounds`` times.
A figure is the least processor time of these rounds, and what counts is the ratio of two figures, since it does not
depend on how fast the machine is or what else it does.  Without requests, the problems are MotionBenchMaker's for the
Panda, in ``mbm_panda`` of the folder ``SCOPT_DATA`` (default: ``../shared/data``).  Perception is told apart.
Motions are the same if all numbers of path and clearance are: a change that only saves time shows so.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
PERCEPTION = "perceive scene"
WORK = "--work"  # as the process that plans
SAME = ("verdict", "path", "clearance_m")  # what is the same of equal motions


def main() -> int:
    """Compare this checkout with another one, as a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("other", type=Path, help="the other checkout, such as a worktree of an earlier release")
    parser.add_argument("requests", type=Path, nargs="*")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--only", default="", help="problems whose name contains this")
    given = parser.parse_args()
    paths = [str(path.resolve()) for path in given.requests] or [str(_panda_folder())]
    workers = [_Worker(checkout.resolve(), paths) for checkout in (given.other, ROOT)]
    names = [name for name in workers[0].names if given.only in name]
    best: list[dict[str, dict[str, Any]]] = [{}, {}]
    for _ in range(given.rounds):
        for name in names:
            for found, worker in zip(best, workers, strict=True):
                answer = worker.plan(name)
                if name not in found or answer["cpu_s"] < found[name]["cpu_s"]:
                    found[name] = answer
    _report(names, *best)
    return 0


def _report(names: Sequence[str], other: dict[str, dict[str, Any]], here: dict[str, dict[str, Any]]) -> None:
    """Print the times of every problem, and the ratios' percentiles."""
    import numpy as np

    from benchmarks.tables import print_table

    ms = [[1e3 * found[name]["cpu_s"] for name in names] for found in (other, here)]
    ratios = np.divide(ms[1], ms[0])
    rows = [
        (name, other[name]["verdict"], here[name]["verdict"], f"{before:.1f}", f"{after:.1f}", f"{ratio:.2f}")
        for name, before, after, ratio in zip(names, *ms, ratios, strict=True)
    ]
    print_table(
        f"Processor time without perception, Python {sys.version.split()[0]} [ms]",
        ("problem", "other", "here", "other", "here", "ratio"),
        rows,
    )
    for name, percentile in (("median", 50.0), ("p95", 95.0)):
        before, after = (float(np.percentile(times, percentile)) for times in ms)
        print(f"  {name}: {before:.1f} ms, {after:.1f} ms, ratio {after / before:.3f}")
    print(f"  median of the ratios: {float(np.median(ratios)):.3f}")
    print(f"  certified: {_count_certified(other)} and {_count_certified(here)} of {len(names)}")
    different = [name for name in names if any(other[name][key] != here[name][key] for key in SAME)]
    print(f"  same motions: {len(names) - len(different)} of {len(names)}", *different)


def _count_certified(found: dict[str, dict[str, Any]]) -> int:
    return sum(answer["verdict"] == "CERTIFIED" for answer in found.values())


def _panda_folder() -> Path:
    return Path(os.environ.get("SCOPT_DATA", ROOT.parent / "shared" / "data")).resolve() / "mbm_panda"


class _Worker:
    """A process that plans with a checkout's code, one problem at a time."""

    def __init__(self, checkout: Path, paths: Sequence[str]) -> None:
        self._process = subprocess.Popen(
            [sys.executable, __file__, WORK, *paths],
            cwd=checkout,
            env={**os.environ, "PYTHONPATH": str(checkout), "OMP_NUM_THREADS": "1"},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self.names: list[str] = self._read()

    def plan(self, name: str) -> dict[str, Any]:
        """Return verdict and processor time [s] of a problem."""
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(name) + "\n")
        self._process.stdin.flush()
        answer: dict[str, Any] = self._read()
        return answer

    def _read(self) -> Any:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise RuntimeError(f"the worker ended with exit code {self._process.wait()}")
        return json.loads(line)


def work(paths: Sequence[str]) -> None:
    """Plan what the lines of stdin name; of a checkout, only what releases share is called."""
    answers = sys.stdout
    sys.stdout = sys.stderr
    problems = _read_panda(Path(paths[0])) if Path(paths[0]).is_dir() else _read_requests(paths)
    print(json.dumps(list(problems)), file=answers, flush=True)
    for line in sys.stdin:
        print(json.dumps(problems[json.loads(line)]()), file=answers, flush=True)


def _read_panda(folder: Path) -> dict[str, Callable[[], dict[str, Any]]]:
    from service.bench.bench import run_problem
    from service.bench.problem_set import BenchRobot, read_problems
    from service.start.robot import load_requested_robot

    panda = folder / "panda_bench" / "panda"
    bench_robot = BenchRobot(panda.with_suffix(".urdf"), panda.with_suffix(".srdf"), folder)
    problems = read_problems(folder, bench_robot, {"timed": False})
    robot = load_requested_robot(problems[0].request)
    return {problem.name: lambda problem=problem: run_problem(problem, robot) for problem in problems}


def _read_requests(paths: Sequence[str]) -> dict[str, Callable[[], dict[str, Any]]]:
    from service.planner import plan
    from service.request.file import load_request

    def run(path: str) -> dict[str, Any]:
        request, spent = load_request(Path(path)), {"perception": 0.0}
        clock = {"step": "", "since": time.process_time()}

        def on_progress(step: str, _: float) -> None:
            now = time.process_time()
            if str(clock["step"]).startswith(PERCEPTION):  # its parts are told, too
                spent["perception"] += now - clock["since"]
            clock.update(step=step, since=now)

        started = time.process_time()
        result = plan(request, on_progress)
        total = time.process_time() - started
        return {
            "verdict": result.verdict.value,
            "path": [] if result.motion is None else result.motion.curve.positions.tolist(),
            "clearance_m": None if result.certificate is None else str(result.certificate.min_clearance_m),
            "cpu_s": total - spent["perception"],
            **spent,
        }

    return {Path(path).stem: lambda path=path: run(path) for path in paths}


if __name__ == "__main__":
    if WORK in sys.argv:
        work(sys.argv[sys.argv.index(WORK) + 1 :])
    else:
        sys.exit(main())
