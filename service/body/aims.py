"""Margins that a plan aims at, from what its request demands."""

from __future__ import annotations

from dataclasses import dataclass, field

from costs.allowance import BodyRef
from costs.robot import RobotModel
from costs.scene import Scene
from service.demands.distances import Distances
from service.request.schema import Options

CLEARANCE_RESERVE_M = 5e-3  # beyond a demanded clearance, for the curve between waypoints


@dataclass(frozen=True)
class Aims:
    """Margins of a plan [m].

    Attributes:
        margin: clearance aimed at.
        balance_margin: distance of the centre of mass inside the support polygon.
        distances: demanded ones from the world, below which no motion is certified.
    """

    margin: float = 0.02
    balance_margin: float = 0.02
    distances: Distances = field(default_factory=Distances)

    @staticmethod
    def of(options: Options, robot: RobotModel, scene: Scene) -> Aims:
        """Return the margins of a request; demanded distances are aimed at with a reserve."""
        distances = Distances.of(options, scene)
        least = distances.bound_least(robot)
        margin = max(options.margin_m, least + CLEARANCE_RESERVE_M) if least else options.margin_m
        return Aims(margin, options.balance_margin_m, distances)

    def list_padded(self, robot: RobotModel, scene: Scene) -> tuple[tuple[BodyRef, BodyRef, float], ...]:
        """Return the margins of links and pieces whose padding demands more than the margin of all others."""
        return tuple(
            (BodyRef("robot", link), BodyRef("scene", None, piece), least + CLEARANCE_RESERVE_M)
            for link, piece, least in self.distances.list_padded(robot, scene)
            if least + CLEARANCE_RESERVE_M > self.margin
        )
