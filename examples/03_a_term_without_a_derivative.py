"""Atlas reaches over a table, first without and then with a cost that raises its left elbow.

Prints the height of the elbow and the verdict of both plans.  The cost is written in this file with its value only; its
derivative comes from finite differences, which are checked as they are computed.  The last line compares the written
derivative of a second residual with finite differences.
"""

import sys

import numpy as np

from costs import Contacts, KinematicsEngine, MotionState, RobotModel, load_robot, locate_frame
from scopt import AffineRows, Cost, Penalty, Residual, check_derivative
from service import parse_request, plan

LINK = "l_larm"  # the lower arm; its joint is the elbow
REQUEST = {
    "robot": {"name": "atlas"},
    "scene": {"obstacles": [{"name": "table", "type": "box", "size": [0.5, 1.2, 0.05], "position": [0.75, 0.0, 0.9]}]},
    "goal": {"poses": [{"link": "l_tool", "position": [0.6, 0.2, 1.15]}]},
}


class BelowHeight(Residual[MotionState]):
    """Distance of the elbow below a target height, one row per waypoint [m]."""

    def __init__(self, robot: RobotModel, height: float) -> None:
        self.joint, _ = locate_frame(robot, LINK)
        self.height = height

    def value(self, state: MotionState) -> np.ndarray:
        return self.height - state.kinematics.position[:, self.joint, 2]


class BelowHeightFaster(BelowHeight):
    """The same residual with a written derivative, about twenty times as fast."""

    def linearize(self, state: MotionState) -> AffineRows:
        kinematics = state.kinematics
        waypoints = np.arange(kinematics.n_waypoints)
        joint, up = np.full(len(waypoints), self.joint), np.tile([0.0, 0.0, 1.0], (len(waypoints), 1))
        rows = kinematics.directional_jacobian(waypoints, joint, kinematics.position[:, self.joint], up)
        return AffineRows.from_blocks(self.value(state), waypoints, -rows[:, None], len(waypoints))


def terms(phase: str, robot: RobotModel, n_waypoints: int) -> list[Cost[MotionState]]:
    """Return the additional terms of one planning step ("goal pose" with one waypoint, or "reach")."""
    weight = 20.0 / n_waypoints  # [cost/m], averaged over the waypoints
    return [Cost("elbow up", BelowHeight(robot, height=1.3), weight, Penalty.HINGE)]


robot = load_robot("atlas")
engine = KinematicsEngine(robot)
elbow, _ = locate_frame(robot, LINK)
for name, own in (("without", None), ("with", terms)):
    result = plan(parse_request(REQUEST), robot=robot, terms=own)
    if result.motion is None:
        sys.exit(f"{result.verdict.value}: {result.explanation}")
    height = engine(result.motion.curve(result.motion.samples)).position[:, elbow, 2]
    print(f"{name} the term: elbow {height[0]:.2f} m high at the start, {height[-1]:.2f} m at the end", end="; ")
    print(result.verdict.value)

rng = np.random.default_rng(0)
configurations = robot.postures["stand"] + 0.1 * rng.normal(size=(4, robot.n))
print(
    check_derivative(BelowHeightFaster(robot, 1.3), lambda q: MotionState(engine(q), Contacts.none()), configurations)
)
