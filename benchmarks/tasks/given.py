"""Doors and valves that are given, from the place that ``scopt stance`` finds: certified or not, why not, at what cost.

``python -m benchmarks.tasks.given [--count N] [--doors N] [--valves N] [--angles 30 60] [--seed S] [--long]
[--out FILE]``

``--count N`` plans N doors and N // 2 valves.  ``--long`` adds random places near each door: the share of the angle
that a search of 60 s of processor time reaches, which plans smaller angles too, with either hand.  Processor time is of
one call of the planner, with the certificate.  Accuracies and torques are those of the certificates, at their worst.
"""

from __future__ import annotations

import argparse
import copy
import json
import statistics
import time
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.tables import print_table
from benchmarks.tasks.given_cases import N_DOORS, N_VALVES, Case, make_doors, make_valves
from costs.robot import RobotModel, load_robot
from service.demands.door.phases import TILT_RESERVE
from service.demands.phase import ANYWHERE
from service.planner import plan
from service.request.file import parse_request
from service.request.schema import PlanRequest, PoseRequest
from service.tasks.stances.search import StanceSearch, find_stance
from service.verify import Certificate

ANGLES = (30.0, 60.0)  # [deg]
STANCE_LIMIT_S = 120.0  # wall time, so that a busy machine does not decide
PLAN_LIMIT_S = 900.0  # wall time, so that a busy machine does not decide
LONG_CPU_S = 60.0  # of a long search
LONG_STEP_DEG = 10.0  # between the angles that it plans
N_RANDOM = 2  # places near each door
RANDOM_M, RANDOM_YAW = 0.35, np.deg2rad(30.0)


@dataclass(frozen=True)
class Run:
    """One plan.

    Attributes:
        name, group: of the case.
        angle_deg: that was asked for; 0 for a valve.
        verdict: of the planner, or ``NO STANCE``, ``ERROR``.
        reason: first sentence of the explanation; empty where certified.
        cpu_s: of the planner.
        stance_cpu_s: of the search for a stance.
        score: of the stance.
        reached_deg: angle of the leaf at the end of the best motion.
        base: position and orientation of the robot.
        steps_s: wall time by step of the planner.
        accuracy: of a certified motion, see ``measure_accuracy``.
        longest_deg: angle that a search of ``LONG_CPU_S`` reaches from there; 0 where there was none.
    """

    name: str
    group: str
    angle_deg: float
    verdict: str
    reason: str
    cpu_s: float
    stance_cpu_s: float
    score: float
    reached_deg: float
    base: dict[str, Any]
    steps_s: dict[str, float]
    accuracy: dict[str, float] | None = None
    longest_deg: float = 0.0

    @property
    def is_certified(self) -> bool:
        """Whether the motion was certified."""
        return self.verdict == "CERTIFIED"


def run_plan(
    case: Case, request: PlanRequest, robot: RobotModel, angle: float, search: StanceSearch | None, stance_cpu: float
) -> Run:
    """Plan one request and measure it."""
    base = request.start.base
    where = {} if base is None else {"position": list(base.position), "quaternion_wxyz": list(base.quaternion_wxyz)}
    best = None if search is None else search.best
    score = 0.0 if best is None else best.score
    began = time.process_time()
    try:
        result = plan(request, robot=robot)
    except Exception as error:  # counted: a benchmark goes on
        spent = time.process_time() - began
        text = f"{type(error).__name__}: {error}"
        return Run(case.name, case.group, angle, "ERROR", text, spent, stance_cpu, score, 0.0, where, {})
    reached = float(result.figures.get("opening_deg", result.figures.get("turned_deg", 0.0)))
    reason = "" if result.verdict.value == "CERTIFIED" else " | ".join(result.explanation[:3])
    return Run(
        case.name, case.group, angle, result.verdict.value, reason, time.process_time() - began, stance_cpu, score,
        reached, where, {step: round(seconds, 2) for step, seconds in result.timings.items()},
        None if reason or result.certificate is None else measure_accuracy(result.certificate),
    )  # fmt: skip


def measure_accuracy(certificate: Certificate) -> dict[str, float]:
    """Return the worst proven accuracies of a certificate's curve.

    ``contact_mm`` of a hand from its place, ``lean_deg`` of its axis beyond what the waypoints may lean, ``foot_mm`` of
    a sole's corner, and ``torque_pct`` of a joint's limit at the samples.
    """
    worst = {"contact_mm": 0.0, "lean_deg": 0.0, "foot_mm": 0.0, "torque_pct": 0.0}
    for check in certificate.checks:
        kind = check.name.split(".")[0]
        if kind == "keep" and check.unit == "m" and check.limit < ANYWHERE:
            worst["contact_mm"] = max(worst["contact_mm"], 1e3 * check.value)
        elif kind == "keep" and check.unit == "rad" and check.limit < np.pi:
            beyond = float(np.rad2deg(check.value - check.limit + TILT_RESERVE))
            worst["lean_deg"] = max(worst["lean_deg"], beyond)
        elif kind == "planted" and not check.name.endswith(".waypoints"):
            worst["foot_mm"] = max(worst["foot_mm"], 1e3 * check.value)
        elif kind == "torque":
            worst["torque_pct"] = max(worst["torque_pct"], 100.0 * check.value)
    return worst


def stand(request: PlanRequest, search: StanceSearch) -> PlanRequest:
    """Return the request at the best place of a search."""
    best = search.best
    if best is None:
        return request
    base = PoseRequest(best.position, best.quaternion_wxyz)
    return replace(request, start=replace(request.start, base=base))


def run_case(case: Case, robot: RobotModel, angles: Sequence[float], seed: int) -> list[Run]:
    """Search for a stance, for the largest angle, and plan every angle from there."""
    data = copy.deepcopy(case.request)
    data["options"] = {"time_limit_s": PLAN_LIMIT_S, "seed": seed}
    request = parse_request(data)
    began = time.process_time()
    search = find_stance(request, STANCE_LIMIT_S, robot=robot)
    stance_cpu = time.process_time() - began
    if search.best is None:
        reason = search.candidates[0].refused[0] if search.candidates and search.candidates[0].refused else ""
        return [Run(case.name, case.group, a, "NO STANCE", reason, 0.0, stance_cpu, 0.0, 0.0, {}, {}) for a in angles]
    runs = []
    for angle in angles:
        if "door" in data["task"]:
            data["task"]["door"]["open_deg"] = angle
        runs.append(run_plan(case, stand(parse_request(data), search), robot, angle, search, stance_cpu))
    return runs


def run_random(case: Case, robot: RobotModel, seed: int) -> list[Run]:
    """Plan from random places near the door; places that are refused are drawn again."""
    rng = np.random.default_rng(seed)
    data = copy.deepcopy(case.request)
    data["options"] = {"time_limit_s": PLAN_LIMIT_S, "seed": seed}
    runs: list[Run] = []
    for _ in range(20 * N_RANDOM):
        if len(runs) == N_RANDOM:
            break
        x, y = rng.uniform(-RANDOM_M, RANDOM_M, 2)
        yaw = rng.uniform(-RANDOM_YAW, RANDOM_YAW)
        height = float(robot.postures["reach_ready"][2])
        turn = (float(np.cos(0.5 * yaw)), 0.0, 0.0, float(np.sin(0.5 * yaw)))
        request = parse_request(data)
        base = PoseRequest((float(x), float(y), height), turn)
        placed = replace(request, start=replace(request.start, base=base))
        run = run_plan(case, placed, robot, float(data["task"]["door"]["open_deg"]), None, 0.0)
        if run.verdict != "ERROR" or "RequestError" not in run.reason:
            runs.append(replace(run, longest_deg=search_long(case, placed, robot, run)))
    return runs


def search_long(case: Case, request: PlanRequest, robot: RobotModel, first: Run) -> float:
    """Return the largest angle that plans of several angles and hands reach within ``LONG_CPU_S`` [deg]."""
    best, spent = first.reached_deg, first.cpu_s
    task = request.task
    if task is None or task.door is None:
        return best
    for angle in np.arange(first.angle_deg, 0.0, -LONG_STEP_DEG).tolist():
        for hand in ("left", "right"):
            if angle <= best + 0.5 or spent >= LONG_CPU_S:
                return best
            asked = replace(request, task=replace(task, door=replace(task.door, open_deg=angle, hand=hand)))
            run = run_plan(case, asked, robot, angle, None, 0.0)
            best, spent = max(best, run.reached_deg), spent + run.cpu_s
    return best


def summary(group: str, runs: Sequence[Run], angles: Sequence[float]) -> tuple[str, ...]:
    """Return one row of the table."""
    cells = [group, str(len({run.name for run in runs}))]
    for angle in angles:
        at = [run for run in runs if run.angle_deg == angle]
        certified = sum(run.is_certified for run in at)
        cells.append(f"{certified}/{len(at)} ({100.0 * certified / len(at):.0f} %)" if at else "-")
    cpu = [run.cpu_s for run in runs if run.verdict != "NO STANCE"]
    stance_cpu = [run.stance_cpu_s for run in runs]
    cells += [f"{statistics.median(cpu):.1f}", f"{np.percentile(cpu, 95):.1f}"] if cpu else ["-", "-"]
    return (*cells, f"{statistics.median(stance_cpu):.1f}")


def print_summary(title: str, runs: Sequence[Run], angles: Sequence[float], names: Sequence[str]) -> None:
    """Print a row for every group, and below the table the reasons of failures."""
    groups: dict[str, list[Run]] = defaultdict(list)
    for run in runs:
        groups[run.group].append(run)
    header = ("group", "cases", *names, "CPU median [s]", "CPU p95 [s]", "stance CPU [s]")
    rows = [summary(group, members, angles) for group, members in groups.items()]
    print_table(title, header, [*rows, summary("all", runs, angles)])
    print_accuracy(groups)
    failures = Counter(f"{run.verdict}: {run.reason[:150]}" for run in runs if not run.is_certified)
    for reason, count in failures.most_common():
        print(f"  {count} x {reason}")


def print_accuracy(groups: dict[str, list[Run]]) -> None:
    """Print the worst accuracies of every group's certified motions."""
    header = ("certified motions, worst", "contact [mm]", "beyond lean [deg]", "feet [mm]", "torque [%]")
    rows = []
    for group, members in groups.items():
        known = [run.accuracy for run in members if run.accuracy is not None]
        if known:
            worst = [max(one[key] for one in known) for key in known[0]]
            rows.append((group, *(f"{value:.2f}" for value in worst[:3]), f"{worst[3]:.0f}"))
    print_table("Accuracy between waypoints, and torques at samples", header, rows)


def main() -> None:
    """Print the tables; write every run with ``--out``."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, help="a quick look: this many doors, half as many valves")
    parser.add_argument("--doors", type=int, default=N_DOORS)
    parser.add_argument("--valves", type=int, default=N_VALVES)
    parser.add_argument("--angles", type=float, nargs="+", default=list(ANGLES))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--long", action="store_true", help="random places near each door too")
    parser.add_argument("--only", default="", help="cases whose name contains this")
    parser.add_argument("--out", type=Path, help="file for every run (JSON)")
    given = parser.parse_args()
    n_doors, n_valves = (given.doors, given.valves) if given.count is None else (given.count, given.count // 2)
    robot = load_robot("atlas")
    doors: list[Run] = []
    valves: list[Run] = []
    long: list[Run] = []

    def write() -> None:
        if given.out is not None:
            groups = {"doors": doors, "valves": valves, "random": long}
            text = json.dumps({name: [asdict(run) for run in runs] for name, runs in groups.items()}, indent=1)
            given.out.write_text(text + "\n")

    def add(runs: list[Run], made: list[Run]) -> None:
        runs += made
        write()
        for run in made:
            asked = f" {run.angle_deg:g} deg" if run.angle_deg else ""
            print(f"{run.name}{asked}: {run.verdict} {run.cpu_s:.1f} s {run.reason[:160]}", flush=True)

    for case in make_doors(n_doors, given.seed, max(given.angles)):
        if given.only in case.name:
            add(doors, run_case(case, robot, given.angles, given.seed))
            if given.long:
                add(long, run_random(case, robot, given.seed))
    for case in make_valves(n_valves, given.seed):
        if given.only in case.name:
            equipped = load_robot("atlas", hand=case.request["robot"]["hand"])
            add(valves, run_case(case, equipped, (0.0,), given.seed))
    if doors:
        names = [f"certified at {angle:g} deg" for angle in given.angles]
        print_summary("Doors, from the best stance", doors, given.angles, names)
    if valves:
        print_summary("Valves, one turn, from the best stance", valves, (0.0,), ("certified",))
    if long:
        shares = [min(run.reached_deg / run.longest_deg, 1.0) for run in long if run.longest_deg > 0.0]
        whole = sum(share >= 0.9 for share in shares)
        print(f"\nRandom places near a door: {len(long)}; from {len(shares)} of them it opens.")
        print(
            f"{whole} plans reach 90 % of the angle that a search of {LONG_CPU_S:g} s reaches, "
            f"{100.0 * np.mean(shares or [0.0]):.0f} % on average."
        )


if __name__ == "__main__":
    main()
