"""Clearance that is asked pair by pair and interval by interval, of swept hulls or of single poses."""

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
class Asked:
    """What is asked of pairs over time.

    Attributes:
        distance: (I,) clearance asked, by interval (of single poses: by waypoint) [m].
        gain: (I,) factor of the rows; an interval of gain 0 has none.
    """

    distance: Float[np.ndarray, "I"]
    gain: Float[np.ndarray, "I"]


@dataclass(frozen=True)
class AskedOfPairs:
    """What is asked of every pair.

    Attributes:
        asked: what may be asked; the pairs point here.
        world: (B, P) index of ``asked`` for a body and a piece; -1 where nothing is asked.
        own: (B, B) for two bodies, symmetric.
        world_limit, own_limit: no more than this is asked of a pair, whatever ``asked`` says [m].
    """

    asked: tuple[Asked, ...]
    world: Int[np.ndarray, "B P"]
    own: Int[np.ndarray, "B B"]
    world_limit: Float[np.ndarray, "B P"]
    own_limit: Float[np.ndarray, "B B"]

    @staticmethod
    def of(
        checker: SweptCollisionChecker,
        everywhere: Asked,
        pairs: Sequence[tuple[BodyRef, BodyRef, Asked]] = (),
        exempt: Sequence[Allowance] = (),
    ) -> AskedOfPairs:
        """The same of all pairs that a checker looks at, but for some.

        Args:
            checker: whose robot and scene it is.
            everywhere: asked of all other pairs.
            pairs: ``(one, other, asked)``; the last that covers a pair counts.
            exempt: pairs of which nothing is asked.
        """
        robot, scene = checker.robot, checker.scene
        index = BodyIndex(robot.bodies, robot.mechanism_links, scene.pieces)
        which = np.zeros(index.shape, dtype=int)
        for row, (one, other, _) in enumerate(pairs, start=1):
            index.fill(which, one, other, row)
        for allowance in exempt:
            index.fill(which, allowance.first, allowance.second, -1)
        own, world = which[:, : index.n_bodies], which[:, index.n_bodies :]
        asked = (everywhere, *(each for _, _, each in pairs))
        return AskedOfPairs(asked, world, own, np.full(world.shape, np.inf), np.full(own.shape, np.inf))

    @property
    def largest(self) -> float:
        """The largest distance that is asked of any pair [m]."""
        return max(float(each.distance.max(initial=0.0)) for each in self.asked)

    def relaxed_to(self, contacts: Contacts, reserve: float) -> AskedOfPairs:
        """No more asked of a pair than the distances of the given contacts, less ``reserve`` [m]."""
        world, own = self.world_limit.copy(), self.own_limit.copy()
        reach = contacts.distance - reserve
        rows = ~contacts.is_self
        np.minimum.at(world, (contacts.body[rows], contacts.other[rows]), reach[rows])
        for first, second in ((contacts.body, contacts.other), (contacts.other, contacts.body)):
            np.minimum.at(own, (first[~rows], second[~rows]), reach[~rows])
        return replace(self, world_limit=world, own_limit=own)


class PairClearance(Residual[MotionState]):
    """``gain (asked - distance)``, one row per contact of which something is asked [m]; at most zero where kept.

    With a checker of poses the rows are those of the single waypoints, else those of ``MotionState.contacts``, swept
    over the intervals.  As a hinge cost this is the collision cost of Schulman et al., IJRR 2014, sec. IV and V.
    """

    def __init__(self, robot: RobotModel, asked: AskedOfPairs, poses: SweptCollisionChecker | None = None) -> None:
        """
        Args:
            robot: whose bodies the contacts speak of.
            asked: of the pairs, by interval; of single poses, by waypoint.
            poses: finds the contacts of single waypoints; None for swept ones.
        """
        self._asked = asked
        self._poses = poses
        self._distance = np.stack([each.distance for each in asked.asked])
        self._gain = np.stack([each.gain for each in asked.asked])
        self._parts = (SweptClearance(robot, is_self=False), SweptClearance(robot, is_self=True))

    def value(self, state: MotionState) -> Float[np.ndarray, "m"]:
        state, gain = self._counted(state)
        return np.asarray(gain * np.concatenate([part.value(state) for part in self._parts]))

    def linearize(self, state: MotionState) -> AffineRows:
        state, gain = self._counted(state)
        rows = AffineRows.stack([part.linearize(state) for part in self._parts])
        jacobian = rows.jacobian.copy()
        jacobian.data *= np.repeat(gain, np.diff(jacobian.indptr))
        return AffineRows(gain * rows.value, jacobian)

    def _counted(self, state: MotionState) -> tuple[MotionState, Float[np.ndarray, "m"]]:
        """The contacts that count with what is asked of them as their margin, world before self, and their gains."""
        contacts = state.contacts if self._poses is None else pose_contacts(self._poses, state.kinematics)
        world, own = ~contacts.is_self, contacts.is_self
        index = np.zeros(len(contacts), dtype=int)
        limit = np.zeros(len(contacts))
        for rows, indices, limits in (
            (world, self._asked.world, self._asked.world_limit),
            (own, self._asked.own, self._asked.own_limit),
        ):
            pair = contacts.body[rows], contacts.other[rows]
            index[rows], limit[rows] = indices[pair], limits[pair]
        gain = np.where(index < 0, 0.0, self._gain[index, contacts.first])
        margin = np.minimum(self._distance[index, contacts.first], limit)
        order = np.concatenate([np.flatnonzero(rows & (gain > 0.0)) for rows in (world, own)])
        return MotionState(state.kinematics, replace(contacts, margin=margin).where(order)), gain[order]


def pose_contacts(checker: SweptCollisionChecker, kinematics: Kinematics) -> Contacts:
    """Contacts of the single waypoints: each is swept to itself."""
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
