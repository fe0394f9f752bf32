"""Swept collision with the world and of the robot with itself, as cost or as constraint."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from costs.collision.contacts import Contacts
from costs.robot.model import RobotModel
from costs.state import MotionState
from scopt import AffineRows, Residual


class SweptClearance(Residual[MotionState]):
    """Margin less distance of a pair, one row per contact [m]; at most zero where the margin is kept.

    The rows are those of ``MotionState.contacts``: signed distances of swept hulls, split between the two waypoints by
    where the witness point lies.  ``is_self`` selects contacts of the robot with itself, else with the world.
    """

    def __init__(self, robot: RobotModel, *, is_self: bool) -> None:
        self._joint = np.array([body.joint for body in robot.bodies], dtype=int)
        self._is_self = is_self

    def _contacts(self, state: MotionState) -> Contacts:
        return state.contacts.where(state.contacts.is_self == self._is_self)

    def value(self, state: MotionState) -> Float[np.ndarray, "m"]:
        contacts = self._contacts(state)
        return np.asarray(contacts.margin - contacts.distance)

    def linearize(self, state: MotionState) -> AffineRows:
        contacts, kinematics = self._contacts(state), state.kinematics
        moving = self._joint[contacts.body]
        still = self._joint[contacts.other] if self._is_self else np.zeros_like(moving)
        sides = []
        for side, waypoint, weight in (
            (0, contacts.first, 1.0 - contacts.share),
            (1, contacts.second, contacts.share),
        ):
            point, normal = contacts.point[:, side], contacts.normal[:, side]
            row = kinematics.directional_jacobian(waypoint, moving, point, normal)
            if self._is_self:
                row = row - kinematics.directional_jacobian(waypoint, still, point, normal)
            sides.append(-weight[:, None] * row)
        value = contacts.margin - contacts.distance
        if kinematics.n_waypoints == 1:
            return AffineRows.from_blocks(value, contacts.first, (sides[0] + sides[1])[:, None], 1)
        return AffineRows.from_blocks(value, contacts.first, np.stack(sides, axis=1), kinematics.n_waypoints)


class Room(Residual[MotionState]):
    """What is missing of a distance from the world beyond the margin, one row per contact that is nearer [m].

    Pairs that may touch, whose margin is negative, have no rows.  As a squared cost it leads a motion through the
    middle of the room that there is, so that surfaces may be a little elsewhere.
    """

    def __init__(self, robot: RobotModel, beyond: float) -> None:
        """
        Args:
            robot: whose links keep away.
            beyond: distance beyond the margin [m]; pairs within it must be among the state's contacts.
        """
        self._clearance, self._beyond = SweptClearance(robot, is_self=False), beyond

    def value(self, state: MotionState) -> Float[np.ndarray, "m"]:
        return self._clearance.value(self._select(state))

    def linearize(self, state: MotionState) -> AffineRows:
        return self._clearance.linearize(self._select(state))

    def _select(self, state: MotionState) -> MotionState:
        contacts = state.contacts
        wanted = contacts.margin + self._beyond
        near = (contacts.margin > 0.0) & (contacts.distance < wanted)
        return MotionState(state.kinematics, replace(contacts, margin=wanted).where(near))
