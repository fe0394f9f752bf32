"""An arm of two links reaches a point, first without and then with a cost that pulls its elbow to a height.

Prints the mean height of the elbow in both cases.  The cost is a residual written in this file: one class with
value and derivative.  Both are functions of the state that all terms share, here the kinematics of all waypoints.
"""

import tempfile
from pathlib import Path

import numpy as np

from costs import Contacts, FramePose, JointDifference, KinematicsEngine, MotionState, load_robot
from scopt import AffineRows, Constraint, Cost, Problem, Residual, Sense, TrustRegionSQP

URDF = """<robot name="arm">
  <link name="base"/><link name="upper"/><link name="fore"/><link name="wrist"/><link name="tip"/>
  <joint name="shoulder_pan" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" velocity="2" effort="50"/></joint>
  <joint name="shoulder_lift" type="revolute"><parent link="upper"/><child link="fore"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" velocity="2" effort="50"/></joint>
  <joint name="elbow" type="revolute"><origin xyz="0.5 0 0"/><parent link="fore"/><child link="wrist"/>
    <axis xyz="0 1 0"/><limit lower="-3" upper="3" velocity="2" effort="50"/></joint>
  <joint name="end" type="fixed"><origin xyz="0.5 0 0"/><parent link="wrist"/><child link="tip"/></joint>
</robot>"""
N_WAYPOINTS = 10


class ElbowHeight(Residual[MotionState]):
    """Height of the elbow above a target height, one row per waypoint [m]."""

    def __init__(self, joint: int, height: float) -> None:
        self.joint, self.height = joint, height

    def value(self, state: MotionState) -> np.ndarray:
        return state.kinematics.position[:, self.joint, 2] - self.height

    def linearize(self, state: MotionState) -> AffineRows:
        kinematics = state.kinematics
        waypoints = np.arange(kinematics.n_waypoints)
        up = np.tile([0.0, 0.0, 1.0], (len(waypoints), 1))
        joint = np.full(len(waypoints), self.joint)
        rows = kinematics.directional_jacobian(waypoints, joint, kinematics.position[:, self.joint], up)
        return AffineRows.from_blocks(self.value(state), waypoints, rows[:, None], kinematics.n_waypoints)


with tempfile.TemporaryDirectory() as folder:
    (Path(folder) / "arm.urdf").write_text(URDF)
    robot = load_robot(urdf=Path(folder) / "arm.urdf")

engine = KinematicsEngine(robot)
elbow = robot.model.getJointId("elbow")
start = np.array([0.0, 0.4, -0.8])
lower, upper = np.tile(robot.lower, (N_WAYPOINTS, 1)), np.tile(robot.upper, (N_WAYPOINTS, 1))
lower[0] = upper[0] = start
target = np.eye(4)
target[:3, 3] = [0.4, 0.5, 0.2]  # [m]
reach = FramePose(robot, "tip", [N_WAYPOINTS - 1], target, axes=(True, True, True, False, False, False))

for weight in (None, 20.0):  # [cost/m^2]
    costs = [Cost("displacement", JointDifference(N_WAYPOINTS, np.ones(robot.n)))]
    if weight is not None:
        costs.append(Cost("elbow height", ElbowHeight(elbow, height=0.45), weight))
    problem = Problem(
        lower,
        upper,
        tuple(costs),
        (Constraint("tip at target", reach, Sense.EQUAL_ZERO),),
        state=lambda x: MotionState(engine(x), Contacts.none()),
    )
    result = TrustRegionSQP().solve(problem, np.tile(start, (N_WAYPOINTS, 1)))
    height = engine(result.x).position[:, elbow, 2]
    miss = max(result.violation.values())
    print(f"{result.message}; elbow {height.mean():.2f} m high on average, tip off by {miss:.1e} m")
