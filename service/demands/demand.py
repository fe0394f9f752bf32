"""The demands of a request on every motion that answers it, free of choices that a planner makes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from costs.robot import RobotModel
from costs.scene import Scene
from service.demands.program import ProgramDemand
from service.demands.stance import list_planted_feet
from service.demands.wheel import Wheel
from service.request.schema import PlanRequest


@dataclass(frozen=True)
class Demands:
    """Demands of a request on every motion that answers it.

    Attributes:
        request: the request.
        robot: the robot without the mechanism that a task moves.
        start: (n,) configuration at the start.
        scene: all pieces, floors included.
        program: demands of the request's TrajOpt problem, or None.
        wheel: wheel of the valve to turn, or None.
    """

    request: PlanRequest
    robot: RobotModel
    start: Float[np.ndarray, "n"]
    scene: Scene
    program: ProgramDemand | None = None
    wheel: Wheel | None = None

    @property
    def feet(self) -> tuple[str, ...]:
        """Planted links."""
        if self.program is not None:
            return self.program.planted
        return list_planted_feet(self.robot, self.request.options.feet)
