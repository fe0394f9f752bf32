"""How far links that may turn about one or two contact points reach behind what they touch."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from costs.robot import RobotModel
from costs.rotation import make_tangent_basis
from costs.state import MotionState
from costs.terms import Joined, PointHalfSpace
from scopt import Constraint
from service.verify import GROUND_TOLERANCE_M, MOST_LEAN_RAD, TURNING_DEPTH_M, CoalSolid

FLAT_POINTS = 3  # from as many points on, a patch at its place fixes its link
MOST_LEAN = float(np.deg2rad(45.0))  # of a patch, in the search for the vertices that matter [rad]
DIRECTIONS, LEANS = 24, 4  # of that search
TOLERANCE = 5e-4  # [m]


def keep_facing(
    robot: RobotModel,
    name: str,
    normal: Float[np.ndarray, "3"],
    place: Float[np.ndarray, "3"],
    waypoints: Int[np.ndarray, "S"],
    reserve_m: float = 0.0,
) -> list[Constraint[MotionState]]:
    """Return constraints that bodies of a link do not reach behind what a patch of one or two points touches.

    The plane that they may not cross leans off it as much as the verifier allows; see
    ``service.verify.ground.measure_behind``. A patch of more points fixes its link and needs none.

    Args:
        robot: with contact patches.
        name: of the patch.
        normal: (3,) unit, of what it touches, in the world.
        place: (3,) a point of what it touches [m].
        waypoints: (S,) at which it does.
        reserve_m: of the allowed depth [m].

    Raises:
        KeyError: the robot has no such patch.
    """
    patch = robot.contacts[name]
    if len(patch.points) >= FLAT_POINTS:
        return []
    level, depth = float(normal @ place), TURNING_DEPTH_M - reserve_m
    rows = [
        PointHalfSpace(
            robot, patch.link, waypoints, -normal, depth + np.sin(MOST_LEAN_RAD) * float(reach) - level, vertex
        )
        for vertex, reach in zip(*_find_first_vertices(robot, name), strict=True)
    ]
    return [Constraint(f"side of {name}", Joined(rows), tolerance=TOLERANCE, unit="m")] if rows else []


def _find_first_vertices(robot: RobotModel, name: str) -> tuple[Float[np.ndarray, "V 3"], Float[np.ndarray, "V"]]:
    """Return the vertices (V, 3) in the link's frame that come behind first when a patch leans, and how far they are.

    Of the bodies that a point of the patch touches, the deepest vertices for leans in many directions [m].
    """
    from scipy.spatial.transform import Rotation  # slow to import

    patch = robot.contacts[name]
    placement = robot.model.frames[robot.model.getFrameId(patch.link)].placement
    rotation, origin = np.array(placement.rotation), np.array(placement.translation)
    normal = patch.normals.mean(axis=0) / np.linalg.norm(patch.normals.mean(axis=0))
    across = make_tangent_basis(normal)
    turns = np.linspace(0.0, 2.0 * np.pi, DIRECTIONS, endpoint=False)
    axes = np.cos(turns)[:, None] * across[0] + np.sin(turns)[:, None] * across[1]
    leans = np.linspace(MOST_LEAN_RAD, MOST_LEAN, LEANS)
    leaned = np.concatenate([Rotation.from_rotvec(lean * axes).apply(normal) for lean in leans])
    vertices, reaches = np.zeros((0, 3)), np.zeros(0)
    for body in robot.bodies:
        if body.link != patch.link:
            continue
        own = (body.vertices - origin) @ rotation
        near = CoalSolid.of_body(body).distances(patch.points @ rotation.T + origin) <= GROUND_TOLERANCE_M
        for point in patch.points[near]:
            offsets = own - point
            reach = np.linalg.norm(offsets, axis=1)
            behind = -offsets @ leaned.T - np.sin(MOST_LEAN_RAD) * reach[:, None]
            first = np.unique(behind.argmax(axis=0)[behind.max(axis=0) > 0.0])
            vertices, reaches = np.concatenate([vertices, own[first]]), np.concatenate([reaches, reach[first]])
    return vertices, reaches
