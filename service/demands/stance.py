"""Stance that a request demands: planted feet, the support polygon, and the allowances of standing links."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.allowance import Allowance, BodyRef
from costs.robot import RobotModel
from costs.scene import Scene
from costs.support import SupportPolygon as FeetHull
from costs.work_space import borrow_data
from service.start.overlaps import Overlap
from service.start.standing import FEET_GROUP, list_carrying_pieces, sole_corners
from service.verify import STANDING_DEPTH_M, PlantedContact, SupportPolygon

UNSETTLED = ("escape", "settle")  # phases that bring a robot into balance, in the order in which they may come first
BALANCE_RESERVE = 2e-3  # the optimiser aims this much further inside; a start with less may settle first [m]
DEPTH_ROUNDING = 1e-4  # by which a pair may be deeper than it was measured at the start [m]


@dataclass(frozen=True)
class Stance:
    """The feet as they stand at the start.

    Attributes:
        contacts: of the planted links.
        hull: of the soles; None where balance is waived.
        height: of the soles [m].
        margin_m: how far inside the hull the centre of mass stays.
    """

    robot: RobotModel
    contacts: tuple[PlantedContact, ...]
    hull: FeetHull | None
    height: float
    margin_m: float

    @staticmethod
    def of(
        robot: RobotModel, start: Float[np.ndarray, "n"], feet: Sequence[str], margin_m: float, is_balanced: bool
    ) -> Stance:
        """Return the stance of a robot on ``feet`` at configuration ``start``.

        Raises:
            ValueError: the soles are on a line.
        """
        data = robot.model.createData()
        pin.framesForwardKinematics(robot.model, data, start)
        soles = {foot: sole_corners(robot, start, foot) for foot in feet}
        contacts = []
        for foot, corners in soles.items():
            pose = np.array(data.oMf[robot.model.getFrameId(foot)].homogeneous)
            contacts.append(PlantedContact(foot, pose, (corners - pose[:3, 3]) @ pose[:3, :3]))
        if not soles or not is_balanced:
            return Stance(robot, tuple(contacts), None, 0.0, margin_m)
        height = float(np.mean([corners[:, 2].mean() for corners in soles.values()]))
        return Stance(robot, tuple(contacts), FeetHull.of_soles(list(soles.values())), height, margin_m)

    def support(self, phase: str, first: Float[np.ndarray, "n"]) -> SupportPolygon | None:
        """Return the support polygon and margin of a phase that begins at configuration ``first``.

        Phases that bring the robot into balance (``UNSETTLED``) may begin with less than the margin.
        """
        if self.hull is None:
            return None
        centre = pin.centerOfMass(self.robot.model, borrow_data(self.robot.model), first)
        is_unsettled = float(self.hull.margin(centre[None, :2])[0]) < self.margin_m + BALANCE_RESERVE
        margin = 0.0 if phase in UNSETTLED and is_unsettled else self.margin_m
        return SupportPolygon(self.hull.vertices, margin, self.height)


def list_planted_feet(robot: RobotModel, feet: tuple[str, ...] | None) -> tuple[str, ...]:
    """Return the links that a request plants: those it lists, or the robot's own; none where the base is fixed."""
    if not robot.is_floating:
        return ()
    return robot.link_groups.get(FEET_GROUP, ()) if feet is None else feet


def make_standing_allowances(planted: Sequence[PlantedContact], scene: Scene) -> tuple[Allowance, ...]:
    """Return the allowances of planted links with what carries their soles: floors, mats, boards, boxes."""
    return tuple(
        Allowance(BodyRef.of_link(contact.link), BodyRef.of_piece(name), STANDING_DEPTH_M)
        for contact in planted
        for name in list_carrying_pieces(contact.points, scene.pieces)
    )


def make_escape_allowances(overlaps: Sequence[Overlap]) -> tuple[Allowance, ...]:
    """Return the allowances of an escape: overlaps at the start may stay as deep as they are there."""
    return tuple(Allowance(*overlap.pair, overlap.depth + DEPTH_ROUNDING) for overlap in overlaps)
