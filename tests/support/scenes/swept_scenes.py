"""Random scenes, small motions and the rotation bound, for tests of the swept collision checker."""

from __future__ import annotations

import numpy as np
from convex_distance import box
from scipy.spatial.transform import Rotation
from tiny_robots import random_configurations

from costs.collision import Contacts, PairMargins, SweptCollisionChecker
from costs.kinematics import Kinematics, KinematicsEngine
from costs.robot import RobotModel
from costs.scene import ConvexPiece, Scene
from costs.state import MotionState


def random_scene(rng: np.random.Generator, count: int, spread: float, centre=(0.0, 0.0, 0.0)) -> Scene:
    """Turned boxes of 5 to 40 cm, within ``spread`` of a centre."""
    pieces = []
    for k in range(count):
        turn = Rotation.random(random_state=int(rng.integers(1 << 30)))
        corners = turn.apply(box(np.zeros(3), rng.uniform(0.05, 0.4, 3))) + rng.uniform(-spread, spread, 3)
        pieces.append(ConvexPiece(f"piece{k}", corners + np.asarray(centre)))
    return Scene(tuple(pieces))


def random_motion(robot: RobotModel, rng: np.random.Generator, n_waypoints: int, step: float) -> np.ndarray:
    """(T, n) a random walk from a random configuration, the steps about ``step`` in every coordinate."""
    start = 0.5 * random_configurations(robot, rng, 1)
    return start + np.cumsum(step * rng.normal(size=(n_waypoints, robot.n)), axis=0)


def state_of(robot: RobotModel, checker: SweptCollisionChecker):
    """Maps an iterate to its kinematics and swept contacts."""
    engine = KinematicsEngine(robot)

    def make(x: np.ndarray) -> MotionState:
        kinematics = engine(x)
        return MotionState(kinematics, checker(kinematics))

    return make


def checker_of(robot: RobotModel, scene: Scene, margin: float, **options) -> SweptCollisionChecker:
    """A checker with one margin for all pairs."""
    buffer = options.pop("buffer", 0.04)
    return SweptCollisionChecker(robot, scene, PairMargins.of(robot, scene, margin, **options), buffer)


def keys(contacts: Contacts) -> list[tuple[int, int, int, bool]]:
    """Interval, body, other and kind of every contact; a self pair in the order of its indices."""
    found = []
    for first, body, other, is_self in zip(
        contacts.first.tolist(), contacts.body.tolist(), contacts.other.tolist(), contacts.is_self.tolist(), strict=True
    ):
        pair = (min(body, other), max(body, other)) if is_self else (body, other)
        found.append((first, *pair, bool(is_self)))
    return found


def body_in_world(robot: RobotModel, kinematics: Kinematics, waypoint: int, body: int) -> np.ndarray:
    """(W, 3) vertices of a body's outer hull at a waypoint."""
    link = robot.bodies[body]
    return np.asarray(
        link.outer @ kinematics.rotation[waypoint, link.joint].T + kinematics.position[waypoint, link.joint]
    )


def body_in_body(robot: RobotModel, kinematics: Kinematics, waypoint: int, moving: int, still: int) -> np.ndarray:
    """(W, 3) vertices of one body in the frame of the joint that carries another."""
    joint = robot.bodies[still].joint
    world = body_in_world(robot, kinematics, waypoint, moving)
    return np.asarray((world - kinematics.position[waypoint, joint]) @ kinematics.rotation[waypoint, joint])


def chord_deviation_bound(robot: RobotModel, dq: np.ndarray, body: int, carrier: int = 0) -> float:
    """How far a point of a body leaves its chord while the joints move linearly by ``dq``, at most [m].

    ``1/8 sum_ij |dq_i| |dq_j| r_k``, k the more distal of i and j, r_k the reach from joint k to the body's farthest
    point whatever the configuration; only what lies between the carrier joint and the body counts.  Revolute joints
    and a base of translation and z-y-x angles only; the carrier must be an ancestor.
    """
    model = robot.model
    link = robot.bodies[body]
    reach = float(np.linalg.norm(link.outer, axis=1).max())
    rates, reaches = [], []
    joint = link.joint
    while joint != carrier:
        first, count = model.joints[joint].idx_v, model.joints[joint].nv
        turning = list(range(first + 3, first + 6)) if count == 6 else [first]
        rates += [abs(dq[k]) for k in turning]
        reaches += [reach] * len(turning)
        reach += float(np.linalg.norm(model.jointPlacements[joint].translation))
        joint = int(model.parents[joint])
    # the lists run from the most distal coordinate inwards, so the distal one of a pair has the smaller index
    return sum(rates[i] * rates[j] * reaches[min(i, j)] for i in range(len(rates)) for j in range(len(rates))) / 8.0
