"""Planning and independent checks of a set of arm problems.

``python -m benchmarks.planning.arm [FOLDER --urdf U ...]``.

By default MotionBenchMaker's Panda problems, in ``mbm_panda`` of the folder ``SCOPT_DATA`` (default:
``../shared/data``); without it nothing is measured.  Printed are the table of ``scopt bench``, quality, the first call
of a new process, and what a judge says that looks at poses every 0.005 rad along the written paths with pinocchio and
coal alone.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from jaxtyping import Float

from benchmarks.tables import print_table
from costs.robot import LinkBody, RobotModel
from service.bench.bench import COLUMNS, list_failures, run_bench, summarize_scenes
from service.bench.problem_set import BenchProblem, BenchRobot, read_problems
from service.setup.world import build_obstacles
from service.start.robot import load_requested_robot

ROOT = Path(__file__).resolve().parents[2]
TIME_LIMIT_S = 2.0
STEP = 0.005  # between the judge's poses [rad]
CLEAR_ENDS = 0.02  # the median clearance is of problems whose ends have at least this clearance [m]
END_TOLERANCE = 1e-3  # [rad, m]
MOVED, TURNED = 0.02, 0.05  # of copies: obstacles [m], ends [rad]
CLEAR_COPY = 1e-3  # clearance of their ends [m]


class Judge:
    """Signed distances between a robot's hulls and pieces, and between its own hulls, pose by pose."""

    def __init__(self, robot: RobotModel) -> None:
        self._robot, self._data = robot, robot.model.createData()
        self._bodies = [(body, _hull(body.vertices)) for body in robot.bodies]
        self._request, self._result = coal.DistanceRequest(), coal.DistanceResult()
        self._request.enable_signed_distance = True

    def clearance(self, q: Float[np.ndarray, "T n"], pieces: Sequence[np.ndarray]) -> float:
        """Return the smallest distance at any of the poses [m], at most 0.1."""
        world = [(_hull(vertices), vertices.min(axis=0), vertices.max(axis=0)) for vertices in pieces]
        return min(self._at(pose, world) for pose in q)

    def _at(self, q: Float[np.ndarray, "n"], world: Sequence[tuple[coal.Convex, np.ndarray, np.ndarray]]) -> float:
        pin.forwardKinematics(self._robot.model, self._data, q)
        placed = [self._placed(body, hull) for body, hull in self._bodies]
        nearest, still = 0.1, coal.Transform3s()
        for body, hull, pose, low, high in placed:
            if body.link in self._robot.fixed_links:
                continue
            for piece, lower, upper in world:
                if np.linalg.norm(np.maximum(np.maximum(lower - high, low - upper), 0.0)) < nearest:
                    nearest = min(nearest, self._distance(hull, pose, piece, still))
        for k, (body, hull, pose, low, high) in enumerate(placed):
            for other, other_hull, other_pose, other_low, other_high in placed[k + 1 :]:
                pair = (min(body.link, other.link), max(body.link, other.link))
                if body.joint == other.joint or pair in self._robot.ignored_pairs:
                    continue
                if np.linalg.norm(np.maximum(np.maximum(other_low - high, low - other_high), 0.0)) < nearest:
                    nearest = min(nearest, self._distance(hull, pose, other_hull, other_pose))
        return nearest

    def _placed(self, body: LinkBody, hull: coal.Convex) -> tuple[Any, ...]:
        pose = self._data.oMi[body.joint]
        vertices = body.vertices @ pose.rotation.T + pose.translation
        at = coal.Transform3s(pose.rotation, pose.translation)
        return body, hull, at, vertices.min(axis=0), vertices.max(axis=0)

    def _distance(self, a: coal.Convex, pose_a: coal.Transform3s, b: coal.Convex, pose_b: coal.Transform3s) -> float:
        self._result.clear()
        return float(coal.distance(a, pose_a, b, pose_b, self._request, self._result))


def _hull(vertices: Float[np.ndarray, "V 3"]) -> coal.Convex:
    """Return the convex hull of a point set, made by coal."""
    points = coal.StdVec_Vec3s()
    points.extend(list(vertices))
    return coal.ConvexBase.convexHull(points, False, "Qx")


def densely(path: Float[np.ndarray, "K n"]) -> Float[np.ndarray, "T n"]:
    """Return poses at most ``STEP`` apart along a piecewise linear path."""
    counts = np.maximum(np.ceil(np.abs(np.diff(path, axis=0)).max(axis=1) / STEP).astype(int), 1)
    parts = [
        first + (last - first) * np.linspace(0.0, 1.0, count + 1)[:-1, None]
        for first, last, count in zip(path[:-1], path[1:], counts, strict=True)
    ]
    return np.concatenate([*parts, path[-1:]])


def judged(
    problems: Sequence[BenchProblem], rows: Sequence[Mapping[str, Any]], robot: RobotModel
) -> Iterator[dict[str, float]]:
    """Yield length relative to the straight line, clearances and end errors of every claimed solution."""
    judge = Judge(robot)
    for problem, row in zip(problems, rows, strict=True):
        if not row["success_claimed"]:
            continue
        columns = [problem.joints.index(joint) for joint in robot.joint_names]
        path = np.array(row["path"])[:, columns]
        request = problem.request
        assert request.goal is not None
        start = np.array([request.start.positions_by_joint[joint] for joint in robot.joint_names])
        goal = np.array([request.goal.joints[joint] for joint in robot.joint_names])
        pieces = [piece.vertices for piece in build_obstacles(request)[0]]
        length = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
        yield {
            "length": float(length / np.linalg.norm(goal - start)),
            "end_error": float(max(np.abs(path[0] - start).max(), np.abs(path[-1] - goal).max())),
            "clearance": judge.clearance(densely(path), pieces),
            "ends": judge.clearance(np.stack([start, goal]), pieces),
        }


def jitter(problems: Sequence[BenchProblem], robot: RobotModel, copies: int, seed: int = 0) -> list[BenchProblem]:
    """Return copies with every obstacle moved by up to ``MOVED`` along each axis and the ends by up to ``TURNED``.

    Ends beyond the limits or in collision are drawn again.
    """
    judge, made = Judge(robot), list[BenchProblem]()
    for k, problem in enumerate(problems):
        rng = np.random.default_rng([seed, k])
        given = (problem.request.start.positions_by_joint, problem.request.goal.joints if problem.request.goal else {})
        ends = np.array([[end[joint] for joint in robot.joint_names] for end in given])
        while len(made) < (k + 1) * copies:
            obstacles = tuple(
                replace(obstacle, position=tuple(np.array(obstacle.position) + rng.uniform(-MOVED, MOVED, 3)))
                for obstacle in problem.request.scene.obstacles
            )
            request = replace(problem.request, scene=replace(problem.request.scene, obstacles=obstacles))
            pieces = [piece.vertices for piece in build_obstacles(request)[0]]
            moved = np.clip(ends + rng.uniform(-TURNED, TURNED, ends.shape), robot.lower + 0.02, robot.upper - 0.02)
            if judge.clearance(moved, pieces) <= CLEAR_COPY:
                continue
            start, goal = (dict(zip(robot.joint_names, row.tolist(), strict=True)) for row in moved)
            assert request.goal is not None
            request = replace(
                request, start=replace(request.start, joints=start), goal=replace(request.goal, joints=goal)
            )
            made.append(replace(problem, name=f"{problem.name}~{len(made) - k * copies}", request=request))
    return made


def first_call(problems: Path, robot: BenchRobot) -> float:
    """Return the CPU time of a new process from its start to the verdict on one problem [s]."""
    code = (
        "import sys, time; from pathlib import Path; from service.bench.problem_set import BenchRobot, read_problems; "
        "from service.planner import plan; "
        "path, urdf, srdf, root = (Path(a) if a else None for a in sys.argv[1:]); "
        "plan(read_problems(path, BenchRobot(urdf, srdf, root), {'timed': False}, 1)[0].request); "
        "print(time.process_time())"
    )
    arguments = [str(problems), str(robot.urdf), str(robot.srdf or ""), str(robot.package_root or "")]
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments], cwd=ROOT, capture_output=True, text=True, check=True
    )
    return float(done.stdout.split()[-1])


def report(folder: Path, bench_robot: BenchRobot, copies: int) -> int:
    """Print everything; return 1 if the judge refutes a claim."""
    problems = read_problems(folder, bench_robot, {"time_limit_s": TIME_LIMIT_S, "timed": False})
    robot = load_requested_robot(problems[0].request)
    problems = jitter(problems, robot, copies) if copies else problems
    with tempfile.TemporaryDirectory() as scratch:
        rows = run_bench(problems, robot, Path(scratch) / "results.json", lambda name, done: None)
    print_table(
        f"{len(problems)} problems of {folder.name}, time limit {TIME_LIMIT_S:g} s", COLUMNS, summarize_scenes(rows)
    )
    for line in list_failures(rows):
        print("  not certified:", *line)
    sampled = [row for row in rows if row["start"].startswith("path of")]
    others = [1e3 * row["cpu_s"] for row in rows if not row["start"].startswith("path of")]
    slowest = 1e3 * max([row["cpu_s"] for row in sampled], default=0.0)
    print(f"  starts from a sampled path: {len(sampled)}, at most {slowest:.0f} ms")
    print(f"  plans from all other starts: at most {max(others, default=0.0):.0f} ms")
    found = list(judged(problems, rows, robot))
    length = np.median([one["length"] for one in found])
    clear = [1e3 * one["clearance"] for one in found if one["ends"] >= CLEAR_ENDS]
    end_error = max(one["end_error"] for one in found)
    false = sum(one["clearance"] <= 0.0 or one["end_error"] > END_TOLERANCE for one in found)
    print(
        f"  length {length:.2f} of the straight line (median), end points within {end_error:.0e}; clearance "
        f"{np.median(clear) if clear else float('nan'):.1f} mm (median of {len(clear)} whose ends have "
        f"{1e3 * CLEAR_ENDS:.0f} mm)"
    )
    print(f"  first call of a new process {first_call(folder, bench_robot):.2f} s CPU")
    print(f"  claims refuted by poses every {STEP} rad: {false} of {len(found)}")
    return int(false > 0)


def main() -> int:
    """Measure the problem set given on the command line, or the default one."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--urdf", type=Path)
    parser.add_argument("--srdf", type=Path)
    parser.add_argument("--package-root", type=Path)
    parser.add_argument("--copies", type=int, default=0, help="of each problem, slightly moved, in place of it")
    given = parser.parse_args()
    if given.folder is not None:
        return report(given.folder, BenchRobot(given.urdf, given.srdf, given.package_root), given.copies)
    folder = Path(os.environ.get("SCOPT_DATA", ROOT.parent / "shared" / "data")) / "mbm_panda"
    if not folder.is_dir():
        print(f"no problems at {folder} (set SCOPT_DATA)")
        return 0
    panda = folder / "panda_bench" / "panda"
    return report(folder, BenchRobot(panda.with_suffix(".urdf"), panda.with_suffix(".srdf"), folder), given.copies)


if __name__ == "__main__":
    sys.exit(main())
