"""Stance that a request demands: planted feet, the support polygon, and the allowances of standing links."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.allowance import Allowance, BodyRef
from costs.robot import RobotModel
from costs.scene import Scene
from costs.support import SupportPolygon as FeetHull
from costs.work_space import borrow_data
from service.start.overlaps import Overlap
from service.start.resting import SUPPORT_DEPTH_M
from service.start.standing import (
    FEET_GROUP,
    FLOOR_KIND,
    WHEEL_DEPTH_M,
    is_level,
    list_carrying_pieces,
    list_links_on_wheels,
    sole_corners,
)
from service.verify import STANDING_DEPTH_M, PlantedContact, SupportPolygon, find_normals

# Phases that bring a robot into balance, in the order in which they may come first.
UNSETTLED = ("escape", "raise", "settle")
BALANCE_RESERVE = 2e-3  # the optimiser aims this much further inside; a start with less may settle first [m]
# By which the region that sloping feet hold is smaller than the hull of their soles, with some room.
REGION_RESERVE_M = 6e-3
ONE_LEVEL_M = 0.015  # difference of height of soles that stand on one level
SLOPE_TILT_RAD = float(np.deg2rad(3.0))  # between the plane of a sloping sole and the ground under it
DEPTH_ROUNDING = 1e-4  # by which a pair may be deeper than it was measured at the start [m]


@dataclass(frozen=True)
class Stance:
    """The feet as they stand at the start.

    Attributes:
        contacts: of the planted links.
        hull: of the soles, seen from above; None where balance is waived.
        height: of the soles [m].
        margin_m: how far inside the hull, or inside the region that the feet hold, the centre of mass stays.
        is_level: whether the hull is where the feet hold the robot; otherwise contact forces have to prove a region.
    """

    robot: RobotModel
    contacts: tuple[PlantedContact, ...]
    hull: FeetHull | None
    height: float
    margin_m: float
    is_level: bool = True

    @staticmethod
    def of(
        robot: RobotModel, start: Float[np.ndarray, "n"], feet: Sequence[str], margin_m: float, is_balanced: bool
    ) -> Stance:
        """Return the stance of a robot on ``feet`` at configuration ``start``.

        Raises:
            ValueError: the soles are on a line.
        """
        contacts = plant_feet(robot, start, feet)
        if not contacts or not is_balanced:
            return Stance(robot, contacts, None, 0.0, margin_m)
        height = float(np.mean([contact.points[:, 2].mean() for contact in contacts]))
        hull = FeetHull.of_soles([contact.points for contact in contacts])
        return Stance(robot, contacts, hull, height, margin_m, are_level(contacts))

    def support(self, phase: str, first: Float[np.ndarray, "n"]) -> SupportPolygon | None:
        """Return the support polygon and margin of a phase that begins at configuration ``first``; None off the level.

        Phases that bring the robot into balance (``UNSETTLED``) may begin with less than the margin.
        """
        if self.hull is None or not self.is_level:
            return None
        return SupportPolygon(self.hull.vertices, self._find_margin(self.hull, phase, first), self.height)

    def region_margin(self, phase: str, first: Float[np.ndarray, "n"]) -> float | None:
        """Return how far inside the region that the feet hold off the level a phase stays, as ``support`` does [m]."""
        return None if self.hull is None or self.is_level else self._find_margin(self.hull, phase, first)

    def _find_margin(self, hull: FeetHull, phase: str, first: Float[np.ndarray, "n"]) -> float:
        centre = pin.centerOfMass(self.robot.model, borrow_data(self.robot.model), first)
        needs_settling = is_unsettled(hull, centre, self.margin_m, is_level=self.is_level)
        return 0.0 if phase in UNSETTLED and needs_settling else self.margin_m


def plant_feet(robot: RobotModel, q: Float[np.ndarray, "n"], feet: Sequence[str]) -> tuple[PlantedContact, ...]:
    """Return the contacts of feet that stand at a configuration; on a slope with the normal of the sole's plane.

    The ground under a sloping sole has to have that normal, up to what its distance from the corners leaves open.
    """
    data = borrow_data(robot.model)
    contacts = []
    for foot in feet:
        corners = sole_corners(robot, q, foot)
        pin.framesForwardKinematics(robot.model, data, q)
        pose = np.array(data.oMf[robot.model.getFrameId(foot)].homogeneous)
        contact = PlantedContact(foot, pose, (corners - pose[:3, 3]) @ pose[:3, :3])
        if not is_level(corners):
            contact = replace(contact, normal=find_normals((contact,))[0], tilt_rad=SLOPE_TILT_RAD)
        contacts.append(contact)
    return tuple(contacts)


def are_level(contacts: Sequence[PlantedContact]) -> bool:
    """Return whether planted soles are level and on one level, so that their hull is where they hold the robot."""
    heights = [contact.points[:, 2].mean() for contact in contacts]
    return all(contact.normal is None for contact in contacts) and float(np.ptp(heights)) <= ONE_LEVEL_M


def is_unsettled(hull: FeetHull, centre: Float[np.ndarray, "3"], margin_m: float, *, is_level: bool) -> bool:
    """Return whether a phase that begins with this centre of mass may begin with less than the margin.

    Off the level the region that contact forces prove is a little smaller than the hull of the soles seen from above.
    """
    reserve = BALANCE_RESERVE if is_level else BALANCE_RESERVE + REGION_RESERVE_M
    return float(hull.margin(centre[None, :2])[0]) < margin_m + reserve


def list_planted_feet(robot: RobotModel, feet: tuple[str, ...] | None) -> tuple[str, ...]:
    """Return the links that a request plants: those it lists, or the robot's own; none where the base is fixed."""
    if not robot.is_floating:
        return ()
    return robot.link_groups.get(FEET_GROUP, ()) if feet is None else feet


def make_standing_allowances(
    robot: RobotModel, planted: Sequence[PlantedContact], scene: Scene
) -> tuple[Allowance, ...]:
    """Return the allowances of planted links with what carries their soles: floors, mats, boards, boxes.

    What a base on wheels carries at a height that no motion changes may touch floors.
    """
    soles = tuple(
        Allowance(BodyRef.of_link(contact.link), BodyRef.of_piece(name), STANDING_DEPTH_M)
        for contact in planted
        for name in list_carrying_pieces(contact.points, scene.pieces)
    )
    floors = [piece.name for piece in scene.pieces if piece.kind == FLOOR_KIND]
    wheels = product(list_links_on_wheels(robot), floors)
    return (*soles, *(Allowance(BodyRef.of_link(a), BodyRef.of_piece(b), WHEEL_DEPTH_M) for a, b in wheels))


def make_resting_allowances(rests: Sequence[tuple[str, str]]) -> tuple[Allowance, ...]:
    """Return the allowances of carried bodies, as names of links, with the pieces on which they rest."""
    return tuple(Allowance(BodyRef.of_link(link), BodyRef.of_piece(piece), SUPPORT_DEPTH_M) for link, piece in rests)


def make_escape_allowances(overlaps: Sequence[Overlap]) -> tuple[Allowance, ...]:
    """Return the allowances of an escape: overlaps at the start may stay as deep as they are there."""
    return tuple(Allowance(*overlap.pair, overlap.depth + DEPTH_ROUNDING) for overlap in overlaps)
