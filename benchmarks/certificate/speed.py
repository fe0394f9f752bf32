"""Processor time of the certificate and of the check of start and goal: ``python -m benchmarks.certificate.speed``.

Motions of the requests under ``examples/requests`` and, when ``SCOPT_DATA`` (default: ``../shared/data`` beside the
checkout) holds them, of the MotionBenchMaker problems for the Panda.  Each is planned once and then checked repeatedly
in this process, as in a server or a benchmark: the robot's hulls are already computed.
"""

from __future__ import annotations

import os
import statistics
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.planning.shipped import shipped_requests
from benchmarks.tables import Samples, print_table
from costs.robot import load_robot
from service.bench.problem_set import BenchRobot, read_problems
from service.planner import plan
from service.request.file import load_request
from service.result.result import PlanResult
from service.start.overlaps import find_overlaps
from service.verify import verify

ROOT = Path(__file__).resolve().parents[2]
N_RUNS = 5
TARGET_MS, START_TARGET_MS = 12.0, 2.0  # medians, Panda


def main() -> None:
    """Plan, measure, print."""
    data = Path(os.environ.get("SCOPT_DATA", ROOT.parent / "shared" / "data")) / "mbm_panda"
    rows = [_row(path.stem, [plan(load_request(path))]) for path in shipped_requests()]
    if (data / "panda_bench").is_dir():
        rows.append(_row("Panda problems", list(_panda(data))))
    title = f"certificate, start and goal check: CPU [ms] (Panda: aims {TARGET_MS:g} and {START_TARGET_MS:g})"
    columns = (
        "motions",
        "number",
        "median",
        "p95",
        "untimed median",
        "p95",
        "one pose, median",
        "least clearance [mm]",
    )
    print_table(title, columns, rows)


def _panda(data: Path) -> Iterator[PlanResult]:
    folder = data / "panda_bench"
    files = BenchRobot(folder / "panda.urdf", folder / "panda.srdf", data)
    robot = load_robot(urdf=files.urdf, srdf=files.srdf, package_dirs=[files.package_root])
    for problem in read_problems(data, files, {"time_limit_s": 10.0}):
        yield plan(problem.request, robot=robot)


def _row(name: str, results: list[PlanResult]) -> list[str]:
    timed, untimed, pose, clearances = list[float](), list[float](), list[float](), list[float]()
    for result in results:
        motion = result.motion
        if motion is None:
            continue
        with threadpool_limits(limits=1, user_api="blas"):
            clearances.append(verify(motion).min_clearance_m)
            timed.append(_median_ms(verify, motion))
            untimed.append(_median_ms(verify, replace(motion, law=None)))
            pose.append(_median_ms(find_overlaps, motion.robot, motion.curve.positions[-1], motion.scene, ()))
    figures = [len(timed), *_spread(timed), *_spread(untimed), statistics.median(pose)]
    shown = [f"{figure:.1f}" if isinstance(figure, float) else str(figure) for figure in figures]
    return [name, *shown, f"{1e3 * statistics.median(clearances):.1f}"]


def _median_ms(step: Callable[..., object], *arguments: object) -> float:
    samples = Samples()
    for _ in range(N_RUNS):
        samples.measure(step, *arguments)
    return 1e3 * statistics.median(samples.cpu)


def _spread(values: list[float]) -> tuple[float, float]:
    return statistics.median(values), float(np.percentile(values, 95))


if __name__ == "__main__":
    main()
