"""Atlas reaches over a table, first without and then with two terms written as CVXPY expressions.

Prints the verdict, how far the base moves and the joints turn in all, and which joints do, then the error for an
expression that is not convex.  The first term is a cost, the sum of absolute joint displacements: it leaves joints at
rest that a sum of squares moves a little.  The second is a constraint that keeps the base within 7 mm of its start.
Both enter every convex subproblem unchanged, not linearised, and Clarabel then solves the subproblem.
"""

import sys

import cvxpy as cp
import numpy as np

from costs import MotionState, RobotModel, load_robot
from scopt import Constraint, ConvexExpression, Cost, Penalty, ProblemError
from service import parse_request, plan

REQUEST = {
    "robot": {"name": "atlas"},
    "start": {"posture": "stand"},
    "scene": {"obstacles": [{"name": "table", "type": "box", "size": [0.5, 1.2, 0.05], "position": [0.75, 0.0, 0.9]}]},
    "goal": {"poses": [{"link": "l_tool", "position": [0.6, 0.2, 1.15]}]},
}
ARMS = ("l_arm", "r_arm", "back", "neck")


def terms(phase: str, robot: RobotModel, n_waypoints: int) -> list[Cost[MotionState] | Constraint[MotionState]]:
    """Return the additional terms of one planning step ("goal pose" or "reach")."""
    rest = robot.postures["stand"]
    upper = [index for index, name in enumerate(robot.joint_names) if name.startswith(ARMS)]
    few = ConvexExpression(robot.n, lambda q: cp.norm1(q[upper] - rest[upper]))
    near = ConvexExpression(robot.n, lambda q: cp.norm(q[:3] - rest[:3]) <= 0.007)  # [m]
    return [
        Cost("few joints", few, weight=10.0 / n_waypoints, penalty=Penalty.HINGE),  # [cost/rad]
        Constraint("base stays near", near, tolerance=2e-4, unit="m"),
    ]


robot = load_robot("atlas")
for name, own in (("without", None), ("with", terms)):
    result = plan(parse_request(REQUEST), robot=robot, terms=own)
    if result.motion is None:
        sys.exit(f"{result.verdict.value}: {result.explanation}")
    q = result.motion.curve(result.motion.samples)
    turned = np.abs(q - q[0]).max(axis=0)
    moving = [joint for index, joint in enumerate(robot.joint_names) if joint.startswith(ARMS) and turned[index] > 0.02]
    base = 1e3 * np.linalg.norm(q[:, :3] - q[0, :3], axis=1).max()
    total = sum(turned[robot.joint_names.index(joint)] for joint in moving)
    figures = f"base moves {base:.1f} mm, {len(moving)} joints turn by {total:.2f} rad:"
    print(f"{name} the terms: {result.verdict.value}, {figures}", *moving)

try:
    ConvexExpression(robot.n, lambda q: cp.norm(q[:3]) >= 0.1)
except ProblemError as error:
    print(error)
