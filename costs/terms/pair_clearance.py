"""Clearance per pair and interval, of swept hulls or of single poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from costs.allowance import Allowance, BodyIndex, BodyRef
from costs.collision import Contacts, SweptCollisionChecker
from costs.kinematics import Kinematics
from costs.robot.model import RobotModel
from costs.state import MotionState
from costs.terms.collision import SweptClearance
from scopt import AffineRows, Residual


@dataclass(frozen=True)
class RequiredClearance:
    """Required clearance over time.

    Attributes:
        distance: (I,) per interval (for single poses: per waypoint) [m].
        gain: (I,) factor of the rows; an interval of gain 0 has no rows.
    """

    distance: Float[np.ndarray, "I"]
    gain: Float[np.ndarray, "I"]


@dataclass(frozen=True)
class ClearancePerPair:
    """Required clearance of every pair.

    Attributes:
        required: the clearances that pairs refer to.
        world: (B, P) index in ``required`` for a body and a piece; -1 for none.
        own: (B, B) for two bodies, symmetric.
        world_limit, own_limit: upper limits of the required clearance [m].
    """

    required: tuple[RequiredClearance, ...]
    world: Int[np.ndarray, "B P"]
    own: Int[np.ndarray, "B B"]
    world_limit: Float[np.ndarray, "B P"]
    own_limit: Float[np.ndarray, "B B"]

    @staticmethod
    def of(
        checker: SweptCollisionChecker,
        everywhere: RequiredClearance,
        pairs: Sequence[tuple[BodyRef, BodyRef, RequiredClearance]] = (),
        exempt: Sequence[Allowance] = (),
    ) -> ClearancePerPair:
        """Require the same clearance of all pairs of a checker, except for some.

        Args:
            checker: of the robot in its scene.
            everywhere: for all other pairs.
            pairs: ``(first, second, required)``; the last that covers a pair counts.
            exempt: pairs without required clearance.
        """
        robot, scene = checker.robot, checker.scene
        index = BodyIndex(robot.bodies, robot.mechanism_links, scene.pieces)
        which = np.zeros(index.shape, dtype=int)
        for row, (first, second, _) in enumerate(pairs, start=1):
            index.fill(which, first, second, row)
        for allowance in exempt:
            index.fill(which, allowance.first, allowance.second, -1)
        own, world = which[:, : index.n_bodies], which[:, index.n_bodies :]
        required = (everywhere, *(each for _, _, each in pairs))
        return ClearancePerPair(required, world, own, np.full(world.shape, np.inf), np.full(own.shape, np.inf))

    @property
    def largest(self) -> float:
        """Largest required clearance [m]."""
        return max(float(each.distance.max(initial=0.0)) for each in self.required)

    def relax_to(self, contacts: Contacts, reserve: float) -> ClearancePerPair:
        """Limit the required clearance to the distances of the given contacts less ``reserve`` [m]."""
        world, own = self.world_limit.copy(), self.own_limit.copy()
        reach = contacts.distance - reserve
        rows = ~contacts.is_self
        np.minimum.at(world, (contacts.body[rows], contacts.other[rows]), reach[rows])
        for first, second in ((contacts.body, contacts.other), (contacts.other, contacts.body)):
            np.minimum.at(own, (first[~rows], second[~rows]), reach[~rows])
        return replace(self, world_limit=world, own_limit=own)


class PairClearance(Residual[MotionState]):
    """``gain (required - distance)``, one row per contact with a required clearance [m]; at most zero where kept.

    With a checker of poses the rows are those of the single waypoints, else those of ``MotionState.contacts``, swept
    over the intervals.  As a hinge cost this is the collision cost of Schulman et al., IJRR 2014, sec. IV and V.
    """

    def __init__(
        self, robot: RobotModel, required: ClearancePerPair, poses: SweptCollisionChecker | None = None
    ) -> None:
        """
        Args:
            required: per interval; for single poses, per waypoint.
            poses: checker for contacts at single waypoints; None for swept contacts.
        """
        self._required = required
        self._poses = poses
        self._distance = np.stack([each.distance for each in required.required])
        self._gain = np.stack([each.gain for each in required.required])
        self._parts = (SweptClearance(robot, is_self=False), SweptClearance(robot, is_self=True))

    def value(self, state: MotionState) -> Float[np.ndarray, "m"]:
        state, gain = self._select_contacts(state)
        return np.asarray(gain * np.concatenate([part.value(state) for part in self._parts]))

    def linearize(self, state: MotionState) -> AffineRows:
        state, gain = self._select_contacts(state)
        rows = AffineRows.stack([part.linearize(state) for part in self._parts])
        jacobian = rows.jacobian.copy()
        jacobian.data *= np.repeat(gain, np.diff(jacobian.indptr))
        return AffineRows(gain * rows.value, jacobian)

    def _select_contacts(self, state: MotionState) -> tuple[MotionState, Float[np.ndarray, "m"]]:
        """Select the contacts with a required clearance as their margin, world before self; also return their gains."""
        contacts = state.contacts if self._poses is None else find_pose_contacts(self._poses, state.kinematics)
        world, own = ~contacts.is_self, contacts.is_self
        index = np.zeros(len(contacts), dtype=int)
        limit = np.zeros(len(contacts))
        for rows, indices, limits in (
            (world, self._required.world, self._required.world_limit),
            (own, self._required.own, self._required.own_limit),
        ):
            pair = contacts.body[rows], contacts.other[rows]
            index[rows], limit[rows] = indices[pair], limits[pair]
        gain = np.where(index < 0, 0.0, self._gain[index, contacts.first])
        margin = np.minimum(self._distance[index, contacts.first], limit)
        order = np.concatenate([np.flatnonzero(rows & (gain > 0.0)) for rows in (world, own)])
        return MotionState(state.kinematics, replace(contacts, margin=margin).where(order)), gain[order]


def find_pose_contacts(checker: SweptCollisionChecker, kinematics: Kinematics) -> Contacts:
    """Find the contacts of the single waypoints: each is swept to itself."""
    twice = np.repeat(np.arange(kinematics.n_waypoints), 2)
    doubled = replace(
        kinematics,
        q=kinematics.q[twice],
        rotation=kinematics.rotation[twice],
        position=kinematics.position[twice],
        jacobian=kinematics.jacobian[twice],
    )
    contacts = checker(doubled)
    contacts = contacts.where(contacts.first % 2 == 0)
    waypoint = contacts.first // 2
    return replace(contacts, first=waypoint, second=waypoint, share=np.zeros(len(contacts)))
