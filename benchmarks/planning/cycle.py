"""One subproblem cycle of Atlas: kinematics, swept collision, linearisation, assembly and QP, part by part.

The robot stands on both feet among boxes a few millimetres from its path and reaches for a point with its left tool, so
feet, balance, pose, collision and self-collision all have rows.
"""

from __future__ import annotations

import statistics

import numpy as np
from jaxtyping import Float

from benchmarks.tables import Samples, print_table
from costs.collision import PairMargins, SweptCollisionChecker
from costs.kinematics import KinematicsEngine
from costs.robot import RobotModel, load_robot
from costs.scene import ConvexPiece, Scene
from costs.state import MotionState
from costs.terms import FramePose
from scopt import Constraint, Problem, Sense
from scopt.convex_model import assemble, convexify
from scopt.qp import select_backend
from service.body.aims import Aims
from service.body.whole_body import WholeBody

N_WAYPOINTS = 20
N_PIECES = 60
N_RUNS = 30
TARGET_MS = 16.0
TRUST_RADIUS = 0.3
PENALTY = 10.0
CLEAR_OF_PATH = 5e-3  # [m]
CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])


def boxes_around(robot: RobotModel, x: Float[np.ndarray, "T n"]) -> Scene:
    """Return a floor and boxes of 5 to 40 cm around the robot, as near as its waypoints allow."""
    rng = np.random.default_rng(4)
    floor = ConvexPiece("floor", np.array([0.0, 0.0, -0.05]) + CORNERS * [6.0, 6.0, 0.1], "floor")
    kinematics = KinematicsEngine(robot)(x)
    pieces: list[ConvexPiece] = []
    while len(pieces) < N_PIECES - 1:
        angle, radius, height = rng.uniform(-np.pi, np.pi), rng.uniform(0.2, 1.2), rng.uniform(0.3, 1.8)
        centre = np.array([radius * np.cos(angle), radius * np.sin(angle), height])
        piece = ConvexPiece(f"box{len(pieces)}", centre + CORNERS * rng.uniform(0.05, 0.4, 3))
        alone = Scene((piece,))
        contacts = SweptCollisionChecker(robot, alone, PairMargins.of(robot, alone, 0.0), buffer=CLEAR_OF_PATH)(
            kinematics
        )
        if contacts.is_self.all():
            pieces.append(piece)
    return Scene((floor, *pieces))


def reaching_problem() -> tuple[Problem[MotionState], WholeBody, SweptCollisionChecker, Float[np.ndarray, "T n"]]:
    """Return the problem, its body and checker, and the iterate at which the cycle is measured."""
    robot = load_robot("atlas")
    stand, ready = robot.postures["stand"], robot.postures["reach_ready"]
    x = stand + np.linspace(0.0, 1.0, N_WAYPOINTS)[:, None] * (ready - stand)
    body = WholeBody.standing(robot, boxes_around(robot, x), stand, ("l_foot", "r_foot"), Aims())
    checker = body.make_checker(ends=[stand])
    lower, upper = body.bounds(N_WAYPOINTS, {0: stand})
    target = np.eye(4)
    target[:3, 3] = [0.6, 0.3, 1.1]
    place = FramePose(robot, "l_tool", [N_WAYPOINTS - 1], target, (True,) * 3 + (False,) * 3)
    reach = Constraint("reach", place, Sense.EQUAL_ZERO)
    return body.make_problem(lower, upper, checker, constraints=[reach]), body, checker, x


def main() -> None:
    """Print the median wall and processor time of every part."""
    problem, body, checker, x = reaching_problem()
    solve = select_backend("piqp")
    is_free = (problem.upper > problem.lower).ravel()
    box = np.tile(TRUST_RADIUS * body.step_scale(), N_WAYPOINTS)
    parts = {name: Samples() for name in ("kinematics", "collision", "linearise", "assemble", "QP")}
    for _ in range(N_RUNS):
        kinematics = parts["kinematics"].measure(body.engine, x)
        contacts = parts["collision"].measure(checker, kinematics)
        state = MotionState(kinematics, contacts)
        model = parts["linearise"].measure(convexify, problem, state, PENALTY)
        subproblem = parts["assemble"].measure(assemble, model, is_free)
        lower, upper = (problem.lower - x).ravel(), (problem.upper - x).ravel()
        program = subproblem.bound_steps(np.maximum(lower, -box), np.minimum(upper, box))
        if not parts["QP"].measure(solve, program).is_usable:
            raise RuntimeError("the QP of the benchmark was not solved")
    rows = []
    for name, samples in parts.items():
        rows.append(
            (name, f"{1e3 * statistics.median(samples.wall):.2f}", f"{1e3 * statistics.median(samples.cpu):.2f}")
        )
    wall, cpu = (sum(float(row[k]) for row in rows) for k in (1, 2))
    rows.append((f"cycle (target {TARGET_MS:g})", f"{wall:.2f}", f"{cpu:.2f}"))
    n_self = int(contacts.is_self.sum())
    print_table(
        f"Atlas subproblem cycle, {N_WAYPOINTS} waypoints, {N_PIECES} pieces [ms, median of {N_RUNS}]: "
        f"{len(program.c)} variables, {len(program.h)} rows, {len(contacts) - n_self} world and {n_self} self contacts",
        ("part", "wall", "cpu"),
        rows,
    )


if __name__ == "__main__":
    main()
