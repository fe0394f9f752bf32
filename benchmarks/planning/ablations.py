"""Effect of each part of the optimiser: one straight start each, with the part switched off or changed.

``python -m benchmarks.planning.ablations [--panda FOLDER] [--scenes N] [--only NAME ...]``

Panda problems are those of a problem set's folder (MotionBenchMaker, MBM), Atlas problems are whole-body reaches among
60 boxes that are known to be solvable.  A start is solved when every constraint is kept at the waypoints and swept
between them; it is clear when 20 poses of each interval are.  Processor time is that of the optimiser.

Tried and not kept, measured on 252 straight starts of the Panda (219 solved as it was, 10.3 subproblems, 47 ms) and 56
of Atlas (48 solved, 16.4 subproblems, 517 ms): mu raised for violated constraints only (219, 10.3, 48 ms; 49, 16.4,
510 ms), only the rows that a trust box can make active (220, 10.4, 50 ms; 45, 15.9, 460 ms), the trust box of each
joint scaled by how far it carries the links (217, 10.0, 49 ms; 47, 14.9, 456 ms), correction of equalities only (220,
10.3, 40 ms; 46, 16.2, 507 ms), witness points decomposed over the supporting vertices (exact gradients, but Atlas
reaches took twice as long).  Non-monotone acceptance against the largest of three merits gained a little with a shrink
of 0.1 (225, 9.8, 47 ms; 52, 15.3, 460 ms) before the box was fitted to rejected steps; it is not in.  The correction of
rejected steps by a second quadratic program gave way to the least-norm correction of every step: 80 whole plans of
Atlas among 60 and 120 boxes took 4,340 quadratic programs with the one and 2,870 with the other, which holds the feet.
"""

from __future__ import annotations

import argparse
import os
import statistics
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice, pairwise
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from benchmarks.planning.crowded_scenes import crowded_scenes
from benchmarks.tables import print_table
from costs.collision import PairMargins, PoseChecker
from costs.robot import RobotModel, load_robot
from costs.state import MotionState
from scopt import Problem, Settings, TrustRegionSQP
from service.bench.problem_set import BenchRobot, read_problems
from service.body.aims import Aims
from service.body.monitor import Monitor
from service.body.paths import straight_path
from service.body.phases import PhaseSolver
from service.body.poses import find_pose
from service.body.task_plan import Solved
from service.body.whole_body import WholeBody
from service.request.schema import PlanRequest
from service.setup.prepare import prepare
from service.tasks.reach.goal import Goal

PANDA = Path(os.environ.get("SCOPT_DATA", Path(__file__).parents[3] / "shared" / "data")) / "mbm_panda"
PANDA_WAYPOINTS = (12, 16, 20)  # each problem is solved with each number of waypoints
ATLAS_WAYPOINTS = (10,)
N_SCENES, N_BOXES = 12, 60
POSES = 20  # per interval in the dense check


@dataclass(frozen=True)
class Case:
    """A problem with its start."""

    body: WholeBody
    problem: Problem[MotionState]
    start: Float[np.ndarray, "T n"]


@dataclass(frozen=True)
class Variant:
    """The optimiser with one part switched off or changed.

    Attributes:
        settings: those that differ from the defaults.
        change: applied to the problem.
    """

    settings: Mapping[str, Any] = field(default_factory=dict)
    change: Callable[[Case], Problem[MotionState]] = lambda case: case.problem


def loose_base(case: Case) -> Problem[MotionState]:
    """Let a correction move the base like any joint."""
    return replace(case.problem, mobility=None)


def unscaled(case: Case) -> Problem[MotionState]:
    """Give the base the same trust radius as a joint."""
    return replace(case.problem, step_scale=None)


VARIANTS: Mapping[str, Variant] = {
    "as it is": Variant(),
    "no second-order correction": Variant({"is_corrected": False}),
    "shrink 0.1 (Schulman et al.)": Variant({"shrink": 0.1}),
    "shrink 0.5": Variant({"shrink": 0.5}),
    "first box 0.1 (Schulman et al.)": Variant({"trust_radius": 0.1}),
    "first box 0.6": Variant({"trust_radius": 0.6}),
    "first penalty 1": Variant({"penalty": 1.0}),
    "first penalty 100": Variant({"penalty": 100.0}),
    "no early end once feasible": Variant({"min_improvement_feasible": 1e-3}),
    "no end at acceptable clearance": Variant({"acceptable_steps": 1000}),
    "base not scaled": Variant(change=unscaled),
    "base corrected like a joint": Variant(change=loose_base),
}


@dataclass(frozen=True)
class Run:
    """Outcome of one start."""

    is_solved: bool
    is_clear: bool
    subproblems: int
    cpu_s: float


def run(case: Case, variant: Variant) -> Run:
    """Solve one start."""
    problem = variant.change(case)
    solver = TrustRegionSQP(replace(Settings(), **variant.settings))
    started = time.process_time()
    result = solver.solve(problem, case.start)
    cpu_s = time.process_time() - started
    is_solved = Solved(result, case.problem, case.body).is_feasible
    return Run(is_solved, is_solved and is_clear(case.body, result.x), len(result.history), cpu_s)


def is_clear(body: WholeBody, x: Float[np.ndarray, "T n"]) -> bool:
    """Whether the straight lines between waypoints touch nothing, at many poses."""
    margins = PairMargins.of(body.robot, body.scene, 0.0, body.standing_allowances())
    s = np.linspace(0.0, 1.0, POSES)[:, None]
    poses = np.concatenate([first + s * (last - first) for first, last in pairwise(x)])
    return PoseChecker(body.engine, body.scene, margins).are_clear(poses)


def cases_of(request: PlanRequest, robot: RobotModel, counts: Sequence[int]) -> Iterator[Case]:
    """Yield the straight line to the goal per number of waypoints; nothing if no pose at the goal is found."""
    setup = prepare(request, robot=robot)
    aims = Aims(request.options.margin_m, request.options.balance_margin_m)
    body = WholeBody.standing(setup.robot, setup.scene, setup.start, setup.contacts, aims)
    solver = PhaseSolver(body, Monitor(float("inf")), Settings())
    if request.goal is None:
        raise ValueError("a request with a goal is needed")
    goal = Goal.of(body, request.goal)
    end = goal.apply_joints(body.nominal)
    if not goal.is_complete:
        pose = find_pose(solver.pose_problem("goal pose", goal.constraints(0), fixed=goal.joints), [("start", end)])
        if not pose.is_feasible:
            return
        end = pose.x[0]
    for count in counts:
        start = straight_path(body.nominal, end, count)
        at_ends = {0: start[0], count - 1: end} if goal.is_complete else {0: start[0]}
        as_it_is = replace(solver, settings=Settings(max_iterations=0))
        posed = as_it_is.solve_trajectory(
            "reach", start, at_ends, constraints=goal.constraints(count - 1), bounds=goal.fix_joints
        )
        yield Case(body, posed.problem, start)


def panda_cases(folder: Path) -> list[Case]:
    """Return all problems of a folder."""
    files = BenchRobot(folder / "panda_bench" / "panda.urdf", folder / "panda_bench" / "panda.srdf", folder)
    robot = load_robot(urdf=files.urdf, srdf=files.srdf, package_dirs=[folder])
    problems = read_problems(folder, files, {})
    return [case for problem in problems for case in cases_of(problem.request, robot, PANDA_WAYPOINTS)]


def atlas_cases(n_scenes: int) -> list[Case]:
    """Return crowded scenes whose straight line is not a solution."""
    robot = load_robot("atlas")
    scenes = (s for s in crowded_scenes(robot, N_BOXES, is_pose=True) if not s.is_straight_enough)
    return [case for scene in islice(scenes, n_scenes) for case in cases_of(scene.request, robot, ATLAS_WAYPOINTS)]


def print_variants(title: str, cases: Sequence[Case], names: Sequence[str]) -> None:
    """Print a table of variants."""
    rows = []
    for name in names:
        runs = [run(case, VARIANTS[name]) for case in cases]
        counted = (sum(r.is_solved for r in runs), sum(r.is_clear for r in runs))
        steps = statistics.mean(r.subproblems for r in runs)
        cpu = [1e3 * r.cpu_s for r in runs]
        figures = (f"{steps:.1f}", f"{statistics.median(cpu):.0f}", f"{statistics.mean(cpu):.0f}")
        rows.append((name, *map(str, counted), *figures))
    header = ("variant", "solved", "clear", "subproblems", "CPU median [ms]", "CPU mean [ms]")
    print_table(f"{title}: {len(cases)} straight starts", header, rows)


def main() -> None:
    """Print a table for each robot."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--panda", type=Path, default=PANDA, help="folder of the problem set")
    parser.add_argument("--scenes", type=int, default=N_SCENES, help="Atlas scenes")
    parser.add_argument("--only", nargs="+", choices=list(VARIANTS), default=list(VARIANTS), metavar="VARIANT")
    options = parser.parse_args()
    if options.panda.is_dir():
        print_variants("Panda, MBM", panda_cases(options.panda), options.only)
    if options.scenes:
        print_variants(f"Atlas among {N_BOXES} boxes", atlas_cases(options.scenes), options.only)


if __name__ == "__main__":
    main()
