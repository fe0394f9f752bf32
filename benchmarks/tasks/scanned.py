"""Valves and doors from simulated scans, and what a moved object costs: certified or not, why not, at what cost.

``python -m benchmarks.tasks.scanned [--valves N] [--doors N] [--displaced N] [--angle DEG] [--seed S] [--out FILE]``

The robot stands at random where the object can be moved: a place is drawn within ``AROUND_M`` and ``AROUND_DEG`` of
the origin, 0.7 to 0.8 m before a valve.  It is taken if the poses of the whole task exist there (``find_stance`` on the
true object), else the first place within ``--radius`` that has them.  A case without such a place does not count, and
is named.  The lidar scans from the robot's head at that place, the object is detected in the loop, and the
motion is planned on what was seen.

``--displaced N``: the objects of the first N certified cases that are given by numbers are moved (valves by 1 cm and 3
deg, doors by 1 cm) and planned again with the choices of the first plan (hand, entry, grip): share and seconds.  The
first motion is also kept, with only the arm yielding that holds the object (at most 15 mm and 5 deg): for the same
displacement, and for a random one of up to that size.
Processor time is of one call of the planner, perception and certificate included.
"""

from __future__ import annotations

import argparse
import copy
import json
import statistics
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.tables import print_table
from benchmarks.tasks.scanned_cases import OPEN_DEG, SCANNER, ScannedCase, make_scanned_doors, make_scanned_valves
from costs.robot import RobotModel, load_robot
from perception import write_pcd
from perception.simulate import Pose, scan
from service.planner import plan
from service.replay.rest import make_rest_request
from service.request.file import parse_request
from service.request.schema import PlanRequest
from service.result.output import write_result
from service.tasks.stances.search import StanceCandidate, find_stance

N_VALVES, N_DOORS, N_DISPLACED = 40, 16, 12
STANCE_LIMIT_S, PLAN_LIMIT_S = 300.0, 900.0  # wall time, so that a busy machine does not decide
AROUND_M, AROUND_DEG = 0.1, 8.0  # of the places that are drawn first
HEAD = (0.12, 0.0, 0.78)  # of the lidar, from the base [m]
DISPLACED_M, DISPLACED_DEG = 0.01, 3.0


@dataclass(frozen=True)
class Run:
    """One plan.

    Attributes:
        name, group: of the case.
        verdict: of the planner, or ``NO STANCE``, ``ERROR``.
        reason: first sentence of the explanation; empty where certified.
        cpu_s: of the planner.
        first_cpu_s: of the plan before, for an object that was moved.
        kept, kept_within: whether the first motion was certified with a yielding arm, for the object moved by all of
            ``DISPLACED_M`` and ``DISPLACED_DEG``, and by a random part of both.
        kept_cpu_s: of keeping the motion, where it was kept for a random part.
        steps_s: wall time by step of the planner.
    """

    name: str
    group: str
    verdict: str
    reason: str = ""
    cpu_s: float = 0.0
    first_cpu_s: float = 0.0
    steps_s: dict[str, float] | None = None
    kept: bool = False
    kept_within: bool = False
    kept_cpu_s: float = 0.0

    @property
    def is_certified(self) -> bool:
        """Whether the motion was certified."""
        return self.verdict == "CERTIFIED"


def make_request(case: ScannedCase, task: dict[str, Any], seed: int) -> dict[str, Any]:
    """Return the request of a case as plain data."""
    return {
        "robot": {"name": "atlas", "hand": case.hand},
        "start": {"posture": "reach_ready"},
        "scene": {"floor": True},
        "task": copy.deepcopy(task),
        "options": {"time_limit_s": PLAN_LIMIT_S, "seed": seed},
    }


def choose_place(
    case: ScannedCase, robot: RobotModel, rng: np.random.Generator, seed: int, radius: float
) -> StanceCandidate | None:
    """Return a random place from which the true object can be moved; None without one."""
    data = make_request(case, case.true, seed)
    x, y = rng.uniform(-AROUND_M, AROUND_M, 2)
    yaw = np.deg2rad(rng.uniform(-AROUND_DEG, AROUND_DEG))
    turn = [float(np.cos(0.5 * yaw)), 0.0, 0.0, float(np.sin(0.5 * yaw))]
    height = float(robot.postures["reach_ready"][2])
    data["start"]["base"] = {"position": [float(x), float(y), height], "quaternion_wxyz": turn}
    search = find_stance(parse_request(data), STANCE_LIMIT_S, radius, robot=robot, takes_first=True)
    whole = [place for place in search.candidates if place.outcome is not None and not place.outcome.missing]
    return whole[0] if whole else None


def open_to(case: ScannedCase, angle: float) -> ScannedCase:
    """Return a door that opens to an angle [deg]; another case as it is."""
    if "door" not in case.true:
        return case
    true, seen = ({"door": {**task["door"], "open_deg": angle}} for task in (case.true, case.seen))
    return replace(case, true=true, seen=seen)


def stand_at(data: dict[str, Any], place: StanceCandidate) -> dict[str, Any]:
    """Return a request from a place."""
    base = {"position": list(place.position), "quaternion_wxyz": list(place.quaternion_wxyz)}
    return {**data, "start": {**data["start"], "base": base}}


def scan_from(case: ScannedCase, place: StanceCandidate, file: Path, seed: int) -> None:
    """Write the scan that a lidar on the robot's head takes of a case."""
    x, y, yaw = place.base
    ahead = Rotation.from_euler("Z", yaw).apply(HEAD) + np.array([x, y, place.position[2]])
    pose = Pose.looking((float(ahead[0]), float(ahead[1]), float(ahead[2])), list(case.middle))
    cloud = scan(case.meshes, pose, SCANNER, seed)
    write_pcd(file, cloud.points, pose.viewpoint, misses=cloud.misses)


def run_plan(name: str, group: str, request: PlanRequest, robot: RobotModel | None, first_cpu: float = 0.0) -> Run:
    """Plan one request and measure it."""
    began = time.process_time()
    try:
        result = plan(request, robot=robot)
    except Exception as error:  # counted: a benchmark goes on
        text = f"{type(error).__name__}: {error}"
        return Run(name, group, "ERROR", text, time.process_time() - began, first_cpu)
    verdict = result.verdict.value
    reason = "" if verdict == "CERTIFIED" else " | ".join(result.explanation[:2])
    steps = {step: round(seconds, 2) for step, seconds in result.timings.items()}
    return Run(name, group, verdict, reason, time.process_time() - began, first_cpu, steps)


def run_scanned(case: ScannedCase, robot: RobotModel, rng: np.random.Generator, seed: int, radius: float) -> Run:
    """Choose a place, scan from there, and plan on what was seen."""
    place = choose_place(case, robot, rng, seed, radius)
    if place is None:
        return Run(case.name, case.group, "NO STANCE")
    with tempfile.TemporaryDirectory() as scratch:
        file = Path(scratch) / "scan.pcd"
        scan_from(case, place, file, seed)
        data = stand_at(make_request(case, case.seen, seed), place)
        data["scene"] = {"cloud": str(file), "floor": True}
        return run_plan(case.name, case.group, parse_request(data), robot)


def displace(
    task: dict[str, Any], rng: np.random.Generator, shares: tuple[float, float] = (1.0, 1.0)
) -> dict[str, Any]:
    """Return a task with its object moved: a valve by shares of 1 cm and 3 deg, a door by one of 1 cm in its plane."""
    moved = copy.deepcopy(task)
    if "valve" in moved:
        valve = moved["valve"]
        shift = rng.normal(size=3)
        shift *= shares[0] * DISPLACED_M / np.linalg.norm(shift)
        about = rng.normal(size=3)
        turn = Rotation.from_rotvec(np.deg2rad(shares[1] * DISPLACED_DEG) * about / np.linalg.norm(about))
        valve["centre"] = (np.array(valve["centre"]) + shift).tolist()
        valve["axis"] = turn.apply(valve["axis"]).tolist()
        if "lever" in valve:
            valve["lever"]["direction"] = turn.apply(valve["lever"]["direction"]).tolist()
        return moved
    angle = rng.uniform(0.0, 2.0 * np.pi)
    shift = shares[0] * DISPLACED_M * np.array([np.cos(angle), np.sin(angle), 0.0])
    door = moved["door"]
    for section, field in (("leaf", "hinge"), ("leaf", "edge"), ("handle", "centre")):
        door[section][field] = (np.array(door[section][field]) + shift).tolist()
    return moved


def run_displaced(case: ScannedCase, robot: RobotModel, rng: np.random.Generator, seed: int, radius: float) -> Run:
    """Plan the true object, move it, and plan again with the choices of the first plan."""
    place = choose_place(case, robot, rng, seed, radius)
    if place is None:
        return Run(case.name, case.group, "NO STANCE")
    data = stand_at(make_request(case, case.true, seed), place)
    began = time.process_time()
    result = plan(parse_request(data), robot=robot)
    first_cpu = time.process_time() - began
    if result.verdict.value != "CERTIFIED" or result.motion is None:
        return Run(case.name, case.group, "NO FIRST PLAN", " | ".join(result.explanation[:2]), first_cpu)
    with tempfile.TemporaryDirectory() as scratch:
        folder = write_result(result, Path(scratch) / "first").folder
        phase = result.motion.phases[0].name
        task = displace(case.true, rng)
        run = run_plan(case.name, case.group, _move(folder, phase, data, task), robot, first_cpu)
        part = displace(case.true, rng, (rng.uniform(), rng.uniform()))
        whole, _ = _keep(_move(folder, phase, data, task, is_compliant=True), robot)
        within, kept_cpu = _keep(_move(folder, phase, data, part, is_compliant=True), robot)
        return replace(run, kept=whole, kept_within=within, kept_cpu_s=kept_cpu)


def _move(
    folder: Path, phase: str, data: dict[str, Any], task: dict[str, Any], *, is_compliant: bool = False
) -> PlanRequest:
    """Return the request for all of an earlier plan with its object moved."""
    rest = make_rest_request(folder, phase, None, is_compliant=is_compliant)
    return replace(rest, task=parse_request({**data, "task": task}).task)


def _keep(request: PlanRequest, robot: RobotModel) -> tuple[bool, float]:
    """Return whether the earlier motion is kept and certified, and the processor time where it is."""
    began = time.process_time()
    result = plan(request, robot=robot)
    is_kept = result.verdict.value == "CERTIFIED" and "hand_displaced_mm" in result.figures
    return is_kept, time.process_time() - began if is_kept else 0.0


def print_summary(title: str, runs: Sequence[Run], *, has_first: bool = False) -> None:
    """Print a row for every group, and below the table the reasons of failures."""
    groups: dict[str, list[Run]] = defaultdict(list)
    for run in runs:
        groups[run.group].append(run)
    header = ("group", "cases", "certified", "CPU median [s]", "CPU p95 [s]")
    if has_first:
        header = (*header, "first plan, median [s]", "kept", "kept, moved by up to", "kept CPU median [s]")
    rows = []
    for group, members in [*groups.items(), ("all", list(runs))]:
        counted = [run for run in members if run.verdict not in ("NO STANCE", "NO FIRST PLAN")]
        if not counted:
            continue
        certified = sum(run.is_certified for run in counted)
        cpu = [run.cpu_s for run in counted]
        cells = [group, str(len(counted)), f"{certified}/{len(counted)} ({100.0 * certified / len(counted):.0f} %)"]
        cells += [f"{statistics.median(cpu):.1f}", f"{np.percentile(cpu, 95):.1f}"]
        if has_first:
            cells += [f"{statistics.median(run.first_cpu_s for run in counted):.1f}"]
            cells += [
                f"{sum(kept)}/{len(kept)}" for kept in zip(*((r.kept, r.kept_within) for r in counted), strict=True)
            ]
            cells += [f"{statistics.median([run.kept_cpu_s for run in counted if run.kept_within] or [0.0]):.1f}"]
        rows.append(tuple(cells))
    print_table(title, header, rows)
    for reason, count in Counter(f"{run.verdict}: {run.reason[:170]}" for run in runs if not run.is_certified).items():
        print(f"  {count} x {reason}")


def main() -> None:
    """Print the tables; write every run with ``--out``."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--valves", type=int, default=N_VALVES)
    parser.add_argument("--doors", type=int, default=N_DOORS)
    parser.add_argument("--displaced", type=int, default=N_DISPLACED, help="of each, valves and doors")
    parser.add_argument("--angle", type=float, default=OPEN_DEG, help="to which doors open [deg]")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="cases whose name contains this")
    parser.add_argument("--radius", type=float, default=0.4, help="of the places that are searched [m]")
    parser.add_argument("--out", type=Path, help="file for every run (JSON)")
    given = parser.parse_args()
    robots = {hand: load_robot("atlas", hand=hand) for hand in ("hook", "gripper")}
    done: dict[str, list[Run]] = {"valves": [], "doors": [], "displaced": []}
    plans = [
        ("valves", run_scanned, make_scanned_valves(given.valves, given.seed)),
        ("doors", run_scanned, make_scanned_doors(given.doors, given.seed)),
        ("displaced", run_displaced, make_scanned_valves(given.displaced, given.seed + 1)),
        ("displaced", run_displaced, make_scanned_doors(given.displaced, given.seed + 1)),
    ]
    for table, run, cases in plans:
        cases = [open_to(case, given.angle) for case in cases]
        for number, case in enumerate(cases):
            if given.only not in case.name:
                continue
            rng = np.random.default_rng([given.seed, number, len(table)])
            made = run(case, robots[case.hand], rng, given.seed, given.radius)
            done[table].append(made)
            print(f"{table} {made.name}: {made.verdict} {made.cpu_s:.1f} s {made.reason[:160]}", flush=True)
            if given.out is not None:
                given.out.write_text(json.dumps({k: [asdict(r) for r in v] for k, v in done.items()}, indent=1) + "\n")
    if done["valves"]:
        print_summary("Valves from scans", done["valves"])
    if done["doors"]:
        print_summary(f"Doors from scans, to {given.angle:g} deg", done["doors"])
    if done["displaced"]:
        print_summary("Objects moved after the plan, planned again with its choices", done["displaced"], has_first=True)


if __name__ == "__main__":
    main()
