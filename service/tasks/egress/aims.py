"""Contacts that a pose has to make: a patch of the robot on a surface, at a given place or anywhere on it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from costs.contact import Contact
from costs.robot import RobotModel
from costs.rotation import make_tangent_basis
from costs.state import MotionState
from costs.terms import ContactPlace, FramePose
from scopt import Constraint, Residual, Sense
from service.body.facing import FLAT_POINTS, keep_facing
from service.demands.contacts.stances import StanceContact, Surface, find_link_pose
from service.demands.egress.demand import MOST_TURN_RAD

SIDE_RESERVE_M = 2e-3  # of the depth behind a surface, for the motions between the poses
PLACE_TOLERANCE_M = 2e-5  # per row of a contact in its place
N_TURNS = 61  # that are tried; an odd number, so that none is among them


@dataclass(frozen=True)
class ContactAim:
    """A patch that has to touch a surface.

    Attributes:
        patch: name among the robot's contacts.
        surface: that it touches.
        place: (3,) where ``mark`` has to be, moved along the normal onto the surface; None for anywhere on it [m].
        mark: (3,) the point of the link that has to be there, in the link's frame; the patch's middle by default [m].
        yaw_rad: turn of the link's x axis about the normal; None for any.
        fixed: exact place, instead of all these.
        slack_m: by which the place may be moved along the surface when motions are planned.
    """

    patch: str
    surface: Surface
    place: Float[np.ndarray, "3"] | None = None
    mark: Float[np.ndarray, "3"] | None = None
    yaw_rad: float | None = None
    fixed: StanceContact | None = None
    slack_m: float = 0.0

    @staticmethod
    def at(contact: StanceContact) -> ContactAim:
        """Return the aim to be where a contact is."""
        return ContactAim(contact.patch, contact.surface, fixed=contact, slack_m=contact.slack_m)

    def make_constraints(self, robot: RobotModel) -> list[Constraint[MotionState]]:
        """Return the constraints that put the patch in its place, at waypoint 0.

        Raises:
            KeyError: the robot has no such patch.
        """
        patch = robot.contacts[self.patch]
        if self.fixed is not None:
            planted = self.fixed.planted
            if len(patch.points) >= FLAT_POINTS:
                return [self._name("place", FramePose(robot, patch.link, [0], planted.pose_world_link), "m or rad")]
            term = ContactPlace.at(robot, patch.link, patch.points, [0], planted.points)
            return [self._name("place", term), *self._face(robot)]
        if self.place is not None and self.yaw_rad is not None and len(patch.points) >= FLAT_POINTS:
            pose = self._find_link_pose(patch, self.place, self.yaw_rad)
            return [self._name("place", FramePose(robot, patch.link, [0], pose), "m or rad"), self._stay_inside(robot)]
        return self._make_free_constraints(robot, patch)

    def _make_free_constraints(self, robot: RobotModel, patch: Contact) -> list[Constraint[MotionState]]:
        """Return constraints of a patch that may turn or move on its surface."""
        surface = self.surface
        level = float(surface.normal @ surface.corners[0])
        on_plane = ContactPlace.on_plane(robot, patch.link, patch.points, [0], surface.normal, level)
        terms = [self._name("plane", on_plane), self._stay_inside(robot), *self._face(robot)]
        if self.place is not None:
            along = make_tangent_basis(surface.normal)
            mark = patch.points.mean(axis=0) if self.mark is None else self.mark
            at = ContactPlace(robot, patch.link, mark[None], [0], along, along @ self.place)
            terms.append(self._name("place", at))
        return terms

    def turn_inside(self, robot: RobotModel) -> ContactAim:
        """Return the aim with the nearest yaw at which the patch is not beyond the edges of its surface.

        The same where its place or yaw is not given, or where no turn up to ``MOST_TURN_RAD`` brings it inside.
        """
        if self.place is None or self.yaw_rad is None:
            return self
        patch = robot.contacts[self.patch]
        turns = np.linspace(-MOST_TURN_RAD, MOST_TURN_RAD, N_TURNS)
        for turn in turns[np.argsort(np.abs(turns), kind="stable")].tolist():
            pose = self._find_link_pose(patch, self.place, self.yaw_rad + turn)
            if self.surface.measure_outside(patch.points @ pose[:3, :3].T + pose[:3, 3]).max() <= 0.0:
                return replace(self, yaw_rad=self.yaw_rad + turn)
        return self

    @property
    def normal(self) -> Float[np.ndarray, "3"]:
        """(3,) unit normal of what it touches, where its place is known [-]."""
        if self.fixed is not None:
            return self.surface.find_normal(self.fixed.points)
        return self.surface.normal if self.place is None else self.surface.find_normal(self.place[None])

    def _face(self, robot: RobotModel) -> list[Constraint[MotionState]]:
        place = self.surface.corners[0] if self.place is None else self.place
        place = place if self.fixed is None else self.fixed.points.mean(axis=0)
        return keep_facing(robot, self.patch, self.normal, place, np.zeros(1, dtype=int), SIDE_RESERVE_M)

    def _stay_inside(self, robot: RobotModel) -> Constraint[MotionState]:
        """Return the constraint that the patch is not beyond the edges of its surface."""
        patch, (normals, offsets) = robot.contacts[self.patch], self.surface.list_edges()
        inside = ContactPlace.inside(robot, patch.link, patch.points, [0], normals, offsets)
        return Constraint(f"{self.patch} within {self.surface.name}", inside, tolerance=PLACE_TOLERANCE_M, unit="m")

    def _find_link_pose(
        self, patch: Contact, place: Float[np.ndarray, "3"], yaw_rad: float
    ) -> Float[np.ndarray, "4 4"]:
        """Return pose_world_link of the patch flat on its surface, its mark at the place and turned by the yaw."""
        pose = find_link_pose(patch, self.surface, place, yaw_rad)
        if self.mark is not None:
            offset = pose[:3, :3] @ (patch.points.mean(axis=0) - self.mark)
            pose[:3, 3] += offset - (offset @ self.surface.normal) * self.surface.normal
        return pose

    def _name(self, what: str, term: Residual[MotionState], unit: str = "m") -> Constraint[MotionState]:
        words = f"{self.patch} on {self.surface.name}: {what}"
        return Constraint(words, term, Sense.EQUAL_ZERO, PLACE_TOLERANCE_M, unit=unit)
