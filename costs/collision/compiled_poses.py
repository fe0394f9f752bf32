"""Clearance check of single poses by the compiled library: one call of pinocchio and one of the library per pose."""

from __future__ import annotations

import ctypes

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.collision.pairs import PairMargins
from costs.collision.sweep import BodyVertices
from costs.native import HullSet, bind
from costs.robot.model import RobotModel
from costs.scene import Scene
from costs.work_space import make_work_space


class CompiledPosesChecker:
    """Answers as ``PoseChecker`` does, except that a pair whose distance rounding hides counts as near."""

    def __init__(self, library: ctypes.CDLL, robot: RobotModel, scene: Scene, margins: PairMargins) -> None:
        self._space = make_work_space(robot.model)
        bodies, hulls = BodyVertices.of(robot), HullSet.of([body.outer for body in robot.bodies])
        pieces = HullSet.of([piece.vertices for piece in scene.pieces])
        n_bodies, n_pieces, n_pairs = len(robot.bodies), len(scene.pieces), len(margins.self_pairs)
        self._is_any_near = bind(
            library.scopt_is_any_near,
            ctypes.c_void_p(self._space.placements.__array_interface__["data"][0]),
            self._space.placements.strides[0] // 8,
            n_bodies,
            np.ascontiguousarray(bodies.joint),
            hulls.points,
            hulls.first,
            np.ascontiguousarray(bodies.centre),
            np.ascontiguousarray(bodies.radius),
            n_pieces,
            pieces.points,
            pieces.first,
            np.array([piece.lower for piece in scene.pieces]).reshape(-1, 3),
            np.array([piece.upper for piece in scene.pieces]).reshape(-1, 3),
            np.ascontiguousarray(margins.world, dtype=float),
            n_pairs,
            np.ascontiguousarray(margins.self_pairs, dtype=np.int64),
            np.ascontiguousarray(margins.own, dtype=float),
            np.empty((n_bodies, 15)),
            np.empty((n_bodies * n_pieces + n_pairs, 3)),
        )

    def are_clear(self, q: Float[np.ndarray, "T n"]) -> bool:
        """Return whether no pair at any pose is nearer than its margin."""
        place, model, data, is_any_near = pin.forwardKinematics, self._space.model, self._space.data, self._is_any_near
        for pose in q:
            place(model, data, pose)
            if is_any_near():
                return False
        return True
