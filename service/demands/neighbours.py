"""Allowances of a mechanism's links and their neighbours: pieces and links that are near them at the start.

A leaf stands in its frame, a lever in its rose, a wheel on its stem.  Scans and polytopes are not exact to the
millimetre, so that neighbours may overlap before anything moves.  What they may overlap later follows from the start
alone:

- A body of the mechanism and a piece, or two bodies of different links, that are within 5 cm of each other at the start
  may overlap by as much as they do there, and 3 mm more.  Nothing else may touch the mechanism.
- Bearings: one body turns or slides inside the other, so that the overlap of the start may grow although nothing
  collides (the corner of a polytope, a bar in its housing).  It is then measured over the whole range of the joint.
  Bearings are two links joined by a joint whose bodies overlap at the start, and a wheel (a joint that may turn by a
  whole turn) with a piece that it overlaps at the start, which are its stem and the wall around it.  A piece beside
  which a spoke merely stands at the start is no bearing.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from costs.allowance import Allowance, BodyRef
from costs.robot import LinkBody, RobotModel
from costs.scene import ConvexPiece, Scene
from costs.stopping import poll
from service.verify import CoalSolid, DistanceQuery, ForwardKinematics

NEAR = 0.05  # at the start, of neighbours [m]
SLACK = 3e-3  # by which neighbours may overlap more than at the start [m]
STEP = 1e-4  # depths are rounded up to it: they are made anew on other machines [m]
RESOLUTION = 1e-3  # of an overlap measured over a joint's range [m]


def make_neighbour_allowances(robot: RobotModel, scene: Scene, start: Float[np.ndarray, "n"]) -> tuple[Allowance, ...]:
    """Return the allowances of the links of a robot's mechanism and their neighbours; none without a mechanism.

    Args:
        robot: the robot augmented by the mechanism.
        scene: the pieces.
        start: (n,) configuration at the start; only the mechanism's joints count.
    """
    bodies = [body for body in robot.bodies if body.link in robot.mechanism_links]
    if not bodies:
        return ()
    poses = _Poses(robot, start)
    return (*_list_with_pieces(poses, bodies, scene.pieces), *_list_with_links(poses, bodies))


def _list_with_pieces(poses: _Poses, bodies: Sequence[LinkBody], pieces: Sequence[ConvexPiece]) -> Iterator[Allowance]:
    """Yield the allowances of mechanism bodies and pieces."""
    if not pieces:
        return
    low = np.array([piece.vertices.min(axis=0) for piece in pieces])
    high = np.array([piece.vertices.max(axis=0) for piece in pieces])
    for body in bodies:
        points = poses.locate(body)
        gap = np.maximum(low - points.max(axis=0), points.min(axis=0) - high)
        for row in np.flatnonzero(np.linalg.norm(np.maximum(gap, 0.0), axis=1) <= NEAR).tolist():
            piece = CoalSolid.of_piece(pieces[row])
            distance = poses.measure(body, piece)
            if distance > NEAR:
                continue
            overlap = max(-distance, 0.0)
            if overlap > 0.0 and poses.is_wheel(body.joint):
                overlap = poses.find_deepest(body, piece, body.joint)
            yield _allow(BodyRef("mechanism", body.link, body.name), BodyRef.of_piece(piece.name), overlap)


def _list_with_links(poses: _Poses, bodies: Sequence[LinkBody]) -> Iterator[Allowance]:
    """Yield the allowances of bodies of different links of the mechanism."""
    for index, body in enumerate(bodies):
        for other in bodies[index + 1 :]:
            if other.joint == body.joint:
                continue
            solid = CoalSolid.of_body(other)
            distance = poses.measure(body, solid)
            if distance > NEAR:
                continue
            overlap = max(-distance, 0.0)
            joint = poses.find_joint_between(body.joint, other.joint)
            if overlap > 0.0 and joint is not None:
                overlap = poses.find_deepest(body, solid, joint)
            yield _allow(
                BodyRef("mechanism", body.link, body.name), BodyRef("mechanism", other.link, other.name), overlap
            )


def _allow(first: BodyRef, second: BodyRef, overlap: float) -> Allowance:
    return Allowance(first, second, float(np.ceil(round((overlap + SLACK) / STEP, 6)) * STEP))


@dataclass(frozen=True)
class _Poses:
    """Distances of bodies at the start, and with one joint of the mechanism moved.

    Attributes:
        robot: the augmented robot.
        start: (n,) configuration.
    """

    robot: RobotModel
    start: Float[np.ndarray, "n"]

    def locate(self, body: LinkBody) -> Float[np.ndarray, "V 3"]:
        """Return a body's vertices in the world at the start [m]."""
        placed = ForwardKinematics(self.robot.model).at(self.start[None])
        return np.asarray(body.vertices @ placed.rotation[0, body.joint].T + placed.translation[0, body.joint])

    def measure(self, body: LinkBody, other: CoalSolid) -> float:
        """Return the signed distance at the start [m]."""
        return float(self._measure_at(body, other, self.start[None])[0])

    def is_wheel(self, joint: int) -> bool:
        """Return whether a joint may turn by a whole turn."""
        low, high = self._range(joint)
        return self._is_revolute(joint) and high - low >= 2.0 * np.pi

    def find_joint_between(self, joint: int, other: int) -> int | None:
        """Return the joint that joins the links of two joints; None if none does."""
        parents = self.robot.model.parents
        if int(parents[other]) == joint:
            return other
        return joint if int(parents[joint]) == other else None

    def find_deepest(self, body: LinkBody, other: CoalSolid, joint: int) -> float:
        """Return the largest overlap while a joint moves through its range, to within the resolution [m].

        Intervals are halved until their middle shows that nothing in them is deeper: moving the joint by ``x`` moves
        no point of the moving body by more than ``x`` times its reach.
        """
        low, high = self._range(joint)
        if self._is_revolute(joint):
            high = min(high, low + 2.0 * np.pi)
        mover = body.vertices if body.joint == joint else other.vertices
        reach = float(np.linalg.norm(mover, axis=1).max()) if self._is_revolute(joint) else 1.0
        column = int(self.robot.model.joints[joint].idx_q)
        deepest = -self.measure(body, other)
        edges = np.linspace(low, high, 17)
        middles, half = 0.5 * (edges[:-1] + edges[1:]), 0.5 * (edges[1] - edges[0])
        while len(middles):
            q = np.tile(self.start, (len(middles), 1))
            q[:, column] = middles
            depths = -self._measure_at(body, other, q)
            deepest = max(deepest, float(depths.max()))
            is_open = depths + reach * half > deepest + RESOLUTION
            half *= 0.5
            middles = np.concatenate([middles[is_open] - half, middles[is_open] + half])
        return deepest

    def _measure_at(self, body: LinkBody, other: CoalSolid, q: Float[np.ndarray, "S n"]) -> Float[np.ndarray, "S"]:
        poll()
        placed = ForwardKinematics(self.robot.model).at(q)
        count = len(q)
        solid = CoalSolid.of_body(body)
        distances, _ = DistanceQuery().closest(
            [solid.convex] * count, *placed.relative(other.joint, body.joint), [other.convex] * count
        )
        return distances

    def _range(self, joint: int) -> tuple[float, float]:
        column = int(self.robot.model.joints[joint].idx_q)
        return float(self.robot.lower[column]), float(self.robot.upper[column])

    def _is_revolute(self, joint: int) -> bool:
        return "Prismatic" not in str(self.robot.model.joints[joint].shortname())
