"""Clearance check of single poses: bounding spheres in numpy, then coal for near pairs, the nearest first."""

from __future__ import annotations

import coal
import numpy as np
from jaxtyping import Float

from costs.collision.pairs import PairMargins
from costs.collision.shapes import make_convex, make_outer_convex
from costs.collision.sweep import BodyVertices
from costs.kinematics import KinematicsEngine
from costs.scene import Scene

_IDENTITY = coal.Transform3s()


class PoseChecker:
    """Checks many poses at once for pairs nearer than their margin; motion between poses is not checked.

    Pairs that may touch are not checked.
    """

    def __init__(self, engine: KinematicsEngine, scene: Scene, margins: PairMargins) -> None:
        self._engine, robot = engine, engine.robot
        self._bodies = BodyVertices.of(robot)
        self._shapes = [make_outer_convex(body) for body in robot.bodies]
        self._pieces = [make_convex(piece.vertices) for piece in scene.pieces]
        self._middle = np.array([0.5 * (piece.lower + piece.upper) for piece in scene.pieces]).reshape(-1, 3)
        self._half = np.array([0.5 * (piece.upper - piece.lower) for piece in scene.pieces]).reshape(-1, 3)
        self._pairs, self._own_margin = margins.self_pairs.tolist(), margins.own.tolist()
        self._world_margin = margins.world.tolist()
        self._reach = np.maximum(self._bodies.radius[:, None] + margins.world, 0.0)
        self._first, self._second = np.ascontiguousarray(margins.self_pairs.T)
        radius = self._bodies.radius
        self._own_reach = np.maximum(radius[self._first] + radius[self._second] + margins.own, 0.0)
        self._squared_reach, self._squared_own_reach = self._reach**2, self._own_reach**2
        self._functors: dict[tuple[bool, int, int], coal.ComputeDistance] = {}
        self._request = coal.DistanceRequest()
        self._request.enable_signed_distance = False
        self._result = coal.DistanceResult()

    def are_clear(self, q: Float[np.ndarray, "T n"]) -> bool:
        """Return whether no pair at any pose is nearer than its margin."""
        kinematics = self._engine.place(q)
        centres = self._bodies.centres_in_world(kinematics)
        gap = np.abs(centres[:, :, None] - self._middle)
        gap -= self._half
        np.maximum(gap, 0.0, out=gap)
        squared = np.einsum("tbpk,tbpk->tbp", gap, gap)
        apart = centres[:, self._first] - centres[:, self._second]
        own_squared = np.einsum("tpk,tpk->tp", apart, apart)
        pose, body, piece = np.nonzero(squared < self._squared_reach)
        own_pose, pair = np.nonzero(own_squared < self._squared_own_reach)
        size = len(pose)
        if not size and not len(own_pose):
            return True
        # The deepest pairs by their spheres come first: most poses in collision end at the first queries.
        excess = np.sqrt(squared[pose, body, piece]) - self._reach[body, piece]
        own_excess = np.sqrt(own_squared[own_pose, pair]) - self._own_reach[pair]
        order = np.argsort(np.concatenate([excess, own_excess]), kind="stable")
        transforms: dict[tuple[int, int], coal.Transform3s] = {}

        def place(t: int, b: int) -> coal.Transform3s:
            known = transforms.get((t, b))
            if known is None:
                joint = self._bodies.joint[b]
                known = coal.Transform3s(kinematics.rotation[t, joint], kinematics.position[t, joint])
                transforms[t, b] = known
            return known

        poses, bodies, pieces = pose.tolist(), body.tolist(), piece.tolist()
        own_poses, pairs = own_pose.tolist(), pair.tolist()
        for row in order.tolist():
            if row < size:
                t, b, other = poses[row], bodies[row], pieces[row]
                there, margin, is_self = _IDENTITY, self._world_margin[b][other], False
            else:
                t, k = own_poses[row - size], pairs[row - size]
                b, other = self._pairs[k]
                there, margin, is_self = place(t, other), self._own_margin[k], True
            self._result.clear()
            if self._get_functor(is_self, b, other)(place(t, b), there, self._request, self._result) < margin:
                return False
        return True

    def _get_functor(self, is_self: bool, body: int, other: int) -> coal.ComputeDistance:
        key = (is_self, body, other)
        functor = self._functors.get(key)
        if functor is None:
            target = self._shapes[other] if is_self else self._pieces[other]
            functor = self._functors[key] = coal.ComputeDistance(self._shapes[body], target)
        return functor
