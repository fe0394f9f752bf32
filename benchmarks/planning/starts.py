"""Starts of the search: which one led to each motion, and what every attempt cost.

``python -m benchmarks.planning.starts [--groups panda copies arms atlas doors valves steps shipped] [--count N]
[--seed S] [--time-limit S] [--out FILE] [--against FILE] [--each]``

Panda problems are MotionBenchMaker's, in ``mbm_panda`` of the folder ``SCOPT_DATA`` (default: ``../shared/data``);
without it they, their copies and the arms among boxes are left out.  ``--out`` writes one row per plan, ``--against``
compares the rows with those of another checkout: the same problems, certified or not, and the ratio of processor time.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.planning.arm import jitter
from benchmarks.planning.arms_in_boxes import Arm, connect, draw_cases
from benchmarks.planning.crowded_scenes import crowded_scenes
from benchmarks.planning.shipped import shipped_requests
from benchmarks.tables import print_table
from benchmarks.tasks.given import stand
from benchmarks.tasks.given_cases import make_doors, make_valves
from benchmarks.tasks.step_cases import list_cases
from costs.kinematics import KinematicsEngine
from costs.robot import RobotModel, load_robot
from service.bench.problem_set import BenchRobot, read_problems
from service.planner import plan
from service.request.file import load_request, parse_request
from service.request.schema import PlanRequest
from service.start.robot import load_requested_robot
from service.tasks.stances.search import find_stance

ROOT = Path(__file__).resolve().parents[2]
TIME_LIMIT_S = 60.0  # wall time, so that a busy machine does not decide
N_BOXES = 60
STANCE_LIMIT_S = 120.0
OPEN_DEG = 60.0
TIP = "panda_hand"
COLUMNS = ("group", "plans", "certified", "CPU sum [s]", "CPU median [s]", "CPU p95 [s]")
START_COLUMNS = ("start", "tried", "feasible", "CPU sum [s]", "CPU a try [s]", "steps a try")
AGAINST_COLUMNS = ("group", "plans", "certified before", "certified now", "CPU before [s]", "CPU now [s]", "ratio")

Row = dict[str, Any]
Case = tuple[str, PlanRequest, RobotModel | None]


def find_panda() -> tuple[Path, BenchRobot] | None:
    """Return the folder of Panda's problems and the robot's files, or None where they are missing."""
    folder = Path(os.environ.get("SCOPT_DATA", ROOT.parent / "shared" / "data")) / "mbm_panda"
    files = folder / "panda_bench" / "panda"
    return (
        (folder, BenchRobot(files.with_suffix(".urdf"), files.with_suffix(".srdf"), folder))
        if files.parent.is_dir()
        else None
    )


def list_panda(count: int, seed: int, *, is_copied: bool) -> Iterator[Case]:
    """Yield ``count`` problems of each scene, chosen by the seed; or copies of them, slightly moved."""
    known = find_panda()
    if known is None:
        return
    problems = read_problems(*known, {"time_limit_s": TIME_LIMIT_S, "timed": False})
    robot = load_requested_robot(problems[0].request)
    rng = np.random.default_rng(seed)
    chosen = []
    for scene in sorted({problem.scene for problem in problems}):
        own = [problem for problem in problems if problem.scene == scene]
        chosen += [own[k] for k in sorted(rng.permutation(len(own))[:count].tolist())]
    for problem in jitter(chosen, robot, 1, seed) if is_copied else chosen:
        yield f"{problem.scene}/{problem.name}", problem.request, robot


def list_arms(count: int, seed: int) -> Iterator[Case]:
    """Yield goals in joints and as poses of an arm among random boxes, where a plain tree finds a way."""
    known = find_panda()
    if known is None:
        return
    section = known[1].to_request()
    robot = load_requested_robot(parse_request({"robot": section, "goal": {"joints": {"any": 0.0}}}))
    arm = Arm("panda", section, robot, robot, KinematicsEngine(robot), TIP)
    solved = (case for case in draw_cases(arm, seed) if connect(arm, case, seed))
    for case in islice(solved, count):
        for kind, goal in arm.list_goals(case):
            yield f"{case.name}/{kind}", arm.make_request(case, goal, TIME_LIMIT_S), robot


def list_atlas(count: int, seed: int) -> Iterator[Case]:
    """Yield reaches of Atlas among boxes that have a solution."""
    robot = load_robot("atlas")
    for is_pose in (True, False):
        for scene in islice(crowded_scenes(robot, N_BOXES, is_pose=is_pose, seed=seed), (count + is_pose) // 2):
            yield scene.name, scene.request, robot


def list_objects(kind: str, count: int, seed: int) -> Iterator[Case]:
    """Yield doors or valves from the place that the search for a stance finds."""
    cases = make_doors(count, seed, OPEN_DEG) if kind == "doors" else make_valves(count, seed)
    for case in cases:
        request = parse_request({**case.request, "options": {"time_limit_s": 10.0 * TIME_LIMIT_S, "seed": seed}})
        robot = load_requested_robot(request)
        search = find_stance(request, STANCE_LIMIT_S, robot=robot)
        if search.best is not None:
            yield case.name, stand(request, search), robot


def list_steps(count: int, seed: int) -> Iterator[Case]:
    """Yield stones, stairs and chairs."""
    robot = load_robot("atlas")
    for name, make in list_cases(robot).items():
        for k in range(count):
            yield f"{name} {seed + k}", parse_request(make(seed + k)), robot


def list_shipped(count: int, seed: int) -> Iterator[Case]:
    """Yield the bundled requests."""
    for path in shipped_requests():
        yield path.stem, load_request(path), None


GROUPS: Mapping[str, Callable[[int, int], Iterator[Case]]] = {
    "panda": lambda count, seed: list_panda(count, seed, is_copied=False),
    "copies": lambda count, seed: list_panda(count, seed, is_copied=True),
    "arms": list_arms,
    "atlas": list_atlas,
    "doors": lambda count, seed: list_objects("doors", count, seed),
    "valves": lambda count, seed: list_objects("valves", count, seed),
    "steps": list_steps,
    "shipped": list_shipped,
}


def run(group: str, case: Case) -> Row:
    """Return the row of one plan: verdict, processor time, the start that led to it, and every attempt."""
    name, request, robot = case
    began = time.process_time()
    result = plan(request, robot=robot)
    return {
        "group": group,
        "name": name,
        "verdict": result.verdict.value,
        "cpu_s": time.process_time() - began,
        "found_from": result.found_from,
        "reason": next(iter(result.explanation), ""),
        "tried": [asdict(tried) for tried in result.tried],
    }


def summarize(rows: Sequence[Row]) -> Iterator[tuple[str, ...]]:
    """Yield ``COLUMNS`` of each group."""
    for group, own in _split(rows, "group"):
        cpu = [row["cpu_s"] for row in own]
        certified = sum(row["verdict"] == "CERTIFIED" for row in own)
        spread = (f"{value:.2f}" for value in (sum(cpu), np.median(cpu), np.percentile(cpu, 95)))
        yield (group, str(len(own)), str(certified), *spread)


def summarize_starts(rows: Sequence[Row]) -> Iterator[tuple[str, ...]]:
    """Yield ``START_COLUMNS`` of each start of each group, trees of a kind together, the cheapest in all last."""
    for group, own in _split(rows, "group"):
        tried = [attempt for row in own for attempt in row["tried"]]
        for attempt in tried:
            attempt["kind"] = attempt["start"].split(", tree")[0]
        kinds = sorted(_split(tried, "kind"), key=lambda kind: -sum(attempt["cpu_s"] for attempt in kind[1]))
        for start, attempts in kinds:
            cpu, steps = (sum(attempt[key] for attempt in attempts) for key in ("cpu_s", "n_steps"))
            feasible = sum(attempt["is_feasible"] for attempt in attempts)
            each = (f"{cpu:.2f}", f"{cpu / len(attempts):.3f}", f"{steps / len(attempts):.1f}")
            yield (f"{group}: {start}", str(len(attempts)), str(feasible), *each)


def compare(before: Sequence[Row], now: Sequence[Row]) -> Iterator[tuple[str, ...]]:
    """Yield ``AGAINST_COLUMNS`` of each group, of the problems that both have."""
    known = {(row["group"], row["name"]): row for row in before}
    both = [(known[key], row) for row in now if (key := (row["group"], row["name"])) in known]
    for group in dict.fromkeys(row["group"] for row in now):
        pairs = [pair for pair in both if pair[1]["group"] == group]
        certified = [sum(pair[k]["verdict"] == "CERTIFIED" for pair in pairs) for k in (0, 1)]
        cpu = [sum(pair[k]["cpu_s"] for pair in pairs) for k in (0, 1)]
        ratio = cpu[1] / cpu[0] if pairs else float("nan")
        counts = (str(len(pairs)), *(str(count) for count in certified))
        yield (group, *counts, *(f"{seconds:.2f}" for seconds in cpu), f"{ratio:.2f}")
    for old, new in both:
        if (old["verdict"] == "CERTIFIED") != (new["verdict"] == "CERTIFIED"):
            yield (f"  {new['name']}: {old['verdict']} -> {new['verdict']} {new['reason'][:80]}", *[""] * 6)


def _split(rows: Sequence[Row], key: str) -> list[tuple[str, list[Row]]]:
    parts: dict[str, list[Row]] = defaultdict(list)
    for row in rows:
        parts[row[key]].append(row)
    return list(parts.items())


def main() -> None:
    """Print a table of the groups, one of the starts, and one against another run."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--groups", nargs="+", default=list(GROUPS), choices=list(GROUPS))
    parser.add_argument("--count", type=int, default=2, help="of a group, or of each kind in it")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--time-limit", type=float, default=None, help="of each plan [s]")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--against", type=Path)
    parser.add_argument("--each", action="store_true", help="a line for every plan")
    given = parser.parse_args()
    rows: list[Row] = []
    for group in given.groups:
        for name, request, robot in GROUPS[group](given.count, given.seed):
            options = request.options
            if given.time_limit is not None:
                request = replace(request, options=replace(options, time_limit_s=given.time_limit))
            rows.append(run(group, (name, request, robot)))
            if given.each:
                last = rows[-1]
                print(f"{group} {name}: {last['verdict']} {last['cpu_s']:.2f} s {last['found_from']}", flush=True)
            if given.out is not None:
                given.out.write_text(json.dumps(rows), encoding="utf-8")
    print_table("Plans", COLUMNS, list(summarize(rows)))
    print_table("Starts: every attempt", START_COLUMNS, list(summarize_starts(rows)))
    if given.against is not None:
        before = json.loads(given.against.read_text(encoding="utf-8"))
        print_table(f"Against {given.against.name}", AGAINST_COLUMNS, list(compare(before, rows)))


if __name__ == "__main__":
    main()
