"""Running a problem set through the planner: one row per problem, a table per scene, resumable."""

from __future__ import annotations

import json
import os
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from costs.robot import RobotModel
from service.bench.problem_set import BenchProblem
from service.errors import RequestError
from service.planner import plan
from service.result.motion_json import samples_of
from service.result.result import PlanResult, Verdict

PEER = "scopt"
ERROR = "ERROR"  # of the planner itself
FAILURE_COLUMNS = ("not certified", "verdict", "reason")
COLUMNS = ("scene", "problems", "certified", "CPU median [ms]", "CPU p95 [ms]", "clearance median [mm]", "failures")


def run_problem(problem: BenchProblem, robot: RobotModel) -> dict[str, Any]:
    """One row of the result file; CPU time is of all threads, from the problem in memory to the verdict."""
    wall, cpu = time.perf_counter(), time.process_time()
    answer = _answer(problem, robot)
    return {
        "problem": problem.name,
        "scene": problem.scene,
        "time_s": time.perf_counter() - wall,
        "cpu_s": time.process_time() - cpu,
        **answer,
    }


def _answer(problem: BenchProblem, robot: RobotModel) -> dict[str, Any]:
    """What the planner makes of a problem, as columns; what it refuses, or fails at, is an answer too."""
    try:
        result = plan(problem.request, robot=robot)
    except RequestError as error:
        return _row(Verdict.INVALID_REQUEST.value, reason=error.problems[0])
    except Exception as error:  # one problem must not cost the others their rows
        return _row(ERROR, reason=" ".join(f"{type(error).__name__}: {error}".split()))
    certificate = result.certificate
    return _row(
        result.verdict.value,
        path=_path(result, problem.joints),
        clearance_m=None if certificate is None else _number(certificate.min_clearance_m),
        start=result.found_from,
        reason=next(iter(result.explanation), "") if result.conflict is None else result.conflict.brief,
    )


def _row(
    verdict: str,
    path: Sequence[Sequence[float]] = (),
    clearance_m: float | None = None,
    start: str = "",
    reason: str = "",
) -> dict[str, Any]:
    return {
        "success_claimed": verdict == Verdict.CERTIFIED.value,
        "path": path,
        "verdict": verdict,
        "clearance_m": clearance_m,
        "start": start,
        "reason": reason,
    }


def run_bench(
    problems: Sequence[BenchProblem],
    robot: RobotModel,
    out: Path,
    on_progress: Callable[[str, float], None],
) -> list[dict[str, Any]]:
    """Rows of all problems; those that ``out`` holds already are kept, and it is written after every problem."""
    rows = {row["problem"]: row for row in _earlier(out)}
    for done, problem in enumerate(problems):
        on_progress(problem.name, done / len(problems))
        if problem.name not in rows:
            rows[problem.name] = run_problem(problem, robot)
            _write(out, rows.values())
    return [rows[problem.name] for problem in problems]


def summarize_scenes(rows: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """Per scene and in all: problems, certified, CPU time median and 95th percentile, failures by verdict."""
    scenes = sorted({row["scene"] for row in rows})
    groups = [(scene, [row for row in rows if row["scene"] == scene]) for scene in scenes]
    return [_summary(name, group) for name, group in (*groups, ("all", list(rows)))]


def list_failures(rows: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """Every problem that was not certified: its name, verdict and first reason."""
    return [(row["problem"], row["verdict"], row["reason"]) for row in rows if not row["success_claimed"]]


def _summary(name: str, rows: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
    cpu = 1e3 * np.array([row["cpu_s"] for row in rows])
    certified = [row for row in rows if row["success_claimed"]]
    clearances = [1e3 * row["clearance_m"] for row in certified if row["clearance_m"] is not None]
    failures = Counter(row["verdict"] for row in rows if not row["success_claimed"])
    return (
        name,
        str(len(rows)),
        str(len(certified)),
        f"{np.median(cpu):.0f}",
        f"{np.percentile(cpu, 95):.0f}",
        f"{np.median(clearances):.1f}" if clearances else "",
        ", ".join(f"{count} {verdict}" for verdict, count in failures.most_common()),
    )


def _path(result: PlanResult, joints: Sequence[str]) -> list[list[float]]:
    """The executed samples in the problem's joint order, to be read joint-linearly."""
    if result.motion is None:
        return []
    columns = [result.robot.joint_names.index(joint) for joint in joints]
    rows: list[list[float]] = result.motion.curve(samples_of(result.motion))[:, columns].tolist()
    return rows


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _earlier(out: Path) -> list[dict[str, Any]]:
    """Rows of an earlier run that was interrupted."""
    if not out.is_file():
        return []
    try:
        data = json.loads(out.read_text(encoding="utf-8"))
        return list(data["results"]) if data.get("peer") == PEER else []
    except (json.JSONDecodeError, KeyError, TypeError, AttributeError):
        return []


def _write(out: Path, rows: Iterable[Mapping[str, Any]]) -> None:
    """As a whole or not at all."""
    fresh = out.with_name(out.name + ".part")
    fresh.write_text(json.dumps({"peer": PEER, "results": list(rows)}), encoding="utf-8")
    os.replace(fresh, out)
