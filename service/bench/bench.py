"""Run of a problem set through the planner: one row per problem, a table per scene, resumable."""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from costs.robot import RobotModel
from service.bench.problem_set import BenchProblem
from service.errors import RequestError
from service.planner import plan
from service.result.motion_json import samples_of
from service.result.result import PlanResult, Verdict
from service.viewer.files import replace_file

PEER = "scopt"
ERROR = "ERROR"  # of the planner itself
FAILURE_COLUMNS = ("not certified", "verdict", "reason")
COLUMNS = ("scene", "problems", "certified", "CPU median [ms]", "CPU p95 [ms]", "clearance median [mm]", "failures")


def run_problem(problem: BenchProblem, robot: RobotModel) -> dict[str, Any]:
    """Return a row of the result file; CPU time is that of all threads, from the problem in memory to the verdict."""
    wall, cpu = time.perf_counter(), time.process_time()
    columns = _plan_problem(problem, robot)
    return {
        "problem": problem.name,
        "scene": problem.scene,
        "time_s": time.perf_counter() - wall,
        "cpu_s": time.process_time() - cpu,
        **columns,
    }


def _plan_problem(problem: BenchProblem, robot: RobotModel) -> dict[str, Any]:
    """Plan a problem; return the columns of its result, of a refusal or of an error of the planner."""
    columns = {"success_claimed": False, "path": [], "verdict": ERROR, "clearance_m": None, "start": "", "reason": ""}
    try:
        result = plan(problem.request, robot=robot)
    except RequestError as error:
        return {**columns, "verdict": Verdict.INVALID_REQUEST.value, "reason": error.problems[0]}
    except Exception as error:  # one problem must not cost the others their rows
        return {**columns, "reason": " ".join(f"{type(error).__name__}: {error}".split())}
    clearance_m = np.inf if result.certificate is None else result.certificate.min_clearance_m
    return {
        "success_claimed": result.verdict is Verdict.CERTIFIED,
        "path": _list_path(result, problem.joints),
        "verdict": result.verdict.value,
        "clearance_m": float(clearance_m) if np.isfinite(clearance_m) else None,
        "start": result.found_from,
        "reason": next(iter(result.explanation), "") if result.conflict is None else result.conflict.brief,
    }


def run_bench(
    problems: Sequence[BenchProblem],
    robot: RobotModel,
    out: Path,
    on_progress: Callable[[str, float], None],
) -> list[dict[str, Any]]:
    """Return the rows of all problems; ``out`` keeps its earlier rows and is written after every problem."""
    rows = {row["problem"]: row for row in _read_rows(out)}
    for done, problem in enumerate(problems):
        on_progress(problem.name, done / len(problems))
        if problem.name not in rows:
            rows[problem.name] = run_problem(problem, robot)
            replace_file(out, json.dumps({"peer": PEER, "results": list(rows.values())}).encode())
    return [rows[problem.name] for problem in problems]


def summarize_scenes(rows: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """Return ``COLUMNS`` for each scene and for all problems."""
    scenes = sorted({row["scene"] for row in rows})
    groups = [(scene, [row for row in rows if row["scene"] == scene]) for scene in scenes]
    return [_summarize(name, group) for name, group in (*groups, ("all", list(rows)))]


def list_failures(rows: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """Return ``FAILURE_COLUMNS`` for every problem that was not certified."""
    return [(row["problem"], row["verdict"], row["reason"]) for row in rows if not row["success_claimed"]]


def _summarize(name: str, rows: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
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


def _list_path(result: PlanResult, joints: Sequence[str]) -> list[list[float]]:
    """Return the executed samples in the problem's joint order, for linear interpolation."""
    if result.motion is None:
        return []
    columns = [result.robot.joint_names.index(joint) for joint in joints]
    rows: list[list[float]] = result.motion.curve(samples_of(result.motion))[:, columns].tolist()
    return rows


def _read_rows(out: Path) -> list[dict[str, Any]]:
    """Return the rows of an earlier run; none if ``out`` is another file."""
    if not out.is_file():
        return []
    try:
        data = json.loads(out.read_text(encoding="utf-8"))
        return list(data["results"]) if data.get("peer") == PEER else []
    except (json.JSONDecodeError, KeyError, TypeError, AttributeError):
        return []
