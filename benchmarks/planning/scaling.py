"""Growth of time and memory with waypoints, pieces and joints: ``python -m benchmarks.planning.scaling``.

A chain of revolute links among boxes one centimetre from its straight path; one of the three numbers grows, the others
stay.  Measured are the set-up of the problem and one cycle of the optimiser (kinematics, swept collision with
world and self, linearisation, quadratic program), and the memory all of it adds.
"""

from __future__ import annotations

import json
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from itertools import pairwise
from math import log
from pathlib import Path

import numpy as np
from jaxtyping import Float

from benchmarks.tables import print_table
from costs.collision import PairMargins, PoseChecker
from costs.kinematics import KinematicsEngine
from costs.robot import RobotModel, load_robot
from costs.scene import ConvexPiece, Scene
from scopt.convex_model import assemble, convexify
from scopt.qp import select_backend
from service.body.aims import Aims
from service.body.whole_body import WholeBody

ROOT = Path(__file__).resolve().parents[2]
AXES: dict[str, tuple[int, ...]] = {
    "waypoints": (10, 20, 40, 80, 160),
    "pieces": (10, 30, 100, 300, 1000, 2000),
    "joints": (7, 14, 28, 42),
}
USUAL = {"waypoints": 20, "pieces": 60, "joints": 7}
N_RUNS = 9
TRUST_RADIUS, PENALTY = 0.3, 10.0
CLEAR_OF_PATH = 0.01  # [m]
LINK = 0.15  # length [m]
CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])


def chain(folder: Path, n_joints: int) -> RobotModel:
    """Return a chain of box links whose joints alternate between the axes z and y."""
    parts = ['<robot name="chain"><link name="base"/>']
    for k in range(n_joints):
        parent, at = ("base", 0.0) if k == 0 else (f"l{k - 1}", LINK)
        parts.append(
            f'<link name="l{k}"><collision><origin xyz="{LINK / 2} 0 0"/><geometry><box size="{0.8 * LINK} 0.05 0.05"/>'
            f'</geometry></collision></link><joint name="j{k}" type="revolute"><parent link="{parent}"/>'
            f'<child link="l{k}"/><origin xyz="{at} 0 0"/><axis xyz="0 {k % 2} {1 - k % 2}"/>'
            '<limit lower="-2.5" upper="2.5" velocity="2" effort="50"/></joint>'
        )
    file = folder / "chain.urdf"
    file.write_text("".join([*parts, "</robot>"]))
    return load_robot(urdf=file)


def boxes_around(robot: RobotModel, x: Float[np.ndarray, "T n"], n_pieces: int) -> Scene:
    """Return boxes of 2 to 15 cm beside the chain's links that do not touch its waypoints."""
    rng = np.random.default_rng(4)
    engine = KinematicsEngine(robot)
    kinematics = engine(x)
    pieces: list[ConvexPiece] = []
    while len(pieces) < n_pieces:
        link = kinematics.position[rng.integers(len(x)), rng.integers(1, robot.n + 1)]
        centre = link + rng.uniform(-0.25, 0.25, 3)
        piece = ConvexPiece(f"box{len(pieces)}", centre + CORNERS * rng.uniform(0.02, 0.15, 3))
        alone = Scene((piece,))
        margins = PairMargins.of(robot, alone, CLEAR_OF_PATH)
        world = PairMargins(margins.world, margins.self_pairs[:0], margins.own[:0])
        if PoseChecker(engine, alone, world).are_clear(x):
            pieces.append(piece)
    return Scene(tuple(pieces))


def measure(waypoints: int, pieces: int, joints: int) -> dict[str, float]:
    """Return the processor time of set-up and cycle [s], and the memory that they add [MB]."""
    with tempfile.TemporaryDirectory() as folder:
        robot = chain(Path(folder), joints)
    turn = 0.35 * (-1.0) ** (np.arange(joints) // 2)
    x = np.linspace(-turn, turn, waypoints)
    scene = boxes_around(robot, x, pieces)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    started = time.process_time()
    body = WholeBody.standing(robot, scene, x[0], (), Aims())
    checker = body.make_checker(ends=[x[0], x[-1]])
    problem = body.make_problem(*body.bounds(waypoints, {0: x[0], waypoints - 1: x[-1]}), checker)
    set_up = time.process_time() - started
    solve = select_backend("piqp")
    is_free = (problem.upper > problem.lower).ravel()
    cycles = []
    for _ in range(N_RUNS):
        started = time.process_time()
        subproblem = assemble(convexify(problem, problem.state(x), PENALTY), is_free)
        lower, upper = (problem.lower - x).ravel(), (problem.upper - x).ravel()
        program = subproblem.bound_steps(np.maximum(lower, -TRUST_RADIUS), np.minimum(upper, TRUST_RADIUS))
        if not solve(program).is_usable:
            raise RuntimeError("the QP of the benchmark was not solved")
        cycles.append(time.process_time() - started)
    return {
        "set_up": set_up,
        "cycle": statistics.median(cycles),
        "rows": len(program.h),
        "memory_mb": (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024.0,
    }


def in_fresh_process(sizes: dict[str, int]) -> dict[str, float]:
    """Run ``measure`` in a new process, to measure its memory alone."""
    code = (
        "import json, sys; from benchmarks.planning.scaling import measure; "
        "print(json.dumps(measure(**json.loads(sys.argv[1]))))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, json.dumps(sizes)], cwd=ROOT, capture_output=True, text=True, check=True
    )
    found: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return found


def main() -> None:
    """Print one table per axis; the last column is the growth exponent of the cycle from the row before."""
    for axis, values in AXES.items():
        measured = [in_fresh_process({**USUAL, axis: value}) for value in values]
        growth = [""] + [
            f"{log(b['cycle'] / a['cycle']) / log(n / m):.2f}"
            for (a, b), (m, n) in zip(pairwise(measured), pairwise(values), strict=True)
        ]
        rows = [
            (
                str(value),
                f"{1e3 * found['set_up']:.1f}",
                f"{1e3 * found['cycle']:.1f}",
                str(int(found["rows"])),
                f"{found['memory_mb']:.0f}",
                exponent,
            )
            for value, found, exponent in zip(values, measured, growth, strict=True)
        ]
        others = ", ".join(f"{count} {name}" for name, count in USUAL.items() if name != axis)
        header = (axis, "set-up [ms]", "cycle [ms]", "QP rows", "memory [MB]", "exponent")
        print_table(f"growth with {axis} ({others}; processor time, median of {N_RUNS})", header, rows)


if __name__ == "__main__":
    main()
