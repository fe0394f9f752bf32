"""Clearance check of many single poses of a robot with few pairs: one call of pinocchio and coal per pose."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.collision.compiled_poses import CompiledPosesChecker
from costs.collision.pairs import PairMargins
from costs.collision.poses import PoseChecker
from costs.collision.shapes import make_convex, make_outer_convex
from costs.kinematics import KinematicsEngine
from costs.native import find_library
from costs.robot.model import RobotModel
from costs.scene import Scene

_MOST_PAIRS = 3000  # each takes 8 us and 9 kB once, as much as a hundredth of a pose's check in numpy


class ManyPosesChecker:
    """Answers as ``PoseChecker`` does, three times faster, after some milliseconds of preparation."""

    def __init__(self, robot: RobotModel, scene: Scene, margins: PairMargins) -> None:
        self._model, self._data = robot.model, robot.model.createData()
        geometry = pin.GeometryModel()
        for number, body in enumerate(robot.bodies):
            _add_convex(geometry, f"body {number}", body.joint, make_outer_convex(body))
        for number, piece in enumerate(scene.pieces):
            _add_convex(geometry, f"piece {number}", 0, make_convex(piece.vertices))
        required = _arrange_margins(margins)
        geometry.setCollisionPairs(required > 0.0, True)
        # The manager reads the model, the margins and the placements from here at every call.
        self._geometry, self._geometry_data = geometry, geometry.createData()
        self._geometry_data.setSecurityMargins(geometry, required, True)
        self._manager = pin.BroadPhaseManager_DynamicAABBTreeCollisionManager(
            self._model, self._geometry, self._geometry_data
        )

    def are_clear(self, q: Float[np.ndarray, "T n"]) -> bool:
        """Return whether no pair at any pose is nearer than its margin."""
        collide = pin.computeCollisions
        return not any(collide(self._model, self._data, self._manager, pose, True) for pose in q)


SearchChecker = PoseChecker | ManyPosesChecker | CompiledPosesChecker
"""Any checker of single poses."""


def make_search_checker(engine: KinematicsEngine, scene: Scene, margins: PairMargins) -> SearchChecker:
    """Return the fastest checker for a search: that of the library, of many poses unless there are too many pairs."""
    library = find_library()
    if library is not None:
        return CompiledPosesChecker(library, engine.robot, scene, margins)
    if count_checked(margins) > _MOST_PAIRS:
        return PoseChecker(engine, scene, margins)
    return ManyPosesChecker(engine.robot, scene, margins)


def count_checked(margins: PairMargins) -> int:
    """Return the number of pairs that are checked: those that may touch are not."""
    return int((margins.world > 0.0).sum() + (margins.own > 0.0).sum())


def _arrange_margins(margins: PairMargins) -> Float[np.ndarray, "N N"]:
    """Arrange the margins of bodies, then pieces, above the diagonal; 0 where a pair is not checked."""
    n_bodies, n_pieces = margins.world.shape
    required = np.zeros((n_bodies + n_pieces, n_bodies + n_pieces))
    required[:n_bodies, n_bodies:] = np.maximum(margins.world, 0.0)
    first, second = np.sort(margins.self_pairs, axis=1).T
    required[first, second] = np.maximum(margins.own, 0.0)
    return required


def _add_convex(geometry: pin.GeometryModel, name: str, joint: int, convex: coal.Convex) -> None:
    """Add a convex in a joint's frame."""
    geometry.addGeometryObject(pin.GeometryObject(name, joint, pin.SE3.Identity(), convex))
