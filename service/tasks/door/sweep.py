"""Where a door's leaf and handle sweep before anything is planned, and what stands in their way."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from costs.allowance import BodyIndex
from costs.robot import LinkBody
from costs.stopping import poll
from service.body.whole_body import WholeBody
from service.demands.door.door import Door
from service.demands.neighbours import make_neighbour_allowances
from service.request.tasks.door import HANDLE_JOINT, LEAF_JOINT
from service.verify import CoalSolid, DistanceQuery, ForwardKinematics, Placements

STEP = np.deg2rad(1.0)  # of the leaf
ROUNDING = 1e-6  # by which an overlap may exceed its allowance [m]


@dataclass(frozen=True)
class BlockedOpening:
    """The first thing that the leaf or its handle meets.

    Attributes:
        name: the piece, or the robot's link.
        part: the body of the door that meets it.
        angle: of the leaf [rad].
        is_piece: whether it is a piece of the scene.
        is_planted: whether it is a link that carries the robot.
    """

    name: str
    part: str
    angle: float
    is_piece: bool
    is_planted: bool

    @property
    def stands_still(self) -> bool:
        """Whether it cannot make way."""
        return self.is_piece or self.is_planted

    def describe(self, target: float) -> str:
        """Return a sentence; ``target`` is the requested angle [rad]."""
        degrees = np.rad2deg(self.angle)
        if self.stands_still:
            stance = "" if self.is_piece else "; stand farther away or beside it"
            return f"the leaf meets {self.name} at {degrees:.0f} deg of the {np.rad2deg(target):.0f} asked for{stance}"
        return f"the leaf would meet {self.name} at {degrees:.0f} deg as the robot stands now; it has to make way"


def find_blocked_opening(body: WholeBody, door: Door, target: float) -> tuple[BlockedOpening, ...]:
    """Return what the leaf and its handle meet first on the way to an angle: the first piece, planted link and leg.

    The leaf is opened in steps of 1 deg, with the handle as it is while the leaf opens.  Pieces have the allowances of
    a certificate, so that no motion past one that is met can be certified.  The robot stands as at the start; what is
    met first comes first.

    Args:
        body: augmented by the door, at the start.
        door: the door.
        target: opening angle [rad].
    """
    angles = np.append(np.arange(door.geometry.ajar + STEP, target, STEP), target)
    names = body.robot.joint_names
    q = np.tile(body.nominal, (len(angles), 1))
    q[:, names.index(LEAF_JOINT)] = angles
    if HANDLE_JOINT in names and door.is_latched:
        q[:, names.index(HANDLE_JOINT)] = max(door.pressed, float(body.nominal[names.index(HANDLE_JOINT)]))
    return find_first_met(body, q, angles)


def find_first_met(
    body: WholeBody, q: Float[np.ndarray, "A n"], values: Float[np.ndarray, "A"]
) -> tuple[BlockedOpening, ...]:
    """Return what a mechanism meets first on its way: the first piece, planted link and leg.

    Args:
        body: augmented by the mechanism, at the start.
        q: (A, n) configurations in their order, the robot as at the start.
        values: (A,) that are reported with what is met.
    """
    placed = ForwardKinematics(body.robot.model).at(q)
    parts = [part for part in body.robot.bodies if part.link in body.robot.mechanism_links]
    met = [*_find_piece(body, parts, placed, values), *_find_links(body, parts, placed, values)]
    return tuple(sorted(met, key=lambda blocked: blocked.angle))


def _find_piece(
    body: WholeBody, parts: Sequence[LinkBody], placed: Placements, angles: Float[np.ndarray, "A"]
) -> Iterator[BlockedOpening]:
    """Yield the piece that is met first."""
    pieces = body.scene.pieces
    if not pieces:
        return
    index = BodyIndex(body.robot.bodies, body.robot.mechanism_links, pieces)
    allowed = np.zeros(index.shape)
    for allowance in make_neighbour_allowances(body.robot, body.scene, body.nominal):
        index.fill(allowed, allowance.first, allowance.second, allowance.depth)
    rows = {part.name: row for row, part in enumerate(body.robot.bodies)}
    low = np.array([piece.vertices.min(axis=0) for piece in pieces])
    high = np.array([piece.vertices.max(axis=0) for piece in pieces])
    query = DistanceQuery()
    for at, angle in enumerate(angles.tolist()):
        poll()
        for part in parts:
            turned, moved = placed.rotation[at, part.joint], placed.translation[at, part.joint]
            points = part.vertices @ turned.T + moved
            near = np.flatnonzero(np.all((low <= points.max(axis=0)) & (high >= points.min(axis=0)), axis=1))
            for column in near.tolist():
                solid = CoalSolid.of_piece(pieces[column])
                convex = CoalSolid.of_body(part).convex
                distance = query.closest([convex], turned[None], moved[None], [solid.convex])[0][0]
                if distance < -allowed[rows[part.name], index.n_bodies + column] - ROUNDING:
                    yield BlockedOpening(solid.name, part.name, angle, is_piece=True, is_planted=False)
                    return


def _find_links(
    body: WholeBody, parts: Sequence[LinkBody], placed: Placements, angles: Float[np.ndarray, "A"]
) -> Iterator[BlockedOpening]:
    """Yield the planted link and the link of a leg that are met first, the robot standing still."""
    model = body.robot.model
    planted = {foot.link for foot in body.planted}
    legs: set[int] = set()
    for name in planted:
        joint = int(model.frames[model.getFrameId(name)].parentJoint)
        while joint > 0:
            legs.add(joint)
            joint = int(model.parents[joint])
    own = [link for link in body.robot.bodies if link.joint in legs and link.link not in body.robot.mechanism_links]
    query, count = DistanceQuery(), len(angles)
    for are_planted in (True, False):
        first: tuple[int, str, str] | None = None
        for link in own:
            if (link.link in planted) != are_planted:
                continue
            for part in parts:
                solids = [CoalSolid.of_body(part).convex] * count, [CoalSolid.of_body(link).convex] * count
                distances, _ = query.closest(solids[0], *placed.relative(link.joint, part.joint), solids[1])
                meets = np.flatnonzero(distances < 0.0)
                if len(meets) and (first is None or meets[0] < first[0]):
                    first = int(meets[0]), link.link, part.name
        if first is not None:
            yield BlockedOpening(first[1], first[2], float(angles[first[0]]), is_piece=False, is_planted=are_planted)
